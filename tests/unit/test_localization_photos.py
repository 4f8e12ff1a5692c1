"""Photographs that others took: ids, corners, and a pose that another solver found."""

import json

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from localization_scene import CELL
from skinplan.localization.detect import MarkerDetector
from skinplan.localization.model import CameraModel
from skinplan.localization.observe import observe
from skinplan.localization.pose import locate
from skinplan.part.model import Fixture, Marker
from skinplan.transforms import difference, transform

FIDUCIALS = ("403.jpg", "tag_01_d7_14cm.png", "tag_245-246_d7_14cm.png")


@pytest.fixture(scope="module")
def photos(shared_data):
    folder = shared_data / "images"
    return folder, json.loads((folder / "ground_truth.json").read_text(encoding="utf-8"))


def camera_of(entry):
    camera = entry["camera"]
    K = np.array(camera["K"], dtype=float).reshape(3, 3)
    return CameraModel(camera["width"], camera["height"], K, np.array(camera["D"], dtype=float))


def custom_dictionary(path):
    store = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    book = cv2.aruco.Dictionary()
    assert book.readDictionary(store.root())
    return book


def tutorial_cases(truth):
    return [
        name for name in truth["opencv_tutorial"] if "corners" in truth["opencv_tutorial"][name]
    ]


def test_tutorial_photographs_have_their_ids_and_corners(photos):
    folder, truth = photos
    names = tutorial_cases(truth)
    assert len(names) >= 3
    for name in names:
        entry = truth["opencv_tutorial"][name]
        book = entry["dictionary"]
        if "custom" in book:
            book = custom_dictionary(folder / "opencv_tutorial" / "tutorial_dict.yml")
        image = cv2.imread(str(folder / "opencv_tutorial" / name))
        found = MarkerDetector(book).find(image)
        wanted = {int(i): np.array(c) for i, c in entry["corners"].items()}
        assert sorted(wanted) == found.ids.tolist(), name
        for marker_id, corners in zip(found.ids.tolist(), found.corners, strict=True):
            # The reference is rounded to whole pixels.
            worst = np.abs(corners - wanted[marker_id]).max()
            assert worst <= entry["tolerance_px"] + 0.5, (name, marker_id, worst)


@pytest.mark.parametrize("name", FIDUCIALS)
@pytest.mark.parametrize("corners", ["auto", "lines", "subpix"])
def test_fiducials_have_their_ids_and_corners(photos, name, corners):
    folder, truth = photos
    entry = truth["fiducials"][name]
    image = cv2.imread(str(folder / "fiducials" / name))
    found = MarkerDetector("DICT_5X5_1000", corners).find(image, camera_of(entry))
    expected = entry.get("ids") or sorted(int(i) for i in entry["corners"])
    assert found.ids.tolist() == expected
    # The reference comes from OpenCV's corner finder; lines differ from it by its inward pull.
    bound = entry["tolerance_px"] if corners != "lines" else 0.7
    for marker_id, pixels in zip(found.ids.tolist(), found.corners, strict=True):
        if "corners" in entry:
            assert np.abs(pixels - np.array(entry["corners"][str(marker_id)])).max() < bound


def test_skewed_edges_without_a_shift_that_can_be_told_take_the_corner_finder(photos):
    folder, truth = photos
    name = "tag_245-246_d7_14cm.png"
    image, camera = (
        cv2.imread(str(folder / "fiducials" / name)),
        camera_of(truth["fiducials"][name]),
    )
    chosen, lines, finder = (
        MarkerDetector("DICT_5X5_1000", how).find(image, camera)
        for how in ("auto", "lines", "subpix")
    )
    np.testing.assert_array_equal(chosen.corners, [lines.corners[0], finder.corners[1]])
    assert chosen.floor_px[0] < 0.05 < 0.15 <= chosen.floor_px[1]


def pose_of_403(photos, corners):
    folder, truth = photos
    entry = truth["fiducials"]["403.jpg"]
    fixture = Fixture("DICT_5X5_1000", np.eye(4), (Marker(403, 0.145, np.eye(4)),))
    image, camera = cv2.imread(str(folder / "fiducials" / "403.jpg")), camera_of(entry)
    seen = observe(image, camera, fixture, CELL.quality, corners)
    pose = locate(seen, camera, fixture, CELL.quality)
    x, y, z, yaw, pitch, roll = entry["base_to_camera_xyz_ypr"]
    turn = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
    wanted = entry["expected_in_base"]
    reference = transform(wanted["xyz"], Rotation.from_euler("xyz", wanted["rpy"]).as_matrix())
    found = transform((x, y, z), turn) @ pose.T_camera_workpiece
    distance, angle = (
        np.linalg.norm(found[:3, 3] - reference[:3, 3]),
        difference(found, reference)[1],
    )
    return pose, distance, np.degrees(angle)


@pytest.mark.parametrize("corners", ["auto", "subpix"])
def test_the_pose_of_403_is_its_reference(photos, corners):
    pose, distance, angle = pose_of_403(photos, corners)
    assert distance < 0.001
    assert angle < 0.2
    assert distance < 4.0 * np.sqrt(np.trace(pose.covariance[:3, :3]))


def test_lines_explain_403_better_than_the_corner_finder_of_its_reference(photos):
    """The reference is a pose by corners that fit no square: see docs/localization.md."""
    by_lines, distance, angle = pose_of_403(photos, "lines")
    by_finder, _, _ = pose_of_403(photos, "subpix")
    assert by_lines.reprojection_error_px < 0.5 * by_finder.reprojection_error_px
    assert distance < 0.002
    assert angle < 0.45
