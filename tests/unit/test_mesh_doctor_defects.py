import dataclasses
import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

import broken_meshes as broken
from broken_meshes import BROKEN, panel
from meshes import grid, joined, moved, random_transform
from skinplan.errors import (
    InputError,
    MeshEmptyError,
    MeshError,
    MeshNotFiniteError,
    MeshRefusedError,
)
from skinplan.mesh.check import check_mesh
from skinplan.mesh.model import SurfaceMesh
from skinplan.transforms import transform

UP = np.array([0.0, 0.0, 1.0])


def names(findings):
    return {finding.name: (finding.count, finding.action) for finding in findings}


def assert_same_surface(first, second, tolerance=3e-6):
    """Same faces with the same winding, in any order."""
    assert len(first.faces) == len(second.faces)
    _, partner = cKDTree(second.centroids).query(first.centroids)
    assert len(np.unique(partner)) == len(partner)
    rolled = [np.roll(second.corners[partner], roll, axis=1) for roll in range(3)]
    apart = np.min([np.abs(first.corners - other).max(axis=(1, 2)) for other in rolled], axis=0)
    assert apart.max() < tolerance


@pytest.fixture(params=sorted(BROKEN))
def defect(request):
    make, expected = BROKEN[request.param]
    return make(), expected


def test_there_are_at_least_twenty():
    assert len(BROKEN) >= 20


def test_each_defect_alone_gets_its_finding(defect):
    mesh, expected = defect
    repaired, findings = check_mesh(mesh)
    assert names(findings) == expected
    assert repaired.face_areas.min() > 0
    assert all(finding.detail for finding in findings)


def test_a_finding_says_where(defect):
    mesh, _ = defect
    lower, upper = mesh.bounds
    for finding in check_mesh(mesh)[1]:
        if finding.name in ("unit doubtful", "upright surface"):
            continue
        assert 1 <= len(finding.where) <= 3
        for place in finding.where:
            assert np.all(place >= lower - 1e-5) and np.all(place <= upper + 1e-5)


def test_repairing_twice_changes_nothing(defect):
    once, _ = check_mesh(defect[0])
    twice, findings = check_mesh(once)
    assert [finding for finding in findings if finding.action != "noted"] == []
    np.testing.assert_array_equal(twice.faces, once.faces)
    np.testing.assert_array_equal(twice.vertices, once.vertices)


def test_the_order_of_faces_and_vertices_does_not_matter(defect):
    mesh, _ = defect
    straight, findings = check_mesh(mesh)
    mixed, mixed_findings = check_mesh(broken.shuffled(mesh, 5))
    assert names(mixed_findings) == names(findings)
    assert_same_surface(mixed, straight)


def test_a_rigid_transform_turns_the_result_along(defect):
    mesh, _ = defect
    T = random_transform(11)
    straight, findings = check_mesh(mesh)
    turned, turned_findings = check_mesh(moved(mesh, T), toward=T[:3, :3] @ UP)
    doubts = {"unit doubtful"}  # the extent along the axes is meant to depend on the frame
    assert {
        name: value for name, value in names(turned_findings).items() if name not in doubts
    } == {name: value for name, value in names(findings).items() if name not in doubts}
    back = moved(turned, np.linalg.inv(T))
    assert_same_surface(back, straight)


REPAIRABLE = {
    name: make
    for name, (make, expected) in BROKEN.items()
    if all(action == "repaired" for _, action in expected.values()) and "solid" not in name
}


@pytest.mark.parametrize(("first", "second"), list(itertools.combinations(sorted(REPAIRABLE), 2)))
def test_two_defects_at_once_both_get_their_finding(first, second):
    """Side by side, each on a panel of its own."""
    beside = moved(REPAIRABLE[second](), transform((1.5, 0.0, 0.0)))
    mesh, findings = check_mesh(joined(REPAIRABLE[first](), beside))
    found = names(findings)
    for name in (first, second):
        for wanted, (count, action) in BROKEN[name][1].items():
            assert found[wanted][0] >= count
            assert found[wanted][1] == action
    assert found["separate parts"] == (2, "noted")
    again, more = check_mesh(mesh)
    assert [finding for finding in more if finding.action != "noted"] == []
    np.testing.assert_array_equal(again.faces, mesh.faces)


