"""Viewpoint feature histograms: closed forms of a plane, a sphere and a cylinder; invariances."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skinplan.errors import InputError
from skinplan.recognition.twins import embedded, mirrored
from skinplan.recognition.vfh import BINS, SECTIONS, vfh

THETA, ALPHA, PHI, DISTANCE, VIEW = SECTIONS
FAR_UP = np.array([0.0, 0.0, 1e6])


def disc(radius: float, rings: int) -> tuple[np.ndarray, np.ndarray]:
    """Even points of a disc: each for the same area."""
    count = 3 * rings**2
    number = np.arange(count) + 0.5
    r, turn = radius * np.sqrt(number / count), number * np.pi * (3.0 - np.sqrt(5.0))
    points = np.stack([r * np.cos(turn), r * np.sin(turn), np.zeros(count)], axis=1)
    return points, np.tile([0.0, 0.0, 1.0], (count, 1))


def hemisphere(radius: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    number = np.arange(count) + 0.5
    z, turn = number / count, number * np.pi * (3.0 - np.sqrt(5.0))
    flat = np.sqrt(1.0 - z**2)
    normals = np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=1)
    return radius * normals, normals


def half_cylinder(radius: float, length: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Even points without rows, along which whole bins would change at once."""
    number = np.arange(count) + 0.5
    x, t = length * (number / count - 0.5), np.pi * ((number * 0.6180339887498949) % 1.0 - 0.5)
    normals = np.stack([np.zeros_like(t), np.sin(t), np.cos(t)], axis=1)
    return radius * normals + x[:, None] * [1.0, 0.0, 0.0], normals


def expected(values: np.ndarray, low: float, high: float, bins: int) -> np.ndarray:
    return 100.0 / len(values) * np.histogram(np.clip(values, low, high), bins, (low, high))[0]


def distance(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.linalg.norm(embedded(one) - embedded(other)))


def test_a_disc_has_one_bin_of_each_angle() -> None:
    points, normals = disc(0.1, 100)
    found = vfh(points, normals, FAR_UP)
    assert found.shape == (BINS,) == (308,)
    for section in (THETA, ALPHA, PHI):
        assert found[section][22] == pytest.approx(100.0)
    assert found[VIEW][127] == pytest.approx(100.0)
    # The area of a ring grows with its radius.
    ring = 2 * np.arange(45) + 1
    np.testing.assert_allclose(found[DISTANCE], 100.0 * ring / 45**2, atol=0.05)


def test_a_disc_seen_askew_moves_only_the_viewpoint_bin() -> None:
    points, normals = disc(0.1, 30)
    askew = vfh(points, normals, 1e6 * np.array([np.sin(1.0), 0.0, np.cos(1.0)]))
    above = vfh(points, normals, FAR_UP)
    np.testing.assert_array_equal(askew[:180], above[:180])
    assert askew[VIEW][int((np.cos(1.0) + 1.0) / 2.0 * 128)] == pytest.approx(100.0)


def test_a_hemisphere_follows_its_closed_form() -> None:
    points, normals = hemisphere(0.05, 40_000)
    found = vfh(points, normals, FAR_UP)
    # cos t is even over the area; the centroid is half a radius up.
    cosine = (np.arange(2_000_000) + 0.5) / 2_000_000
    away = np.sqrt(1.25 - cosine)
    np.testing.assert_allclose(
        found[THETA], expected(np.arccos(cosine), -np.pi, np.pi, 45), atol=0.05
    )
    assert found[ALPHA][22] == pytest.approx(100.0)
    np.testing.assert_allclose(
        found[PHI], expected((cosine - 0.5) / away, -1.0, 1.0, 45), atol=0.05
    )
    np.testing.assert_allclose(found[DISTANCE], expected(away, 0.0, np.sqrt(1.25), 45), atol=0.1)
    np.testing.assert_allclose(found[VIEW][:64], 0.0)
    np.testing.assert_allclose(found[VIEW][64:], 100.0 / 64.0, atol=0.01)


