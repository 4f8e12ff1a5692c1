"""Strategy ``published``: rows on the flat surface, Poisson samples on the features (M2.2)."""

import logging

import numpy as np

from skinplan.errors import MeshRefusedError
from skinplan.mesh.model import Segmentation, SurfaceMesh
from skinplan.part.model import ScanSettings
from skinplan.scan_path.clearance import Clearance, repair_by_tilt, tilt_toward
from skinplan.scan_path.features import sample_features
from skinplan.scan_path.frame import (
    RowFrame,
    base_normal,
    candidate_frames,
    given_frame,
    part_frame,
    vertex_areas,
)
from skinplan.scan_path.model import FEATURE, ROW, LeftOut, ScanPath
from skinplan.scan_path.rows import RowPoints, sample_rows, scannable_faces
from skinplan.transforms import Array

# Of two row directions whose paths differ by less, the one with fewer rows is taken: every turn
# costs time.
_SAME_LENGTH = 1.05
# With an incidence limit of 60 degrees the surface beyond is still seen.
_LARGEST_LEAN_RAD = np.deg2rad(75.0)
_log = logging.getLogger(__name__)


def published_path(
    mesh: SurfaceMesh, segmentation: Segmentation, settings: ScanSettings
) -> ScanPath:
    """Plans a scan path as the paper does (M2.2).

    Args:
        mesh: A checked mesh.
        segmentation: Its complex regions.
        settings: Checked settings.

    Returns:
        The path: row points outside the complex regions, then the points of each region.

    Raises:
        MeshRefusedError: No face looks to the scanner's side, or no pose keeps clear of the part.
        PartInvalidError: The row direction is perpendicular to the part.
    """
    smoothed, regions = segmentation.smoothed, segmentation.face_region
    base = base_normal(mesh)
    rows = least_rows(mesh, segmentation, settings, base, settings.sensitivity)
    flat = regions[rows.faces] == 0
    scannable = scannable_faces(smoothed, base)
    features = sample_features(
        mesh,
        smoothed,
        (regions > 0) & scannable,
        part_frame(mesh, base),
        settings.row_interval_m,
        settings.sensitivity,
    )
    order = np.argsort(regions[features.faces], kind="stable")
    feature_regions = regions[features.faces][order]
    # Feature poses tilt toward the mean normal of their region, row poses toward that of the part.
    means = [base] + [
        base_normal_or(mesh, (regions == region) & scannable, base)
        for region in range(1, segmentation.regions + 1)
    ]
    row_count = int(flat.sum())
    kinds = np.repeat([ROW, FEATURE], [row_count, len(order)])
    normals = np.concatenate([rows.normals[flat], features.normals[order]])
    path = ScanPath(
        positions=np.zeros((len(kinds), 3)),
        directions=-limit_lean(normals, base),
        targets=np.concatenate([rows.targets[flat], features.targets[order]]),
        kinds=kinds,
        groups=np.concatenate([_renumbered(rows.rows[flat]), feature_regions]),
        strategy="published",
        regions=segmentation.regions,
    )
    bases = np.stack(means)[np.concatenate([np.zeros(row_count, dtype=np.int64), feature_regions])]
    return offset_and_repair(path, mesh, bases, settings)


def rows_only_path(
    mesh: SurfaceMesh, segmentation: Segmentation, settings: ScanSettings
) -> ScanPath:
    """Plans conventional row cutting: rows over the whole part, one view direction (Fig. 21).

    Args:
        mesh: A checked mesh.
        segmentation: Its complex regions; rows run over them.
        settings: Checked settings.

    Returns:
        The path, row points only.

    Raises:
        MeshRefusedError: No face looks to the scanner's side.
        PartInvalidError: The row direction is perpendicular to the part.
    """
    base = base_normal(mesh)
    rows = least_rows(mesh, segmentation, settings, base, 0.0)
    count = len(rows.rows)
    if count == 0:
        raise MeshRefusedError(
            "no row crosses the part; a surface wider than a quarter of the row interval is "
            "accepted"
        )
    directions = np.tile(-base, (count, 1))
    return ScanPath(
        positions=rows.targets - settings.standoff_m * directions,
        directions=directions,
        targets=rows.targets,
        kinds=np.full(count, ROW),
        groups=rows.rows,
        strategy="rows only",
        regions=segmentation.regions,
    )


