"""Offered QoS in the form in which rosbag2 keeps it.

A YAML sequence, with names from metadata version 9 on.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import yaml

from skinplan.errors import BagInvalidError

INFINITE_NS = 2**63 - 1
# Longer texts are no profiles that anybody offers; they are read, but not kept.
_LONGEST_KEPT = 4096

# rmw's numbers, which metadata up to version 8 has in the place of names.
_HISTORY = ("system_default", "keep_last", "keep_all", "unknown")
_RELIABILITY = ("system_default", "reliable", "best_effort", "unknown", "best_available")
_DURABILITY = ("system_default", "transient_local", "volatile", "unknown", "best_available")
_LIVELINESS = (
    "system_default",
    "automatic",
    "manual_by_node",
    "manual_by_topic",
    "unknown",
    "best_available",
)


@dataclass(frozen=True)
class QosProfile:
    """The QoS that one publisher offers.

    Attributes:
        history: ``keep_last``, ``keep_all``, ``system_default`` or ``unknown``.
        depth: Queue depth of ``keep_last``.
        reliability: ``reliable``, ``best_effort``, ``system_default``, ``best_available`` or
            ``unknown``.
        durability: ``transient_local``, ``volatile``, ``system_default``, ``best_available`` or
            ``unknown``.
        deadline_ns: [ns]; `INFINITE_NS` = none.
        lifespan_ns: [ns]; `INFINITE_NS` = none.
        liveliness: ``automatic``, ``manual_by_topic``, ``system_default``, ``best_available`` or
            ``unknown``.
        liveliness_lease_ns: [ns]; `INFINITE_NS` = none.
        avoid_ros_namespace_conventions: Topic name is used as it is.
    """

    history: str = "keep_last"
    depth: int = 10
    reliability: str = "reliable"
    durability: str = "volatile"
    deadline_ns: int = INFINITE_NS
    lifespan_ns: int = INFINITE_NS
    liveliness: str = "automatic"
    liveliness_lease_ns: int = INFINITE_NS
    avoid_ros_namespace_conventions: bool = False

    @property
    def latched(self) -> bool:
        """Whether late subscribers get the last message."""
        return self.durability == "transient_local"


def qos_document(profiles: tuple[QosProfile, ...]) -> list[dict[str, Any]]:
    """Returns the profiles as rosbag2's YAML nodes (metadata version 9)."""
    return [
        {
            "history": profile.history,
            "depth": profile.depth,
            "reliability": profile.reliability,
            "durability": profile.durability,
            "deadline": _duration(profile.deadline_ns),
            "lifespan": _duration(profile.lifespan_ns),
            "liveliness": profile.liveliness,
            "liveliness_lease_duration": _duration(profile.liveliness_lease_ns),
            "avoid_ros_namespace_conventions": profile.avoid_ros_namespace_conventions,
        }
        for profile in profiles
    ]


def qos_text(profiles: tuple[QosProfile, ...]) -> str:
    """Returns the profiles as the text of a channel's ``offered_qos_profiles``."""
    return str(yaml.safe_dump(qos_document(profiles), sort_keys=False)).rstrip("\n")


def qos_profiles(node: object) -> tuple[QosProfile, ...]:
    """Reads profiles of any metadata version.

    Args:
        node: The text of a channel or of metadata up to version 8, or the YAML sequence of version
            9; empty = none.

    Returns:
        The profiles, empty when none were recorded.

    Raises:
        BagInvalidError: The text is no YAML sequence of profiles.
    """
    if isinstance(node, str):
        return _of_text(node) if len(node) < _LONGEST_KEPT else _of_text.__wrapped__(node)
    return _of_node(node)


@lru_cache(maxsize=256)
def _of_text(text: str) -> tuple[QosProfile, ...]:
    """A bag has tens of topics with a handful of profiles, each 5 ms of YAML."""
    try:
        node = yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise BagInvalidError(
            f"offered_qos_profiles: a YAML sequence is accepted, found {error}"
        ) from error
    return _of_node(node)


def _of_node(node: object) -> tuple[QosProfile, ...]:
    if not node:
        return ()
    if not isinstance(node, list):
        raise BagInvalidError(
            f"offered_qos_profiles: a YAML sequence is accepted, found {type(node).__name__}"
        )
    return tuple(_profile(item) for item in node)


def _profile(item: Any) -> QosProfile:
    try:
        return QosProfile(
            history=_named(item["history"], _HISTORY),
            depth=int(item["depth"]),
            reliability=_named(item["reliability"], _RELIABILITY),
            durability=_named(item["durability"], _DURABILITY),
            deadline_ns=_nanoseconds(item["deadline"]),
            lifespan_ns=_nanoseconds(item["lifespan"]),
            liveliness=_named(item["liveliness"], _LIVELINESS),
            liveliness_lease_ns=_nanoseconds(item["liveliness_lease_duration"]),
            avoid_ros_namespace_conventions=bool(item["avoid_ros_namespace_conventions"]),
        )
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise BagInvalidError(
            "offered_qos_profiles: a profile with rosbag2's keys is accepted, found "
            f"{str(item)[:120]}"
        ) from error


def _named(value: Any, names: tuple[str, ...]) -> str:
    if isinstance(value, int):
        return names[value] if 0 <= value < len(names) else "unknown"
    return str(value)


def _duration(nanoseconds: int) -> dict[str, int]:
    return {"sec": nanoseconds // 10**9, "nsec": nanoseconds % 10**9}


def _nanoseconds(node: Any) -> int:
    # Some middlewares wrote larger figures for "infinite": they all mean none.
    total = int(node["sec"]) * 10**9 + int(node["nsec"])
    return INFINITE_NS if int(node["sec"]) >= 0x7FFFFFFF else total
