"""The rendered image, without the detector."""

import numpy as np
import pytest

from localization_scene import CAMERA, CELL, base_facing, camera_pose, row_fixture
from skinplan.errors import InputError
from skinplan.localization.camera import project
from skinplan.mock.camera import MockCamera
from skinplan.transforms import apply

FIXTURE = row_fixture()
POSE = camera_pose(base_facing(0.2, 1.0, 0.1))


@pytest.fixture(scope="module")
def clean():
    return MockCamera(CELL.camera, FIXTURE, seed=1, blur_px=0.0, noise=0.0)


def grey_at(image, T_camera_workpiece, marker_id, place):
    point = apply(T_camera_workpiece @ FIXTURE.T_workpiece_marker(marker_id), np.array([place]))
    column, row = np.rint(project(point, CAMERA)[0]).astype(int)
    return int(image[row, column])


def test_border_is_black_and_plate_white_where_projected(clean):
    image = clean.render(POSE)
    assert image.shape == (CAMERA.height, CAMERA.width)
    assert image.dtype == np.uint8
    for side in (-1.0, 1.0):
        assert grey_at(image, POSE, 14, (side * 0.043, 0.0, 0.0)) < 40
        assert grey_at(image, POSE, 14, (0.0, side * 0.043, 0.0)) < 40
        assert grey_at(image, POSE, 14, (side * 0.06, 0.0, 0.0)) > 210
        assert 100 < grey_at(image, POSE, 14, (0.0, side * 0.09, 0.0)) < 160


def test_the_mean_grey_does_not_depend_on_the_place_between_pixels(clean):
    """Every pixel is the mean over its area: a shift of a fraction of a pixel moves no light."""
    levels, shifts = [], np.linspace(0.0, 0.003, 25)
    for shift in shifts:
        image = clean.render(camera_pose(base_facing(0.2 + shift, 1.0, 0.0)))
        levels.append(image[:, 350:950].astype(float).sum())
    # The distortion changes the sizes slowly; what is left is the coarseness of the sampling.
    slow = np.polyval(np.polyfit(shifts, levels, 2), shifts)
    light_of_a_pixel_column = 200.0 * 130
    assert np.abs(levels - slow).max() < 0.1 * light_of_a_pixel_column


def test_seen_from_behind_or_behind_the_camera_nothing_is_drawn(clean):
    empty = clean.render(camera_pose(base_facing(0.0, 1.0, np.pi)))
    assert empty.min() > 90
    assert empty.max() < 170
    behind = camera_pose(base_facing(0.0, 1.0, 0.0, turn=np.pi))
    np.testing.assert_array_equal(clean.render(behind), empty)


def test_noise_is_the_stated_one_new_in_every_image_and_seeded(clean):
    noisy, again = (MockCamera(CELL.camera, FIXTURE, 3, blur_px=0.0, noise=2.0) for _ in range(2))
    first, second = noisy.render(POSE), noisy.render(POSE)
    flat = np.s_[500:700, 100:1200]
    difference = first[flat].astype(float) - clean.render(POSE)[flat]
    assert np.std(difference) == pytest.approx(2.0, rel=0.05)
    assert abs(np.mean(difference)) < 0.1
    assert np.std(first[flat].astype(float) - second[flat]) == pytest.approx(2.8, rel=0.1)
    np.testing.assert_array_equal(first, again.render(POSE))


def test_blur_softens_edges_and_keeps_the_mean(clean):
    soft = MockCamera(CELL.camera, FIXTURE, 3, blur_px=1.5, noise=0.0).render(POSE).astype(float)
    sharp = clean.render(POSE).astype(float)
    assert np.abs(np.diff(soft, axis=1)).max() < 0.6 * np.abs(np.diff(sharp, axis=1)).max()
    assert soft.mean() == pytest.approx(sharp.mean(), abs=0.1)


def test_what_is_no_pose_is_refused(clean):
    with pytest.raises(InputError, match="finite"):
        clean.render(np.full((4, 4), np.nan))
