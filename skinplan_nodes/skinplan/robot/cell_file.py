"""The cell file: a `CellConfig` as YAML.

Keys are the dataclass' names; what is left out has its default; unknown keys are refused.
Transforms are ``{translation_m: [x, y, z], rotation_xyzw: [x, y, z, w]}``.

::

    robot: ur5
    home_rad: [1.4, -2.4, 2.1, 0.3, 1.4, -1.5707963]
    T_base_link_arm_base: {translation_m: [0, 0, 1.0]}
    T_map_tracker: null  # not given: planning stations proposes a place
    camera: {width: 1280, height: 720, K: [915, 0, 640, 0, 915, 360, 0, 0, 1], D: [0, 0, 0, 0, 0]}
    quality: {alpha: 0.5, threshold: 0.85}
    tracker: {range_min_m: 1.0, range_max_m: 6.0, cone_rad: 0.87, targets: 8, targets_least: 3}
    obstacles:
      - {name: wall, size_m: [4.0, 0.2, 3.0], T_map_box: {translation_m: [0, 2.0, 1.5]}}
"""

from dataclasses import fields as members
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from skinplan.errors import CellInvalidError, PartInvalidError
from skinplan.part.fields import Fields
from skinplan.robot.cell_model import (
    CameraConfig,
    CellConfig,
    Obstacle,
    QualitySettings,
    TrackerSettings,
)

_LARGEST_FILE_BYTES = 1_000_000
# Accepted ranges: key -> lower, upper, in words.
_NUMBERS = {
    "velocity_max_rad_s": (1e-3, 50.0, "a number in (0, 50] [rad/s]"),
    "acceleration_max_rad_s2": (1e-3, 500.0, "a number in (0, 500] [rad/s^2]"),
    "scanner_radius_m": (0.0, 1.0, "a number in [0, 1] [m]"),
    "base_speed_m_s": (1e-3, 5.0, "a number in (0, 5] [m/s]"),
    "base_error_m": (0.0, 1.0, "a number in [0, 1] [m]"),
    "base_error_rad": (0.0, 0.5, "a number in [0, 0.5] [rad]"),
    "collision_margin_m": (0.0, 0.2, "a number in [0, 0.2] [m]"),
    "settle_s": (0.0, 600.0, "a number in [0, 600] [s]"),
}
_QUALITY = {
    "alpha": (0.0, 1.0, "a number in [0, 1]"),
    "distance_min_m": (0.05, 20.0, "a number in [0.05, 20] [m]"),
    "distance_max_m": (0.05, 50.0, "a number in [0.05, 50] [m]"),
    "threshold": (0.0, 1.0, "a number in [0, 1]"),
}
_TRACKER = {
    "range_min_m": (0.0, 50.0, "a number in [0, 50] [m]"),
    "range_max_m": (0.1, 100.0, "a number in [0.1, 100] [m]"),
    "cone_rad": (0.01, 3.2, "half an angle in [0.01, 3.2] [rad]"),
    "ring_radius_m": (0.0, 1.0, "a number in [0, 1] [m]"),
}
_MOUNTING = {
    "mounting_error_m": (0.0, 0.1, "a number in [0, 0.1] [m]"),
    "mounting_error_rad": (0.0, 0.1, "a number in [0, 0.1] [rad]"),
}
_CORNER_FINDERS = ("auto", "lines", "subpix")
_MOST_OBSTACLES = 100
_KEYS = [m.name for m in members(CellConfig) if m.name != "propose_tracker"]
_POSES = ("T_base_link_arm_base", "T_tool0_scanner", "T_map_tracker", "T_map_work")


def load_cell(path: Path | str | None = None) -> CellConfig:
    """Reads a cell file.

    Args:
        path: The YAML file; None = the default cell.

    Returns:
        The cell.

    Raises:
        CellInvalidError: No such file, a key is unknown, or a value is out of range.
    """
    if path is None:
        return CellConfig()
    file = Path(path)
    try:
        return _read(Fields(_read_yaml(file), "", file.name, _KEYS))
    except PartInvalidError as error:  # the reader of part files is used for the keys
        raise CellInvalidError(str(error)) from error


def _read_yaml(file: Path) -> object:
    if not file.is_file():
        raise CellInvalidError(f"no cell file {file}; a YAML file is accepted")
    if file.stat().st_size > _LARGEST_FILE_BYTES:
        raise CellInvalidError(
            f"{file.name} has {file.stat().st_size} bytes; a YAML file below 1 MB is accepted"
        )
    try:
        values = yaml.safe_load(file.read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError, OSError) as error:
        raise CellInvalidError(f"{file.name} is no readable YAML: {error}") from error
    return {} if values is None else values


