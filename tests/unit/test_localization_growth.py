"""Images whose grey levels are no straight line of the light: edges are out of their place."""

import cv2
import numpy as np
import pytest

from localization_scene import CAMERA, CELL, base_facing, camera_pose, row_fixture, true_corners
from skinplan.localization.detect import MarkerDetector, dictionary_of
from skinplan.localization.edge_lines import intersections
from skinplan.localization.edges import refine_corners
from skinplan.localization.growth import common_growth, drawn_in, edge_growth
from skinplan.mock.camera import MockCamera

FIXTURE = row_fixture()
TRUTH = camera_pose(base_facing(0.1, 0.9, 0.2))
IDS, CORNERS = true_corners(TRUTH, FIXTURE)
BOOK = dictionary_of(FIXTURE.dictionary)


@pytest.fixture(scope="module")
def light():
    """What falls on the sensor: blurred, before its tone curve, shape (h, w)."""
    image = MockCamera(CELL.camera, FIXTURE, 1, blur_px=0.0, noise=0.0, samples=6).render(TRUTH)
    return image.astype(np.float64)


def photographed(light, gamma, glare=0.0, noise=2.0):
    blurred = (1.0 - glare) * cv2.GaussianBlur(light, (0, 0), 0.8)
    blurred += glare * cv2.GaussianBlur(light, (0, 0), 3.0)
    grey = 255.0 * (blurred / 255.0) ** gamma
    grey += np.random.default_rng(4).normal(0.0, noise, grey.shape)
    return np.rint(grey.clip(0, 255)).astype(np.uint8)


def found(image, corners):
    detection = MarkerDetector(FIXTURE.dictionary, corners).find(image, CAMERA)
    assert detection.ids.tolist() == IDS.tolist()
    return detection


def measured(image):
    """Growth by corners that lie on the edges as they are seen."""
    return edge_growth(image, IDS, refine_corners(image, CORNERS, 7, CAMERA).corners, BOOK)[:2]


def error_px(image, corners):
    return float(np.sqrt(np.mean((found(image, corners).corners - CORNERS) ** 2)))


@pytest.mark.parametrize("gamma", [0.6, 1.0, 1.5, 2.2])
def test_a_tone_curve_moves_no_corner(light, gamma):
    """Within 0.05 px, and as far as the covariance says; OpenCV's finder is off by more."""
    image = photographed(light, gamma)
    assert error_px(image, "auto") < 0.05
    assert error_px(image, "auto") < error_px(image, "subpix")
    seen = found(image, "auto")
    floor = seen.floor_px[:, None, None] ** 2 * np.eye(8)
    errors = (seen.corners - CORNERS).reshape(-1, 8)
    squares = np.einsum(
        "mi,mi->m", errors, np.linalg.solve(seen.covariance + floor, errors[..., None])[..., 0]
    )
    assert squares.mean() / 8 < 2.5


@pytest.mark.parametrize("gamma", [0.7, 1.5])
def test_the_growth_is_measured_with_its_sign(light, gamma):
    growth, sigma = measured(photographed(light, gamma))
    assert np.all(np.sign(growth) == np.sign(gamma - 1.0))
    assert np.all(np.abs(growth) > 3.0 * sigma)
    assert common_growth(growth, sigma) == pytest.approx(np.median(growth), abs=0.03)


def test_a_straight_tone_curve_grows_nothing(light):
    growth, sigma = measured(photographed(light, 1.0))
    assert np.all(np.abs(growth) < 0.03)
    assert common_growth(growth, sigma) == 0.0


def test_growth_that_can_not_be_told_from_chance_is_none():
    assert common_growth(np.array([0.1, 0.05]), np.array([0.1, 0.08])) == 0.0
    assert common_growth(np.zeros(0), np.zeros(0)) == 0.0
    small = np.array([[[10, 10], [20, 10], [20, 20], [10, 20]]], dtype=float)
    growth, sigma, _ = edge_growth(np.zeros((40, 40), np.uint8), np.array([7]), small, BOOK)
    assert common_growth(growth, sigma) == 0.0


def test_squares_are_drawn_in_by_the_shift():
    square = np.array([[[10, 10], [30, 10], [30, 40], [10, 40]]], dtype=float)
    np.testing.assert_allclose(
        drawn_in(square, 0.5)[0], [[10.5, 10.5], [29.5, 10.5], [29.5, 39.5], [10.5, 39.5]]
    )
    assert np.isnan(intersections(np.array([[[0.0, 1.0, 2.0]] * 4]))).all()


def test_glare_and_a_rough_print_leave_the_corners_in_their_place(light):
    """Edges are skewed by glare under a dark tone curve; the cells tell half a pixel."""
    image = photographed(light, 2.2, glare=0.2)
    for centre in CORNERS.mean(axis=1):
        x, y = np.rint(centre).astype(int)
        half = int(0.36 * np.ptp(CORNERS[0, :, 0]))
        inner = image[y - half : y + half, x - half : x + half]
        rough = cv2.GaussianBlur(
            np.random.default_rng(1).normal(0.0, 160.0, inner.shape), (0, 0), 1.5
        )
        inner[:] = (inner + rough).clip(0, 255).astype(np.uint8)
    assert error_px(image, "auto") < 0.6 * error_px(image, "subpix")
