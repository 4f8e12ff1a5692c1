"""Reading a mapping of a part file key by key, so that every mistake is named with its place."""

import difflib
import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from skinplan.errors import PartInvalidError
from skinplan.transforms import Array, quaternion, transform


class Fields:
    """One mapping of a part file, with the place it stands at.

    Attributes:
        values: The mapping.
        place: Where it stands, for messages (``scan``, ``fixture.markers[1]``; empty = top level).
        source: Name of the file, for messages.
    """

    def __init__(self, values: object, place: str, source: str, known: Iterable[str]) -> None:
        """Checks that it is a mapping and has only known keys.

        Args:
            values: What the file has there.
            place: Where it stands.
            source: Name of the file.
            known: The accepted keys.

        Raises:
            PartInvalidError: It is no mapping, or a key is unknown.
        """
        self.place = place
        self.source = source
        accepted = sorted(known)
        if not isinstance(values, Mapping):
            raise self.error("", _named(values), f"a mapping with the keys {', '.join(accepted)}")
        self.values: Mapping[str, Any] = values
        for key in values:
            if key not in accepted:
                raise self._unknown(str(key), accepted)

    def error(self, key: str, found: str, accepted: str) -> PartInvalidError:
        """Returns the error for a key: what was found and what would be accepted."""
        return PartInvalidError(
            f"{self.source}: {self.path(key)}: found {found}; accepted is {accepted}"
        )

    def path(self, key: str) -> str:
        """Returns the full name of a key."""
        return ".".join(part for part in (self.place, key) if part) or "the file"

    def has(self, key: str) -> bool:
        """Says whether the key is given and not null."""
        return self.values.get(key) is not None

    def text(self, key: str, accepted: str = "a text") -> str:
        """Returns a text that must be given."""
        value = self._required(key, accepted)
        if not isinstance(value, str) or not value.strip():
            raise self.error(key, _named(value), accepted)
        return value

    def number(self, key: str, low: float, high: float, accepted: str) -> float:
        """Returns a number in [low, high] that must be given."""
        value = self._required(key, accepted)
        if not _is_number(value) or not low <= value <= high:
            raise self.error(key, _named(value), accepted)
        return float(value)

    def integer(self, key: str, low: int, high: int) -> int:
        """Returns a whole number in [low, high] that must be given."""
        accepted = f"a whole number from {low} to {high}"
        value = self._required(key, accepted)
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
            raise self.error(key, _named(value), accepted)
        return value

    def flag(self, key: str) -> bool:
        """Returns true or false, which must be given."""
        value = self._required(key, "true or false")
        if not isinstance(value, bool):
            raise self.error(key, _named(value), "true or false")
        return value

    def vector(self, key: str, length: int, accepted: str) -> Array:
        """Returns a list of finite numbers that must be given, shape (length,)."""
        value = self._required(key, accepted)
        if not isinstance(value, list) or len(value) != length or not all(map(_is_number, value)):
            raise self.error(key, _named(value), accepted)
        return np.array(value, dtype=float)

    def pose(self, key: str) -> Array:
        """Returns a rigid transform given as ``{translation_m, rotation_xyzw}``, shape (4, 4) [m].

        The rotation may be left out (none).
        """
        inner = Fields(
            self._required(key, "a pose: translation_m, rotation_xyzw"),
            self.path(key),
            self.source,
            ("translation_m", "rotation_xyzw"),
        )
        translation = inner.vector("translation_m", 3, "three numbers [m]")
        if not inner.has("rotation_xyzw"):
            return transform(translation)
        accepted = "a unit quaternion (x, y, z, w)"
        rotation = inner.vector("rotation_xyzw", 4, accepted)
        if abs(np.linalg.norm(rotation) - 1.0) > 1e-3:
            raise inner.error("rotation_xyzw", _named(rotation.tolist()), accepted)
        return transform(translation, rotation)

    def _required(self, key: str, accepted: str) -> Any:
        if self.values.get(key) is None:
            raise self.error(key, "nothing", accepted)
        return self.values[key]

    def _unknown(self, key: str, accepted: list[str]) -> PartInvalidError:
        near = difflib.get_close_matches(key, accepted, n=1, cutoff=0.5)
        hint = f" (did you mean {near[0]}?)" if near else ""
        return PartInvalidError(
            f"{self.source}: unknown key {self.path(key)}{hint}; accepted are {', '.join(accepted)}"
        )


def pose_fields(T_a_b: Array) -> dict[str, list[float]]:
    """Returns the form in which `Fields.pose` reads a rigid transform, shape (4, 4) [m]."""
    rounded = np.round(np.concatenate([T_a_b[:3, 3], quaternion(T_a_b)]), 12) + 0.0
    return {"translation_m": rounded[:3].tolist(), "rotation_xyzw": rounded[3:].tolist()}


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def _named(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
