"""What a part is judged by: tolerances and characteristics of its part file.

::

    inspection:
      deviation_max_m: 0.0005        # largest local deviation, either side; left out: not judged
      area_ratio_min: 0.95           # share of the area that must be measured
      characteristics:
        - id: skin                   # profile of a surface: tolerance_m is the width of its zone
          kind: profile
          tolerance_m: 0.001
        - id: seat                   # all but `points` may be limited to a ball
          kind: flatness
          tolerance_m: 0.0002
          centre_m: [0.1, 0, 0.02]
          radius_m: 0.05
        - id: knob
          kind: sphere_diameter      # tolerance_m: largest difference from nominal_m
          nominal_m: 0.06
          tolerance_m: 0.0001
          centre_m: [0.4, 0.1, 0.03]
          radius_m: 0.04
        - id: gauge                  # the measuring points (`points`), one by one
          kind: points
          tolerance_m: 0.001
"""

import math
import re
from dataclasses import dataclass

from skinplan.part.fields import Fields

KINDS = ("profile", "flatness", "sphere_diameter", "points")
_ID = re.compile(r"[A-Za-z0-9_.-]{1,64}")
_KEYS = ("deviation_max_m", "area_ratio_min", "characteristics")
_ONE = ("id", "kind", "tolerance_m", "nominal_m", "centre_m", "radius_m")
_MOST = 1000
_TOLERANCE = "a tolerance above 0, up to 0.1 [m]"


@dataclass(frozen=True)
class Characteristic:
    """One thing that is asked of the part.

    Attributes:
        id: Its name, [A-Za-z0-9_.-].
        kind: One of `KINDS`.
        tolerance_m: ``profile`` and ``points``: width of the zone, half of it on each side;
            ``flatness``: distance of two planes; ``sphere_diameter``: difference from nominal [m].
        nominal_m: Nominal diameter; NaN = the kind has none [m].
        centre_m: Middle of the ball that it is limited to, workpiece frame; None = no limit [m].
        radius_m: Radius of that ball [m].
    """

    id: str
    kind: str
    tolerance_m: float
    nominal_m: float = math.nan
    centre_m: tuple[float, float, float] | None = None
    radius_m: float = math.inf


@dataclass(frozen=True)
class InspectionPlan:
    """What a part is judged by.

    Attributes:
        deviation_max_m: Largest deviation of a small piece of surface; NaN = not judged [m].
        area_ratio_min: Share of the area that must be measured [1].
        characteristics: What is asked one by one.
    """

    deviation_max_m: float = math.nan
    area_ratio_min: float = 0.95
    characteristics: tuple[Characteristic, ...] = ()


def read_plan(values: object, source: str) -> InspectionPlan:
    """Reads the key ``inspection`` of a part file.

    Raises:
        PartInvalidError: A key is unknown or missing, or a value is out of range.
    """
    fields = Fields(values, "inspection", source, _KEYS)
    deviation, ratio = math.nan, InspectionPlan.area_ratio_min
    if fields.has("deviation_max_m"):
        deviation = fields.number("deviation_max_m", 1e-7, 0.1, _TOLERANCE)
    if fields.has("area_ratio_min"):
        ratio = fields.number("area_ratio_min", 0.0, 1.0, "a share from 0 to 1")
    listed = fields.values.get("characteristics") or []
    accepted = f"a list of up to {_MOST} characteristics, each id once"
    if not isinstance(listed, list) or len(listed) > _MOST:
        raise fields.error("characteristics", f"{str(listed)[:60]!r}", accepted)
    found = tuple(_characteristic(value, k, source) for k, value in enumerate(listed))
    if len({each.id for each in found}) != len(found):
        raise fields.error("characteristics", "an id twice", accepted)
    return InspectionPlan(deviation, ratio, found)


def plan_fields(plan: InspectionPlan) -> dict[str, object]:
    """Returns a plan in the form in which `read_plan` reads it."""
    values: dict[str, object] = {"area_ratio_min": plan.area_ratio_min}
    if math.isfinite(plan.deviation_max_m):
        values["deviation_max_m"] = plan.deviation_max_m
    if plan.characteristics:
        values["characteristics"] = [_fields_of(each) for each in plan.characteristics]
    return values


def _characteristic(values: object, number: int, source: str) -> Characteristic:
    fields = Fields(values, f"inspection.characteristics[{number}]", source, _ONE)
    name = fields.text("id")
    if not _ID.fullmatch(name):
        raise fields.error("id", repr(name), "1 to 64 letters, digits, '_', '.' or '-'")
    kind = fields.text("kind", f"one of {', '.join(KINDS)}")
    if kind not in KINDS:
        raise fields.error("kind", repr(kind), f"one of {', '.join(KINDS)}")
    tolerance = fields.number("tolerance_m", 1e-7, 0.1, _TOLERANCE)
    nominal = math.nan
    if kind == "sphere_diameter":
        nominal = fields.number("nominal_m", 1e-4, 10.0, "a diameter from 0.0001 to 10 [m]")
    elif fields.has("nominal_m"):
        raise fields.error("nominal_m", "a number", "nothing: only sphere_diameter has it")
    if not fields.has("centre_m") and kind != "sphere_diameter":
        if fields.has("radius_m"):
            raise fields.error("radius_m", "a number without centre_m", "both of them, or none")
        return Characteristic(name, kind, tolerance, nominal)
    if kind == "points":
        raise fields.error("centre_m", "a place", "nothing: the measuring points have theirs")
    x, y, z = fields.vector("centre_m", 3, "three numbers [m]").tolist()
    radius = fields.number("radius_m", 1e-4, 100.0, "a radius from 0.0001 to 100 [m]")
    return Characteristic(name, kind, tolerance, nominal, (x, y, z), radius)


def _fields_of(each: Characteristic) -> dict[str, object]:
    values: dict[str, object] = {
        "id": each.id,
        "kind": each.kind,
        "tolerance_m": each.tolerance_m,
    }
    if math.isfinite(each.nominal_m):
        values["nominal_m"] = each.nominal_m
    if each.centre_m is not None:
        values |= {"centre_m": list(each.centre_m), "radius_m": each.radius_m}
    return values
