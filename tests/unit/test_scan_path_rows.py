import numpy as np
import pytest

from meshes import grid, half_cylinder, joined, moved, random_transform, without
from skinplan.errors import MeshRefusedError, PartInvalidError
from skinplan.mesh.model import SurfaceMesh
from skinplan.scan_path.cut import cut_mesh
from skinplan.scan_path.frame import RowFrame, base_normal, candidate_frames, given_frame
from skinplan.scan_path.rows import plane_offsets, sample_rows
from skinplan.transforms import transform

UP = np.array([0.0, 0.0, 1.0])
ALONG_X = RowFrame(np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]), UP)


def lines_of(mesh, offsets, frame=ALONG_X):
    use = np.ones(len(mesh.faces), dtype=bool)
    return cut_mesh(mesh, mesh.vertex_normals, use, frame, np.asarray(offsets, dtype=float))


def rows_of(mesh, frame=ALONG_X, interval=0.08, k=2.0):
    flat = np.zeros(len(mesh.faces), dtype=bool)
    return sample_rows(mesh, mesh, frame, interval, flat, k)


def curves(lines):
    return [lines.points[a:b] for a, b in zip(lines.starts[:-1], lines.starts[1:], strict=True)]


def length(points):
    return np.linalg.norm(np.diff(points, axis=0), axis=1).sum()


def test_cuts_of_a_cylinder_are_arcs():
    radius = 0.4
    mesh = half_cylinder(radius, 1.0, 0.01)
    across = RowFrame(np.array([0.0, 1.0, 0.0]), np.array([-1.0, 0.0, 0.0]), UP)
    # One of the planes runs exactly through a row of vertices.
    found = curves(lines_of(mesh, [-0.333, 0.0, 0.217], across))
    assert len(found) == 3
    for points, offset in zip(found, [-0.333, 0.0, 0.217], strict=True):
        np.testing.assert_allclose(-points[:, 0], offset, atol=1e-12)
        assert length(points) == pytest.approx(2 * np.pi / 3 * radius, rel=1e-3)
        assert np.all(np.diff(points[:, 1]) >= 0)
        np.testing.assert_allclose(np.hypot(points[:, 1], points[:, 2]), radius, atol=1e-4)


def test_the_face_after_a_point_holds_the_curve():
    rng = np.random.default_rng(2)
    mesh = grid(1.0, 0.6, 0.05, lambda x, y: 0.02 * rng.normal(size=x.shape))
    shuffled = SurfaceMesh(mesh.vertices, mesh.faces[rng.permutation(len(mesh.faces))])
    lines = lines_of(shuffled, [-0.2, -0.05, 0.0, 0.11])
    inside = np.flatnonzero(lines.faces >= 0)
    middles = (lines.points[inside] + lines.points[inside + 1]) / 2
    corners = shuffled.corners[lines.faces[inside]]
    normals = shuffled.face_normals[lines.faces[inside]]
    np.testing.assert_allclose(
        np.einsum("ij,ij->i", middles - corners[:, 0], normals), 0.0, atol=1e-12
    )
    assert np.all(middles >= corners.min(axis=1) - 1e-12)
    assert np.all(middles <= corners.max(axis=1) + 1e-12)
    assert [len(points) for points in curves(lines)].count(2) == 0
    assert len(curves(lines)) == 4


def test_cuts_move_with_the_mesh():
    mesh = without(grid(1.0, 0.6, 0.03, lambda x, y: x * y), lambda x, y: np.hypot(x, y) < 0.15)
    T = random_transform(4)
    frame = RowFrame(T[:3, :3] @ ALONG_X.along, T[:3, :3] @ ALONG_X.across, T[:3, :3] @ UP)
    lines = lines_of(mesh, [0.011, 0.201])
    again = lines_of(moved(mesh, T), np.array([0.011, 0.201]) + frame.across @ T[:3, 3], frame)
    np.testing.assert_allclose(again.points, lines.points @ T[:3, :3].T + T[:3, 3], atol=1e-9)
    np.testing.assert_array_equal(again.faces, lines.faces)


def test_no_plane_hits():
    lines = lines_of(grid(1.0, 0.6, 0.1), [5.0])
    assert (len(lines.points), list(lines.starts)) == (0, [0])


@pytest.mark.parametrize("size", [(2.9, 0.8), (1.8, 1.0), (0.7, 0.6), (0.5, 0.3)])
def test_rows_of_a_plane_fill_it_and_stay_inside(size):
    interval = 0.08
    found = rows_of(grid(*size, 0.02), interval=interval)
    y = np.unique(found.targets[:, 1].round(9))
    assert np.diff(y).max() <= interval + 1e-9
    assert size[1] / 2 - 0.011 < y[-1] < size[1] / 2
    assert y[0] == pytest.approx(-y[-1], abs=1e-6)
    for row in range(found.rows.max() + 1):
        x = found.targets[found.rows == row, 0]
        assert 0 < np.diff(x).min() and np.diff(x).max() <= interval * 1.011
        assert size[0] / 2 - 0.011 < x[-1] < size[0] / 2
        assert x[0] == pytest.approx(-x[-1], abs=1e-6)
    np.testing.assert_allclose(found.normals, np.tile(UP, (len(found.rows), 1)), atol=1e-9)
    assert len(found.rows) <= np.prod([np.ceil(side / interval) + 1 for side in size])


