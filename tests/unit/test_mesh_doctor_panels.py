"""Real panels: what the doctor must keep to on each, whatever the panel is."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

import broken_meshes as broken
from meshes import joined, moved, random_transform
from skinplan.mesh.check import check_mesh
from skinplan.mesh.load import load_mesh
from skinplan.mesh.model import SurfaceMesh
from skinplan.mesh.topology import edge_table
from unit.test_mesh_doctor_defects import assert_same_surface, names

# Panels like these, of other origin, pass as well: nothing below knows one of them.
COUNT = 6


@pytest.fixture(params=range(COUNT))
def panel(request, shared_data):
    files = sorted((shared_data / "panels").glob("*.stl"))
    assert len(files) >= COUNT
    return load_mesh(files[request.param])


def test_a_panel_comes_through_nearly_whole(panel):
    repaired, findings = check_mesh(panel)
    assert repaired.area > 0.97 * panel.area
    assert len(repaired.faces) > 0.97 * len(panel.faces)
    upward = repaired.face_areas[repaired.face_normals[:, 2] > 0].sum()
    assert upward > 0.97 * repaired.area
    assert {finding.action for finding in findings} <= {"repaired", "noted"}
    assert not {"closed solid", "double skin", "hidden parts"} & set(names(findings))


def test_what_is_left_is_clean(panel):
    repaired, _ = check_mesh(panel)
    edges = edge_table(repaired.faces)
    assert edges.same_winding.all()
    assert len(np.unique(np.sort(repaired.faces, axis=1), axis=0)) == len(repaired.faces)
    assert len(np.unique(repaired.faces)) == len(repaired.vertices)
    sides = np.linalg.norm(repaired.corners - np.roll(repaired.corners, 1, axis=1), axis=2)
    assert (2 * repaired.face_areas / sides.max(axis=1)).min() > 1e-7


def test_no_vertex_is_made_up(panel):
    """All that moves are vertices within the tolerance of rounding."""
    repaired, _ = check_mesh(panel)
    distance, _ = cKDTree(panel.vertices).query(repaired.vertices)
    assert distance.max() < 2e-5
    assert np.count_nonzero(distance) <= 0.001 * len(distance)


def test_repairing_twice_changes_nothing(panel):
    once, _ = check_mesh(panel)
    twice, findings = check_mesh(once)
    assert [finding for finding in findings if finding.action != "noted"] == []
    np.testing.assert_array_equal(twice.faces, once.faces)
    np.testing.assert_array_equal(twice.vertices, once.vertices)


def test_order_and_place_do_not_matter(panel):
    T = random_transform(3)
    straight, findings = check_mesh(panel)
    turned, more = check_mesh(moved(broken.shuffled(panel, 1), T), toward=T[:3, 2])
    assert {finding.name for finding in more} == {finding.name for finding in findings}
    assert_same_surface(moved(turned, np.linalg.inv(T)), straight, tolerance=2e-5)


def test_more_defects_on_a_panel_are_undone(panel):
    """Flips, repeats, specks and unused vertices are added; the same panel comes out."""
    clean, before = check_mesh(panel)
    rng = np.random.default_rng(7)
    mesh = broken.flipped(clean, rng.choice(len(clean.faces), len(clean.faces) // 5, replace=False))
    mesh = broken.with_faces(mesh, *clean.faces[::50], [3, 3, 4])
    mesh = joined(mesh, moved(broken.speck(), random_transform(1)))
    mesh = SurfaceMesh(np.vstack([mesh.vertices, [[1.0, 2.0, 3.0]]]), mesh.faces)
    repaired, findings = check_mesh(mesh)
    assert_same_surface(repaired, clean)
    found = names(findings)
    assert found["duplicate faces"] == (len(clean.faces[::50]), "repaired")
    assert found["degenerate faces"] == (1, "repaired")
    assert found["debris"] == (1, "repaired")
    assert found["unreferenced vertices"] == (1, "repaired")
    assert "flipped faces" in found


@pytest.mark.parametrize("closed", [True, False])
def test_of_a_panel_made_thick_the_outer_side_is_left(panel, closed):
    """A back 2 mm below it, with and without walls along rim and holes."""
    clean, _ = check_mesh(panel)
    repaired, findings = check_mesh(broken.thick(clean, 0.002, closed))
    assert {"closed solid", "double skin", "hidden parts"} & set(names(findings))
    assert repaired.area == pytest.approx(clean.area, rel=0.02)
    for first, second in ((clean, repaired), (repaired, clean)):
        distance, _ = cKDTree(second.centroids).query(first.centroids)
        assert first.face_areas[distance > 2e-5].sum() < 0.03 * first.area
