"""Where a part stands, by depth images and its shape; and what its shape leaves open."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import meshes
from shape_parts import LENGTH_M, WIDTH_M, cylinder, egg_crate, flat, two_bumps
from skinplan.errors import AlignmentError, NoCloudError
from skinplan.localization.camera import camera_model
from skinplan.mesh.model import SurfaceMesh
from skinplan.mock.depth_camera import BASELINE_M, SUBPIXEL_PX, DepthCamera
from skinplan.recognition.depth_rays import DepthRays
from skinplan.recognition.shape_fit import ShapeFit, ShapeSettings
from skinplan.recognition.shape_gate import judge_shape
from skinplan.recognition.shape_pose import ShapePose, locate_shape
from skinplan.recognition.verdict import AMBIGUOUS, FAILED, GOOD
from skinplan.recognition.view import ViewSettings
from skinplan.robot.cell import CameraConfig
from skinplan.transforms import Array, transform

CAMERA = CameraConfig()
MODEL = camera_model(CAMERA)
PANEL = meshes.grid(LENGTH_M, WIDTH_M, 0.01, two_bumps)
PLATE = meshes.grid(LENGTH_M, WIDTH_M, 0.01, flat)
NOISE = SUBPIXEL_PX / (float(CAMERA.K[0, 0]) * BASELINE_M)
#: The mock camera's errors as they are: white, and no more.
EXACT = ShapeSettings(noise_at_1m_m=NOISE, patch_error_m=0.0)


def looked_for(distance_m: float = 1.2) -> Array:
    """A part that faces the camera, a little above its axis."""
    return transform((0.0, -0.15, distance_m), np.diag([1.0, -1.0, -1.0]))


def beside(pose: Array, seed: int, away_m: float = 0.03, turned_deg: float = 2.0) -> Array:
    """Moves a part so far in a direction that is drawn."""
    random = np.random.default_rng(seed)
    shift, axis = (each / np.linalg.norm(each) for each in random.normal(size=(2, 3)))
    turn = Rotation.from_rotvec(np.radians(turned_deg) * axis).as_matrix()
    return transform(pose[:3, 3] + away_m * shift, turn @ pose[:3, :3])


def images(mesh: SurfaceMesh, truth: Array, seed: int, count: int = 8) -> Array:
    """Depth images of a part."""
    camera = DepthCamera(CAMERA, mesh, seed)
    return np.concatenate([camera.cloud(truth) for _ in range(count)])


def errors(found: ShapePose, truth: Array) -> Array:
    """Returns x y z [m] rx ry rz [rad] of a pose against the truth."""
    turned = Rotation.from_matrix(found.T_camera_workpiece[:3, :3] @ truth[:3, :3].T)
    return np.concatenate([found.T_camera_workpiece[:3, 3] - truth[:3, 3], turned.as_rotvec()])


def normalised(seed: int, settings: ShapeSettings) -> float:
    """Returns the normalised square of one draw's error, 6 on average."""
    truth = beside(looked_for(1.4), seed)
    found = locate_shape(images(PANEL, truth, seed), PANEL, looked_for(1.4), settings)
    assert found.doubt == ""
    off = errors(found, truth)
    assert np.linalg.norm(off[:3]) < 0.002 and np.linalg.norm(off[3:]) < np.radians(0.2)
    return float(off @ np.linalg.solve(found.covariance, off))


def test_a_part_beside_its_place_is_found_as_well_as_the_covariance_says() -> None:
    squares = [normalised(seed, EXACT) for seed in range(5)]
    # Chi-square of 30 numbers, 0.1 % at both ends; a little more for the weights of the steps.
    assert 11.6 < sum(squares) < 1.25 * 59.7
    # By default more is counted on than the mock camera's white noise.
    assert normalised(0, ShapeSettings()) < squares[0]


@pytest.mark.long
def test_the_covariance_is_honest_over_many_draws() -> None:
    squares = np.array([normalised(seed, EXACT) for seed in range(100, 200)])
    assert 4.3 < squares.mean() < 6.8
    assert np.mean(squares < 12.59) > 0.92


