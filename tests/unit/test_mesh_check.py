import numpy as np
import pytest

from meshes import grid, joined, moved, without
from skinplan.errors import MeshEmptyError, MeshNotFiniteError, MeshRefusedError
from skinplan.mesh.check import check_mesh
from skinplan.mesh.load import merge_vertices
from skinplan.mesh.model import SurfaceMesh
from skinplan.transforms import transform

PANEL = grid(1.0, 0.6, 0.05, lambda x, y: 0.1 * np.sin(2 * x) * y)


def names(findings):
    return {finding.name: (finding.count, finding.action) for finding in findings}


def with_faces(mesh, *faces):
    return SurfaceMesh(mesh.vertices, np.concatenate([mesh.faces, np.array(faces)]))


def flipped(mesh, which):
    faces = mesh.faces.copy()
    faces[which] = faces[which][:, ::-1]
    return SurfaceMesh(mesh.vertices, faces)


def same_surface(first, second):
    """Same faces with the same winding, in any order."""
    keys = []
    for mesh in (first, second):
        rolled = [np.roll(face, -np.argmin(face)) for face in mesh.faces]
        keys.append(sorted(tuple(mesh.vertices[face].round(9).ravel()) for face in rolled))
    return keys[0] == keys[1]


def test_a_good_mesh_has_no_findings():
    mesh, findings = check_mesh(PANEL)
    assert findings == ()
    assert same_surface(mesh, PANEL)


def test_degenerate_and_duplicate_faces_are_removed():
    panel = grid(1.0, 0.6, 0.05)
    first = panel.faces[0]
    # Vertices 0, 1, 2 lie on a line.
    mesh, findings = check_mesh(
        with_faces(panel, [3, 3, 4], [0, 1, 2], first[::-1], np.roll(first, 1))
    )
    assert names(findings) == {
        "degenerate faces": (2, "repaired"),
        "duplicate faces": (2, "repaired"),
    }
    assert same_surface(mesh, panel)


def test_flipped_faces_are_turned():
    which = np.random.default_rng(1).choice(len(PANEL.faces), 60, replace=False)
    mesh, findings = check_mesh(flipped(PANEL, which))
    assert names(findings) == {"flipped faces": (60, "repaired")}
    assert same_surface(mesh, PANEL)


def test_a_part_that_looks_inward_is_turned_as_a_whole():
    mesh, findings = check_mesh(flipped(PANEL, np.arange(len(PANEL.faces))))
    assert names(findings) == {"inverted parts": (1, "repaired")}
    assert mesh.face_normals[:, 2].min() > 0


def test_debris_is_dropped_and_large_parts_stay():
    beside = moved(PANEL, transform((1.2, 0.0, 0.0)))
    speck = moved(grid(0.02, 0.02, 0.01), transform((0.0, 0.0, 0.3)))
    mesh, findings = check_mesh(joined(PANEL, speck, beside))
    assert names(findings) == {"debris": (1, "repaired"), "separate parts": (2, "noted")}
    assert same_surface(mesh, joined(PANEL, beside))


def test_holes_and_crowded_edges_are_noted():
    holed = without(PANEL, lambda x, y: np.hypot(x - 0.2, y) < 0.1)
    _, findings = check_mesh(holed)
    assert names(findings) == {"holes": (1, "noted")}
    fin = grid(1.0, 0.2, 0.05)
    upright = moved(fin, transform((0.0, 0.0, 0.1), [[1, 0, 0], [0, 0, -1], [0, 1, 0]]))
    both = joined(grid(1.0, 0.6, 0.05), upright)
    _, findings = check_mesh(SurfaceMesh(*merge_vertices(both.vertices.round(9), both.faces)))
    assert names(findings)["non-manifold edges"] == (20, "noted")


def test_repairing_twice_changes_nothing():
    speck = moved(grid(0.02, 0.02, 0.01), transform((0.0, 0.0, 0.3)))
    broken = with_faces(flipped(joined(PANEL, speck), np.arange(0, 200, 3)), [5, 5, 6])
    once, _ = check_mesh(broken)
    twice, findings = check_mesh(once)
    assert [f for f in findings if f.action == "repaired"] == []
    np.testing.assert_array_equal(twice.faces, once.faces)
    np.testing.assert_array_equal(twice.vertices, once.vertices)


def test_refused_meshes():
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
    with pytest.raises(MeshRefusedError, match="degenerate"):
        check_mesh(SurfaceMesh(corners, np.array([[0, 0, 1], [2, 2, 2]])))
    with pytest.raises(MeshEmptyError):
        check_mesh(SurfaceMesh(corners, np.zeros((0, 3), dtype=np.int64)))
    with pytest.raises(MeshNotFiniteError):
        check_mesh(SurfaceMesh(corners * np.nan, faces))


def test_of_a_closed_solid_the_side_of_the_scanner_is_left():
    """A corner tetrahedron: seen from above only its slanted face."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    solid = SurfaceMesh(corners, np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]))
    mesh, findings = check_mesh(solid)
    assert names(findings)["closed solid"] == (1, "repaired")
    np.testing.assert_allclose(mesh.face_normals, [np.full(3, 3**-0.5)])
