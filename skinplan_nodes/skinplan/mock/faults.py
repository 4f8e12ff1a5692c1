"""Faults on demand: at a time of the cell's clock, at a place in the shop, for a while."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

from skinplan.errors import FaultUnknownError, InputError
from skinplan.transforms import Array

PROCESS_KILLED = "process_killed"
_RADIUS_M = 0.5
_FORM = "name[@time_s][+duration_s][;key=value]"


@dataclass(frozen=True)
class FaultKind:
    """A fault that a device can have.

    Attributes:
        name: Its name.
        values: Its values by name: default, least, greatest.
        at_once: It is over as soon as it has begun.
    """

    name: str
    values: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    at_once: bool = False


@dataclass(frozen=True)
class Fault:
    """One order to fail.

    Attributes:
        name: Name of the fault.
        at_s: It begins at this time of the cell's clock [s]; 0 = now.
        duration_s: It ends by itself after so long [s]; 0 = it lasts until it is ended.
        place: With a radius: it begins when the device is near this place, frame map [m].
        radius_m: How near [m]; 0 = the place does not count.
        values: Values of the fault by name.
    """

    name: str
    at_s: float = 0.0
    duration_s: float = 0.0
    place: tuple[float, float, float] = (0.0, 0.0, 0.0)
    radius_m: float = 0.0
    values: Mapping[str, float] = field(default_factory=dict)


def parse_fault(text: str) -> Fault:
    """Reads a fault as it stands in a parameter.

    Args:
        text: ``name[@time_s][+duration_s][;key=value]``; the keys ``place`` (``x,y`` or ``x,y,z``
            [m]) and ``radius`` [m] say where, the others are the fault's own.

    Raises:
        InputError: It is written otherwise.
    """
    head, *pairs = text.split(";")
    head, plus, duration = head.partition("+")
    name, at, begin = head.partition("@")
    if not name.isidentifier():
        raise InputError(f"a fault as {_FORM} is accepted, found {text!r}")
    fault = Fault(
        name,
        _number(begin, text) if at else 0.0,
        _number(duration, text) if plus else 0.0,
    )
    seen: dict[str, str] = {}
    for pair in pairs:
        key, equals, value = pair.partition("=")
        if not equals or not key.isidentifier() or key in seen:
            raise InputError(f"a fault as {_FORM}, every key once, is accepted, found {text!r}")
        seen[key] = value
    place = seen.pop("place", None)
    radius = seen.pop("radius", None)
    if place is not None:
        reach = _RADIUS_M if radius is None else _number(radius, text)
        fault = replace(fault, place=_place(place, text), radius_m=reach)
    elif radius is not None:
        raise InputError(f"a radius goes with a place, found {text!r}")
    return replace(fault, values={key: _number(value, text) for key, value in seen.items()})


class FaultBook:
    """The faults of one device or of all devices of a node.

    Args:
        kinds: What can be asked for; `PROCESS_KILLED` is always among it.
        owner: Whose faults they are, for messages.
    """

    def __init__(self, kinds: Iterable[FaultKind], owner: str) -> None:
        every = (*kinds, FaultKind(PROCESS_KILLED, at_once=True))
        self._kinds = {kind.name: kind for kind in every}
        self._owner = owner
        self._pending: list[Fault] = []
        # Active faults by name, and when each ends [s].
        self._active: dict[str, tuple[Fault, float]] = {}
        self._ended: list[str] = []

    @property
    def active(self) -> list[str]:
        """Names of the faults that are active."""
        return list(self._active)

    @property
    def pending(self) -> list[str]:
        """Names of the faults that wait for their time or place."""
        return [fault.name for fault in self._pending]

    def add(self, fault: Fault) -> None:
        """Notes a fault; `step` lets it begin.

        Raises:
            FaultUnknownError: There is no such fault.
            InputError: A time, place or value that can't be used.
        """
        kind = self._kinds.get(fault.name)
        if kind is None:
            raise FaultUnknownError(
                f"fault {fault.name!r} of {self._owner} was asked for; {sorted(self._kinds)} are "
                f"accepted"
            )
        for name in ("at_s", "duration_s", "radius_m"):
            value = getattr(fault, name)
            if not (math.isfinite(value) and value >= 0.0):
                raise InputError(f"{fault.name}: {name} >= 0 is accepted, found {value}")
        if not all(map(math.isfinite, fault.place)):
            raise InputError(f"{fault.name}: a finite place is accepted, found {fault.place}")
        self._pending.append(replace(fault, values=self._values(kind, fault)))

    def clear(self) -> None:
        """Ends all faults and forgets those that wait."""
        self._pending.clear()
        self._ended.extend(self._active)
        self._active.clear()

    def values(self, name: str) -> Mapping[str, float] | None:
        """Returns the values of a fault that is active; None = it is not."""
        entry = self._active.get(name)
        return None if entry is None else entry[0].values

    def step(self, now_s: float, place: Array | None = None) -> tuple[list[Fault], list[str]]:
        """Lets begin and end what is due.

        Args:
            now_s: Time on the cell's clock [s].
            place: Where the device is, frame map, shape (3,) [m]; None = not known.

        Returns:
            The faults that began, and the names of those that ended.
        """
        ended, self._ended = self._ended, []
        over = [name for name, (_, end_s) in self._active.items() if now_s >= end_s]
        for name in over:
            del self._active[name]
        begun = [fault for fault in self._pending if _is_due(fault, now_s, place)]
        for fault in begun:
            self._pending.remove(fault)
            if not self._kinds[fault.name].at_once:
                end_s = now_s + fault.duration_s if fault.duration_s else math.inf
                self._active[fault.name] = fault, end_s
        return begun, ended + [name for name in over if name not in self._active]

    def _values(self, kind: FaultKind, fault: Fault) -> dict[str, float]:
        unknown = sorted(set(fault.values) - set(kind.values))
        if unknown:
            raise InputError(
                f"{fault.name}: the values {sorted(kind.values)} are accepted, found {unknown}"
            )
        found = {}
        for name, (default, least, most) in kind.values.items():
            value = fault.values.get(name, default)
            if not least <= value <= most:
                raise InputError(
                    f"{fault.name}: {name} from {least:g} to {most:g} is accepted, found {value:g}"
                )
            found[name] = value
        return found


def _is_due(fault: Fault, now_s: float, place: Array | None) -> bool:
    if now_s < fault.at_s:
        return False
    if fault.radius_m == 0.0:
        return True
    return place is not None and math.dist(fault.place, place) <= fault.radius_m


def _number(text: str, whole: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"a fault as {_FORM} with finite numbers is accepted, found {whole!r}")
    return value


def _place(text: str, whole: str) -> tuple[float, float, float]:
    numbers = [_number(item, whole) for item in text.split(",")]
    if len(numbers) not in (2, 3):
        raise InputError(f"a place as x,y or x,y,z is accepted, found {whole!r}")
    x, y, z = (*numbers, 0.0)[:3]
    return x, y, z