def test_a_part_far_beside_is_found_and_one_beyond_the_bounds_is_not() -> None:
    truth = beside(looked_for(), 3, 0.12, 3.0)
    points = images(PANEL, truth, 3)
    found = locate_shape(points, PANEL, looked_for())
    assert np.linalg.norm(errors(found, truth)[:3]) < 0.002
    narrow = ShapeSettings(reach_m=0.11)
    with pytest.raises(AlignmentError, match="where it was looked for; up to 110 mm and 4.0 deg"):
        locate_shape(points, PANEL, looked_for(), narrow)


def test_a_plate_and_a_body_of_revolution_are_ambiguous_and_what_is_open_is_named() -> None:
    for mesh, words in (
        (PLATE, ("shift along (1.00, 0.00, 0.00)", "shift along (0.00, 1.00", "turn about (0.00")),
        (cylinder(), ("shift along (1.00", "turn about (1.00")),
    ):
        points = images(mesh, beside(looked_for(), 1), 1)
        found = locate_shape(points, mesh, looked_for())
        verdict = judge_shape(points, MODEL, mesh, found, ViewSettings())
        assert verdict.grade == AMBIGUOUS
        assert verdict.reason.startswith("the images leave open: ")
        assert all(word in verdict.reason for word in words), verdict.reason


def test_hills_that_look_alike_are_ambiguous() -> None:
    wide = meshes.grid(2.0, 1.4, 0.01, egg_crate)
    pose = transform((0.0, 0.0, 0.9), np.diag([1.0, -1.0, -1.0]))
    points = images(wide, beside(pose, 2, 0.02, 0.5), 2, count=2)
    found = locate_shape(points, wide, pose)
    assert found.undetermined == () and "another pose fits about as well" in found.doubt


def test_a_verdict_says_what_does_not_lie_there() -> None:
    truth = beside(looked_for(), 5)
    points = images(PANEL, truth, 5)
    found = locate_shape(points, PANEL, looked_for())
    good = judge_shape(points, MODEL, PANEL, found, ViewSettings())
    assert good.grade == GOOD and good.seen_ratio > 0.8 and "residual" in good.reason
    # The same features on a panel of which a third is missing.
    shorter = SurfaceMesh(PANEL.vertices, PANEL.faces[PANEL.corners[:, :, 1].max(axis=1) < 0.06])
    cut = images(shorter, truth, 5)
    found = locate_shape(cut, PANEL, looked_for())
    failed = judge_shape(cut, MODEL, PANEL, found, ViewSettings())
    assert failed.grade == FAILED and "should be seen of it are there" in failed.reason
    aside = replace(found, T_camera_workpiece=transform((5.0, 0.0, 1.0)))
    assert not judge_shape(points, MODEL, PANEL, aside, ViewSettings()).is_judged


def test_hardly_a_point_is_no_view() -> None:
    with pytest.raises(NoCloudError, match="3 pixels have a depth where the part may be"):
        locate_shape(looked_for()[:3, 3] + 0.01 * np.eye(3), PANEL, looked_for())


def test_the_change_of_depth_is_that_of_a_small_motion() -> None:
    pose = beside(looked_for(), 7)
    rays = DepthRays.of(images(PANEL, pose, 7, count=1), NOISE, 100)
    fit = ShapeFit(PANEL, EXACT)
    seen = fit.render(rays, pose)
    rows = seen.jacobian(fit.pivot, fit.size_m)
    for number, motion in enumerate(1e-6 * np.eye(6)):
        ahead, back = (fit.render(rays, fit.moved(pose, way * motion)) for way in (1.0, -1.0))
        change = -(ahead.residual - back.residual) / 2e-6
        # Of a ray that goes over to another face the change is none.
        same = seen.hit & ahead.hit & back.hit
        off = np.abs(change - rows[:, number])[same]
        assert np.quantile(off, 0.98) < 1e-4


def test_images_of_one_pixel_are_averaged() -> None:
    ways = np.array([[0.1, 0.2, 1.0], [0.3, -0.1, 1.0]])
    points = np.concatenate([depth * ways for depth in (1.0, 1.2)])
    rays = DepthRays.of(points, 0.002, 2)
    order = np.argsort(rays.directions[:, 0])
    np.testing.assert_allclose(rays.depth, 1.1)
    np.testing.assert_allclose(rays.sigma, 0.002 * 1.21 / np.sqrt(2))
    np.testing.assert_allclose(rays.points[order], 1.1 * ways)
