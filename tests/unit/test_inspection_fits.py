"""Spheres and planes through points: exact, noisy, with outliers, and what is refused."""

import numpy as np
import pytest

from skinplan.errors import InputError
from skinplan.inspection.fits import fit_plane, fit_sphere

DIAMETER = 0.022225
CENTRE = np.array([1.2, -0.7, 2.4])


def cap(random, count, opening_rad=1.5):
    """Points of the cap of a sphere that a scanner at the origin sees."""
    axis = -CENTRE / np.linalg.norm(CENTRE)
    z = random.uniform(np.cos(opening_rad), 1.0, count)
    turn = random.uniform(-np.pi, np.pi, count)
    u = np.cross(axis, [1.0, 0.0, 0.0])
    u /= np.linalg.norm(u)
    v = np.cross(axis, u)
    ring = np.sqrt(1.0 - z**2)
    away = z[:, None] * axis + ring[:, None] * (
        np.cos(turn)[:, None] * u + np.sin(turn)[:, None] * v
    )
    return CENTRE + 0.5 * DIAMETER * away, away


@pytest.mark.parametrize("opening_rad", [0.5, 1.5, 3.1])
def test_exact_points_give_the_sphere_back(opening_rad):
    points, _ = cap(np.random.default_rng(1), 400, opening_rad)
    found = fit_sphere(points)
    assert np.allclose(found.centre, CENTRE, atol=1e-9)
    assert found.diameter == pytest.approx(DIAMETER, abs=2e-9)
    assert found.form_error < 1e-8 and found.rms < 1e-8


def test_four_points_make_a_sphere():
    found = fit_sphere(np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, 0, 1]]))
    assert found.diameter == pytest.approx(2.0) and np.allclose(found.centre, 0.0, atol=1e-9)


def test_the_covariance_is_that_of_the_scatter():
    random = np.random.default_rng(2)
    errors = []
    for _ in range(200):
        points, away = cap(random, 300)
        found = fit_sphere(points + away * random.normal(0.0, 3e-5, (300, 1)))
        error = np.append(found.centre - CENTRE, found.diameter - DIAMETER)
        errors.append(error @ np.linalg.solve(found.covariance, error))
    # Mean of chi^2 with 4 degrees of freedom, +- 5 standard errors.
    assert abs(np.mean(errors) - 4.0) < 5.0 * np.sqrt(8.0 / 200)


def test_outliers_do_not_move_the_sphere():
    random = np.random.default_rng(3)
    points, away = cap(random, 2000)
    points += away * random.normal(0.0, 3e-5, (2000, 1))
    stray = CENTRE + random.uniform(-0.02, 0.02, (300, 3))
    found = fit_sphere(np.vstack([points, stray]))
    assert np.linalg.norm(found.centre - CENTRE) < 1e-5
    assert abs(found.diameter - DIAMETER) < 1e-5
    assert found.used[:2000].mean() > 0.99 and found.used[2000:].mean() < 0.05


def test_a_plane_is_found_with_outliers_and_its_flatness_without_them():
    random = np.random.default_rng(4)
    normal = np.array([0.2, -0.3, -0.93]) / np.linalg.norm([0.2, -0.3, -0.93])
    points = random.uniform(-0.3, 0.3, (3000, 3)) + [0.0, 0.0, 2.0]
    points -= ((points - [0.0, 0.0, 2.0]) @ normal)[:, None] * normal
    noise = random.normal(0.0, 3e-5, 3000)
    points += noise[:, None] * normal
    points[:200] += random.uniform(0.002, 0.05, (200, 1)) * normal
    found = fit_plane(points)
    assert found.normal @ normal > 1.0 - 1e-8
    assert found.rms == pytest.approx(3e-5, rel=0.1)
    assert not found.used[:200].any() and found.form_error < 12 * 3e-5
    assert found.normal @ found.point < 0.0


@pytest.mark.parametrize(
    ("points", "reason"),
    [
        (np.zeros((3, 3)), "4 points or more"),
        (np.zeros((9, 3)), "same point"),
        (np.random.default_rng(0).uniform(size=(9, 3)) * [1, 1, 0], "one plane"),
        (np.full((9, 3), np.nan), "finite"),
        (np.zeros((9, 2)), "shape"),
    ],
)
def test_points_that_make_no_sphere_are_named(points, reason):
    with pytest.raises(InputError, match=reason):
        fit_sphere(points)


def test_points_that_make_no_plane_are_named():
    with pytest.raises(InputError, match="one line"):
        fit_plane(np.arange(9)[:, None] * np.array([[1.0, 2.0, 3.0]]))
    with pytest.raises(InputError, match="3 points or more"):
        fit_plane(np.zeros((2, 3)))
