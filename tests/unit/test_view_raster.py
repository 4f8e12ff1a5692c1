"""The image of a mesh: where a point of space is in it, what hides what, which colour is where."""

import numpy as np
import pytest

import meshes
from skinplan.errors import InputError, MeshRefusedError
from skinplan.mesh.model import SurfaceMesh
from skinplan.view.camera import front_axes, front_view, raised_view, view_of
from skinplan.view.display_mesh import refined, thinned
from skinplan.view.raster import Light, coloured, rasterise, smaller


def front_light(view, strength=0.0):
    return Light.of(view.right, view.toward, strength)


def pixel_of(view, image, point):
    row, column = view.pixels(np.array([point]))[0]
    return image[row, column]


@pytest.mark.parametrize("seed", range(4))
def test_pixels_and_places_are_each_others_inverse(seed):
    T = meshes.random_transform(seed)
    view = front_view(meshes.moved(meshes.grid(0.6, 0.3, 0.05), T), 150)
    centres = view.pixel_centres()
    cells = view.pixels(centres.reshape(-1, 3)).reshape(view.rows, view.columns, 2)
    rows, columns = np.indices((view.rows, view.columns))
    assert np.array_equal(cells[..., 0], rows)
    assert np.array_equal(cells[..., 1], columns)
    assert np.allclose(view.depth(centres.reshape(-1, 3)), 0.0, atol=1e-12)


@pytest.mark.parametrize("seed", range(4))
def test_the_front_view_looks_along_the_normal_with_the_long_side_across(seed):
    T = meshes.random_transform(seed)
    right, toward = front_axes(meshes.moved(meshes.grid(0.9, 0.3, 0.05), T))
    assert toward == pytest.approx(T[:3, 2], abs=1e-9)
    assert abs(right @ T[:3, 0]) == pytest.approx(1.0, abs=1e-9)


def test_the_window_holds_all_points_with_a_margin():
    mesh = meshes.grid(0.9, 0.3, 0.05)
    view = front_view(mesh, 400)
    left, right, bottom, top = view.extent
    assert (left, right) == pytest.approx((-0.45 - 0.036, 0.45 + 0.036))
    assert bottom < -0.15 and top > 0.15
    assert view.width_m / view.columns == pytest.approx(view.height_m / view.rows)


def test_from_above_the_height_of_a_point_moves_it_down():
    view = raised_view(meshes.grid(0.9, 0.3, 0.05), 400, np.deg2rad(60.0))
    low, high = view.plane(np.array([[0.1, 0.1, 0.0], [0.1, 0.1, 0.2]]))
    assert high[0] == pytest.approx(low[0])
    assert high[1] - low[1] == pytest.approx(-0.2 * np.sin(np.deg2rad(60.0)))


def test_the_raster_has_the_depth_of_the_surface():
    mesh = meshes.grid(0.6, 0.4, 0.01, lambda x, y: 0.1 * x)
    view = view_of(mesh.vertices, np.array([1.0, 0, 0]), np.array([0, 0, 1.0]), 200)
    raster = rasterise(mesh, view)
    shown = raster.faces >= 0
    u = view.plane(view.pixel_centres().reshape(-1, 3))[:, 0].reshape(shown.shape)
    assert shown.mean() > 0.8
    assert raster.depth[shown] == pytest.approx(0.1 * u[shown], abs=1e-6)
    assert np.isneginf(raster.depth[~shown]).all()


def test_what_is_behind_the_surface_is_hidden():
    mesh = meshes.grid(0.6, 0.4, 0.02)
    raster = rasterise(mesh, front_view(mesh, 200))
    before, on, behind = [0.1, 0.05, 0.1], [0.1, 0.05, 0.0], [0.1, 0.05, -0.05]
    beside, outside = [0.305, 0.0, -0.05], [9.0, 0.0, 0.1]
    seen = raster.visible(np.array([before, on, behind, beside, outside]), 0.001)
    assert seen.tolist() == [True, True, False, True, False]


def test_each_pixel_has_the_colour_of_its_face():
    mesh = meshes.grid(0.6, 0.4, 0.02)
    colours = np.where(mesh.centroids[:, :1] > 0, [[1.0, 0, 0]], [[0, 0, 1.0]])
    view = front_view(mesh, 200)
    image = coloured(rasterise(mesh, view), mesh, colours, front_light(view))
    assert pixel_of(view, image, [0.2, 0.1, 0.0])[:3].argmax() == 0
    assert pixel_of(view, image, [-0.2, 0.1, 0.0])[:3].argmax() == 2
    assert pixel_of(view, image, [0.2, 0.1, 0.0])[3] == 255
    assert image[0, 0].tolist() == [0, 0, 0, 0]


