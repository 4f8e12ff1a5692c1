"""Which part a depth camera sees on its fixture."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import meshes
from skinplan.errors import InputError, NoCloudError
from skinplan.localization.camera import camera_model
from skinplan.mesh.model import SurfaceMesh
from skinplan.mock.depth_camera import BASELINE_M, SUBPIXEL_PX, DepthCamera
from skinplan.recognition.view import Candidate, ViewFit, describe, fit_view
from skinplan.robot.cell import CameraConfig
from skinplan.transforms import Array, apply, inverse, transform

CAMERA = CameraConfig()
MODEL = camera_model(CAMERA)


def panel(height_m: float, length_m: float = 0.5) -> SurfaceMesh:
    """A panel with a bump."""
    return meshes.grid(length_m, 0.3, 0.01, lambda x, y: meshes.bump(x, y, height_m, 0.06))


PARTS = {
    "rib": panel(0.03),
    "twin": panel(0.0305),
    "high": panel(0.045),
    "flat": panel(0.0),
    "long": panel(0.03, 0.62),
}


def looking_at(mesh: SurfaceMesh, distance_m: float, angle_rad: float = 0.35) -> Array:
    """The part before the camera, seen from aside by an angle."""
    middle = mesh.bounds.mean(axis=0)
    turn = Rotation.from_euler("xy", [np.pi, angle_rad])
    return transform((0.0, 0.0, distance_m) - turn.apply(middle), turn.as_matrix())


def seen(name: str, distance_m: float = 1.0, seed: int = 1) -> dict[str, ViewFit]:
    """Fits all parts to a view of one; the pose is known to 2 mm and 2 mrad."""
    pose = looking_at(PARTS[name], distance_m)
    random = np.random.default_rng(seed)
    turn = Rotation.from_rotvec(random.normal(0.0, 0.002, 3)).as_matrix()
    believed = pose @ transform(random.normal(0.0, 0.002, 3), turn)
    cloud = DepthCamera(CAMERA, PARTS[name], seed).cloud(pose)
    placed = {other: Candidate(mesh, believed) for other, mesh in PARTS.items()}
    return fit_view(cloud, MODEL, placed)


def test_the_depth_camera_measures_depth_as_its_data_sheet_says() -> None:
    flat = PARTS["flat"]
    pose = transform((-0.25, 0.15, 1.2), Rotation.from_euler("x", np.pi).as_matrix())
    cloud = DepthCamera(CAMERA, flat, 3).cloud(pose)
    off = apply(inverse(pose), cloud)[:, 2]
    wanted = SUBPIXEL_PX / (CAMERA.K[0, 0] * BASELINE_M) * 1.2**2
    assert np.std(off) == pytest.approx(wanted, rel=0.05)
    assert abs(np.mean(off)) < 4.0 * wanted / np.sqrt(len(off))
    assert len(DepthCamera(CAMERA, flat, 3).cloud(transform((0.0, 0.0, 9.0), pose[:3, :3]))) == 0


@pytest.mark.parametrize("name", ["rib", "high", "flat", "long"])
def test_a_part_is_told_from_others(name: str) -> None:
    fits = seen(name)
    good = {other for other, fit in fits.items() if fit.fits}
    assert good == ({"rib", "twin"} if name in ("rib", "twin") else {name})
    for other, fit in fits.items():
        assert fit.is_judged and fit.seen_ratio > 0.9, other
        assert bool(fit.reason) != fit.fits
    if name in ("rib", "twin"):
        assert describe(fits) == "rib and twin can't be told apart"
    elif name == "flat":
        assert describe(fits).startswith("flat, residual ")


def test_none_of_them_is_said_with_what_speaks_against_each() -> None:
    fits = seen("high")
    text = describe({name: fits[name] for name in ("rib", "long")})
    assert text.startswith("unknown part (rib: a patch of its surface lies ")
    assert "; long: " in text


def test_what_stands_before_the_part_says_nothing_against_it() -> None:
    pose = looking_at(PARTS["rib"], 1.0)
    cloud = DepthCamera(CAMERA, PARTS["rib"], 1).cloud(pose)
    hidden = np.abs(cloud[:, 0] / cloud[:, 2] + 0.05) < 0.04
    cloud[hidden] *= 0.5
    fit = fit_view(cloud, MODEL, {"rib": Candidate(PARTS["rib"], pose)})["rib"]
    assert fit.fits, fit.reason
    gone = fit_view(cloud[~hidden], MODEL, {"rib": Candidate(PARTS["rib"], pose)})["rib"]
    assert "of what should be seen of it are there" in gone.reason


def test_a_part_that_is_hardly_in_the_picture_is_not_judged() -> None:
    pose = looking_at(PARTS["long"], 0.4)
    pose[0, 3] += 0.56
    cloud = DepthCamera(CAMERA, PARTS["long"], 1).cloud(pose)
    fit = fit_view(cloud, MODEL, {"long": Candidate(PARTS["long"], pose)})["long"]
    assert not fit.is_judged and not fit.fits and "can be seen from here" in fit.reason


def test_an_empty_fixture_is_none_of_them() -> None:
    elsewhere = looking_at(PARTS["rib"], 2.2)
    cloud = DepthCamera(CAMERA, PARTS["rib"], 1).cloud(elsewhere)
    fits = fit_view(cloud, MODEL, {"rib": Candidate(PARTS["rib"], looking_at(PARTS["rib"], 1.0))})
    assert fits["rib"].reason == "hardly a point lies where it should be"


def test_bad_input_is_named() -> None:
    placed = {"rib": Candidate(PARTS["rib"], np.eye(4))}
    with pytest.raises(NoCloudError, match="at least 200 points are accepted, found 3"):
        fit_view(np.ones((3, 3)), MODEL, placed)
    with pytest.raises(InputError, match="finite coordinates"):
        fit_view(np.full((500, 3), np.nan), MODEL, placed)
    with pytest.raises(InputError, match="at least one candidate"):
        fit_view(np.ones((500, 3)), MODEL, {})
    with pytest.raises(InputError, match="T_camera_workpiece"):
        fit_view(np.ones((500, 3)), MODEL, {"rib": Candidate(PARTS["rib"], np.ones((4, 4)))})
    with pytest.raises(InputError, match="at least 1 is accepted"):
        DepthCamera(CAMERA, PARTS["rib"], 1, step_px=0)
