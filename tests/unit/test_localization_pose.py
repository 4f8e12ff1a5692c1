"""The pose of the workpiece against the truth that the image was made from."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from localization_scene import (
    CAMERA,
    CELL,
    base_facing,
    camera_pose,
    observed,
    row_fixture,
    true_corners,
)
from skinplan.errors import (
    AmbiguousPoseError,
    ImageInvalidError,
    LocalizationError,
    NoMarkerError,
    WrongMarkerError,
)
from skinplan.localization.judge import exact_detection, observations
from skinplan.localization.model import CameraModel, Sighting
from skinplan.localization.observe import observe
from skinplan.localization.pose import locate
from skinplan.mock.camera import MockCamera
from skinplan.part.model import Fixture, Marker
from skinplan.transforms import difference, transform

FIXTURE = row_fixture()
QUALITY = CELL.quality
CORNER_NOISE_PX = 0.02


def _seen(ids, corners):
    found = exact_detection(ids, corners, CORNER_NOISE_PX)
    return Sighting(observations(found, CAMERA, FIXTURE, QUALITY))


@pytest.mark.parametrize("view", [(0.0, 1.0, 0.0), (0.5, 2.2, 0.35), (-0.3, 1.4, -1.0)])
def test_exact_corners_give_the_exact_pose(view):
    truth = camera_pose(base_facing(*view))
    pose = locate(observed(truth, FIXTURE), CAMERA, FIXTURE, QUALITY)
    distance, angle = difference(truth, pose.T_camera_workpiece)
    assert distance < 1e-6
    assert angle < 1e-6
    assert pose.reprojection_error_px < 1e-6
    assert pose.distance_m == pytest.approx(view[1] * np.cos(view[2]), abs=1e-6)
    assert pose.angle_rad == pytest.approx(np.pi / 2 - abs(view[2]), abs=1e-6)


def test_the_fixture_may_stand_anywhere_in_the_workpiece():
    """Moving the workpiece frame moves the answer with it."""
    truth = camera_pose(base_facing(0.0, 1.1, 0.2))
    pose = locate(observed(truth, FIXTURE), CAMERA, FIXTURE, QUALITY)
    shift = transform((0.3, -0.2, 0.1), Rotation.from_rotvec([0.4, -0.3, 0.8]).as_matrix())
    moved = replace(FIXTURE, T_workpiece_fixture=shift @ FIXTURE.T_workpiece_fixture)
    again = locate(observed(truth, FIXTURE), CAMERA, moved, QUALITY)
    np.testing.assert_allclose(again.T_camera_workpiece @ shift, pose.T_camera_workpiece, atol=1e-6)


def test_markers_in_space_are_solved_together():
    fixture = Fixture(
        "DICT_5X5_100",
        np.eye(4),
        (
            Marker(1, 0.12, transform((-0.3, 0.0, 0.0))),
            Marker(2, 0.08, transform((0.2, 0.1, 0.1), Rotation.from_euler("y", 0.5).as_matrix())),
        ),
    )
    truth = transform((0.1, -0.05, 1.2), Rotation.from_euler("xyz", [3.3, 0.2, 0.1]).as_matrix())
    pose = locate(observed(truth, fixture), CAMERA, fixture, QUALITY)
    assert pose.marker_ids.tolist() == [1, 2]
    assert max(difference(truth, pose.T_camera_workpiece)) < 1e-6


def test_rendered_image_gives_the_pose_within_two_millimetres():
    camera = MockCamera(CELL.camera, FIXTURE, seed=3)
    random = np.random.default_rng(5)
    for _ in range(15):
        view = random.uniform([-0.8, 0.9, -0.05], [0.8, 1.1, 0.05])
        truth = camera_pose(base_facing(*view))
        seen = observe(camera.render(truth), CAMERA, FIXTURE, QUALITY)
        pose = locate(seen, CAMERA, FIXTURE, QUALITY)
        distance, angle = difference(truth, pose.T_camera_workpiece)
        assert distance < 0.002
        assert angle < np.radians(0.1)
        assert pose.quality > QUALITY.threshold


def test_covariance_tells_the_scatter():
    """Monte Carlo: the normalised squared error of a 6-D pose has a mean of 6."""
    random = np.random.default_rng(11)
    truth = camera_pose(base_facing(0.0, 1.0, 0.1))
    squares = []
    for _ in range(150):
        seen = observed(truth, FIXTURE, random, CORNER_NOISE_PX)
        pose = locate(seen, CAMERA, FIXTURE, QUALITY)
        turn = Rotation.from_matrix(pose.T_camera_workpiece[:3, :3] @ truth[:3, :3].T).as_rotvec()
        error = np.concatenate([pose.T_camera_workpiece[:3, 3] - truth[:3, 3], turn])
        squares.append(error @ np.linalg.solve(pose.covariance, error))
    # Standard deviation of the mean of 150 chi-squared values: sqrt(2 * 6 / 150) = 0.28.
    assert 5.0 < np.mean(squares) < 7.0


def test_more_noise_means_more_covariance():
    random = np.random.default_rng(2)
    truth = camera_pose(base_facing(0.0, 1.0, 0.1))
    calm = locate(observed(truth, FIXTURE, random, 0.02), CAMERA, FIXTURE, QUALITY)
    wild = locate(observed(truth, FIXTURE, random, 0.4), CAMERA, FIXTURE, QUALITY)
    assert np.all(np.diag(wild.covariance) > 10 * np.diag(calm.covariance))
    assert np.all(np.linalg.eigvalsh(calm.covariance) > 0)


def test_single_marker_far_away_is_refused_as_ambiguous():
    random = np.random.default_rng(4)
    truth = camera_pose(base_facing(0.2, 2.8, 0.25))
    refused = 0
    for _ in range(20):
        seen = observed(truth, FIXTURE, random, 0.5, only=[14])
        assert len(seen.markers) == 1
        try:
            pose = locate(seen, CAMERA, FIXTURE, QUALITY)
        except AmbiguousPoseError as error:
            refused += 1
            assert "14" in str(error)
            continue
        # What is not refused is no mirrored solution.
        assert difference(truth, pose.T_camera_workpiece)[1] < np.radians(20)
    assert refused >= 5


def test_the_bound_of_ambiguity_is_a_parameter():
    seen = observed(
        camera_pose(base_facing(0.2, 2.8, 0.25)), FIXTURE, np.random.default_rng(4), 0.3, only=[14]
    )
    assert 0.0 < seen.markers[0].ambiguity_ratio < 1.0
    locate(seen, CAMERA, FIXTURE, QUALITY, ambiguity_max=seen.markers[0].ambiguity_ratio * 1.01)
    with pytest.raises(AmbiguousPoseError):
        locate(seen, CAMERA, FIXTURE, QUALITY, ambiguity_max=seen.markers[0].ambiguity_ratio * 0.99)


def test_oblique_single_marker_near_is_no_guess():
    truth = camera_pose(base_facing(0.2, 1.0, 0.5))
    seen = observed(truth, FIXTURE, np.random.default_rng(1), 0.02, only=[14])
    assert seen.markers[0].ambiguity_ratio < 0.2
    assert difference(truth, locate(seen, CAMERA, FIXTURE, QUALITY).T_camera_workpiece)[0] < 0.02


def test_nothing_seen_is_no_marker():
    with pytest.raises(NoMarkerError, match="DICT_5X5_100"):
        locate(Sighting(()), CAMERA, FIXTURE, QUALITY)


def test_markers_of_another_fixture_are_wrong_ones():
    other = row_fixture(first_id=40)
    image = MockCamera(CELL.camera, other, seed=1).render(camera_pose(base_facing(0, 1.0, 0)))
    seen = observe(image, CAMERA, FIXTURE, QUALITY)
    assert not seen.markers
    with pytest.raises(WrongMarkerError, match="4[0-9]"):
        locate(seen, CAMERA, FIXTURE, QUALITY)
    foreign = observe(image, CAMERA, other, QUALITY)
    with pytest.raises(WrongMarkerError, match="accepted"):
        locate(foreign, CAMERA, FIXTURE, QUALITY)


def test_markers_that_are_not_where_the_fixture_says_are_refused():
    ids, corners = true_corners(camera_pose(base_facing(0.0, 1.0, 0.0)), FIXTURE)
    swapped = _seen(ids[::-1], corners)
    with pytest.raises(LocalizationError, match="px"):
        locate(swapped, CAMERA, FIXTURE, QUALITY)


def test_degenerate_corners_give_no_traceback():
    ids = np.array([10, 11])
    corners = np.stack([np.full((4, 2), 300.0), np.linspace(0, 90, 8).reshape(4, 2)])
    seen = _seen(ids, corners)
    with pytest.raises(LocalizationError):
        locate(seen, CAMERA, FIXTURE, QUALITY)


def test_image_of_another_size_is_refused():
    with pytest.raises(ImageInvalidError, match="1280 x 720"):
        observe(np.zeros((480, 640), np.uint8), CAMERA, FIXTURE, QUALITY)


@pytest.mark.parametrize(
    "camera",
    [
        CameraModel(1280, 720, np.full((3, 3), np.nan), np.zeros(5)),
        CameraModel(1280, 720, np.zeros((3, 3)), np.zeros(5)),
        CameraModel(1280, 720, CAMERA.K, np.zeros(3)),
        CameraModel(0, 720, CAMERA.K, np.zeros(5)),
    ],
)
def test_camera_that_can_not_be_is_refused(camera):
    with pytest.raises(ImageInvalidError, match="accepted"):
        observe(np.zeros((720, 1280), np.uint8), camera, FIXTURE, QUALITY)
