import dataclasses

import numpy as np
import pytest

from meshes import bump, grid, moved, random_transform
from skinplan.errors import InputError, ScanPathInvalidError
from skinplan.mesh.model import Segmentation
from skinplan.scan_path.model import FEATURE, ROW, ScanPath
from skinplan.scanner.certifier import Certifier
from skinplan.scanner.coverage import certify, certify_motion
from skinplan.scanner.model import ScannerModel
from skinplan.scanner.motion import row_sequences, views_between
from skinplan.scanner.sight import Sight
from skinplan.transforms import apply, rotate

SCANNER = ScannerModel(0.1, 0.2, 0.4, 0.3, np.radians(60))
DOWN = np.array([0.0, 0.0, -1.0])


def path_of(positions, directions, kinds=None, groups=None):
    count = len(positions)
    kinds = np.full(count, ROW) if kinds is None else np.asarray(kinds)
    groups = np.zeros(count, dtype=np.int64) if groups is None else np.asarray(groups)
    return ScanPath(positions, directions, positions + 0.3 * directions, kinds, groups, "test", 0)


def plain(mesh):
    return Segmentation(np.zeros(len(mesh.faces), dtype=np.int64), mesh)


def test_a_straight_motion_is_divided_evenly():
    positions = np.array([[0.0, 0.0, 0.3], [0.095, 0.0, 0.3], [0.095, 0.005, 0.3]])
    directions = np.tile(DOWN, (3, 1))
    places, views = views_between(positions, directions, [np.arange(3)], 0.01, 0.1)
    np.testing.assert_allclose(places[:, 0], 0.0095 * np.arange(1, 10))
    np.testing.assert_allclose(places[:, 1:], [[0.0, 0.3]] * 9)
    np.testing.assert_allclose(views, np.tile(DOWN, (9, 1)))


def test_a_turn_has_equal_angles_in_one_plane():
    first, last = np.array([1.0, 0.0, 0.0]), np.array([0.0, np.sin(1.2), np.cos(1.2)])
    places, views = views_between(
        np.zeros((2, 3)), np.array([first, last]), [np.array([0, 1])], 0.01, np.radians(2.0)
    )
    assert len(views) == 44 and not places.any()
    np.testing.assert_allclose(np.linalg.norm(views, axis=1), 1.0)
    angles = np.arccos(np.einsum("ij,ij->i", views[:-1], views[1:]))
    np.testing.assert_allclose(angles, np.pi / 2 / 45, atol=1e-9)
    np.testing.assert_allclose(views @ np.cross(first, last), 0.0, atol=1e-12)


def test_opposite_directions_turn_through_some_plane():
    views = views_between(
        np.zeros((2, 3)), np.array([DOWN, -DOWN]), [np.array([0, 1])], 0.01, np.pi / 4
    )[1]
    np.testing.assert_allclose(views @ DOWN, np.cos(np.pi / 4 * np.arange(1, 4)), atol=1e-12)


def test_only_neighbours_of_a_sequence_are_joined():
    positions = np.zeros((6, 3))
    positions[:, 0] = [0.0, 0.1, 1.0, 1.1, 2.0, 2.1]
    path = path_of(
        positions, np.tile(DOWN, (6, 1)), [ROW, ROW, ROW, ROW, FEATURE, FEATURE], [3, 3, 4, 4, 1, 1]
    )
    rows = row_sequences(path)
    assert [row.tolist() for row in rows] == [[0, 1], [2, 3]]
    places, _ = views_between(positions, path.directions, rows, 0.05)
    np.testing.assert_allclose(places[:, 0], [0.05, 1.05])
    backward, _ = views_between(positions, path.directions, [np.array([5, 4, 2])], 0.3)
    np.testing.assert_allclose(backward[:, 0], [1.75, 1.5, 1.25])
    assert len(views_between(positions, path.directions, [], 0.05)[0]) == 0
    assert len(views_between(positions, path.directions, [np.array([3])], 0.05)[0]) == 0
    none = path_of(np.zeros((0, 3)), np.zeros((0, 3)))
    assert row_sequences(none) == []