def test_many_defects_on_one_panel_give_the_panel_back():
    """Noise, flips, repeats, flat faces, specks, unused vertices and a back, all at once."""
    rng = np.random.default_rng(4)
    mesh = broken.thick(panel(), 0.002)
    mesh = broken.flipped(mesh, rng.choice(len(mesh.faces), 200, replace=False))
    mesh = broken.with_faces(mesh, *mesh.faces[:40], [5, 5, 6], [9, 9, 9])
    mesh = broken.soup(joined(mesh, broken.speck(), broken.speck(0.2)), 2e-8)
    mesh = SurfaceMesh(np.vstack([mesh.vertices, [[3.0, 3.0, 3.0]]]), mesh.faces)
    repaired, findings = check_mesh(broken.shuffled(mesh, 2))
    found = names(findings)
    assert found["duplicate faces"] == (40, "repaired")
    assert found["degenerate faces"] == (2, "repaired")
    assert found["debris"] == (2, "repaired")
    assert found["closed solid"] == (1, "repaired")
    assert found["unreferenced vertices"] == (1, "repaired")
    assert {"cracks", "flipped faces"} <= set(found)
    assert_same_surface(repaired, panel())


HEAPS = given(
    chosen=st.lists(st.sampled_from(sorted(BROKEN)), min_size=1, max_size=4),
    seed=st.integers(0, 1000),
    toward=st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: np.linalg.norm(v) > 0.1),
)


@settings(max_examples=40, deadline=None)
@HEAPS
def test_any_heap_of_defects_is_repaired_once_and_for_all(chosen, seed, toward):
    assert_fixed_point(chosen, seed, toward)


@pytest.mark.long
@settings(max_examples=1000, deadline=None)
@HEAPS
def test_a_thousand_heaps_of_defects_are_repaired_once_and_for_all(chosen, seed, toward):
    assert_fixed_point(chosen, seed, toward)


def assert_fixed_point(chosen, seed, toward):
    """Through one another, from any side: nothing sensible may come out, but a fixed point does."""
    heap = joined(*(moved(BROKEN[name][0](), random_transform(seed)) for name in chosen))
    try:
        once, _ = check_mesh(broken.shuffled(heap, seed), toward)
    except MeshError as error:
        assert error.findings[-1].action == "refused"
        return
    twice, findings = check_mesh(once, toward)
    assert [finding for finding in findings if finding.action != "noted"] == []
    np.testing.assert_array_equal(twice.faces, once.faces)
    np.testing.assert_array_equal(twice.vertices, once.vertices)


def test_the_size_of_the_largest_hole_is_said():
    (finding,) = check_mesh(broken.holed())[1]
    np.testing.assert_allclose(finding.where[0][:2], (0.2, 0.0), atol=0.02)
    assert "mm across" in finding.detail


def test_a_hole_is_as_large_as_it_is():
    """A square hole of 0.2 m: 283 mm across its corners, 400 cm2."""
    flat = grid(1.0, 0.6, 0.05)
    x, y = np.abs(flat.centroids[:, :2]).T
    (finding,) = check_mesh(broken.kept(flat, ~((x < 0.1) & (y < 0.1))))[1]
    assert finding.count == 1
    assert "283 mm across" in finding.detail
    assert "400 cm2" in finding.detail


def test_vertices_further_apart_than_noise_stay_apart():
    mesh = broken.soup(panel(), 2e-4)
    repaired, findings = check_mesh(mesh)
    assert "cracks" not in names(findings)
    assert names(findings)["separate parts"] == (480, "noted")
    assert len(repaired.faces) == 480


