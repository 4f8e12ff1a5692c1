"""Which part a cloud is: found wherever it lies, refused when it is none, and alike is said."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skinplan.errors import InputError, NoCloudError
from skinplan.mesh.model import SurfaceMesh
from skinplan.recognition.identify import IdentifySettings, identify
from skinplan.transforms import apply, difference, transform

STEP = 0.01


def skin(
    width: float, height: float, bumps: list[tuple[float, float, float]], bend: float = 0.0
) -> SurfaceMesh:
    """A panel with bumps (x, y, height), bent about x."""
    x, y = np.meshgrid(
        np.linspace(-width / 2, width / 2, round(width / STEP) + 1),
        np.linspace(-height / 2, height / 2, round(height / STEP) + 1),
        indexing="ij",
    )
    z = bend * y**2
    for u, v, up in bumps:
        z = z + up * np.exp(-((x - u) ** 2 + (y - v) ** 2) / 0.06**2)
    number = np.arange(x.size).reshape(x.shape)
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    faces = np.concatenate(
        [np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)]
    )
    return SurfaceMesh(np.stack([x, y, z], -1).reshape(-1, 3), faces)


def mirrored(mesh: SurfaceMesh) -> SurfaceMesh:
    return SurfaceMesh(mesh.vertices * [-1, 1, 1], mesh.faces[:, ::-1])


def scan(mesh: SurfaceMesh, rng: np.random.Generator, count: int = 12_000) -> np.ndarray:
    face = rng.choice(len(mesh.faces), count, p=mesh.face_areas / mesh.area)
    points = np.einsum("nc,nci->ni", rng.dirichlet(np.ones(3), count), mesh.corners[face])
    return points + rng.normal(size=(count, 1)) * 5e-5 * mesh.face_normals[face]


def somewhere(rng: np.random.Generator) -> np.ndarray:
    return transform(rng.normal(size=3) * 2, Rotation.random(rng=rng).as_matrix())


LEFT = skin(0.9, 0.5, [(0.2, 0.1, 0.03), (-0.3, -0.1, -0.02)], 0.2)
PARTS = {
    "left": LEFT,
    "right": mirrored(LEFT),
    "smooth": skin(0.9, 0.5, [], 0.2),
    "long": skin(1.3, 0.5, [(0.2, 0.1, 0.03)], 0.2),
    "square": skin(0.6, 0.6, [(0.1, 0.15, 0.04), (-0.2, 0.1, 0.02)]),
}
FRONT = np.array([0.0, 0.0, 2.0])


@pytest.mark.parametrize("name", ["left", "right", "smooth", "long", "square"])
def test_every_part_is_found_wherever_it_lies(name: str) -> None:
    rng = np.random.default_rng(len(name))
    place = somewhere(rng)
    found = identify(
        apply(place, scan(PARTS[name], rng)), PARTS, outside=apply(place, FRONT[None])[0]
    )
    assert found.name == name, found.reason
    assert found.T_cloud_workpiece is not None
    assert found.residuals_m[name] < 1e-4
    if name != "smooth":  # which looks the same when turned by half a turn
        distance, angle = difference(place, found.T_cloud_workpiece)
        assert distance < 5e-4 and angle < 1e-3
    assert found.fits[name].other_pose == (name == "smooth")


def test_a_bumpy_part_is_told_from_its_mirror_without_knowing_the_side() -> None:
    rng = np.random.default_rng(3)
    place = somewhere(rng)
    found = identify(apply(place, scan(LEFT, rng)), {"right": PARTS["right"], "left": LEFT})
    assert found.name == "left"
    assert found.fits["right"].residual_m > 5 * found.fits["left"].residual_m


def test_twins_are_said_to_be_alike() -> None:
    rng = np.random.default_rng(4)
    smooth = PARTS["smooth"]
    found = identify(
        scan(smooth, rng),
        {"one": smooth, "two": mirrored(smooth), "long": PARTS["long"]},
        outside=FRONT,
    )
    assert found.name is None and found.T_cloud_workpiece is None
    assert set(found.alike) == {"one", "two"}
    assert "told apart" in found.reason


def test_a_part_that_is_no_candidate_is_unknown() -> None:
    rng = np.random.default_rng(5)
    others = {name: mesh for name, mesh in PARTS.items() if name != "left"}
    found = identify(scan(LEFT, rng), others, outside=FRONT)
    assert found.name is None and found.alike == ()
    assert "unknown" in found.reason
    assert "1.3" in found.fits["long"].reason
    assert all(fit.reason for fit in found.fits.values())
    assert np.isnan(found.residuals_m["long"])


def test_debris_does_not_hide_a_part() -> None:
    rng = np.random.default_rng(6)
    points = scan(LEFT, rng)
    points[:100] += rng.uniform(-0.3, 0.3, size=(100, 3))
    assert identify(points, PARTS, outside=FRONT).name == "left"


def test_half_a_part_is_not_taken_for_a_part() -> None:
    points = scan(LEFT, np.random.default_rng(7))
    found = identify(points[points[:, 0] > 0], PARTS, outside=FRONT)
    assert found.name is None


def test_a_part_with_a_hole_in_the_cloud_is_not_complete() -> None:
    points = scan(LEFT, np.random.default_rng(8))
    points = points[np.abs(points[:, 0]) > 0.2]
    found = identify(points, {"left": LEFT}, IdentifySettings(inlier_ratio_min=0.5), FRONT)
    assert found.name is None
    assert "seen" in found.fits["left"].reason


def test_what_can_t_be_identified_is_named() -> None:
    with pytest.raises(InputError, match="candidate"):
        identify(np.zeros((500, 3)), {})
    with pytest.raises(NoCloudError, match="found 10"):
        identify(np.zeros((10, 3)), PARTS)
    with pytest.raises(InputError, match="finite"):
        identify(np.full((500, 3), np.nan), PARTS)
    with pytest.raises(InputError, match="shape"):
        identify(scan(LEFT, np.random.default_rng(0), 500), PARTS, outside=np.zeros(2))
    assert identify(np.zeros((500, 3)), PARTS).name is None
