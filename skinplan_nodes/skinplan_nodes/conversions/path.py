"""The scan path and its predicted coverage."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from skinplan_msgs import msg as messages

from skinplan.errors import InputError, ScanPathInvalidError
from skinplan.plan_record import scan_path_hash
from skinplan.scan_path.model import FEATURE, ROW, ScanPath
from skinplan.scanner.model import Coverage, CoverageFigures
from skinplan.transforms import Array
from skinplan_nodes.conversions.geometry import (
    header_to_msg,
    point_to_msg,
    require_frame,
    vector_to_msg,
)

_UNIT_TOLERANCE = 1e-3
_UNKNOWN = float("nan")
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


def coverage_figures_to_msg(figures: CoverageFigures | Coverage) -> messages.CoverageFigures:
    """Converts predicted coverage."""
    return messages.CoverageFigures(
        area_ratio=figures.area_ratio,
        feature_area_ratio=figures.feature_area_ratio,
        rows_only_area_ratio=figures.rows_only_area_ratio,
        rows_only_feature_area_ratio=figures.rows_only_feature_area_ratio,
    )


def coverage_figures_from_msg(msg: messages.CoverageFigures) -> CoverageFigures:
    """Returns predicted coverage."""
    return CoverageFigures(
        msg.area_ratio,
        msg.feature_area_ratio,
        msg.rows_only_area_ratio,
        msg.rows_only_feature_area_ratio,
    )


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