def test_a_vertex_moves_no_further_than_the_tolerance():
    noisy = broken.noisy_soup()
    repaired, _ = check_mesh(noisy)
    assert len(repaired.vertices) == len(panel().vertices)
    distance = np.linalg.norm(repaired.vertices[:, None] - panel().vertices, axis=2).min(axis=1)
    assert distance.max() < 1e-7 * np.sqrt(3)


def test_a_crowd_of_near_vertices_does_no_harm():
    """Twenty thousand loose faces in one place: pairs of near vertices would be 10^9."""
    rng = np.random.default_rng(6)
    crowd = 0.1 + rng.uniform(0, 2e-7, (60_000, 3))
    mesh = joined(panel(), SurfaceMesh(crowd, np.arange(60_000).reshape(-1, 3)))
    repaired, findings = check_mesh(mesh)
    assert_same_surface(repaired, panel())
    assert names(findings)["degenerate faces"][1] == "repaired"


def test_cells_between_ribs_are_no_debris():
    """Ribs make crowded edges all round small cells of a skin: the skin stays whole."""
    skin = grid(2.0, 1.0, 0.05)
    ribs = [
        moved(grid(2.0, 0.1, 0.05), transform((0, y, -0.05), [[1, 0, 0], [0, 0, -1], [0, 1, 0]]))
        for y in (-0.05, 0.0, 0.05)
    ]
    mesh = broken.merged(joined(skin, *ribs))
    repaired, findings = check_mesh(mesh)
    assert len(repaired.faces) == len(mesh.faces)
    assert names(findings) == {"non-manifold edges": (120, "noted")}


CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
FACE = np.array([[0, 1, 2]])


@pytest.mark.parametrize(
    ("vertices", "faces", "error", "finding"),
    [
        (CORNERS, np.zeros((0, 3), dtype=int), MeshEmptyError, None),
        (np.zeros((0, 3)), FACE, MeshEmptyError, None),
        (CORNERS * np.nan, FACE, MeshNotFiniteError, ("vertices not finite", 4)),
        (CORNERS + [0, np.inf, 0], FACE, MeshNotFiniteError, ("vertices not finite", 4)),
        (CORNERS, [[0, 1, 4], [0, -1, 2]], MeshRefusedError, ("faces without vertices", 2)),
        (CORNERS, [[0, 0, 1], [2, 2, 2]], MeshRefusedError, ("degenerate faces", 2)),
        (CORNERS * 1e-9, FACE, MeshRefusedError, ("degenerate faces", 1)),
        (CORNERS[:, :2], FACE, InputError, None),
        (CORNERS, FACE * 1.0, InputError, None),
        (CORNERS, FACE[:, :2], InputError, None),
    ],
)
def test_what_can_not_be_repaired_is_refused_by_name(vertices, faces, error, finding):
    with pytest.raises(error) as caught:
        check_mesh(SurfaceMesh(np.asarray(vertices), np.asarray(faces)))
    if finding is not None:
        last = caught.value.findings[-1]
        assert (last.name, last.count, last.action) == (*finding, "refused")


@pytest.mark.parametrize("toward", [(0, 0, 0), (0, 0, np.nan), (1, 0), "up"])
def test_the_scanner_is_somewhere(toward):
    with pytest.raises((InputError, ValueError)):
        check_mesh(panel(), toward)


def test_a_million_faces_too_many_are_refused(monkeypatch):
    from skinplan.mesh import check

    monkeypatch.setattr(check, "MOST_FACES", 479)
    with pytest.raises(MeshRefusedError, match="480 faces; up to 479") as caught:
        check_mesh(panel())
    assert caught.value.findings[0].name == "huge mesh"


def test_findings_are_plain_records():
    (finding,) = check_mesh(broken.inverted())[1]
    assert set(dataclasses.asdict(finding)) == {"name", "count", "action", "detail", "where"}