def _read(fields: Fields) -> CellConfig:
    values: dict[str, Any] = {
        key: fields.number(key, *_NUMBERS[key]) for key in _NUMBERS if fields.has(key)
    }
    values["propose_tracker"] = fields.values.get("T_map_tracker", "") is None
    poses = [key for key in _POSES if key != "T_map_tracker" or not values["propose_tracker"]]
    values |= {key: fields.pose(key) for key in poses if fields.has(key)}
    if fields.has("robot"):
        values["robot"] = fields.text("robot", "the name of an arm model")
    if fields.has("home_rad"):
        values["home_rad"] = tuple(
            fields.vector("home_rad", 6, "six joint positions [rad]").tolist()
        )
    if fields.has("base_size_m"):
        size = fields.vector("base_size_m", 3, "length, width, height [m]")
        if np.any(size <= 0.0) or np.any(size > 10.0):
            raise fields.error("base_size_m", str(size.tolist()), "three numbers in (0, 10] [m]")
        values["base_size_m"] = tuple(size.tolist())
    if fields.has("camera"):
        values["camera"] = _read_camera(fields)
    if fields.has("quality"):
        values["quality"] = _read_quality(fields)
    if fields.has("tracker"):
        values["tracker"] = _read_tracker(fields)
    if fields.has("obstacles"):
        values["obstacles"] = _read_obstacles(fields)
    return CellConfig(**values)


def _read_tracker(fields: Fields) -> TrackerSettings:
    names = [m.name for m in members(TrackerSettings)]
    inner = Fields(fields.values["tracker"], "tracker", fields.source, names)
    values: dict[str, Any] = {
        key: inner.number(key, *_TRACKER[key]) for key in _TRACKER if inner.has(key)
    }
    values |= {
        key: inner.integer(key, 1, 64) for key in ("targets", "targets_least") if inner.has(key)
    }
    tracker = TrackerSettings(**values)
    if tracker.range_min_m >= tracker.range_max_m:
        found = f"{tracker.range_min_m} and range_max_m {tracker.range_max_m}"
        raise inner.error("range_min_m", found, "range_min_m below range_max_m")
    if tracker.targets_least > tracker.targets:
        found = f"{tracker.targets_least} of {tracker.targets} targets"
        raise inner.error("targets_least", found, "no more than there are targets")
    return tracker


def _read_obstacles(fields: Fields) -> tuple[Obstacle, ...]:
    given = fields.values["obstacles"]
    if not isinstance(given, list) or len(given) > _MOST_OBSTACLES:
        raise fields.error("obstacles", str(given)[:80], f"a list of at most {_MOST_OBSTACLES}")
    names = [m.name for m in members(Obstacle)]
    result = []
    for number, values in enumerate(given):
        inner = Fields(values, f"obstacles[{number}]", fields.source, names)
        size = inner.vector("size_m", 3, "three extents [m]")
        if np.any(size <= 0.0) or np.any(size > 100.0):
            raise inner.error("size_m", str(size.tolist()), "three numbers in (0, 100] [m]")
        name = inner.text("name", "what the obstacle is")
        result.append(Obstacle(name, inner.pose("T_map_box"), tuple(size.tolist())))
    return tuple(result)


def _read_camera(fields: Fields) -> CameraConfig:
    names = [m.name for m in members(CameraConfig)]
    inner = Fields(fields.values["camera"], "camera", fields.source, names)
    values: dict[str, Any] = {
        key: inner.integer(key, 16, 20000) for key in ("width", "height") if inner.has(key)
    }
    if inner.has("K"):
        accepted = "nine numbers, row by row, focal lengths > 0 [px]"
        values["K"] = inner.vector("K", 9, accepted).reshape(3, 3)
        if values["K"][0, 0] <= 0.0 or values["K"][1, 1] <= 0.0:
            raise inner.error("K", str(inner.values["K"]), accepted)
    if inner.has("D"):
        accepted = "distortion coefficients, five (plumb_bob) or eight (rational_polynomial)"
        given = inner.values["D"]
        count = 8 if isinstance(given, list) and len(given) == 8 else 5
        values["D"] = inner.vector("D", count, accepted)
    if inner.has("T_base_link_camera_link"):
        values["T_base_link_camera_link"] = inner.pose("T_base_link_camera_link")
    values |= {key: inner.number(key, *_MOUNTING[key]) for key in _MOUNTING if inner.has(key)}
    if inner.has("corners"):
        accepted = f"one of {', '.join(_CORNER_FINDERS)}"
        values["corners"] = inner.text("corners", accepted)
        if values["corners"] not in _CORNER_FINDERS:
            raise inner.error("corners", repr(values["corners"]), accepted)
    return CameraConfig(**values)


def _read_quality(fields: Fields) -> QualitySettings:
    names = [m.name for m in members(QualitySettings)]
    inner = Fields(fields.values["quality"], "quality", fields.source, names)
    values: dict[str, Any] = {
        key: inner.number(key, *_QUALITY[key]) for key in _QUALITY if inner.has(key)
    }
    if inner.has("max_attempts"):
        values["max_attempts"] = inner.integer("max_attempts", 1, 1000)
    quality = QualitySettings(**values)
    if quality.distance_min_m >= quality.distance_max_m:
        found = f"{quality.distance_min_m} and distance_max_m {quality.distance_max_m}"
        raise inner.error("distance_min_m", found, "distance_min_m below distance_max_m")
    return quality
