"""Bounds of the scan settings, for part files, services and commands alike."""

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from skinplan.part.fields import Fields
from skinplan.part.model import ScanSettings


@dataclass(frozen=True)
class _Bound:
    """Accepted range of a number: [low, high]."""

    low: float
    high: float
    unit: str

    @property
    def text(self) -> str:
        return f"a number from {self.low:g} to {self.high:.6g} [{self.unit}]"


_NUMBERS = {
    "sensitivity": _Bound(0.0, 50.0, "1"),
    "overlap_ratio": _Bound(0.0, 0.98, "1"),
    "field_radius_m": _Bound(0.005, 2.0, "m"),
    "standoff_m": _Bound(0.01, 5.0, "m"),
    "range_min_m": _Bound(0.001, 5.0, "m"),
    "range_max_m": _Bound(0.01, 10.0, "m"),
    "incidence_max_rad": _Bound(0.05, math.pi / 2, "rad"),
    "tilt_max_rad": _Bound(0.0, math.pi / 3, "rad"),
    "clearance_m": _Bound(0.0, 5.0, "m"),
    "tcp_speed_m_s": _Bound(0.001, 5.0, "m/s"),
    "frame_rate_hz": _Bound(0.1, 10_000.0, "Hz"),
    "tour_effort_s": _Bound(0.0, 600.0, "s"),
    "incidence_margin_rad": _Bound(0.0, 0.5, "rad"),
    "field_margin_m": _Bound(0.0, 0.5, "m"),
    "patch_angle_rad": _Bound(0.05, 1.4, "rad"),
    "footprint_m": _Bound(0.005, 4.0, "m"),
    "tool_tilt_rad": _Bound(-math.pi / 3, math.pi / 3, "rad"),
    "merge_gap_m": _Bound(0.0, 2.0, "m"),
}
_FIELDS_OF_VIEW = ("cylinder", "cone")
_MOST_VIEWS = 1000
_STRATEGIES = ("strategy", "station_strategy", "order_strategy", "timing")
SCAN_KEYS = tuple(field.name for field in dataclasses.fields(ScanSettings))


def read_settings(values: object, place: str, source: str) -> ScanSettings:
    """Makes scan settings from a mapping; what is left out keeps its default.

    Args:
        values: Mapping with keys of `ScanSettings`.
        place: Where it stands, for messages.
        source: Name of the file or request, for messages.

    Returns:
        Checked settings.

    Raises:
        PartInvalidError: An unknown key, or a value out of range.
    """
    fields = Fields(values, place, source, SCAN_KEYS)
    found: dict[str, object] = {}
    for key, bound in _NUMBERS.items():
        if fields.has(key):
            found[key] = fields.number(key, bound.low, bound.high, bound.text)
    for key in _STRATEGIES:
        if fields.has(key):
            found[key] = fields.text(key, "the name of a strategy")
    if fields.has("least_views"):
        found["least_views"] = fields.integer("least_views", 1, _MOST_VIEWS)
    if fields.has("field_of_view"):
        found["field_of_view"] = _field_of_view(fields)
    if fields.has("optimise_passes"):
        found["optimise_passes"] = fields.flag("optimise_passes")
    if fields.has("row_direction"):
        found["row_direction"] = _direction(fields)
    settings = ScanSettings(**found)  # type: ignore[arg-type]
    _check_together(settings, fields)
    return settings


def check_settings(settings: ScanSettings, source: str = "scan settings") -> ScanSettings:
    """Returns the settings, with the row direction as unit vector, or says what is wrong with them.

    Raises:
        PartInvalidError: A value out of range.
    """
    return read_settings(settings_fields(settings), "", source)


def settings_fields(settings: ScanSettings) -> dict[str, object]:
    """Returns settings in the form in which `read_settings` reads them."""
    values = dataclasses.asdict(settings)
    if values["row_direction"] is not None:
        values["row_direction"] = [float(x) for x in values["row_direction"]]
    return values


def _field_of_view(fields: Fields) -> str:
    accepted = " or ".join(_FIELDS_OF_VIEW)
    name = fields.text("field_of_view", accepted)
    if name not in _FIELDS_OF_VIEW:
        raise fields.error("field_of_view", repr(name), accepted)
    return name


def _direction(fields: Fields) -> tuple[float, float, float]:
    accepted = "three numbers, the direction of the rows in the workpiece frame, not all zero"
    vector = fields.vector("row_direction", 3, accepted)
    length = float(np.linalg.norm(vector))
    if length < 1e-6:
        raise fields.error("row_direction", str(vector.tolist()), accepted)
    # A unit vector stays as it is, so that reading what was written changes nothing.
    unit = vector if abs(length - 1.0) < 1e-12 else vector / length
    return (float(unit[0]), float(unit[1]), float(unit[2]))


def _check_together(settings: ScanSettings, fields: Fields) -> None:
    if settings.range_min_m >= settings.range_max_m:
        raise fields.error(
            "range_min_m",
            f"{settings.range_min_m:g}",
            f"less than range_max_m, {settings.range_max_m:g}",
        )
    if not settings.range_min_m <= settings.standoff_m <= settings.range_max_m:
        raise fields.error(
            "standoff_m",
            f"{settings.standoff_m:g}",
            f"inside the scanner's range, {settings.range_min_m:g} to {settings.range_max_m:g} m",
        )
    room = min(settings.field_radius_m, (settings.range_max_m - settings.range_min_m) / 2)
    if settings.field_margin_m >= room:
        raise fields.error(
            "field_margin_m",
            f"{settings.field_margin_m:g}",
            f"less than field_radius_m and than half the scanner's range, {room:g}",
        )
    if settings.incidence_margin_rad >= settings.incidence_max_rad:
        raise fields.error(
            "incidence_margin_rad",
            f"{settings.incidence_margin_rad:g}",
            f"less than incidence_max_rad, {settings.incidence_max_rad:g}",
        )
    if settings.clearance_m >= settings.standoff_m:
        raise fields.error(
            "clearance_m",
            f"{settings.clearance_m:g}",
            f"less than standoff_m, {settings.standoff_m:g}",
        )
    if settings.strategy == "patches":
        _check_patches(settings, fields)


def _check_patches(settings: ScanSettings, fields: Fields) -> None:
    """What the other strategies do not read is not held against them."""
    widest = 2.0 * settings.field_radius_m
    if settings.footprint_m is not None and settings.footprint_m > widest:
        raise fields.error(
            "footprint_m",
            f"{settings.footprint_m:g}",
            f"at most twice field_radius_m, {widest:g}: rows farther apart leave strips",
        )
    tilt, limit = abs(settings.tool_tilt_rad), settings.incidence_max_rad
    if tilt >= limit:
        raise fields.error(
            "tool_tilt_rad",
            f"{settings.tool_tilt_rad:g}",
            f"less than incidence_max_rad, {limit:g}, to either side",
        )
    if settings.patch_angle_rad + tilt > limit:
        raise fields.error(
            "patch_angle_rad",
            f"{settings.patch_angle_rad:g}",
            f"at most incidence_max_rad less the tilt of the tool, {limit - tilt:g}",
        )
