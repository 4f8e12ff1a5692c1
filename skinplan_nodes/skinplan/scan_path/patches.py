"""Strategy ``patches``: rows over patches of the surface, and over several parts (R 5).

The surface is split into patches that one direction can treat. Each is projected along its mean
normal, eq (1), and rows are laid over the projection; the scanner or tool keeps its direction over
a patch and stands as high as the part about each point asks for. Rows of patches and parts beside
each other are made one where that saves turns. The stand-off, the field of view and the range of
the settings are those of whatever is moved: a scanner, a spray gun or a wiping tool.
"""

import logging
from dataclasses import replace

import numpy as np

from skinplan.errors import MeshRefusedError
from skinplan.mesh.model import Segmentation, SurfaceMesh
from skinplan.part.model import ScanSettings
from skinplan.scan_path.frame import base_normal, given_frame, part_frame
from skinplan.scan_path.merge_rows import RowGroup, RowMerger
from skinplan.scan_path.model import ROW, ScanPath
from skinplan.scan_path.partition import Indices, Partition
from skinplan.scan_path.patch_rows import RowRule, row_targets
from skinplan.scan_path.published import limit_lean, offset_and_repair
from skinplan.scan_path.rows import scannable_faces
from skinplan.scanner.model import SurfaceSamples
from skinplan.scanner.samples import sample_surface
from skinplan.transforms import Array

# Samples of a patch are so many to an interval, and at least so many in all.
_SAMPLES_PER_INTERVAL = 10
_LEAST_SAMPLES = 60
# A patch smaller than the square of this share of the interval is left to its neighbours.
_LEAST_PATCH_RATIO = 0.12
# The lowest place about a pose stays in this share of the range beyond the stand-off.
_RISE_RATIO = 0.5
_log = logging.getLogger(__name__)


def patches_path(mesh: SurfaceMesh, segmentation: Segmentation, settings: ScanSettings) -> ScanPath:
    """Plans rows over patches.

    Args:
        mesh: A checked mesh of one part or of several side by side.
        segmentation: Its complex regions; its smoothed normals part the patches.
        settings: Checked settings.

    Returns:
        The path, row points only, in the order of the patches along the part.

    Raises:
        MeshRefusedError: No face looks to the scanner's side, or no pose keeps clear of the part.
        PartInvalidError: The row direction is perpendicular to the part.
    """
    base = base_normal(mesh)
    if settings.row_direction is not None:
        given_frame(base, settings.row_direction)
    rule = row_rule(settings)
    groups = row_groups(mesh, segmentation, settings, base)
    targets, normals, rows = [], [], []
    count = 0
    for group in groups:
        points, numbers = row_targets(group.samples, group.rows, rule)
        targets.append(points)
        rows.append(numbers + count)
        normals.append(np.tile(_axis(group, settings.tool_tilt_rad, base), (len(points), 1)))
        count += len(group.rows.members)
    path = ScanPath(
        positions=np.zeros((sum(map(len, targets)), 3)),
        directions=-np.concatenate(normals),
        targets=np.concatenate(targets),
        kinds=np.full(sum(map(len, targets)), ROW),
        groups=np.concatenate(rows),
        strategy="patches",
        regions=segmentation.regions,
    )
    bases = np.broadcast_to(base, path.targets.shape)
    repaired = offset_and_repair(path, mesh, bases, settings)
    return replace(repaired, groups=np.unique(repaired.groups, return_inverse=True)[1].reshape(-1))


def row_rule(settings: ScanSettings) -> RowRule:
    """Returns how rows are laid with these settings; eq (5) of M on half the footprint."""
    footprint = settings.footprint_m or 2.0 * settings.field_radius_m
    return RowRule(
        (1.0 - settings.overlap_ratio) * footprint / 2.0,
        settings.merge_gap_m,
        _RISE_RATIO * (settings.range_max_m - settings.standoff_m),
    )


def row_groups(
    mesh: SurfaceMesh, segmentation: Segmentation, settings: ScanSettings, base: Array
) -> list[RowGroup]:
    """Splits a part into patches, lays rows over them, and merges the rows.

    Args:
        mesh: The part.
        segmentation: Its smoothed surface.
        settings: Checked settings.
        base: Mean normal of the part, shape (3,).

    Raises:
        MeshRefusedError: Nothing of it can be treated from outside.
    """
    rule = row_rule(settings)
    smoothed = segmentation.smoothed
    least = (_LEAST_PATCH_RATIO * rule.interval_m) ** 2
    partition = Partition(mesh, smoothed.face_normals, settings.patch_angle_rad, least)
    patches = _in_order(mesh, base, partition.patches(scannable_faces(smoothed, base)))
    merger = RowMerger(rule, settings.patch_angle_rad, settings.row_direction)
    alone = [
        group
        for group in (merger.alone(_samples(mesh, smoothed, patch, rule)) for patch in patches)
        if group is not None
    ]
    if not alone:
        raise MeshRefusedError(
            "no patch of the part faces the scanner and is wider than a line; a skin with one side "
            "to scan is accepted"
        )
    groups = merger.merged(alone)
    _log.info(
        "scan path: %d patches with %d rows of their own, %d rows in %d groups after merging",
        len(alone),
        sum(len(group.rows.members) for group in alone),
        sum(len(group.rows.members) for group in groups),
        len(groups),
    )
    return groups


def _samples(
    mesh: SurfaceMesh, smoothed: SurfaceMesh, patch: Indices, rule: RowRule
) -> SurfaceSamples:
    area = float(mesh.face_areas[patch].sum())
    spacing = min(rule.interval_m / _SAMPLES_PER_INTERVAL, float(np.sqrt(area / _LEAST_SAMPLES)))
    samples = sample_surface(mesh, spacing, patch)
    return replace(samples, normals=smoothed.face_normals[samples.faces])


def _in_order(mesh: SurfaceMesh, base: Array, patches: list[Indices]) -> list[Indices]:
    """Sorts patches by their middle along the part."""
    along = part_frame(mesh, base).along
    places = mesh.centroids @ along
    middles = [float(np.average(places[each], weights=mesh.face_areas[each])) for each in patches]
    return [patches[number] for number in np.argsort(np.round(middles, 6), kind="stable")]


def _axis(group: RowGroup, tilt_rad: float, base: Array) -> Array:
    """Returns the unit direction from the part to the scanner or tool, shape (3,)."""
    frame = group.rows.frame
    normal = limit_lean(frame.base[None], base)[0]
    along = frame.along - (frame.along @ normal) * normal
    along = along / np.linalg.norm(along)
    return np.asarray(np.cos(tilt_rad) * normal + np.sin(tilt_rad) * along)
