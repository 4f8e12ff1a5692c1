"""The covariance against Monte Carlo, the bundle's robustness, fusion and tracking."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from localization_scene import CAMERA, CELL, base_facing, camera_pose, observed, row_fixture
from skinplan.errors import FixtureMismatchError, ImageInvalidError, InputError
from skinplan.localization.camera import (
    project,
    project_rays,
    ray_derivative,
    require_camera,
    undistorted,
)
from skinplan.localization.chain import LocatedPart, moved_by
from skinplan.localization.fuse import fuse
from skinplan.localization.model import CameraModel, Sighting
from skinplan.localization.observe import observe
from skinplan.localization.pose import locate
from skinplan.localization.tracking import MarkerTracker
from skinplan.mock.camera import MockCamera
from skinplan.transforms import difference, inverse, transform

FIXTURE = row_fixture()
QUALITY = CELL.quality
T_ARM_BASE_CAMERA = inverse(CELL.T_base_link_arm_base) @ CELL.camera.T_base_link_optical


def normalised(located, wanted):
    found = located.T_arm_base_workpiece
    turn = Rotation.from_matrix(found[:3, :3] @ wanted[:3, :3].T).as_rotvec()
    error = np.concatenate([found[:3, 3] - wanted[:3, 3], turn])
    return error @ np.linalg.solve(located.covariance, error)


@pytest.mark.parametrize(
    ("view", "only"),
    [
        pytest.param((0.0, 1.0, 0.1), None, marks=pytest.mark.long),
        ((0.2, 0.9, 0.6), [14]),
    ],
)
def test_a_thousand_draws_scatter_as_the_covariance_says(view, only):
    """In the arm base, for the bundle and for one marker: within the 95 % band of chi squared."""
    random = np.random.default_rng(12)
    truth = camera_pose(base_facing(*view))
    squares = []
    for _ in range(1000):
        seen = observed(truth, FIXTURE, random, 0.05, only=only)
        pose = locate(seen, CAMERA, FIXTURE, QUALITY)
        located = LocatedPart.from_camera(pose, T_ARM_BASE_CAMERA, 0.0)
        squares.append(normalised(located, T_ARM_BASE_CAMERA @ truth))
    low, high = chi2.ppf([0.025, 0.975], 6 * 1000) / 1000
    assert low < np.mean(squares) < high
    inside = np.mean((squares > chi2.ppf(0.025, 6)) & (squares < chi2.ppf(0.975, 6)))
    assert 0.935 < inside < 0.965


def test_the_error_of_the_mounting_is_carried_along():
    """Monte Carlo over the hand-eye calibration; the lever to the workpiece counts."""
    random = np.random.default_rng(3)
    truth = camera_pose(base_facing(0.0, 1.0, 0.1))
    pose = locate(observed(truth, FIXTURE), CAMERA, FIXTURE, QUALITY)
    pose = replace(pose, covariance=np.zeros((6, 6)), T_camera_workpiece=truth)
    located = LocatedPart.from_camera(pose, T_ARM_BASE_CAMERA, 0.0, 0.002, 0.003)
    errors = []
    for _ in range(4000):
        turn = Rotation.from_rotvec(random.normal(0.0, 0.003, 3)).as_matrix()
        drawn = T_ARM_BASE_CAMERA.copy()
        drawn[:3, :3] = turn @ drawn[:3, :3]
        drawn[:3, 3] += random.normal(0.0, 0.002, 3)
        found = (drawn @ truth)[:3, 3] - (T_ARM_BASE_CAMERA @ truth)[:3, 3]
        errors.append(found)
    np.testing.assert_allclose(np.cov(np.transpose(errors)), located.covariance[:3, :3], atol=9e-7)


def test_a_marker_that_was_moved_on_the_fixture_is_left_out_and_named():
    truth = camera_pose(base_facing(0.0, 1.4, 0.1))
    moved = replace(
        FIXTURE,
        markers=tuple(
            replace(marker, T_fixture_marker=marker.T_fixture_marker @ transform((0.05, 0.02, 0)))
            if marker.id == 13
            else marker
            for marker in FIXTURE.markers
        ),
    )
    pose = locate(observed(truth, moved, np.random.default_rng(1), 0.02), CAMERA, FIXTURE, QUALITY)
    assert pose.rejected_ids.tolist() == [13]
    assert 13 not in pose.marker_ids
    assert difference(truth, pose.T_camera_workpiece)[0] < 0.002


def test_two_markers_that_contradict_each_other_are_no_fixture():
    truth = camera_pose(base_facing(0.0, 1.4, 0.1))
    seen = observed(truth, FIXTURE, only=[13, 14])
    shifted = transform((0.1, 0.0, 0.0))
    other = replace(
        FIXTURE,
        markers=tuple(
            replace(m, T_fixture_marker=m.T_fixture_marker @ shifted) if m.id == 13 else m
            for m in FIXTURE.markers
        ),
    )
    with pytest.raises(FixtureMismatchError, match="more than half"):
        locate(seen, CAMERA, other, QUALITY)


def test_a_covered_marker_is_hidden_and_a_partly_covered_one_keeps_its_place():
    truth = camera_pose(base_facing(0.0, 1.2, 0.1))
    camera = MockCamera(CELL.camera, FIXTURE, seed=1)
    ids = [item.id for item in observe(camera.render(truth), CAMERA, FIXTURE, QUALITY).markers]
    number = ids[1]
    corners = observed(truth, FIXTURE, only=[number]).markers[0].corners
    middle = corners.mean(axis=0)
    image = camera.render(truth, [middle + 1.5 * (corners - middle)])
    seen = observe(image, CAMERA, FIXTURE, QUALITY)
    assert number not in [item.id for item in seen.markers]
    pose = locate(seen, CAMERA, FIXTURE, QUALITY)
    assert pose.hidden_ids.tolist() == [number]
    assert difference(truth, pose.T_camera_workpiece)[0] < 0.002
    # Half of the white margin and a bit of one edge covered.
    edge = corners[0] + 0.45 * (corners[1] - corners[0])
    finger = edge + np.array([[-3, -25], [3, -25], [3, 3], [-3, 3]])
    seen = observe(camera.render(truth, [finger]), CAMERA, FIXTURE, QUALITY)
    for item in seen.markers:
        if item.id == number:
            assert np.abs(item.corners - corners).max() < 0.5


@pytest.mark.parametrize("share", [0.06, 0.1, 0.15])
def test_a_covered_edge_gives_no_wrong_corners(share):
    """A strip over one side: the marker is not found, or named as partly hidden."""
    camera, named = MockCamera(CELL.camera, FIXTURE, seed=1), 0
    for angle in (0.0, 0.3, -0.4):
        truth = camera_pose(base_facing(0.0, 1.0, angle))
        for item in observed(truth, FIXTURE).markers:
            top = item.corners[0] + share * (item.corners[1] - item.corners[0])
            low = item.corners[3] + share * (item.corners[2] - item.corners[3])
            out = 0.3 * (item.corners[0] - item.corners[1])
            down = 0.3 * (item.corners[3] - item.corners[0])
            strip = np.array(
                [item.corners[0] + out - down, top - down, low + down, item.corners[3] + out + down]
            )
            seen = observe(camera.render(truth, [strip]), CAMERA, FIXTURE, QUALITY)
            named += item.id in (*seen.covered, *seen.partly)
            for other in seen.markers:
                if other.id == item.id:
                    assert np.abs(other.corners - item.corners).max() < 1.5
    assert share > 0.06 or named > 0


def test_both_planar_solutions_and_their_errors_are_given():
    seen = observed(camera_pose(base_facing(0.2, 2.0, 0.4)), FIXTURE, only=[14]).markers[0]
    assert seen.reprojection_error_px < seen.second_error_px
    assert difference(seen.T_camera_marker, seen.T_camera_second)[1] > np.radians(20)
    ratio = seen.reprojection_error_px / seen.second_error_px
    assert seen.ambiguity_ratio == pytest.approx(ratio)


def test_fusion_averages_the_noise_and_leaves_an_outlier_out():
    random = np.random.default_rng(5)
    truth = camera_pose(base_facing(0.0, 1.2, 0.2))
    frames = [observed(truth, FIXTURE, random, 0.1) for _ in range(16)]
    one = locate(frames[0], CAMERA, FIXTURE, QUALITY)
    fused = fuse(frames, CAMERA, FIXTURE, QUALITY)
    all_of_them = locate(fused, CAMERA, FIXTURE, QUALITY)
    assert fused.images == 16
    ratio = np.trace(one.covariance) / np.trace(all_of_them.covariance)
    assert 8.0 < ratio < 32.0
    shaken = camera_pose(base_facing(0.02, 1.2, 0.2))
    with_outlier = fuse([*frames, observed(shaken, FIXTURE, random, 0.1)], CAMERA, FIXTURE, QUALITY)
    pose = locate(with_outlier, CAMERA, FIXTURE, QUALITY)
    assert difference(pose.T_camera_workpiece, all_of_them.T_camera_workpiece)[0] < 2e-4


def test_fusion_keeps_what_any_image_says_is_odd_and_needs_an_image():
    truth = camera_pose(base_facing(0.0, 1.2, 0.2))
    seen = observed(truth, FIXTURE)
    odd = replace(seen, duplicates=(seen.markers[0].id,))
    fused = fuse([seen, odd, seen], CAMERA, FIXTURE, QUALITY)
    assert fused.duplicates == odd.duplicates
    assert seen.markers[0].id not in [item.id for item in fused.markers]
    assert fuse([Sighting(()), seen], CAMERA, FIXTURE, QUALITY).markers
    with pytest.raises(InputError, match="at least 1"):
        fuse([], CAMERA, FIXTURE, QUALITY)


def test_tracking_gives_what_the_whole_image_gives():
    camera = MockCamera(CELL.camera, FIXTURE, seed=2)
    tracker = MarkerTracker(FIXTURE, QUALITY)
    windowed = 0
    for step in range(24):
        truth = camera_pose(base_facing(0.002 * step, 1.3, 0.1))
        image = camera.render(truth)
        seen, whole = tracker.observe(image, CAMERA), observe(image, CAMERA, FIXTURE, QUALITY)
        windowed += tracker.windowed
        assert [item.id for item in seen.markers] == [item.id for item in whole.markers]
        for a, b in zip(seen.markers, whole.markers, strict=True):
            np.testing.assert_allclose(a.corners, b.corners, atol=0.05)
    assert 18 <= windowed < 24, "now and then the whole image is looked at"
    away = camera.render(camera_pose(base_facing(0.0, 1.0, np.pi)))
    assert not tracker.observe(away, CAMERA).markers
    assert not tracker.windowed


def test_rational_polynomial_projects_as_opencv_and_has_its_derivative():
    D = np.array([0.3, -0.2, 0.001, -0.002, 0.05, 0.2, -0.1, 0.03])
    camera = require_camera(CameraModel(1280, 720, CAMERA.K, D))
    points = np.random.default_rng(1).uniform([-0.5, -0.3, 1], [0.5, 0.3, 2], (30, 3))
    expected, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), CAMERA.K, D)
    pixels, rays = project(points, camera), points[:, :2] / points[:, 2:]
    np.testing.assert_allclose(pixels, expected[:, 0], atol=1e-9)
    np.testing.assert_allclose(undistorted(pixels, camera), rays, atol=1e-7)
    for model in (camera, replace(camera, D=np.zeros(0))):
        derivative = ray_derivative(rays, model)
        for axis in range(2):
            step = np.eye(2)[axis] * 1e-6
            slope = (project_rays(rays + step, model) - project_rays(rays - step, model)) / 2e-6
            np.testing.assert_allclose(derivative[:, :, axis], slope, rtol=1e-5, atol=1e-4)


def test_a_rectified_image_gives_the_same_pose():
    truth = camera_pose(base_facing(0.0, 1.1, 0.2))
    image = MockCamera(CELL.camera, FIXTURE, seed=1).render(truth)
    rectified = cv2.undistort(image, CAMERA.K, CAMERA.D)
    flat = CameraModel(CAMERA.width, CAMERA.height, CAMERA.K, np.zeros(0))
    pose = locate(observe(rectified, flat, FIXTURE, QUALITY), flat, FIXTURE, QUALITY)
    distance, angle = difference(truth, pose.T_camera_workpiece)
    assert distance < 0.002
    assert angle < np.radians(0.1)


def test_far_too_many_pixels_are_refused():
    huge = np.lib.stride_tricks.as_strided(np.zeros(1, np.uint8), (20000, 20000), (0, 0))
    with pytest.raises(ImageInvalidError, match="at most"):
        observe(huge, CameraModel(20000, 20000, CAMERA.K, CAMERA.D), FIXTURE, QUALITY)


def test_a_part_has_moved_beyond_a_bound_only():
    assert moved_by(np.eye(4), transform((0.2, 0, 0)), 0.25, 0.1) == ""
    assert "0.300 m" in moved_by(np.eye(4), transform((0.3, 0, 0)), 0.25, 0.1)
    turned = transform(rotation=Rotation.from_euler("z", 0.2).as_matrix())
    assert "11.5 deg" in moved_by(np.eye(4), turned, 0.25, 0.1)
