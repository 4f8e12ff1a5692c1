import numpy as np
from scipy.spatial.transform import Rotation

from skinplan.robot.cell import CellConfig
from skinplan.robot.scanner_pose import (
    interpolate_directions,
    mean_direction,
    scanner_frames,
    tilted,
    tool_poses,
)

REFERENCE = np.array([0.0, 1.0, 0.0])


def directions(count, seed=0):
    found = np.random.default_rng(seed).normal(size=(count, 3))
    found = np.vstack([found, [REFERENCE, -REFERENCE, [0, 0, 1.0], [0, 0, -1.0]]])
    return found / np.linalg.norm(found, axis=1, keepdims=True)


def test_x_is_the_view_and_frames_are_rotations():
    d = directions(50)
    rolls = np.linspace(-3, 3, len(d))
    frames = scanner_frames(np.arange(3.0 * len(d)).reshape(-1, 3), d, rolls, REFERENCE)
    assert np.allclose(frames[:, :3, 0], d)
    assert np.allclose(frames[:, :3, :3] @ np.swapaxes(frames[:, :3, :3], 1, 2), np.eye(3))
    assert np.allclose(np.linalg.det(frames[:, :3, :3]), 1.0)
    assert np.allclose(frames[:, :3, 3], np.arange(3.0 * len(d)).reshape(-1, 3))


def test_roll_turns_about_the_view():
    d = directions(20)
    none = scanner_frames(np.zeros_like(d), d, 0.0, REFERENCE)
    some = scanner_frames(np.zeros_like(d), d, 0.7, REFERENCE)
    turn = np.swapaxes(none[:, :3, :3], 1, 2) @ some[:, :3, :3]
    assert np.allclose(turn, Rotation.from_euler("x", 0.7).as_matrix())


def test_vertical_views_are_no_singularity():
    """Views near straight up have nearly the same frame, whichever way they lean."""
    angle = np.linspace(0, 2 * np.pi, 12)
    near_up = np.stack([1e-4 * np.cos(angle), 1e-4 * np.sin(angle), np.ones(12)], axis=1)
    near_up /= np.linalg.norm(near_up, axis=1, keepdims=True)
    frames = scanner_frames(np.zeros((12, 3)), near_up, 0.0, REFERENCE)
    assert np.abs(frames - frames[0]).max() < 1e-3


def test_tool_poses_bring_the_scanner_there():
    d = directions(10)
    cell = CellConfig()
    poses = tool_poses(np.ones_like(d), d, 0.3, cell.T_tool0_scanner, REFERENCE)
    assert np.allclose(
        poses @ cell.T_tool0_scanner, scanner_frames(np.ones_like(d), d, 0.3, REFERENCE)
    )


def test_tilted_views_lean_by_the_angle_to_all_sides():
    d = directions(10)
    leaned = tilted(d, 0.2)
    assert leaned.shape == (len(d), 16, 3)
    assert np.allclose(np.einsum("nki,ni->nk", leaned, d), np.cos(0.2))
    assert np.allclose(leaned.mean(axis=1), np.cos(0.2) * d)


def test_interpolation_stays_on_the_great_arc():
    first, second = directions(30, 1), directions(30, 2)
    apart = np.einsum("ni,ni->n", first, second) > -0.999
    first, second = first[apart], second[apart]
    whole = np.arccos(np.clip(np.einsum("ni,ni->n", first, second), -1, 1))
    for share in (0.0, 0.3, 1.0):
        found = interpolate_directions(first, second, np.full(len(first), share))
        gone = np.arccos(np.clip(np.einsum("ni,ni->n", first, found), -1, 1))
        assert np.allclose(gone, share * whole, atol=1e-6)
        assert np.allclose(np.linalg.norm(found, axis=1), 1.0)


def test_mean_direction_of_opposite_views_is_one_of_them():
    pair = np.array([[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]])
    assert np.allclose(mean_direction(pair), pair[0])
    assert np.allclose(mean_direction(pair[:1]), pair[0])
