"""Holds a measured surface against the characteristics that the part file asks for."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from skinplan.errors import InputError
from skinplan.inspection.fits import fit_plane, fit_sphere
from skinplan.inspection.surface import SurfaceFigures
from skinplan.part.inspection_plan import Characteristic
from skinplan.part.inspection_points import InspectionPoints
from skinplan.transforms import Array

PASS, FAIL, NOT_MEASURED = "pass", "fail", "not_measured"
# Less of the asked surface measured is no measurement of it.
_MEASURED_RATIO_MIN = 0.95
# A measuring point takes the local deviation of the nearest sample within [m].
_NEAR_M = 0.01


@dataclass(frozen=True)
class Result:
    """One characteristic, measured; of ``points`` one for each measuring point.

    Attributes:
        id: Its name; measuring points have their number behind it.
        kind: Kind of the characteristic, ``point`` for a measuring point.
        tolerance_m: As asked [m].
        nominal_m: Nominal value; NaN = the kind has none [m].
        value_m: Measured value in the meaning of the kind; NaN = not measured [m].
        state: ``pass``, ``fail`` or ``not_measured``.
        measured_ratio: Share of the asked surface that was measured [1].
        form_error_m: Of a sphere, largest minus smallest distance; NaN = the kind has none [m].
        place: Middle of what was asked, workpiece frame [m].
        normal: Outward normal of a measuring point; zero = the kind has none.
        reason: Why it is not measured; empty = it is.
    """

    id: str
    kind: str
    tolerance_m: float
    nominal_m: float
    value_m: float
    state: str
    measured_ratio: float
    form_error_m: float = math.nan
    place: tuple[float, float, float] = (math.nan, math.nan, math.nan)
    normal: tuple[float, float, float] = (0.0, 0.0, 0.0)
    reason: str = ""


def evaluate(
    asked: tuple[Characteristic, ...],
    figures: SurfaceFigures,
    points: InspectionPoints | None = None,
) -> tuple[Result, ...]:
    """Evaluates what is asked, in its order.

    Args:
        asked: Characteristics of the part file.
        figures: What was measured.
        points: The part's measuring points; None = it has none.
    """
    found: list[Result] = []
    for each in asked:
        if each.kind == "points":
            found += _points(each, figures, points)
        else:
            found.append(_surface(each, figures))
    return tuple(found)


def _surface(asked: Characteristic, figures: SurfaceFigures) -> Result:
    samples = figures.samples
    inside = np.ones(len(samples.points), dtype=bool)
    if asked.centre_m is not None:
        inside = np.linalg.norm(samples.points - asked.centre_m, axis=1) <= asked.radius_m
    local = figures.local
    known = inside & np.isfinite(local)
    area = float(samples.weights[inside].sum())
    ratio = float(samples.weights[known].sum()) / area if area > 0.0 else 0.0
    value, form, reason = math.nan, math.nan, ""
    try:
        value, form = _value(asked, figures, known)
    except InputError as error:
        reason = str(error)
    difference = abs(value - asked.nominal_m) if math.isfinite(asked.nominal_m) else value
    failed = difference > asked.tolerance_m
    if not failed and ratio < _MEASURED_RATIO_MIN:
        reason = reason or (
            f"{100 * ratio:.1f} % of the asked surface was measured, at least "
            f"{100 * _MEASURED_RATIO_MIN:.0f} % are accepted"
        )
    state = FAIL if failed else NOT_MEASURED if reason else PASS
    place = samples.points[inside].mean(axis=0) if inside.any() else np.full(3, np.nan)
    return Result(
        asked.id,
        asked.kind,
        asked.tolerance_m,
        asked.nominal_m,
        value,
        state,
        ratio,
        form,
        _triple(place),
        reason=reason,
    )


def _value(
    asked: Characteristic, figures: SurfaceFigures, known: NDArray[np.bool_]
) -> tuple[float, float]:
    """Returns the value in the meaning of the kind, and the form error beside it [m]."""
    local, samples = figures.local[known], figures.samples
    if len(local) == 0:
        raise InputError(f"{asked.id}: none of the asked surface was measured")
    if asked.kind == "profile":
        return 2.0 * float(np.abs(local).max()), math.nan
    places = samples.points[known] + local[:, None] * samples.normals[known]
    if asked.kind == "flatness":
        return float(np.ptp(fit_plane(places).deviations)), math.nan
    sphere = fit_sphere(places)
    return sphere.diameter, sphere.form_error


def _points(
    asked: Characteristic, figures: SurfaceFigures, points: InspectionPoints | None
) -> list[Result]:
    if points is None:
        reason = f"{asked.id}: the part file has no measuring points"
        return [Result(asked.id, "point", asked.tolerance_m, 0.0, math.nan, NOT_MEASURED, 0.0,
                       reason=reason)]  # fmt: skip
    local = figures.local
    known = np.flatnonzero(np.isfinite(local))
    values = np.full(len(points), np.nan)
    if len(known):
        distance, near = cKDTree(figures.samples.points[known]).query(points.targets)
        values = np.where(distance <= _NEAR_M, local[known[near]], np.nan)
    found = []
    for k, value in enumerate(values.tolist()):
        missed = not math.isfinite(value)
        failed = abs(value) > asked.tolerance_m / 2.0
        found.append(
            Result(
                f"{asked.id}.{k + 1}",
                "point",
                asked.tolerance_m,
                0.0,
                value,
                NOT_MEASURED if missed else FAIL if failed else PASS,
                0.0 if missed else 1.0,
                place=_triple(points.targets[k]),
                normal=_triple(points.normals[k]),
                reason="nothing was measured near it" if missed else "",
            )
        )
    return found


def _triple(values: Array) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in values)
    return x, y, z
