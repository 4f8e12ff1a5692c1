"""Shares and distributions of a coverage certificate, per region and overall."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from skinplan.scanner.model import Coverage, RegionShares, SurfaceSamples
from skinplan.scanner.sight import Sight
from skinplan.transforms import Array

BIN_RAD = float(np.deg2rad(5.0))
_EDGES_RAD: Array = BIN_RAD * np.arange(19, dtype=float)
_NEIGHBOURS = 7


@dataclass(frozen=True, eq=False)
class IncidenceFigures:
    """How obliquely the seen area is seen at best, weighted by area; NaN where nothing is seen.

    Attributes:
        edges_rad: Ends of the bins, 5 degrees each, shape (19,) [rad].
        shares: Share of the seen area in each bin [1], shape (18,), sum 1.
        least_rad: Smallest angle [rad].
        median_rad: Half of the area has at most this angle [rad].
        p95_rad: 95 % of the area have at most this angle [rad].
        largest_rad: Largest angle [rad].
        within_limit_ratio: Share of the seen area within the scanner's incidence limit [1].
    """

    edges_rad: Array
    shares: Array
    least_rad: float
    median_rad: float
    p95_rad: float
    largest_rad: float
    within_limit_ratio: float


@dataclass(frozen=True, eq=False)
class RegionFigures:
    """Figures of one region of a part, or of all of it.

    Attributes:
        name: ``whole part``, ``flat surface``, ``complex regions`` (all of them together) or
            ``region <number>``.
        area_m2: Area [m^2].
        seen_ratio: Share of the area seen at least once [1].
        often_seen_ratio: Share of the area seen at least as often as asked for [1].
        seeable_ratio: Share of the area that can be seen at all [1]; NaN when not asked.
        seen_of_seeable_ratio: Share of that area seen at least once [1]; NaN when not asked.
        often_seen_of_seeable_ratio: Share of that area seen at least as often as asked for [1].
        axis: Incidence against the view axis (the gate).
        ray: Incidence against the ray from the scanner's origin.
        areas_m2: Area in each state of `Sight`, shape (8,) [m^2].
    """

    name: str
    area_m2: float
    seen_ratio: float
    often_seen_ratio: float
    seeable_ratio: float
    seen_of_seeable_ratio: float
    often_seen_of_seeable_ratio: float
    axis: IncidenceFigures
    ray: IncidenceFigures
    areas_m2: Array


def seen_ratio(
    samples: SurfaceSamples, views: NDArray[np.int64], where: NDArray[np.bool_], least: int = 1
) -> float:
    """Returns the share of area that is seen.

    Args:
        samples: The surface samples.
        views: Number of views of each, shape (s,).
        where: Which samples count, shape (s,).
        least: Number of views from which on a sample counts as seen.

    Returns:
        Share [1]; NaN when no samples count.
    """
    area = float(samples.weights[where].sum())
    return (
        float(samples.weights[where & (views >= least)].sum()) / area if area > 0 else float("nan")
    )


def whole_figures(coverage: Coverage) -> RegionFigures:
    """Returns the figures of the whole part."""
    return region_figures(coverage, np.ones(len(coverage.views), dtype=bool), "whole part")


def all_figures(coverage: Coverage) -> list[RegionFigures]:
    """Returns the figures of the whole part, the flat surface, all complex regions, and each."""
    regions = coverage.regions
    figures = [
        whole_figures(coverage),
        region_figures(coverage, regions == 0, "flat surface"),
        region_figures(coverage, regions > 0, "complex regions"),
    ]
    for region in range(1, int(regions.max(initial=0)) + 1):
        figures.append(region_figures(coverage, regions == region, f"region {region}"))
    return figures


def region_shares(figures: RegionFigures) -> RegionShares:
    """Returns the figures of a region in short."""
    axis, ray = figures.axis, figures.ray
    return RegionShares(
        name=figures.name,
        area_m2=figures.area_m2,
        seen_ratio=figures.seen_ratio,
        often_seen_ratio=figures.often_seen_ratio,
        seeable_ratio=figures.seeable_ratio,
        seen_of_seeable_ratio=figures.seen_of_seeable_ratio,
        often_seen_of_seeable_ratio=figures.often_seen_of_seeable_ratio,
        axis_rad=(axis.median_rad, axis.p95_rad, axis.largest_rad),
        ray_rad=(ray.median_rad, ray.p95_rad, ray.largest_rad),
        ray_within_limit_ratio=ray.within_limit_ratio,
        areas_m2=tuple(figures.areas_m2.tolist()),
    )


def region_figures(coverage: Coverage, where: NDArray[np.bool_], name: str) -> RegionFigures:
    """Returns the figures of some of the samples.

    Args:
        coverage: The certificate.
        where: Which samples count, shape (s,).
        name: Name of the region.

    Returns:
        The figures; shares of nothing are NaN.
    """
    samples, views, least = coverage.samples, coverage.views, coverage.least_views
    weights = samples.weights[where]
    able = coverage.can_be_seen
    inside = np.zeros_like(where) if able is None else where & able
    limit = coverage.scanner.incidence_max_rad
    return RegionFigures(
        name=name,
        area_m2=float(weights.sum()),
        seen_ratio=seen_ratio(samples, views, where),
        often_seen_ratio=seen_ratio(samples, views, where, least),
        seeable_ratio=float("nan") if able is None else seen_ratio(samples, able * 1, where),
        seen_of_seeable_ratio=seen_ratio(samples, views, inside),
        often_seen_of_seeable_ratio=seen_ratio(samples, views, inside, least),
        axis=incidence_figures(coverage.axis_rad[where], weights, limit),
        ray=incidence_figures(coverage.ray_rad[where], weights, limit),
        areas_m2=np.bincount(coverage.sights[where], weights, len(Sight)).astype(float),
    )


def incidence_figures(angles_rad: Array, weights: Array, limit_rad: float) -> IncidenceFigures:
    """Returns the distribution of incidence angles.

    Args:
        angles_rad: Angles, NaN for what is not seen, shape (n,) [rad].
        weights: Area of each, shape (n,) [m^2].
        limit_rad: The incidence limit [rad].

    Returns:
        The distribution over what is seen.
    """
    seen = np.isfinite(angles_rad)
    angles, areas = angles_rad[seen], weights[seen]
    area = float(areas.sum())
    if not area > 0:
        nothing = float("nan")
        shares = np.full(len(_EDGES_RAD) - 1, nothing)
        return IncidenceFigures(_EDGES_RAD, shares, nothing, nothing, nothing, nothing, nothing)
    order = np.argsort(angles, kind="stable")
    ends = np.cumsum(areas[order]) / area
    median, p95 = angles[order[np.searchsorted(ends, (0.5 - 1e-9, 0.95 - 1e-9))]]
    # An angle above 90 degrees (a ray from behind, beside a steep view) counts in the last bin.
    binned = np.histogram(np.minimum(angles, _EDGES_RAD[-1]), _EDGES_RAD, weights=areas)[0]
    return IncidenceFigures(
        edges_rad=_EDGES_RAD,
        shares=binned / area,
        least_rad=float(angles.min()),
        median_rad=float(median),
        p95_rad=float(p95),
        largest_rad=float(angles.max()),
        within_limit_ratio=float(areas[angles <= limit_rad + 1e-9].sum()) / area,
    )


def sampling_error(coverage: Coverage) -> float:
    """Estimates how wrong the share of area seen can be, because only samples are judged.

    Only samples along the boundary of what is seen can be on the wrong side of it: the figure is
    the share of the unseen samples that have a seen one among their six nearest, at least one
    sample.

    Args:
        coverage: The certificate.

    Returns:
        Share of the area [1]; NaN without samples.
    """
    points, weights = coverage.samples.points, coverage.samples.weights
    if len(points) == 0:
        return float("nan")
    unseen = np.flatnonzero(coverage.views == 0)
    area = float(weights.sum())
    edge = 0.0
    if 0 < len(unseen) < len(points):
        _, near = cKDTree(points).query(points[unseen], k=min(_NEIGHBOURS, len(points)))
        beside = np.any(coverage.views[near] > 0, axis=1)
        edge = float(weights[unseen[beside]].sum())
    return max(edge, float(weights.max())) / area
