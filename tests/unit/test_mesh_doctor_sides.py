import numpy as np
import pytest
from scipy.spatial import ConvexHull, cKDTree

import broken_meshes as broken
from meshes import grid, half_cylinder, joined, moved, random_transform
from skinplan.mesh.check import check_mesh
from skinplan.mesh.model import SurfaceMesh
from skinplan.transforms import transform
from unit.test_mesh_doctor_defects import assert_same_surface, names

SKINS = {
    "panel": broken.panel,
    "flat": lambda: grid(1.0, 0.6, 0.05),
    "cylinder": lambda: half_cylinder(1.0, 1.0, 0.05),
    "bump": broken.bumped_skin,
    "groove": broken.grooved_skin,
}

FLOORS = {
    "bump": broken.bumped_skin,
    "groove": broken.grooved_floor,
}


@pytest.mark.parametrize("name", sorted(SKINS))
@pytest.mark.parametrize("closed", [True, False])
def test_of_two_skins_2_mm_apart_the_outer_is_kept(name, closed):
    skin = SKINS[name]()
    repaired, findings = check_mesh(broken.thick(skin, 0.002, closed))
    assert_same_surface(repaired, skin)
    assert set(names(findings)) == {"closed solid" if closed else "hidden parts"}


@pytest.mark.parametrize("name", sorted(SKINS))
def test_the_side_is_that_of_the_scanner(name):
    """From below the back is kept, and it looks down."""
    floor = FLOORS[name]() if name in FLOORS else None
    plate = broken.thick(SKINS[name](), 0.05, floor=floor)
    below, _ = check_mesh(plate, toward=(0, 0, -1))
    back = SurfaceMesh(plate.vertices, plate.faces[len(plate.faces) // 2 :])
    assert below.face_normals[:, 2].max() < 0
    assert set(map(tuple, below.vertices.round(9))) <= set(map(tuple, back.vertices.round(9)))


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("name", ["groove", "bump"])
def test_thick_blocks_keep_the_walls_of_their_features(name, seed):
    """Upright walls of a groove stay, upright walls along the rim go."""
    skin = SKINS[name]()
    T = random_transform(seed)
    block = moved(broken.thick(skin, 0.1, floor=FLOORS[name]()), T)
    repaired, findings = check_mesh(block, toward=T[:3, 2])
    assert set(names(findings)) == {"closed solid"}
    assert_same_surface(moved(repaired, np.linalg.inv(T)), skin)


def test_undercut_walls_stay():
    skin = broken.grooved_skin(undercut=0.004)
    assert skin.face_normals[:, 2].min() < -0.2
    repaired, _ = check_mesh(broken.thick(skin, 0.1, floor=broken.grooved_floor()))
    distance, _ = cKDTree(repaired.centroids).query(skin.centroids)
    assert distance.max() < 1e-9
    assert repaired.area == pytest.approx(skin.area, rel=0.01)


@pytest.mark.parametrize("draft_deg", [0.0, 3.0, 10.0])
def test_walls_of_the_rim_go_up_to_85_degrees(draft_deg):
    """A block that widens downward: its walls count as skin from 5 degrees of draft on."""
    block = broken.box(1.0, 0.6, 0.1)
    low = block.vertices[:, 2] < 0
    wider = 1.0 + 0.1 * np.tan(np.deg2rad(draft_deg)) / np.array([0.5, 0.3])
    vertices = block.vertices.copy()
    vertices[low, :2] *= wider
    repaired, findings = check_mesh(SurfaceMesh(vertices, block.faces))
    assert names(findings)["closed solid"] == (1, "repaired")
    assert len(repaired.faces) == (10 if draft_deg > 5 else 2)
    assert repaired.face_normals[:, 2].min() > 0


def test_a_sphere_leaves_its_upper_half():
    angle, height = np.meshgrid(np.linspace(0, 2 * np.pi, 65)[:-1], np.linspace(-1, 1, 42)[1:-1])
    ring = np.sqrt(1 - height**2)
    points = np.stack([ring * np.cos(angle), ring * np.sin(angle), height], axis=2).reshape(-1, 3)
    points = np.vstack([points, [0, 0, -1], [0, 0, 1]])
    hull = ConvexHull(points)
    rng = np.random.default_rng(1)
    simplices = np.array([rng.permutation(face) for face in hull.simplices]).astype(np.int64)
    repaired, findings = check_mesh(SurfaceMesh(points, simplices))
    assert names(findings)["closed solid"] == (1, "repaired")
    # 85 degrees from the top: a cap of height 1 - cos(85 deg).
    assert repaired.area == pytest.approx(2 * np.pi * (1 - np.cos(np.deg2rad(85))), rel=0.05)
    assert repaired.face_normals[:, 2].min() > 0
    outward = np.einsum("ij,ij->i", repaired.face_normals, repaired.centroids)
    assert outward.min() > 0.9


@pytest.mark.parametrize("gap", [0.001, 0.005, 0.01])
def test_shells_one_behind_another_need_not_fit(gap):
    """The back has other triangles, looks either way and is somewhat smaller."""
    front = broken.panel()
    other = grid(0.98, 0.58, 0.031, lambda x, y: 0.1 * np.sin(2 * x) * y - gap)
    for back in (other, broken.flipped(other, np.arange(len(other.faces)))):
        repaired, findings = check_mesh(joined(back, front))
        assert names(findings) == {"hidden parts": (1, "repaired")}
        assert_same_surface(repaired, front)


def test_parts_that_can_be_seen_stay():
    """A second skin 0.5 m lower shows from the side; one beside shows anyway."""
    for place in ((0.0, 0.0, -0.5), (1.1, 0.0, -0.02)):
        both = joined(broken.panel(), moved(broken.panel(), transform(place)))
        repaired, findings = check_mesh(both)
        assert names(findings) == {"separate parts": (2, "noted")}
        assert len(repaired.faces) == len(both.faces)


def test_a_skin_bent_round_is_not_cut():
    """A half pipe that turns under itself on both sides, and an open tube."""
    for half_angle in (0.6 * np.pi, 0.75 * np.pi, 0.95 * np.pi):
        skin = half_cylinder(0.3, 1.0, 0.03, half_angle)
        repaired, findings = check_mesh(skin)
        assert len(repaired.faces) == len(skin.faces)
        assert [finding for finding in findings if finding.action == "repaired"] == []
        outward = np.einsum("ij,ij->i", repaired.face_normals, repaired.centroids * [0, 1, 1])
        assert outward.min() > 0


def test_a_solid_stands_beside_a_skin():
    solid = moved(broken.thick(broken.panel(), 0.02), transform((1.2, 0.0, 0.0)))
    repaired, findings = check_mesh(joined(broken.panel(), solid))
    assert names(findings) == {"closed solid": (1, "repaired"), "separate parts": (2, "noted")}
    both = joined(broken.panel(), moved(broken.panel(), transform((1.2, 0.0, 0.0))))
    assert_same_surface(repaired, both)


def test_two_half_turns_have_two_sides():
    """The twin of the Moebius strip: twisted as well, but its winding is consistent."""
    whole = broken.strip(2)
    mixed = broken.flipped(whole, np.arange(0, len(whole.faces), 3))
    repaired, findings = check_mesh(mixed)
    assert "one-sided parts" not in names(findings)
    assert names(findings)["flipped faces"][1] == "repaired"
    assert len(repaired.faces) == len(whole.faces)
    edges = repaired.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    assert len(np.unique(edges, axis=0)) == len(edges)


def test_of_a_one_sided_strip_every_face_looks_to_the_scanner():
    repaired, findings = check_mesh(broken.moebius())
    assert names(findings)["one-sided parts"] == (1, "noted")
    assert repaired.face_normals[:, 2].min() > -1e-5


@pytest.mark.parametrize("bend", [0.5, -0.5])
@pytest.mark.parametrize("thickness", [0.002, 0.01])
def test_tilted_rims_of_thin_plates_leave_no_walls(bend, thickness):
    """A bent plate, hollow or arched: the walls of a hollow one's rim look up, and still go."""
    skin = grid(1.0, 0.6, 0.02, lambda x, y: bend * (x**2 + y**2))
    repaired, findings = check_mesh(broken.thick(skin, thickness))
    assert names(findings) == {"closed solid": (1, "repaired")}
    assert_same_surface(repaired, skin)
