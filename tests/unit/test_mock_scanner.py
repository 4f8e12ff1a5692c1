"""The mock scanner before planes whose answers are known."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skinplan.errors import InputError
from skinplan.mesh.model import SurfaceMesh
from skinplan.mock.scanner import MockScanner
from skinplan.scanner.model import ScannerModel
from skinplan.transforms import apply, transform

MODEL = ScannerModel(0.2, 0.2, 0.4, 0.3, np.pi / 3)
# Looks along -z of the workpiece.
DOWN = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])


def plane(half=2.0, z=0.0):
    corners = np.array([[-half, -half, z], [half, -half, z], [half, half, z], [-half, half, z]])
    return SurfaceMesh(corners, np.array([[0, 1, 2], [0, 2, 3]]))


def scanner(mesh=None, **settings):
    return MockScanner(plane() if mesh is None else mesh, MODEL, seed=1, **settings)


def at(distance, tilt=0.0):
    turn = DOWN @ Rotation.from_euler("y", tilt).as_matrix()
    place = -distance * turn[:, 0]
    return transform(place, turn)


def test_points_lie_on_the_plane_inside_the_disc():
    pose = at(0.3)
    frame = scanner().frame(pose)
    assert len(frame.points) == 900
    np.testing.assert_allclose(frame.points[:, 0], 0.3, atol=6 * 3e-5)
    radii = np.linalg.norm(frame.points[:, 1:], axis=1)
    assert radii.max() <= 0.2 + 1e-9
    # Evenly over the disc: a quarter of the rays is within half of the radius.
    assert 0.2 < np.mean(radii < 0.1) < 0.3
    np.testing.assert_allclose(apply(pose, frame.points)[:, 2], 0.0, atol=6 * 3e-5)
    np.testing.assert_allclose(frame.incidence, 0.0, atol=1e-6)


def test_noise_is_the_stated_one_along_the_ray():
    distances = np.concatenate([scanner().frame(at(0.3)).points[:, 0] for _ in range(3)])
    assert np.std(distances) == pytest.approx(3e-5, rel=0.1)
    exact = scanner(noise_m=0.0).frame(at(0.3, 0.4))
    np.testing.assert_allclose(apply(at(0.3, 0.4), exact.points)[:, 2], 0.0, atol=1e-9)
    np.testing.assert_allclose(exact.incidence, 0.4, atol=1e-9)


def test_frames_take_other_rays_and_repeat_with_the_seed():
    one, other = scanner(), scanner()
    first, second = one.frame(at(0.3)), one.frame(at(0.3))
    assert not np.allclose(first.points, second.points)
    np.testing.assert_array_equal(first.points, other.frame(at(0.3)).points)


@pytest.mark.parametrize(("distance", "seen"), [(0.19, 0), (0.21, 900), (0.39, 900), (0.41, 0)])
def test_range_window(distance, seen):
    assert len(scanner().frame(at(distance)).points) == seen


@pytest.mark.parametrize(("tilt", "seen"), [(1.0, True), (1.1, False), (np.pi, False)])
def test_incidence_limit(tilt, seen):
    """A tilted plane: rays farther up leave the range window, none the limit."""
    assert (len(scanner().frame(at(0.3, tilt)).points) > 0) == seen


def test_what_is_in_front_hides_what_is_behind():
    front = plane(half=0.05, z=0.2)
    back = plane()
    both = SurfaceMesh(
        np.vstack([back.vertices, front.vertices]), np.vstack([back.faces, front.faces + 4])
    )
    points = scanner(both).frame(at(0.35)).points
    behind = np.all(np.abs(points[:, 1:]) < 0.049, axis=1)
    assert len(points) > 500
    assert not np.any(behind)


def test_nothing_in_view_is_an_empty_frame():
    frame = scanner().frame(at(-1.0))
    assert frame.points.shape == (0, 3)
    assert frame.intensity.shape == frame.incidence.shape == (0,)


def test_bad_input_is_refused():
    with pytest.raises(InputError, match="finite"):
        scanner().frame(np.full((4, 4), np.nan))
    with pytest.raises(InputError, match="at least 1"):
        scanner(rays=0)
