"""The file with which a person overrides the QoS of topics that are played, as rosbag2 has it."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import yaml

from skinplan.errors import InputError
from skinplan.recording.qos import INFINITE_NS, QosProfile

_LARGEST = 2**20
_CHOICES = {
    "history": ("keep_last", "keep_all", "system_default"),
    "reliability": ("reliable", "best_effort", "system_default"),
    "durability": ("transient_local", "volatile", "system_default"),
    "liveliness": ("automatic", "manual_by_topic", "system_default"),
}
# Key of the file -> field of the profile.
_DURATIONS = {
    "deadline": "deadline_ns",
    "lifespan": "lifespan_ns",
    "liveliness_lease_duration": "liveliness_lease_ns",
}


def read_overrides(path: Path) -> dict[str, Callable[[QosProfile], QosProfile]]:
    """Reads a file of overrides.

    Args:
        path: YAML file: topic -> policy -> value, durations as ``{sec: 1, nsec: 0}``.

    Returns:
        Topic -> what changes a profile; policies that the file does not name stay.

    Raises:
        InputError: The file can't be read, or has an unknown policy or value.
    """
    try:
        if path.stat().st_size > _LARGEST:
            raise InputError(f"{path}: QoS overrides of up to {_LARGEST} bytes are accepted")
        document = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError, yaml.YAMLError) as error:
        raise InputError(f"{path}: a YAML file of QoS overrides is accepted ({error})") from error
    if not isinstance(document, dict) or not all(isinstance(key, str) for key in document):
        raise InputError(f"{path}: a mapping from topics to QoS policies is accepted")
    return {topic: _change(path, topic, given) for topic, given in document.items()}


def _change(path: Path, topic: str, given: Any) -> Callable[[QosProfile], QosProfile]:
    if not isinstance(given, dict):
        raise InputError(f"{path}: {topic}: a mapping of QoS policies is accepted")
    fields = dict(_field(f"{path}: {topic}", str(key), value) for key, value in given.items())
    return lambda profile: replace(profile, **fields)


def _field(where: str, key: str, value: Any) -> tuple[str, Any]:
    if key in _CHOICES:
        if value not in _CHOICES[key]:
            raise InputError(
                f"{where}: {key}: {', '.join(_CHOICES[key])} are accepted, found {value!r}"
            )
        return key, value
    if key == "depth":
        if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < 2**31:
            raise InputError(f"{where}: depth: a whole number from 0 is accepted, found {value!r}")
        return key, value
    if key == "avoid_ros_namespace_conventions":
        if not isinstance(value, bool):
            raise InputError(f"{where}: {key}: true or false is accepted, found {value!r}")
        return key, value
    if key in _DURATIONS:
        return _DURATIONS[key], _nanoseconds(f"{where}: {key}", value)
    known = [*_CHOICES, "depth", *_DURATIONS, "avoid_ros_namespace_conventions"]
    raise InputError(f"{where}: the policies {', '.join(known)} are accepted, found {key!r}")


def _nanoseconds(where: str, value: Any) -> int:
    parts = value if isinstance(value, Mapping) else {}
    sec, nsec = parts.get("sec"), parts.get("nsec")
    if not (isinstance(sec, int) and isinstance(nsec, int) and sec >= 0 and nsec >= 0):
        raise InputError(f"{where}: sec and nsec from 0 are accepted, found {value!r}")
    return min(sec * 10**9 + nsec, INFINITE_NS)
