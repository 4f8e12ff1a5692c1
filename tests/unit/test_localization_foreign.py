"""Markers that are not the fixture's are named, as by a detector that looks for all."""

import cv2
import numpy as np
import pytest

from localization_scene import CAMERA, CELL, base_facing, camera_pose, row_fixture
from skinplan.localization.detect import MarkerDetector
from skinplan.mock.camera import MockCamera

FIXTURE = row_fixture()
OWN = [marker.id for marker in FIXTURE.markers]


def rendered(seed, **values):
    random = np.random.default_rng(seed)
    place = random.uniform([-0.6, 0.8, -0.8, -0.05], [0.6, 2.2, 0.8, 0.05])
    return MockCamera(CELL.camera, FIXTURE, seed, **values).render(camera_pose(base_facing(*place)))


@pytest.mark.parametrize(
    "own",
    [
        [10, 12, 14, 16],
        pytest.param([3], marks=pytest.mark.long),
        pytest.param(OWN, marks=pytest.mark.long),
    ],
)
def test_own_and_foreign_ids_are_all_that_are_there(own):
    detector, foreign = MarkerDetector(FIXTURE.dictionary), 0
    for seed in range(8):
        image = rendered(seed)
        every, some = detector.find(image, CAMERA), detector.find(image, CAMERA, ids=own)
        assert some.ids.tolist() == [i for i in every.ids.tolist() if i in own]
        # Some are read that the detector, which looks more roughly, does not find.
        assert (
            {*every.ids.tolist(), *every.covered} - {*own} <= set(some.foreign) <= {*OWN} - {*own}
        )
        assert every.foreign == ()
        foreign += len(some.foreign)
        kept = np.isin(every.ids, own)
        np.testing.assert_allclose(some.corners, every.corners[kept], atol=0.03)
    assert foreign > 0 or own == OWN


@pytest.mark.parametrize(
    "values",
    [
        {"noise": 6.0},
        pytest.param({"light": 0.3}, marks=pytest.mark.long),
        pytest.param({"blur_px": 1.2}, marks=pytest.mark.long),
    ],
)
def test_in_bad_images(values):
    detector, named, there = MarkerDetector(FIXTURE.dictionary), 0, 0
    for seed in range(8):
        image = rendered(seed, **values)
        every, some = detector.find(image, CAMERA), detector.find(image, CAMERA, ids=[3])
        assert set(some.foreign) <= set(OWN)
        named, there = named + len(some.foreign), there + len(every.ids)
    assert named >= 0.95 * there > 15


def test_a_marker_that_fills_the_image_and_none():
    book = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_1000)
    detector = MarkerDetector(book)
    image = np.full((400, 400), 255, dtype=np.uint8)
    assert detector.find(image, ids=[1]).foreign == ()
    image[60:340, 60:340] = cv2.aruco.generateImageMarker(book, 777, 280)
    for turned in (image, np.rot90(image), np.rot90(image, 2)):
        found = detector.find(np.ascontiguousarray(turned), ids=[1])
        assert found.foreign == (777,)
        assert len(found.ids) == 0
    assert detector.find(np.ascontiguousarray(image[:, ::-1]), ids=[1]).foreign == ()


def test_ids_that_the_dictionary_does_not_have_leave_all_of_it():
    image = rendered(1)
    detector = MarkerDetector(FIXTURE.dictionary)
    assert detector.find(image, ids=[500]).ids.tolist() == detector.find(image).ids.tolist()
