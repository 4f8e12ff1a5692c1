"""The scan path and its predicted coverage."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from skinplan_msgs import msg as messages

from skinplan.errors import InputError, ScanPathInvalidError
from skinplan.mesh.model import Finding
from skinplan.plan_record import scan_path_hash
from skinplan.scan_path.model import FEATURE, ROW, LeftOut, ScanPath
from skinplan.scanner.model import CoverageFigures, RegionShares
from skinplan.transforms import Array
from skinplan_nodes.conversions.geometry import (
    header_to_msg,
    point_to_msg,
    require_frame,
    vector_to_msg,
)

_UNIT_TOLERANCE = 1e-3
_UNKNOWN = float("nan")
_ANGLES = ("median", "p95", "largest")
#: Fields of RegionCoverage in the order of `Sight`.
_AREAS = (
    "area_seen_often",
    "area_seen",
    "area_cannot_be_seen",
    "area_too_oblique",
    "area_out_of_range",
    "area_hidden_by_part",
    "area_hidden_by_fixture",
    "area_not_reached",
)
NO_FIGURES = CoverageFigures(_UNKNOWN, _UNKNOWN, _UNKNOWN, _UNKNOWN)


@dataclass(frozen=True)
class PathFacts:
    """What travels with a scan path besides its points.

    Attributes:
        part_id: Id of the part.
        mesh_sha256: Hash of the mesh file that was planned on.
        triangles: Triangles of the mesh.
        area_m2: Area of the mesh [m^2].
        coverage: Predicted coverage.
    """

    part_id: str = ""
    mesh_sha256: str = ""
    triangles: int = 0
    area_m2: float = 0.0
    coverage: CoverageFigures = field(default=NO_FIGURES)


def coverage_figures_to_msg(figures: CoverageFigures) -> messages.CoverageFigures:
    """Converts predicted coverage."""
    return messages.CoverageFigures(
        area_ratio=figures.area_ratio,
        feature_area_ratio=figures.feature_area_ratio,
        rows_only_area_ratio=figures.rows_only_area_ratio,
        rows_only_feature_area_ratio=figures.rows_only_feature_area_ratio,
        least_views=figures.least_views,
        regions=[_region_to_msg(region) for region in figures.regions],
    )


def coverage_figures_from_msg(msg: messages.CoverageFigures) -> CoverageFigures:
    """Returns predicted coverage."""
    return CoverageFigures(
        msg.area_ratio,
        msg.feature_area_ratio,
        msg.rows_only_area_ratio,
        msg.rows_only_feature_area_ratio,
        msg.least_views,
        tuple(_region_from_msg(region) for region in msg.regions),
    )


def _region_to_msg(region: RegionShares) -> messages.RegionCoverage:
    msg = messages.RegionCoverage(
        name=region.name,
        area=region.area_m2,
        seen_ratio=region.seen_ratio,
        often_seen_ratio=region.often_seen_ratio,
        seeable_ratio=region.seeable_ratio,
        seen_of_seeable_ratio=region.seen_of_seeable_ratio,
        often_seen_of_seeable_ratio=region.often_seen_of_seeable_ratio,
        ray_within_limit_ratio=region.ray_within_limit_ratio,
    )
    for kind, angles in (("axis", region.axis_rad), ("ray", region.ray_rad)):
        for name, angle in zip(_ANGLES, angles, strict=True):
            setattr(msg, f"{kind}_incidence_{name}", angle)
    for name, area in zip(_AREAS, region.areas_m2, strict=True):
        setattr(msg, name, area)
    return msg


def _region_from_msg(msg: messages.RegionCoverage) -> RegionShares:
    return RegionShares(
        name=msg.name,
        area_m2=msg.area,
        seen_ratio=msg.seen_ratio,
        often_seen_ratio=msg.often_seen_ratio,
        seeable_ratio=msg.seeable_ratio,
        seen_of_seeable_ratio=msg.seen_of_seeable_ratio,
        often_seen_of_seeable_ratio=msg.often_seen_of_seeable_ratio,
        axis_rad=(
            msg.axis_incidence_median,
            msg.axis_incidence_p95,
            msg.axis_incidence_largest,
        ),
        ray_rad=(msg.ray_incidence_median, msg.ray_incidence_p95, msg.ray_incidence_largest),
        ray_within_limit_ratio=msg.ray_within_limit_ratio,
        areas_m2=tuple(getattr(msg, name) for name in _AREAS),
    )


def finding_to_msg(finding: Finding) -> messages.MeshFinding:
    """Converts what the mesh doctor found."""
    return messages.MeshFinding(
        name=finding.name,
        count=finding.count,
        action=finding.action,
        detail=finding.detail,
        where=[point_to_msg(np.array(place)) for place in finding.where],
    )


def finding_from_msg(msg: messages.MeshFinding) -> Finding:
    """Returns what the mesh doctor found."""
    where = tuple((place.x, place.y, place.z) for place in msg.where)
    return Finding(msg.name, msg.count, msg.action, msg.detail, where)


def scan_path_to_msg(
    path: ScanPath, facts: PathFacts | None = None, stamp_s: float = 0.0
) -> messages.ScanPath:
    """Converts a scan path; its hash is made here."""
    known = facts or PathFacts()
    rows = zip(path.positions, path.directions, path.targets, path.kinds, path.groups, strict=True)
    return messages.ScanPath(
        header=header_to_msg("workpiece", stamp_s),
        part_id=known.part_id,
        mesh_sha256=known.mesh_sha256,
        strategy=path.strategy,
        points=[
            messages.ScanPathPoint(
                position=point_to_msg(position),
                direction=vector_to_msg(direction),
                target=point_to_msg(target),
                kind=int(kind),
                group=int(group),
            )
            for position, direction, target, kind, group in rows
        ],
        regions=path.regions,
        triangles=known.triangles,
        area=known.area_m2,
        lower_bound=path.lower_bound,
        left_out=[
            messages.LeftOutTarget(target=point_to_msg(left.target), reason=left.reason)
            for left in path.left_out
        ],
        coverage=coverage_figures_to_msg(known.coverage),
        plan_hash=scan_path_hash(path),
    )


def scan_path_from_msg(msg: messages.ScanPath) -> ScanPath:
    """Returns the scan path; one without points is a scan path, too.

    Raises:
        ScanPathInvalidError: Another frame than workpiece, numbers that are not finite, directions
            that are no unit vectors, an unknown kind, or points without the stated hash.
    """
    try:
        require_frame(msg.header, "workpiece", "scan path")
    except InputError as error:
        raise ScanPathInvalidError(str(error)) from error
    path = ScanPath(
        positions=_checked([p.position for p in msg.points], "positions"),
        directions=_directions(msg),
        targets=_checked([p.target for p in msg.points], "targets"),
        kinds=_kinds(msg),
        groups=np.array([p.group for p in msg.points], dtype=np.int64),
        strategy=msg.strategy,
        regions=msg.regions,
        lower_bound=msg.lower_bound,
        left_out=tuple(
            LeftOut(np.array([left.target.x, left.target.y, left.target.z]), left.reason)
            for left in msg.left_out
        ),
    )
    if msg.plan_hash and scan_path_hash(path) != msg.plan_hash:
        raise ScanPathInvalidError(
            f"scan path of part {msg.part_id!r}: its points do not have the stated hash "
            f"{msg.plan_hash}; the points as they were planned, or no hash, are accepted"
        )
    return path


def path_facts_from_msg(msg: messages.ScanPath) -> PathFacts:
    """Returns what travels with the points."""
    return PathFacts(
        msg.part_id,
        msg.mesh_sha256,
        msg.triangles,
        msg.area,
        coverage_figures_from_msg(msg.coverage),
    )


def require_points(path: ScanPath) -> ScanPath:
    """Returns the scan path when it has points.

    Raises:
        ScanPathInvalidError: It has none.
    """
    if len(path) == 0:
        raise ScanPathInvalidError(
            "a scan path of 0 points was given; one with at least 1 is accepted"
        )
    return path


def _kinds(msg: messages.ScanPath) -> Any:
    kinds = np.array([p.kind for p in msg.points], dtype=np.int64)
    if not np.isin(kinds, (ROW, FEATURE)).all():
        raise ScanPathInvalidError(
            f"scan path: the kinds {ROW} and {FEATURE} are accepted, found "
            f"{np.unique(kinds).tolist()}"
        )
    return kinds


def _directions(msg: messages.ScanPath) -> Array:
    found = _checked([p.direction for p in msg.points], "directions")
    off = np.flatnonzero(np.abs(np.linalg.norm(found, axis=1) - 1.0) > _UNIT_TOLERANCE)
    if len(off):
        raise ScanPathInvalidError(
            f"scan path: unit directions are accepted, {len(off)} of {len(found)} have another "
            f"length, the first is number {off[0]}"
        )
    return found


def _checked(items: list[Any], what: str) -> Array:
    found = np.array([[item.x, item.y, item.z] for item in items], dtype=float).reshape(-1, 3)
    off = np.flatnonzero(~np.isfinite(found).all(axis=1))
    if len(off):
        raise ScanPathInvalidError(
            f"scan path: finite {what} are accepted, {len(off)} of {len(found)} are not, the first "
            f"is number {off[0]}"
        )
    return found
