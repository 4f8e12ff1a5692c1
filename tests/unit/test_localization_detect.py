"""Rendered images: what is found is where it was drawn."""

import cv2
import numpy as np
import pytest

from localization_scene import CELL, base_facing, camera_pose, row_fixture, true_corners
from skinplan.errors import ImageInvalidError, PartInvalidError
from skinplan.localization.camera import camera_model
from skinplan.localization.detect import detect_markers
from skinplan.localization.pose import CLEAR_SIDE_PX
from skinplan.mock.camera import MockCamera

CAMERA = camera_model(CELL.camera)
FIXTURE = row_fixture()
VIEWS = [(0.0, 1.0, 0.0), (0.3, 0.8, 0.1), (-0.4, 1.5, -0.4), (0.1, 2.2, 0.35), (0.2, 1.2, 1.0)]


def narrowest(corners):
    return np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).min(axis=1)


@pytest.fixture(scope="module")
def clean():
    return MockCamera(CELL.camera, FIXTURE, seed=1, blur_px=0.0, noise=0.0)


@pytest.fixture(scope="module")
def real():
    return MockCamera(CELL.camera, FIXTURE, seed=1)


@pytest.mark.parametrize("view", VIEWS)
def test_corners_without_noise_are_within_a_twentieth_pixel(clean, view):
    T_camera_workpiece = camera_pose(base_facing(*view))
    found = detect_markers(clean.render(T_camera_workpiece), FIXTURE.dictionary, CAMERA)
    ids, corners = found.ids, found.corners
    true_ids, expected = true_corners(T_camera_workpiece, FIXTURE)
    assert ids.tolist() == true_ids.tolist()
    clear = narrowest(expected) > CLEAR_SIDE_PX
    assert clear.sum() >= 2
    assert np.sqrt(np.mean((corners - expected)[clear] ** 2)) < 0.05


@pytest.mark.parametrize("view", VIEWS)
def test_corners_with_blur_and_noise_are_within_a_tenth_pixel(real, view):
    T_camera_workpiece = camera_pose(base_facing(*view))
    found = detect_markers(real.render(T_camera_workpiece), FIXTURE.dictionary, CAMERA)
    ids, corners = found.ids, found.corners
    true_ids, expected = true_corners(T_camera_workpiece, FIXTURE)
    # A marker at the very rim of the image may be missed.
    both = np.isin(true_ids, ids) & (narrowest(expected) > CLEAR_SIDE_PX)
    assert both.sum() >= 2
    errors = corners[np.isin(ids, true_ids[both])] - expected[both]
    assert np.sqrt(np.mean(errors**2)) < 0.1


def test_without_the_camera_the_bend_of_the_edges_stays(clean):
    T_camera_workpiece = camera_pose(base_facing(0.2, 0.8, 0.0))
    image = clean.render(T_camera_workpiece)
    _, expected = true_corners(T_camera_workpiece, FIXTURE)
    straight = detect_markers(image, FIXTURE.dictionary, CAMERA).corners
    bent = detect_markers(image, FIXTURE.dictionary).corners
    assert np.abs(straight - expected).max() < np.abs(bent - expected).max() < 0.5


def test_colour_gives_what_grey_gives(real):
    image = real.render(camera_pose(base_facing(0.0, 1.0, 0.0)))
    grey = detect_markers(image, FIXTURE.dictionary)
    colour = detect_markers(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), FIXTURE.dictionary)
    assert grey.ids.tolist() == colour.ids.tolist()
    np.testing.assert_allclose(grey.corners, colour.corners, atol=0.02)


def test_empty_wall_has_no_markers(real):
    away = camera_pose(base_facing(0.0, 1.0, np.pi))
    found = detect_markers(real.render(away), FIXTURE.dictionary)
    assert found.ids.shape == (0,)
    assert found.corners.shape == (0, 4, 2)
    assert found.covariance.shape == (0, 8, 8)


def test_an_id_at_two_places_is_left_out_and_the_others_stay():
    plate = np.full((300, 900), 255, np.uint8)
    book = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
    for place, marker_id in enumerate((7, 8, 7)):
        left = 50 + 300 * place
        plate[80:220, left : left + 140] = cv2.aruco.generateImageMarker(book, marker_id, 140)
    found = detect_markers(plate, "DICT_5X5_100")
    assert found.ids.tolist() == [8]
    assert found.duplicates == (7,)
    expected = np.array([[350, 80], [490, 80], [490, 220], [350, 220]]) - 0.5
    np.testing.assert_allclose(found.corners[0], expected, atol=0.05)


def test_mirrored_print_is_no_marker():
    book = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
    plate = np.pad(cv2.aruco.generateImageMarker(book, 7, 140), 60, constant_values=255)
    straight = detect_markers(plate, "DICT_5X5_100")
    assert (straight.ids.tolist(), straight.mirrored) == ([7], ())
    mirrored = detect_markers(np.ascontiguousarray(plate[:, ::-1]), "DICT_5X5_100")
    assert 7 not in mirrored.ids
    assert mirrored.mirrored == (7,)


@pytest.mark.parametrize(
    "image",
    [
        np.zeros((0, 0), np.uint8),
        np.zeros((10, 10), np.float32),
        np.zeros((10, 10, 4), np.uint8),
        np.zeros(10, np.uint8),
    ],
)
def test_what_is_no_image_is_refused(image):
    with pytest.raises(ImageInvalidError, match="8 bit"):
        detect_markers(image, "DICT_5X5_100")


@pytest.mark.parametrize("name", ["DICT_9X9_100", "", "CORNER_REFINE_NONE"])
def test_unknown_dictionary_is_refused_with_those_that_exist(name):
    with pytest.raises(PartInvalidError, match="DICT_5X5_100"):
        detect_markers(np.zeros((10, 10), np.uint8), name)


def test_photographs(shared_data):
    cases = {"403.jpg": [403], "tag_01_d7_14cm.png": [1], "tag_245-246_d7_14cm.png": [245, 246]}
    for name, expected in cases.items():
        image = cv2.imread(str(shared_data / "images" / "fiducials" / name))
        found = detect_markers(image, "DICT_5X5_1000").ids.tolist()
        assert found == expected, name