def least_rows(
    mesh: SurfaceMesh,
    segmentation: Segmentation,
    settings: ScanSettings,
    base: Array,
    sensitivity: float,
) -> RowPoints:
    """Cuts rows along the given direction, or along the one of two that needs the shorter path.

    Args:
        mesh: The mesh.
        segmentation: Its complex regions.
        settings: Interval and row direction.
        base: Mean normal, shape (3,).
        sensitivity: Exponent k of the spacing along the rows.

    Returns:
        Row points, those in complex regions included.
    """
    if settings.row_direction is not None:
        frames: tuple[RowFrame, ...] = (given_frame(base, settings.row_direction),)
    else:
        frames = candidate_frames(mesh.vertices, base, vertex_areas(mesh))
    interval = settings.row_interval_m
    complex_faces = segmentation.face_region > 0
    found = [
        sample_rows(mesh, segmentation.smoothed, frame, interval, complex_faces, sensitivity)
        for frame in frames
    ]
    # From row to row the scanner also has to cross over.
    lengths = [rows.length_m + interval * rows.rows.max(initial=0) for rows in found]
    return min(
        (
            rows
            for rows, length in zip(found, lengths, strict=True)
            if length <= _SAME_LENGTH * min(lengths)
        ),
        key=lambda rows: int(rows.rows.max(initial=0)),
    )


def offset_and_repair(
    path: ScanPath, mesh: SurfaceMesh, bases: Array, settings: ScanSettings
) -> ScanPath:
    """Offsets the targets by d_best (M2.1) and tilts or drops the poses too near to the part.

    Args:
        path: Targets and directions; positions are not read.
        mesh: The part.
        bases: Normal toward which each pose may be tilted, shape (n, 3).
        settings: Stand-off, clearance, largest tilt.

    Returns:
        The path with positions, without the poses that can't be repaired: these are listed.

    Raises:
        MeshRefusedError: No pose is left.
    """
    repair = repair_by_tilt(
        Clearance(mesh),
        path.targets,
        -path.directions,
        bases,
        settings.standoff_m,
        settings.clearance_m,
        settings.tilt_max_rad,
    )
    keep = repair.usable
    reason = (
        f"the scanner would stand nearer than {settings.clearance_m:g} m to the part, or the part "
        f"hides the view, also when tilted by {np.degrees(settings.tilt_max_rad):.0f} degrees"
    )
    if repair.tilted or not keep.all():
        _log.info(
            "scan path: %d poses too near to the part were tilted, %d could not be repaired and "
            "are left out",
            repair.tilted,
            int((~keep).sum()),
        )
    if not keep.any():
        raise MeshRefusedError(
            f"none of {len(keep)} scan poses keeps {settings.clearance_m} m from the part; "
            "a surface that can be seen from outside at the stand-off is accepted"
        )
    return ScanPath(
        positions=(path.targets + settings.standoff_m * repair.normals)[keep],
        directions=-repair.normals[keep],
        targets=path.targets[keep],
        kinds=path.kinds[keep],
        groups=path.groups[keep],
        strategy=path.strategy,
        regions=path.regions,
        left_out=tuple(LeftOut(path.targets[pose], reason) for pose in np.flatnonzero(~keep)),
    )


def limit_lean(normals: Array, base: Array) -> Array:
    """Turns normals that lean too far from the base normal back to the limit.

    At a folded rim a pose along the normal would stand beside or behind the part.

    Args:
        normals: Unit normals, shape (n, 3).
        base: Mean normal of the part, shape (3,).

    Returns:
        Unit normals, at most 75 degrees from the base normal, shape (n, 3).
    """
    lean = np.arccos(np.clip(normals @ base, -1.0, 1.0))
    excess = np.maximum(lean - _LARGEST_LEAN_RAD, 0.0)
    turned = tilt_toward(normals, np.broadcast_to(base, normals.shape), excess)
    return np.where(excess[:, None] > 0, turned, normals)


def base_normal_or(mesh: SurfaceMesh, faces: np.ndarray, otherwise: Array) -> Array:
    """Returns the mean normal of some faces, shape (3,), or the other one when they have none."""
    try:
        return base_normal(mesh, faces)
    except MeshRefusedError:
        return otherwise


def _renumbered(numbers: np.ndarray) -> np.ndarray:
    return np.unique(numbers, return_inverse=True)[1].reshape(-1)
