"""Rigid transforms against closed forms."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skinplan import transforms
from skinplan.errors import InputError


def random_transform(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return transforms.transform(rng.normal(size=3), Rotation.random(random_state=seed).as_matrix())


@pytest.mark.parametrize("seed", range(5))
def test_inverse_undoes(seed):
    T_a_b = random_transform(seed)
    assert np.allclose(transforms.inverse(T_a_b) @ T_a_b, np.eye(4), atol=1e-12)
    stack = np.stack([T_a_b, random_transform(seed + 100)])
    assert np.allclose(transforms.inverse(stack) @ stack, np.eye(4), atol=1e-12)


def test_apply_maps_from_b_to_a():
    T_a_b = transforms.planar(1.0, 2.0, np.pi / 2)
    assert np.allclose(transforms.apply(T_a_b, np.array([[1.0, 0.0, 0.0]])), [[1.0, 3.0, 0.0]])
    assert np.allclose(transforms.rotate(T_a_b, np.array([[1.0, 0.0, 0.0]])), [[0.0, 1.0, 0.0]])


@pytest.mark.parametrize("seed", range(5))
def test_quaternion_round_trip(seed):
    T_a_b = random_transform(seed)
    found = transforms.quaternion(T_a_b)
    assert found[3] >= 0
    assert np.allclose(transforms.transform(T_a_b[:3, 3], found), T_a_b, atol=1e-12)


def test_heading_and_difference():
    T_a_b = transforms.planar(0.0, 0.0, 0.3)
    T_a_c = transforms.planar(3.0, 4.0, -0.2)
    assert transforms.heading(T_a_c) == pytest.approx(-0.2)
    assert transforms.difference(T_a_b, T_a_c) == pytest.approx((5.0, 0.5))


@pytest.mark.parametrize(
    ("translation", "rotation", "words"),
    [
        ((0.0, 0.0), None, "(3,)"),
        ((0.0, np.nan, 0.0), None, "finite"),
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0), "length 0"),
        ((0.0, 0.0, 0.0), np.eye(2), "(3, 3)"),
    ],
)
def test_bad_input_is_named(translation, rotation, words):
    with pytest.raises(InputError, match=words.replace("(", r"\(").replace(")", r"\)")):
        transforms.transform(translation, rotation)


def test_a_mirror_is_no_rigid_transform():
    with pytest.raises(InputError, match="orthonormal"):
        transforms.require_transform(np.diag([1.0, 1.0, -1.0, 1.0]), "T")
    assert transforms.require_transform(np.eye(4), "T").shape == (4, 4)