def test_light_comes_from_the_upper_left_and_backs_are_dark():
    def roof(x, y):
        return -0.5 * np.abs(x)

    mesh = meshes.grid(0.6, 0.4, 0.02, roof)
    view = front_view(mesh, 200)
    white = np.ones((len(mesh.faces), 3))
    image = coloured(rasterise(mesh, view), mesh, white, front_light(view, 0.42))
    left, right = (pixel_of(view, image, [x, 0.0, roof(x, 0)])[0] for x in (-0.2, 0.2))
    assert left > right + 20
    turned = SurfaceMesh(mesh.vertices, mesh.faces[:, ::-1])
    back = coloured(rasterise(turned, view), turned, white, front_light(view, 0.42))
    assert pixel_of(view, back, [-0.2, 0.0, roof(0.2, 0)])[0] < right


def test_a_smaller_image_has_the_mean_colour_of_what_is_shown():
    image = np.zeros((2, 4, 4), dtype=np.uint8)
    image[:, :2] = [100, 200, 50, 255]
    image[0, 2] = [80, 80, 80, 255]
    small = smaller(image, 2)
    assert small.shape == (1, 2, 4)
    assert small[0, 0].tolist() == [100, 200, 50, 255]
    assert small[0, 1].tolist() == [80, 80, 80, 64]


@pytest.mark.parametrize(
    "points", [np.zeros((0, 3)), np.zeros((4, 2)), np.array([[0.0, np.nan, 0.0]])]
)
def test_a_view_of_no_points_is_refused(points):
    with pytest.raises(InputError):
        view_of(points, np.array([1.0, 0, 0]), np.array([0, 0, 1.0]), 100)


def test_colours_of_another_mesh_are_refused():
    mesh = meshes.grid(0.6, 0.4, 0.1)
    view = front_view(mesh, 50)
    with pytest.raises(InputError, match="one per face"):
        coloured(rasterise(mesh, view), mesh, np.ones((3, 3)), front_light(view))


def test_a_closed_body_has_no_front():
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
    with pytest.raises(MeshRefusedError):
        front_axes(SurfaceMesh(np.concatenate([np.zeros((1, 3)), np.eye(3)]), faces))


@pytest.mark.parametrize("seed", range(3))
def test_cut_faces_are_short_and_cover_the_same_surface(seed):
    mesh = meshes.moved(meshes.grid(0.4, 0.1, 0.1), meshes.random_transform(seed))
    display = refined(mesh, 0.03)
    sides = display.mesh.corners - np.roll(display.mesh.corners, 1, axis=1)
    assert np.linalg.norm(sides, axis=2).max() <= 0.03
    areas = np.bincount(display.parents, weights=display.mesh.face_areas)
    assert areas == pytest.approx(mesh.face_areas)
    assert display.mesh.face_normals == pytest.approx(mesh.face_normals[display.parents], abs=1e-9)


def test_fine_meshes_are_not_cut_and_small_ones_not_thinned():
    mesh = meshes.grid(0.1, 0.1, 0.005)
    assert refined(mesh).mesh is mesh
    assert thinned(mesh, len(mesh.faces)).mesh is mesh


def test_a_sliver_does_not_explode():
    sliver = SurfaceMesh(np.array([[0, 0, 0], [3.0, 0, 0], [1.5, 0.001, 0]]), np.array([[0, 1, 2]]))
    assert len(refined(sliver, 0.01).parents) < 20_000
    assert len(refined(sliver, 1e-9, most=500).parents) <= 500


def test_a_thinned_mesh_keeps_shape_area_and_origin_of_its_faces():
    mesh = meshes.grid(0.6, 0.4, 0.004, lambda x, y: meshes.bump(x, y))
    display = thinned(mesh, 5000)
    assert 1000 < len(display.mesh.faces) <= 5000
    assert display.mesh.area == pytest.approx(mesh.area, rel=0.05)
    away = display.mesh.centroids - mesh.centroids[display.parents]
    assert np.linalg.norm(away, axis=1).max() < 0.03
    facing = np.einsum("ij,ij->i", display.mesh.face_normals, mesh.face_normals[display.parents])
    assert np.median(facing) > 0.99
    moved = thinned(meshes.moved(mesh, meshes.random_transform(5)), 5000)
    assert len(moved.mesh.faces) <= 5000
