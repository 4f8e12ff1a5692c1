"""Markers that are partly hidden: what is seen of them counts, and nothing else does."""

from dataclasses import replace

import numpy as np
import pytest

from localization_scene import CAMERA, CELL, base_facing, camera_pose, observed, row_fixture
from skinplan.localization.observe import observe
from skinplan.localization.pose import locate
from skinplan.localization.tracking import MarkerTracker
from skinplan.mock.camera import MockCamera
from skinplan.transforms import difference

FIXTURE = row_fixture()
QUALITY = CELL.quality
TRUTH = camera_pose(base_facing(0.0, 1.1, 0.2))
EXPECTED = {item.id: item.corners for item in observed(TRUTH, FIXTURE).markers}


@pytest.fixture(scope="module")
def camera():
    return MockCamera(CELL.camera, FIXTURE, seed=4)


def strip(corners, share, side):
    """A polygon over so much of a marker, from one of its sides."""
    a, b, c, d = np.roll(corners, side, axis=0)
    out, down = 0.15 * (b - a), 0.15 * (d - a)
    top, low = a + share * (b - a), d + share * (c - d)
    return np.array([a - out - down, top - down, low + down, d - out + down])


def covered(camera, ids, share, side, fixture=FIXTURE):
    covers = [strip(EXPECTED[i], share, side) for i in ids]
    return observe(camera.render(TRUTH, covers), CAMERA, fixture, QUALITY)


def normalised(item):
    """Squared error of a marker's corners by their covariance; 8 on an average."""
    error = (item.corners - EXPECTED[item.id]).ravel()
    known = item.corner_covariance + item.corner_floor_px**2 * np.eye(8)
    return float(error @ np.linalg.solve(known, error))


@pytest.mark.parametrize("share", [0.03, 0.1, 0.2, 0.3, 0.5])
def test_visible_edges_count_where_the_others_tell_the_place(camera, share):
    wholly, partly = [], []
    for side in range(4):
        seen = covered(camera, [14], share, side)
        whole = [item for item in seen.markers if item.id not in seen.partly]
        assert 14 not in [item.id for item in whole]
        assert 14 in (*seen.partly, *seen.covered) or share > 0.3
        for item in seen.markers:
            (partly if item.id in seen.partly else wholly).append(normalised(item))
        pose = locate(seen, CAMERA, FIXTURE, QUALITY)
        assert 14 in pose.hidden_ids, "the one who looks for what covers it is told"
        assert difference(TRUTH, pose.T_camera_workpiece)[0] < 1e-3
    assert len(partly) >= (3 if share < 0.5 else 2)
    assert max(partly) < 30.0
    assert np.mean(partly) < 12.0
    assert np.mean(wholly) < 12.0


def test_of_a_hidden_edge_nothing_is_known(camera):
    seen = covered(camera, [14], 0.3, 0)
    item = next(item for item in seen.markers if item.id == 14)
    sigma = np.sqrt(np.diag(item.corner_covariance)).reshape(4, 2)
    # The left edge: top left and bottom left.
    assert np.all(sigma[[0, 3]].max(axis=1) > 10.0)
    assert np.all(sigma[[1, 2]] < 0.1)


def test_with_all_but_one_covered_the_pose_is_better_than_of_the_one(camera):
    ids = sorted(EXPECTED)
    errors = {"one": [], "all": []}
    for side in range(4):
        seen = covered(camera, ids[1:], 0.15, side)
        assert len(seen.partly) >= 1
        alone = replace(seen, markers=tuple(m for m in seen.markers if m.id not in seen.partly))
        for name, sighting in (("one", alone), ("all", seen)):
            pose = locate(sighting, CAMERA, FIXTURE, QUALITY)
            errors[name].append(difference(TRUTH, pose.T_camera_workpiece)[0])
    assert np.mean(errors["all"]) < 0.6 * np.mean(errors["one"])


def test_a_tracked_marker_that_gets_covered_still_counts(camera):
    tracker = MarkerTracker(FIXTURE, QUALITY)
    free, hidden = camera.render(TRUTH), camera.render(TRUTH, [strip(EXPECTED[14], 0.2, 0)])
    looks = [tracker.observe(image, CAMERA) for image in (free, free, hidden, hidden)]
    assert [seen.partly for seen in looks] == [(), (), (14,), (14,)]
    # That it is free again is seen when the whole image is looked at again.
    looks += [tracker.observe(free, CAMERA) for _ in range(10)]
    assert looks[-1].partly == ()
    ids = [[item.id for item in seen.markers] for seen in looks]
    assert ids == [sorted(EXPECTED)] * len(looks)


def test_another_marker_in_the_place_is_not_taken_for_a_hidden_one():
    swapped = replace(
        FIXTURE, markers=tuple(replace(m, id=77) if m.id == 14 else m for m in FIXTURE.markers)
    )
    seen = covered(MockCamera(CELL.camera, swapped, seed=4), [14], 0.1, 0)
    assert 14 not in [item.id for item in seen.markers]
    seen = covered(MockCamera(CELL.camera, swapped, seed=4), [], 0.1, 0)
    assert seen.unknown == (77,)
    assert 14 not in [item.id for item in seen.markers]


def test_markers_that_contradict_each_other_expect_nothing(camera):
    """Where the pose may be wrong, edges near it must not confirm it."""
    seen = covered(camera, [14], 0.2, 0)
    assert 14 in seen.partly
    moved = replace(
        FIXTURE,
        markers=tuple(
            replace(m, size_m=1.03 * m.size_m) if m.id in (12, 13) else m for m in FIXTURE.markers
        ),
    )
    seen = covered(camera, [14], 0.2, 0, moved)
    assert 14 not in seen.partly


def test_an_edge_that_is_beside_its_place_leaves_its_marker_out():
    """A thin cover that nobody noticed: three others are enough to tell."""
    seen = observed(TRUTH, FIXTURE, np.random.default_rng(2), 0.03)
    first = seen.markers[0]
    corners = first.corners + np.array([[1.2, 0.0], [0.0, 0.0], [0.0, 0.0], [1.2, 0.0]])
    wrong = replace(seen, markers=(replace(first, corners=corners), *seen.markers[1:]))
    pose = locate(wrong, CAMERA, FIXTURE, QUALITY)
    assert pose.rejected_ids.tolist() == [first.id]
    assert locate(seen, CAMERA, FIXTURE, QUALITY).rejected_ids.size == 0
