"""Scan path strategy ``points``."""

import dataclasses

import numpy as np
import pytest

from meshes import random_transform
from skinplan.errors import InspectionPointsError
from skinplan.mesh.model import SurfaceMesh
from skinplan.mesh.prepare import prepare_mesh
from skinplan.mesh.segment import segment_mesh
from skinplan.part.inspection_points import InspectionPoints
from skinplan.part.model import ScanSettings
from skinplan.part.samples import write_sample
from skinplan.plan_record import scan_path_hash
from skinplan.scan_path.model import FEATURE
from skinplan.scan_path.plan import plan_scan_path
from skinplan.transforms import apply, rotate

SETTINGS = ScanSettings(strategy="points")


@pytest.fixture(scope="module")
def engine(tmp_path_factory):
    part = write_sample("engine", tmp_path_factory.mktemp("engine"), triangles=10_000)
    return part, prepare_mesh(part)


def planned(engine, points, settings=SETTINGS):
    prepared = engine[1]
    return plan_scan_path(prepared.mesh, prepared.segmentation, settings, points)


def test_the_path_looks_at_every_point_from_the_standoff(engine):
    points = engine[0].points
    path = planned(engine, points, engine[0].scan)
    assert len(path) == path.feature_points == 150 and not path.left_out
    assert np.array_equal(path.targets, points.targets)
    np.testing.assert_allclose(path.positions + 0.3 * path.directions, points.targets, atol=1e-12)
    np.testing.assert_allclose(path.directions, -points.normals, atol=1e-8)
    assert np.all(path.kinds == FEATURE) and path.strategy == "points"
    assert np.array_equal(path.groups, points.groups)


def test_surfaces_follow_one_another_whatever_the_order_in_the_file(engine):
    points = engine[0].points
    mixed = np.random.default_rng(3).permutation(150)
    shuffled = InspectionPoints(points.targets[mixed], points.normals[mixed], points.groups[mixed])
    path = planned(engine, shuffled)
    assert np.all(np.diff(path.groups) >= 0)
    for group in (1, 2, 3):
        np.testing.assert_array_equal(
            path.targets[path.groups == group], shuffled.targets[shuffled.groups == group]
        )


def test_the_hash_follows_the_points(engine):
    points = engine[0].points
    same = InspectionPoints(points.targets.copy(), points.normals.copy(), points.groups.copy())
    moved = points.targets.copy()
    moved[17, 1] += 1e-4
    other = InspectionPoints(moved, points.normals, points.groups)
    first = scan_path_hash(planned(engine, points))
    assert scan_path_hash(planned(engine, same)) == first
    assert scan_path_hash(planned(engine, other)) != first


def test_a_moved_part_has_a_moved_path(engine):
    part, prepared = engine
    T = random_transform(4)
    mesh = SurfaceMesh(apply(T, prepared.mesh.vertices), prepared.mesh.faces)
    points = InspectionPoints(
        apply(T, part.points.targets), rotate(T, part.points.normals), part.points.groups
    )
    path, moved = planned(engine, part.points), plan_scan_path(
        mesh, segment_mesh(mesh), SETTINGS, points
    )  # fmt: skip
    np.testing.assert_allclose(moved.positions, apply(T, path.positions), atol=1e-9)
    np.testing.assert_allclose(moved.directions, rotate(T, path.directions), atol=1e-9)


def corner(height):
    """A floor of 1 x 1 m with a wall of some height along x = 0."""
    vertices = np.array(
        [[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, height], [0, 1, height]]
    )
    return SurfaceMesh(vertices, np.array([[0, 1, 2], [0, 2, 3], [0, 3, 5], [0, 5, 4]]))


def floor_points(x, group):
    x = np.array(x)
    return InspectionPoints(
        np.stack([x, np.full(len(x), 0.5), np.zeros(len(x))], axis=1),
        np.tile([0.0, 0.0, 1.0], (len(x), 1)),
        np.array(group),
    )


def test_poses_beside_a_wall_are_tilted_or_left_out_with_the_reason():
    mesh = corner(1.0)
    wall = InspectionPoints(
        np.array([[0.08, 0.5, 0.0], [0.05, 0.3, 0.0], [0.0, 0.5, 0.6], [0.7, 0.5, 0.0]]),
        np.array([[0.0, 0, 1], [0, 0, 1], [1, 0, 0], [0, 0, 1]]),
        np.array([1, 2, 1, 3]),
    )
    path = plan_scan_path(mesh, segment_mesh(mesh), SETTINGS, wall)
    # Group 1 has the wall's side too: its first pose leans away from the wall. Group 2 has not.
    assert path.groups.tolist() == [1, 1, 3]
    assert path.directions[0, 0] < -0.05
    np.testing.assert_allclose(path.positions[0] + 0.3 * path.directions[0], wall.targets[0])
    assert path.positions[0, 0] >= SETTINGS.clearance_m - 1e-9
    assert len(path.left_out) == 1
    np.testing.assert_array_equal(path.left_out[0].target, wall.targets[1])
    assert "nearer than 0.15 m" in path.left_out[0].reason


def test_a_group_whose_normals_cancel_out_is_not_tilted():
    mesh = corner(0.2)
    both = InspectionPoints(
        np.array([[0.5, 0.5, 0.0], [0.5, 0.4, 0.0]]),
        np.array([[0.0, 0, 1], [0, 0, -1]]),
        np.array([1, 1]),
    )
    path = plan_scan_path(mesh, segment_mesh(mesh), SETTINGS, both)
    np.testing.assert_allclose(path.directions, [[0, 0, -1], [0, 0, 1]])


def test_a_part_without_points_is_refused(engine):
    with pytest.raises(InspectionPointsError, match="gives no measuring points"):
        planned(engine, None)


def test_the_other_strategies_do_not_ask_for_points():
    mesh = corner(0.02)
    settings = dataclasses.replace(SETTINGS, strategy="published")
    points = floor_points([0.5], [1])
    with_points = plan_scan_path(mesh, segment_mesh(mesh), settings, points)
    without = plan_scan_path(mesh, segment_mesh(mesh), settings)
    assert scan_path_hash(with_points) == scan_path_hash(without)
