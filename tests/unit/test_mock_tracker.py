"""The mock tracker: noise and distortion as stated; what hides the scanner from it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import meshes
from skinplan.errors import InputError
from skinplan.mock.tracker import VOLUME_LENGTH_M, LineOfSight, MockTracker
from skinplan.robot.arm import ArmModel
from skinplan.robot.cell import CellConfig
from skinplan.transforms import difference, inverse, planar, transform

TRACKER = transform((1.0, 2.0, 3.0), Rotation.from_euler("z", 0.7).as_matrix())
CELL = CellConfig()
HOME = np.array(CELL.home_rad)


def test_it_measures_with_noise():
    tracker = MockTracker(TRACKER, seed=1, volumetric_m=0.0)
    pose = TRACKER @ transform((2.0, 0.3, 0.1), Rotation.from_euler("x", 0.4).as_matrix())
    exact = inverse(TRACKER) @ pose
    errors = np.array([difference(exact, tracker.measure(pose)) for _ in range(400)])
    # Root mean square of three axes.
    np.testing.assert_allclose(
        np.sqrt(np.mean(errors**2, axis=0)), np.sqrt(3) * np.array([2e-5, 3e-5]), rtol=0.15
    )
    with pytest.raises(InputError):
        tracker.measure(np.eye(3))


def test_lengths_are_wrong_by_the_volumetric_accuracy_at_most():
    random = np.random.default_rng(4)
    worst = 0.0
    for seed in range(60):
        tracker = MockTracker(TRACKER, seed, noise_m=0.0, noise_rad=0.0)
        first, second = random.uniform(-1.0, 1.0, (2, 3)) + [3.0, 0.0, 0.0]
        found = [tracker.measure(TRACKER @ transform(place))[:3, 3] for place in (first, second)]
        length = np.linalg.norm(second - first)
        error = abs(np.linalg.norm(found[1] - found[0]) - length)
        assert error <= 6.4e-5 * length / VOLUME_LENGTH_M + 1e-12
        worst = max(worst, error / length)
    assert worst > 0.5 * 6.4e-5 / VOLUME_LENGTH_M, "the distortion is there at all"


def sight(T_map_tracker=None, mesh_at=(0.0, 50.0, 0.0)):
    cell = CELL if T_map_tracker is None else replace(CELL, T_map_tracker=T_map_tracker)
    part = meshes.grid(0.6, 0.6, 0.05)
    return LineOfSight(cell, ArmModel.load(cell), part, transform(mesh_at))


ARM_BASE = planar(-0.3, -2.2, 0.25) @ CELL.T_base_link_arm_base
SCANNER = (ARM_BASE @ ArmModel.load(CELL).forward_scanner(HOME[None])[0])[:3, 3]
BELOW = (-0.2, -0.2, -1.2)


def looking_from(offset):
    """Returns the pose of a tracker at this place from the scanner, looking at it."""
    view = -np.array(offset) / np.linalg.norm(offset)
    side = np.cross([0.0, 0.0, 1.0], view)
    side /= np.linalg.norm(side)
    return transform(SCANNER + offset, np.column_stack([view, side, np.cross(view, side)]))


def test_what_keeps_the_tracker_from_seeing_is_named():
    free = looking_from((0.3, 2.0, 0.5))
    assert sight(free).hindrance(HOME, ARM_BASE) == ""
    assert "range" in sight(looking_from((0.1, 8.0, 1.0))).hindrance(HOME, ARM_BASE)
    turned = free @ transform(rotation=Rotation.from_euler("z", np.pi).as_matrix())
    assert "cone" in sight(turned).hindrance(HOME, ARM_BASE)
    below = looking_from(BELOW)
    reasons = {sight(below).hindrance(HOME, ARM_BASE)}
    reasons.add(sight(looking_from((0.05, -2.0, 0.1))).hindrance(HOME, ARM_BASE))
    assert any("arm" in reason or "base" in reason for reason in reasons), reasons
    # A sheet half way, lying across the line of sight.
    above = looking_from((0.0, 0.1, 1.5))
    middle = SCANNER + np.array([0.0, 0.05, 0.75])
    assert "part" in sight(above, middle).hindrance(HOME, ARM_BASE)


def test_a_tracker_that_was_asked_the_same_again_looks_again_when_anything_moved():
    away, lowered = ARM_BASE.copy(), HOME.copy()
    away[1, 3] -= 20.0
    lowered[1] += 1.5
    tracker = sight(looking_from(BELOW))
    assert "base" in tracker.hindrance(HOME, ARM_BASE)
    assert "base" in tracker.hindrance(HOME, ARM_BASE)
    assert "range" in tracker.hindrance(lowered, ARM_BASE)
    assert "base" in tracker.hindrance(HOME, ARM_BASE)
    assert "range" in tracker.hindrance(HOME, away)