def test_a_half_cylinder_follows_its_closed_form() -> None:
    radius, length = 0.03, 0.2
    points, normals = half_cylinder(radius, length, 90_000)
    found = vfh(points, normals, FAR_UP)
    number = np.arange(1_000_000) + 0.5
    x = length * ((0.7548776662466927 * number) % 1.0 - 0.5)
    t = np.pi * ((0.5698402909980532 * number) % 1.0 - 0.5)
    up, side = radius * np.cos(t) - 2.0 * radius / np.pi, radius * np.sin(t)
    rho = np.hypot(x, side)
    away = np.hypot(rho, up)
    theta = np.arctan2(radius * np.sin(t) ** 2 / rho, np.cos(t))
    for section, values, low, high, bins in (
        (THETA, theta, -np.pi, np.pi, 45),
        (ALPHA, -x * np.sin(t) / rho, -1.0, 1.0, 45),
        (PHI, up / away, -1.0, 1.0, 45),
        (DISTANCE, away, 0.0, away.max(), 45),
        (VIEW, np.cos(t), -1.0, 1.0, 128),
    ):
        np.testing.assert_allclose(found[section], expected(values, low, high, bins), atol=0.1)


def test_translation_and_turning_about_the_view_change_nothing() -> None:
    points, normals = half_cylinder(0.03, 0.2, 2500)
    askew = Rotation.from_euler("xyz", [0.3, -0.2, 0.0]).as_matrix()
    points, normals = points @ askew.T, normals @ askew.T
    above = points.mean(axis=0) + [0.0, 0.0, 0.5]
    first = vfh(points, normals, above)
    turn = Rotation.from_euler("z", 1.234).as_matrix()
    shift = np.array([5.0, -3.0, 2.0])
    moved = vfh(points @ turn.T + shift, normals @ turn.T, above @ turn.T + shift)
    # Rounding may move a point that lies on a bin's edge.
    assert np.abs(moved - first).sum() < 5 * 2 * 100.0 / len(points)


def test_sampling_density_changes_little() -> None:
    # Stated in docs/recognition.md.
    radius, length = 0.03, 0.2
    area = np.pi * radius * length
    dense = vfh(*half_cylinder(radius, length, round(area / 0.0005**2)), FAR_UP)
    for step, bound in ((0.001, 0.005), (0.002, 0.015), (0.004, 0.04)):
        thin = vfh(*half_cylinder(radius, length, round(area / step**2)), FAR_UP)
        assert distance(dense, thin) < bound


def test_size_counts_only_when_it_is_asked_for() -> None:
    points, normals = half_cylinder(0.03, 0.2, 2500)
    one, twice = (vfh(scale * points, normals, FAR_UP) for scale in (1.0, 2.0))
    assert distance(one, twice) < 0.02
    one, twice = (vfh(scale * points, normals, FAR_UP, 0.25) for scale in (1.0, 2.0))
    assert distance(one, twice) > 0.2
    np.testing.assert_array_equal(one[:135], vfh(points, normals, FAR_UP)[:135])


def test_a_mirror_image_turns_alpha_over() -> None:
    rng = np.random.default_rng(1)
    points = rng.normal(size=(500, 3)) * [0.1, 0.05, 0.01]
    normals = rng.normal(size=(500, 3)) * [0.3, 0.3, 0.1] + [0.1, 0.2, 1.0]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    flip = np.array([1.0, -1.0, 1.0])
    found = vfh(points * flip, normals * flip, FAR_UP)
    assert np.abs(found - vfh(points, normals, FAR_UP)).max() > 1.0
    np.testing.assert_allclose(found, mirrored(vfh(points, normals, FAR_UP)), atol=1e-9)


def test_what_has_no_descriptor_is_refused() -> None:
    points, normals = disc(0.1, 5)
    with pytest.raises(InputError, match="as many normals"):
        vfh(points, normals[1:], FAR_UP)
    with pytest.raises(InputError, match="cancel out"):
        vfh(np.tile(points, (2, 1)), np.concatenate([normals, -normals]), FAR_UP)
    with pytest.raises(InputError, match="on one line"):
        vfh(np.outer(np.arange(5.0), [0, 0, 1]), np.tile([0.0, 0.0, 1.0], (5, 1)), FAR_UP)
    with pytest.raises(InputError, match="positive size"):
        vfh(points, normals, FAR_UP, -1.0)
    with pytest.raises(InputError, match="finite"):
        vfh(points * np.nan, normals, FAR_UP)
