import dataclasses

import numpy as np
import pytest
from scipy.spatial import cKDTree

from meshes import PANELS, bump, grid
from skinplan.errors import (
    InputError,
    MeshNotFiniteError,
    MeshRefusedError,
    PartInvalidError,
    StrategyUnknownError,
)
from skinplan.mesh.check import check_mesh
from skinplan.mesh.load import load_mesh
from skinplan.mesh.model import Segmentation, SurfaceMesh
from skinplan.mesh.segment import segment_mesh
from skinplan.part.model import ScanSettings
from skinplan.part.samples import sample_panel
from skinplan.scan_path.model import FEATURE, ROW
from skinplan.scan_path.plan import plan_scan_path, rows_only_path
from skinplan.scanner.coverage import certify, coverage_figures
from skinplan.scanner.model import ScannerModel

SETTINGS = dataclasses.replace(ScanSettings(), strategy="published")
SCANNER = ScannerModel.from_settings(SETTINGS)
# Points of an independent implementation of the same method on parts of the same description.
POINTS = {"scene1": 322, "scene2": 142, "scene3": 427, "scene4": 447}
# ... and the share of the features' area that row cutting alone sees.
ROWS_ONLY = {"scene2": 0.863, "scene3": 0.837, "scene4": 0.714}


def planned(mesh, settings=SETTINGS):
    segmentation = segment_mesh(mesh)
    return segmentation, plan_scan_path(mesh, segmentation, settings)


def small():
    """A panel with a bump; its triangles are uneven, so that nothing hangs on equal numbers."""

    def shape(x, y):
        return 0.2 * y**2 + bump(x - 0.0123, y + 0.0071, height=0.05, radius=0.12, wall=0.03)

    flat = grid(1.0, 0.6, 0.0097)
    vertices = flat.vertices + 0.0
    inner = (np.abs(vertices[:, 0]) < 0.49) & (np.abs(vertices[:, 1]) < 0.29)
    shift = np.random.default_rng(7).uniform(-0.002, 0.002, (len(vertices), 2))
    vertices[inner, :2] += shift[inner]
    vertices[:, 2] = shape(vertices[:, 0], vertices[:, 1])
    return SurfaceMesh(vertices, flat.faces)


@pytest.fixture(scope="module", params=sorted(POINTS))
def scene(request):
    mesh = SurfaceMesh(*sample_panel(request.param).triangulate(100_000))
    return request.param, mesh, *planned(mesh)


def test_figures_of_the_scenes(scene):
    name, _, segmentation, path = scene
    assert len(path) == pytest.approx(POINTS[name], rel=0.15)
    assert path.row_points + path.feature_points == len(path)
    assert path.regions == segmentation.regions
    assert (path.feature_points > 0) == (name != "scene1")


def test_poses_are_what_the_method_says(scene):
    _, mesh, segmentation, path = scene
    np.testing.assert_allclose(np.linalg.norm(path.directions, axis=1), 1.0, atol=1e-9)
    np.testing.assert_allclose(
        path.positions, path.targets - SETTINGS.standoff_m * path.directions, atol=1e-9
    )
    assert np.all(np.diff(path.kinds) >= 0)
    rows = path.groups[path.kinds == ROW]
    np.testing.assert_array_equal(np.unique(rows), np.arange(rows.max() + 1))
    if path.feature_points == 0:
        return
    # Feature points stand in their own region.
    _, face = cKDTree(mesh.centroids).query(path.targets[path.kinds == FEATURE])
    region = segmentation.face_region[face]
    assert np.mean(region == path.groups[path.kinds == FEATURE]) > 0.95


def test_fig_21():
    """Row cutting leaves the sides of scene4's bumps unseen; the adaptive path sees them."""
    mesh = SurfaceMesh(*sample_panel("scene4").triangulate(100_000))
    segmentation, path = planned(mesh)
    adaptive = certify(mesh, segmentation, path, SCANNER)
    rows = certify(mesh, segmentation, rows_only_path(mesh, segmentation, SETTINGS), SCANNER)
    assert rows.feature_area_ratio <= 0.75
    assert adaptive.feature_area_ratio > 0.99
    assert adaptive.area_ratio > 0.995


def test_row_cutting_leaves_bump_sides_unseen_and_features_close_them(scene):
    """Fig. 21."""
    name, mesh, segmentation, path = scene
    adaptive = certify(mesh, segmentation, path, SCANNER)
    rows = certify(mesh, segmentation, rows_only_path(mesh, segmentation, SETTINGS), SCANNER)
    figures = coverage_figures(adaptive, rows)
    assert figures.area_ratio > 0.999
    if name == "scene1":
        assert np.isnan(figures.feature_area_ratio)
        assert figures.rows_only_area_ratio > 0.999
        return
    assert figures.feature_area_ratio > 0.999
    assert figures.rows_only_feature_area_ratio == pytest.approx(ROWS_ONLY[name], abs=0.04)
    assert figures.rows_only_area_ratio < 0.98


@pytest.mark.parametrize("name", PANELS)
def test_panels_of_others_plan_without_help(shared_data, name):
    mesh, _ = check_mesh(load_mesh(shared_data / "panels" / name, "m"))
    segmentation, path = planned(mesh)
    assert path.positions[:, 2].min() > mesh.bounds[0, 2]
    found = certify(mesh, segmentation, path, SCANNER, spacing_m=0.01)
    assert found.area_ratio > 0.995


def test_planning_twice_gives_the_same_plan():
    (_, first), (_, second) = planned(small()), planned(small())
    for field in dataclasses.fields(first):
        np.testing.assert_array_equal(getattr(first, field.name), getattr(second, field.name))


def test_a_given_row_direction_is_kept():
    mesh = small()
    settings = dataclasses.replace(SETTINGS, row_direction=(0.0, 2.0, 0.0))
    path = rows_only_path(mesh, segment_mesh(mesh), settings)
    for row in np.unique(path.groups):
        assert np.ptp(path.targets[path.groups == row, 0]) < 1e-6


@pytest.mark.parametrize("name", ["patch", "publshed", ""])
def test_strategies_that_are_not_there(name):
    mesh = grid(0.5, 0.5, 0.05)
    with pytest.raises(StrategyUnknownError, match="published"):
        planned(mesh, dataclasses.replace(SETTINGS, strategy=name))


def test_what_can_not_be_planned():
    mesh = grid(0.5, 0.5, 0.05)
    segmentation = segment_mesh(mesh)
    with pytest.raises(PartInvalidError, match="standoff_m"):
        plan_scan_path(mesh, segmentation, dataclasses.replace(SETTINGS, standoff_m=-0.3))
    with pytest.raises(PartInvalidError, match="row_direction"):
        plan_scan_path(
            mesh, segmentation, dataclasses.replace(SETTINGS, row_direction=(0.0, 0.0, 1.0))
        )
    with pytest.raises(InputError, match="segmentation"):
        plan_scan_path(mesh, Segmentation(segmentation.face_region[1:], mesh), SETTINGS)
    broken = SurfaceMesh(np.where(mesh.vertices > 0.2, np.nan, mesh.vertices), mesh.faces)
    with pytest.raises(MeshNotFiniteError):
        plan_scan_path(broken, segmentation, SETTINGS)
    # In a narrow pit no pose keeps its distance.
    tight = dataclasses.replace(SETTINGS, clearance_m=0.29, tilt_max_rad=0.0)
    pit = grid(0.1, 0.1, 0.005, lambda x, y: 20 * (x**2 + y**2))
    with pytest.raises(MeshRefusedError, match="keeps"):
        planned(pit, tight)