def test_rows_stop_at_a_hole_and_go_on_behind_it():
    hole = 0.25
    mesh = without(grid(2.0, 0.8, 0.01), lambda x, y: np.hypot(x, y) < hole)
    found = rows_of(mesh)
    assert np.hypot(found.targets[:, 0], found.targets[:, 1]).min() > hole - 0.01
    crossing = np.abs(found.targets[:, 1]) < 0.15
    for y in np.unique(found.targets[crossing, 1].round(6)):
        here = np.abs(found.targets[:, 1] - y) < 1e-6
        left = here & (found.targets[:, 0] < 0)
        assert len(np.unique(found.rows[here])) == 2
        assert len(np.unique(found.rows[left])) == 1
        edge = -np.sqrt(hole**2 - y**2)
        assert edge - 0.03 < found.targets[left, 0].max() < edge


def test_small_holes_do_not_break_rows():
    mesh = without(grid(2.0, 0.8, 0.005), lambda x, y: np.hypot(x % 0.1 - 0.05, y - 0.01) < 0.012)
    whole = rows_of(grid(2.0, 0.8, 0.005))
    found = rows_of(mesh)
    assert found.rows.max() == whole.rows.max()
    assert len(found.rows) == len(whole.rows)
    # Targets stand on the part, not in the holes.
    off = np.hypot(found.targets[:, 0] % 0.1 - 0.05, found.targets[:, 1] - 0.01)
    assert off.min() > 0.005


def test_spacing_follows_the_normals():
    flat = rows_of(grid(1.0, 0.5, 0.01), interval=0.05, k=6)
    plain = rows_of(grid(1.0, 0.5, 0.01), interval=0.05, k=0)
    assert len(flat.rows) == len(plain.rows)
    across = RowFrame(np.array([0.0, 1.0, 0.0]), np.array([-1.0, 0.0, 0.0]), UP)
    steps = {}
    for k in (0.0, 2.0, 6.0):
        rows = rows_of(half_cylinder(0.15, 0.5, 0.005), across, interval=0.05, k=k)
        first = rows.targets[rows.rows == 0]
        angle = np.arctan2(first[:, 1], first[:, 2])
        steps[k] = 0.15 * np.diff(angle).max()
    # Eq (4) with normals one interval apart on a radius of three intervals.
    turn = np.cos(0.05 / 0.15)
    assert steps[0.0] <= 0.05 * 1.011
    assert steps[2.0] <= 0.05 * turn**2 * 1.02
    assert steps[6.0] <= 0.05 * turn**6 * 1.02


def test_plane_offsets_of_a_narrow_strip():
    strip = grid(1.0, 0.05, 0.01)
    found = plane_offsets(strip, np.ones(len(strip.faces), dtype=bool), ALONG_X.across, 0.08)
    np.testing.assert_allclose(found, [0.0], atol=1e-12)


def test_row_direction_is_that_of_the_sides():
    T = random_transform(11)
    mesh = moved(grid(2.0, 0.7, 0.02, lambda x, y: 0.1 * y**2), T)
    base = base_normal(mesh)
    np.testing.assert_allclose(base, T[:3, :3] @ UP, atol=1e-9)
    longer, shorter = candidate_frames(mesh.vertices, base)
    assert abs(longer.along @ T[:3, 0]) == pytest.approx(1.0, abs=1e-6)
    assert abs(shorter.along @ T[:3, 1]) == pytest.approx(1.0, abs=1e-6)
    for frame in (longer, shorter):
        axes = np.stack([frame.along, frame.across, frame.base])
        np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-9)


def test_given_direction_is_projected_or_refused():
    frame = given_frame(UP, (3.0, 3.0, 1.0))
    np.testing.assert_allclose(frame.along, np.array([1.0, 1.0, 0.0]) / np.sqrt(2))
    with pytest.raises(PartInvalidError, match="row_direction"):
        given_frame(UP, (0.0, 0.0, 1.0))


def test_a_surface_without_a_side_is_refused():
    mesh = grid(1.0, 0.5, 0.1)
    turned = moved(mesh, transform((0, 0, 1), np.diag([1.0, -1.0, -1.0])))
    with pytest.raises(MeshRefusedError, match="mean normal"):
        base_normal(joined(mesh, turned))
