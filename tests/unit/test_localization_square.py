"""The two poses of a square: exact where the image is, whichever way it stands."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from localization_scene import CAMERA
from skinplan.localization.camera import project
from skinplan.localization.solve import marker_errors, turned_by
from skinplan.localization.square import square_corners, square_solutions
from skinplan.transforms import apply, transform

SIZE_M = 0.1
# Half a turn: the marker's z looks at the camera, its y upwards.
FACING = np.diag([1.0, -1.0, -1.0])


def seen(pose):
    return project(apply(pose, square_corners(SIZE_M)), CAMERA)


def solved(corners):
    return square_solutions(np.array(corners), np.full(len(corners), SIZE_M), CAMERA)


def poses(count=400, slant=1.2):
    random = np.random.default_rng(7)
    for _ in range(count):
        place = np.array([*random.uniform(-0.4, 0.4, 2), 1.0]) * random.uniform(0.4, 3.0)
        axis = random.uniform(0.0, 2.0 * np.pi)
        tilt = random.uniform(0.0, slant) * np.array([np.cos(axis), np.sin(axis), 0.0])
        turn = Rotation.from_rotvec(tilt).as_matrix() @ FACING
        turn = turn @ Rotation.from_rotvec([0.0, 0.0, random.uniform(-np.pi, np.pi)]).as_matrix()
        pose = transform(place, turn)
        if turn[:, 2] @ place < 0.0:
            yield pose


def test_one_of_the_two_is_the_pose():
    truth = list(poses())
    assert len(truth) > 300
    found = solved([seen(pose) for pose in truth])
    for pose, both in zip(truth, found, strict=True):
        assert np.abs(both - pose).max(axis=(1, 2)).min() < 1e-8


def test_the_other_explains_the_image_better_than_its_neighbours():
    """It is the local minimum, but for the perspective that the derivative does not see."""
    for pose in poses(60, 0.9):
        corners = seen(pose)
        both = solved([corners])[0]
        other = both[int(np.argmax(np.abs(both - pose).max(axis=(1, 2))))]
        if turned_by(pose, other) < 0.3:
            continue
        middle = 0.5 * (pose[:3, :3] + other[:3, :3])
        left, _, right = np.linalg.svd(middle)
        between = transform(other[:3, 3], left @ right)
        points, pixels = square_corners(SIZE_M)[None], corners[None]
        errors = marker_errors(np.array([other, between]), points, pixels, CAMERA)[:, 0]
        assert errors[0] < errors[1]


@pytest.mark.parametrize("angle", [-0.6, 0.0, 1e-9, 1e-4, 0.4])
def test_a_level_camera_before_an_upright_marker(angle):
    """Exactly half a turn, where a rotation vector is lost."""
    turn = Rotation.from_rotvec([0.0, angle, 0.0]).as_matrix() @ FACING
    pose = transform((0.2, 0.0, 1.5), turn)
    assert np.abs(solved([seen(pose)])[0] - pose).max(axis=(1, 2)).min() < 1e-7


def test_degenerate_corners_have_no_pose_and_leave_the_others():
    pose = transform((0.0, 0.1, 1.0), FACING)
    line = np.column_stack([np.linspace(100.0, 160.0, 4), np.full(4, 50.0)])
    point = np.full((4, 2), 300.0)
    straight = replace(CAMERA, D=np.zeros(0))
    corners = np.array([line, project(apply(pose, square_corners(SIZE_M)), straight), point])
    found = square_solutions(corners, np.full(3, SIZE_M), straight)
    assert np.isnan(found[0]).all()
    assert np.isnan(found[2]).all()
    assert np.abs(found[1] - pose).max(axis=(1, 2)).min() < 1e-6


def test_no_squares():
    assert solved(np.zeros((0, 4, 2))).shape == (0, 2, 4, 4)