def test_a_moved_disc_sees_a_stadium():
    mesh = grid(1.6, 0.6, 0.02)
    positions = np.array([[-0.4, 0.0, 0.3], [0.4, 0.0, 0.3]])
    path = path_of(positions, np.tile(DOWN, (2, 1)))
    disc = np.pi * 0.01
    points = certify(mesh, plain(mesh), path, SCANNER, 0.004)
    assert points.area_ratio * mesh.area == pytest.approx(2 * disc, rel=0.01)
    found = certify_motion(mesh, plain(mesh), path, SCANNER, 0.004)
    wanted = disc + 0.8 * 0.2
    assert abs(found.area_ratio * mesh.area - wanted) <= 0.2 * 0.004 * (np.pi * 0.2 + 1.6)
    still = certify_motion(mesh, plain(mesh), path, SCANNER, 0.004, sequences=[])
    np.testing.assert_array_equal(still.views, points.views)


def track(seed, mesh):
    rng = np.random.default_rng(seed)
    positions = np.column_stack(
        [rng.uniform(-0.45, 0.45, 8), rng.uniform(-0.25, 0.25, 8), rng.uniform(0.24, 0.45, 8)]
    )
    directions = rng.normal(0, 0.4, (8, 3)) + DOWN
    return positions, directions / np.linalg.norm(directions, axis=1, keepdims=True)


@pytest.mark.parametrize("field", ["cylinder", "cone"])
@pytest.mark.parametrize("least", [1, 3])
def test_what_is_left_out_changes_no_answer(field, least):
    mesh = grid(1.0, 0.6, 0.02, lambda x, y: bump(x, y, 0.09, 0.15, 0.05))
    scanner = dataclasses.replace(SCANNER, field=field)
    certifier = Certifier(mesh, plain(mesh), scanner, 0.008, least_views=least)
    positions, directions = track(4, mesh)
    between = views_between(positions, directions, [np.arange(8)])
    everything = path_of(
        np.concatenate([positions, between[0]]), np.concatenate([directions, between[1]])
    )
    exact = certifier.points(everything)
    short = certifier.motion(path_of(positions, directions))
    along = certifier.track(everything.positions, everything.directions)
    for found in (short, along):
        np.testing.assert_array_equal(
            np.minimum(found.views, least), np.minimum(exact.views, least)
        )
        assert np.all(found.views <= exact.views)
        np.testing.assert_array_equal(found.reasons, exact.reasons)
        np.testing.assert_array_equal(found.sights, exact.sights)
        assert found.area_ratio == exact.area_ratio
        # Of the views some were not tested: the best angle can only look worse.
        seen = exact.views > 0
        assert np.all(found.axis_rad[seen] >= exact.axis_rad[seen])
    assert 0.1 < exact.area_ratio < 0.95
    assert set(np.unique(exact.reasons)) >= {Sight.SEEN, Sight.TOO_OBLIQUE, Sight.NOT_REACHED}


def test_motion_turns_with_the_part():
    mesh = grid(1.0, 0.6, 0.02, lambda x, y: bump(x, y, 0.09, 0.15, 0.05))
    T = random_transform(12)
    turned = moved(mesh, T)
    positions, directions = track(7, mesh)
    first = certify_motion(mesh, plain(mesh), path_of(positions, directions), SCANNER, 0.01)
    path = path_of(apply(T, positions), rotate(T, directions))
    second = certify_motion(turned, plain(turned), path, SCANNER, 0.01)
    assert np.mean(first.sights != second.sights) < 2e-3


def test_motion_that_can_not_be():
    positions, directions = np.zeros((2, 3)), np.tile(DOWN, (2, 1))
    pair = [np.array([0, 1])]
    far = positions + [[0.0, 0.0, 0.0], [1e5, 0.0, 0.0]]
    for step_m, step_rad in ((0.0, 0.1), (-1.0, 0.1), (np.nan, 0.1), (0.01, 0.0), (0.01, np.inf)):
        with pytest.raises(InputError, match="steps"):
            views_between(positions, directions, pair, step_m, step_rad)
    with pytest.raises(InputError, match="at most"):
        views_between(far, directions, pair, 0.01)
    for wrong in (np.array([0, 2]), np.array([-1, 0])):
        with pytest.raises(ScanPathInvalidError, match="from 0 to 1"):
            views_between(positions, directions, [wrong])
    with pytest.raises(ScanPathInvalidError, match="finite"):
        views_between(positions * np.nan, directions, pair)
    with pytest.raises(ScanPathInvalidError, match="unit"):
        views_between(positions, directions * 2, pair)
