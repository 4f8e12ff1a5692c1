"""Poses keep clear of the part, rows keep to it: checked by other means than those of planning."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial import cKDTree

from meshes import PANELS, bump, grid, without
from skinplan.mesh.check import check_mesh
from skinplan.mesh.load import load_mesh
from skinplan.mesh.model import SurfaceMesh
from skinplan.mesh.segment import segment_mesh
from skinplan.part.model import ScanSettings
from skinplan.part.samples import sample_panel
from skinplan.scan_path.model import ROW
from skinplan.scan_path.plan import plan_scan_path, rows_only_path
from skinplan.scanner.rays import RayCaster
from skinplan.scanner.samples import sample_surface

SETTINGS = dataclasses.replace(ScanSettings(), strategy="published")
# Planning measures distances to points 8 mm apart: at 100 mm it can be wrong by this.
TOLERANCE_M = 0.0002
# Rows begin and end this far from the edge of the part.
FROM_EDGE_M = 0.010


def planned(mesh):
    return plan_scan_path(mesh, segment_mesh(mesh), SETTINGS)


def to_segment(points, begin, end):
    """Distance of points, shape (n, 1, 3), from segments, shape (m, 3)."""
    side = end - begin
    share = ((points - begin) * side).sum(-1) / np.maximum((side**2).sum(-1), 1e-30)
    foot = begin + np.clip(share, 0.0, 1.0)[..., None] * side
    return np.linalg.norm(points - foot, axis=-1)


def distances(points, corners):
    """Exact distance of points, shape (n, 3), from all triangles, shape (n, m)."""
    a, b, c = (corners[:, corner] for corner in range(3))
    normal = np.cross(b - a, c - a)
    normal = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    places = points[:, None]
    height = ((places - a) * normal).sum(-1)
    foot = places - height[..., None] * normal
    inside = np.ones(height.shape, dtype=bool)
    for begin, end in ((a, b), (b, c), (c, a)):
        inside &= (np.cross(end - begin, foot - begin) * normal).sum(-1) >= 0
    edges = [to_segment(places, begin, end) for begin, end in ((a, b), (b, c), (c, a))]
    return np.where(inside, np.abs(height), np.min(edges, axis=0))


def assert_clear(mesh, path):
    """No pose is nearer than the safe distance, nor behind the skin that it looks at."""
    apart, _ = cKDTree(sample_surface(mesh, 0.003).points).query(path.positions)
    assert apart.min() >= SETTINGS.clearance_m - TOLERANCE_M
    depth, face = RayCaster(mesh).hits(path.positions, path.directions)
    assert np.all(face >= 0)
    np.testing.assert_allclose(depth, SETTINGS.standoff_m, atol=0.003)
    assert np.all((mesh.face_normals[face] * path.directions).sum(axis=1) < 0)
    on_part = np.linalg.norm(
        path.positions + depth[:, None] * path.directions - path.targets, axis=1
    )
    assert on_part.max() < 0.003


@pytest.mark.parametrize("name", ["scene1", "scene2", "scene3", "scene4"])
def test_scenes(name):
    mesh = SurfaceMesh(*sample_panel(name).triangulate(100_000))
    assert_clear(mesh, planned(mesh))


@pytest.mark.parametrize("name", PANELS)
def test_panels_of_others(shared_data, name):
    mesh, _ = check_mesh(load_mesh(shared_data / "panels" / name, "m"))
    assert_clear(mesh, planned(mesh))


def test_every_pose_against_every_triangle():
    mesh = grid(
        0.6, 0.5, 0.015, lambda x, y: bump(x - 0.21, y, 0.12, 0.16, 0.03) + bump(x + 0.21, y, 0.12)
    )
    path = planned(mesh)
    apart = np.concatenate(
        [
            distances(part, mesh.corners).min(axis=1)
            for part in np.array_split(path.positions, max(1, len(path) // 20))
        ]
    )
    assert apart.min() >= SETTINGS.clearance_m - TOLERANCE_M
    # Without the repair some poses would be too near.
    raw = (
        path.targets
        + SETTINGS.standoff_m
        * segment_mesh(mesh).smoothed.vertex_normals[cKDTree(mesh.vertices).query(path.targets)[1]]
    )
    assert distances(raw[:: max(1, len(raw) // 150)], mesh.corners).min() < SETTINGS.clearance_m


@pytest.mark.parametrize("name", ["scene1", "scene3", "scene4"])
def test_rows_cover_the_edges_and_do_not_overrun_them(name):
    panel = sample_panel(name)
    mesh = SurfaceMesh(*panel.triangulate(100_000))
    path = rows_only_path(mesh, segment_mesh(mesh), SETTINGS)
    half = np.array(panel.size_m) / 2
    assert np.all(np.abs(path.targets[:, :2]) < half)
    # One row along each long edge; every row reaches both ends.
    for side in (-1, 1):
        assert (side * path.targets[:, 1]).max() > half[1] - FROM_EDGE_M - 1e-4
    for row in np.unique(path.groups):
        x = path.targets[path.groups == row, 0]
        assert x.max() > half[0] - FROM_EDGE_M - 1e-4
        assert x.min() < -half[0] + FROM_EDGE_M + 1e-4
    height = RayCaster(mesh).hits(
        np.c_[path.targets[:, :2], np.full(len(path), 1.0)],
        np.tile([0.0, 0.0, -1.0], (len(path), 1)),
    )[0]
    np.testing.assert_allclose(1.0 - height, path.targets[:, 2], atol=2e-6)


def test_rows_end_near_holes_and_go_on_behind_them():
    hole = 0.21
    mesh = without(
        grid(2.0, 0.8, 0.008, lambda x, y: 0.3 * y**2), lambda x, y: np.hypot(x - 0.3, y) < hole
    )
    path = planned(mesh)
    rows = path.kinds == ROW
    aside = np.hypot(path.targets[rows, 0] - 0.3, path.targets[rows, 1])
    assert aside.min() > hole - 0.008
    y = path.targets[rows, 1]
    for place in np.unique(np.round(y[np.abs(y) < 0.8 * hole], 3)):
        here = np.abs(y - place) < 0.002
        edge = np.sqrt(hole**2 - place**2)
        x = path.targets[rows, 0][here] - 0.3
        assert -edge - 0.02 - FROM_EDGE_M < x[x < 0].max() < -edge + 0.008
        assert edge - 0.008 < x[x > 0].min() < edge + 0.02 + FROM_EDGE_M
        assert len(np.unique(path.groups[rows][here])) == 2


def zigzag(path):
    """Length of the way through all rows, every other one backward."""
    rows = [path.targets[path.groups == row] for row in np.unique(path.groups)]
    way = np.concatenate([row[:: 1 - 2 * (number % 2)] for number, row in enumerate(rows)])
    return np.linalg.norm(np.diff(way, axis=0), axis=1).sum()


@pytest.mark.parametrize("name", ["scene1", "scene4"])
def test_rows_run_where_the_path_is_shortest(name):
    """Of all directions in the panel none has a way through all rows 5 % shorter.

    Of lengths that differ by less, the one with fewer rows is taken.
    """
    mesh = SurfaceMesh(*sample_panel(name).triangulate(20_000))
    segmentation = segment_mesh(mesh)
    found = rows_only_path(mesh, segmentation, SETTINGS)
    lengths = []
    for angle in np.radians(np.arange(0, 180, 15)):
        direction = (float(np.cos(angle)), float(np.sin(angle)), 0.0)
        settings = dataclasses.replace(SETTINGS, row_direction=direction)
        lengths.append(zigzag(rows_only_path(mesh, segmentation, settings)))
    assert zigzag(found) < 1.05 * min(lengths)
    along = np.abs(np.diff(found.targets[found.groups == 0], axis=0)).sum(axis=0)
    assert along[0] > 20 * along[1]
