"""Strategy ``coverage``: few points that see all that can be seen; re-scans of what is missing."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial import cKDTree

from meshes import PANELS, bump, grid, half_cylinder, joined, moved, random_transform, without
from skinplan.errors import NothingMissingError, PartInvalidError
from skinplan.inspection.gaps import missing_samples
from skinplan.mesh.check import check_mesh
from skinplan.mesh.load import load_mesh
from skinplan.mesh.model import SurfaceMesh
from skinplan.mesh.segment import segment_mesh
from skinplan.part.model import ScanSettings
from skinplan.part.samples import sample_panel
from skinplan.scan_path.model import FEATURE, ROW
from skinplan.scan_path.plan import plan_scan_path, rows_only_path
from skinplan.scan_path.rescan import rescan_path
from skinplan.scan_path.view_choice import some_of
from skinplan.scanner.coverage import visible
from skinplan.scanner.model import ScannerModel
from skinplan.scanner.rays import RayCaster
from skinplan.scanner.samples import sample_surface
from skinplan.scanner.seeable import seeable

SETTINGS = ScanSettings(strategy="coverage")
SCANNER = ScannerModel.from_settings(SETTINGS)
MOST_POINTS = {"scene1": 80, "scene2": 35, "scene3": 110, "scene4": 105}


def planned(mesh, settings=SETTINGS):
    segmentation = segment_mesh(mesh)
    return segmentation, plan_scan_path(mesh, segmentation, settings)


def seen(mesh, path, scanner=SCANNER):
    """Samples 5 mm apart, by how many points each is seen, and which can be seen at all."""
    samples, caster = sample_surface(mesh, 0.005), RayCaster(mesh)
    views = visible(samples, caster, path.positions, path.directions, scanner)
    can = (views > 0) | seeable(mesh, samples, scanner, SETTINGS.clearance_m, caster)
    return samples, views, can


def require_well_seen(mesh, segmentation, path):
    """Of what can be seen 99.9 %, of the features 99.5 %: three times, axis within 60 degrees."""
    samples, views, can = seen(mesh, path)
    feature = segmentation.face_region[samples.faces] > 0
    assert np.mean(views[can] >= 3) >= 0.999
    if np.any(can & feature):
        assert np.mean(views[can & feature] >= 3) >= 0.995


def require_clear(mesh, path):
    tree = cKDTree(np.concatenate([sample_surface(mesh, 0.004).points, mesh.vertices]))
    assert tree.query(path.positions)[0].min() >= SETTINGS.clearance_m - 1e-6


@pytest.mark.parametrize("name", list(MOST_POINTS))
def test_scenes_are_seen_three_times_with_few_points(name):
    vertices, faces = sample_panel(name).triangulate(100_000)
    mesh, _ = check_mesh(SurfaceMesh(vertices, faces))
    segmentation, path = planned(mesh)
    assert len(path) <= MOST_POINTS[name]
    assert path.lower_bound <= len(path) <= 1.08 * path.lower_bound
    require_well_seen(mesh, segmentation, path)
    require_clear(mesh, path)


@pytest.mark.parametrize("panel", PANELS)
def test_panels_of_others_are_seen(shared_data, panel):
    mesh, _ = check_mesh(load_mesh(shared_data / "panels" / panel))
    segmentation, path = planned(mesh)
    require_well_seen(mesh, segmentation, path)
    require_clear(mesh, path)


def panel_with_bump():
    return grid(
        0.9, 0.6, 0.01, lambda x, y: 0.2 * y**2 + bump(x, y, height=0.06, radius=0.1, wall=0.03)
    )


def test_path_has_the_promised_form():
    mesh = panel_with_bump()
    segmentation, path = planned(mesh)
    assert path.strategy == "coverage"
    assert np.all(np.diff(path.kinds) >= 0)
    assert set(path.kinds.tolist()) <= {ROW, FEATURE}
    assert np.allclose(np.linalg.norm(path.directions, axis=1), 1.0)
    assert np.allclose(path.positions + SETTINGS.standoff_m * path.directions, path.targets)
    rows = path.groups[path.kinds == ROW]
    assert np.array_equal(np.unique(rows), np.arange(len(np.unique(rows))))
    features = path.groups[path.kinds == FEATURE]
    assert np.all((features >= 1) & (features <= max(segmentation.regions, 1)))


def test_points_of_a_pass_stand_in_order_on_one_line():
    mesh = grid(1.6, 0.7, 0.02)
    _, path = planned(mesh)
    assert path.feature_points == 0
    for row in np.unique(path.groups):
        points = path.targets[path.groups == row]
        assert np.ptp(points[:, 1]) < 1e-9
        assert np.all(np.diff(points[:, 0]) > 0) or np.all(np.diff(points[:, 0]) < 0)
    # Passes keep their inset from the edges.
    assert np.abs(path.targets[:, 0]).max() <= 0.8 - 0.4 * SETTINGS.field_radius_m + 1e-9
    assert np.abs(path.targets[:, 1]).max() <= 0.35 - 0.4 * SETTINGS.field_radius_m + 1e-9


def test_margins_are_kept():
    mesh = half_cylinder(0.8, 0.8, 0.02, half_angle=0.5)
    strict = dataclasses.replace(SETTINGS, incidence_margin_rad=0.2, field_margin_m=0.02)
    _, path = planned(mesh, strict)
    narrower = dataclasses.replace(
        SCANNER,
        field_radius_m=SCANNER.field_radius_m - 0.02,
        incidence_max_rad=SCANNER.incidence_max_rad - 0.2,
    )
    samples, views, _ = seen(mesh, path, narrower)
    assert np.mean(views >= 3) >= 0.995
    _, usual = planned(mesh)
    assert len(path) > len(usual)


@pytest.mark.parametrize("least", [1, 2, 5])
def test_every_place_is_seen_as_often_as_asked(least):
    mesh = grid(0.8, 0.5, 0.02)
    _, path = planned(mesh, dataclasses.replace(SETTINGS, least_views=least))
    _, views, _ = seen(mesh, path)
    assert np.mean(views >= least) >= 0.999
    assert views.min() < 3 * least + 10


def test_row_direction_is_obeyed():
    mesh = grid(1.2, 0.7, 0.02)
    _, path = planned(mesh, dataclasses.replace(SETTINGS, row_direction=(0.0, 1.0, 0.0)))
    for row in np.unique(path.groups):
        assert np.ptp(path.targets[path.groups == row][:, 0]) < 1e-9
    with pytest.raises(PartInvalidError, match="perpendicular"):
        planned(mesh, dataclasses.replace(SETTINGS, row_direction=(0.0, 0.0, 1.0)))


def test_holes_cut_a_pass_in_two_and_their_rims_are_seen():
    mesh = without(grid(1.6, 0.6, 0.01), lambda x, y: (np.abs(x) < 0.25) & (np.abs(y) < 0.31))
    segmentation, path = planned(mesh)
    assert np.all(np.abs(path.targets[path.kinds == ROW][:, 0]) >= 0.25 - 1e-9)
    require_well_seen(mesh, segmentation, path)


def test_two_parts_side_by_side():
    left, right = grid(0.5, 0.5, 0.02), grid(0.5, 0.5, 0.02)
    mesh = joined(left, SurfaceMesh(right.vertices + [0.9, 0.0, 0.02], right.faces))
    segmentation, path = planned(mesh)
    require_well_seen(mesh, segmentation, path)


def test_deterministic():
    mesh = panel_with_bump()
    _, first = planned(mesh)
    _, second = planned(mesh)
    for name in ("positions", "directions", "targets", "kinds", "groups"):
        assert np.array_equal(getattr(first, name), getattr(second, name))


def test_quality_does_not_depend_on_the_place_of_the_part():
    mesh = panel_with_bump()
    _, here = planned(mesh)
    T = random_transform(4)
    there_mesh = moved(mesh, T)
    segmentation, there = planned(there_mesh)
    assert abs(len(here) - len(there)) <= 0.1 * len(here) + 1
    require_well_seen(there_mesh, segmentation, there)


def test_triangle_order_and_size_change_little():
    fine, coarse = (
        panel_with_bump(),
        grid(
            0.9,
            0.6,
            0.015,
            lambda x, y: 0.2 * y**2 + bump(x, y, height=0.06, radius=0.1, wall=0.03),
        ),
    )
    shuffled = SurfaceMesh(
        fine.vertices, fine.faces[np.random.default_rng(2).permutation(len(fine.faces))]
    )
    counts = [len(planned(mesh)[1]) for mesh in (fine, coarse, shuffled)]
    assert max(counts) - min(counts) <= 0.15 * min(counts) + 1


def test_rescan_sees_what_row_cutting_left_out():
    mesh = panel_with_bump()
    segmentation = segment_mesh(mesh)
    rows = rows_only_path(mesh, segmentation, SETTINGS)
    samples, views, can = seen(mesh, rows)
    missing = can & (views == 0)
    assert missing.any()
    path = rescan_path(mesh, segmentation, SETTINGS, some_of(samples, missing))
    assert path.strategy == "rescan"
    assert len(path) < len(rows) / 2
    again = visible(samples, RayCaster(mesh), path.positions, path.directions, SCANNER)
    assert np.mean(again[missing] >= 3) >= 0.99


def test_rescan_of_a_cloud_with_a_hole():
    mesh = grid(1.2, 0.6, 0.02)
    cloud = sample_surface(mesh, 0.004).points
    kept = np.hypot(cloud[:, 0] - 0.3, cloud[:, 1] - 0.05) > 0.08
    missing = missing_samples(mesh, cloud[kept])
    assert missing.weights.sum() == pytest.approx(np.pi * 0.072**2, rel=0.1)
    path = rescan_path(mesh, segment_mesh(mesh), SETTINGS, missing)
    # Three views, as many as are asked for, and no more.
    assert len(path) == SETTINGS.least_views
    assert np.all(np.hypot(path.targets[:, 0] - 0.3, path.targets[:, 1] - 0.05) < 0.2)


def test_rescan_of_a_whole_cloud_has_nothing_to_do():
    mesh = grid(0.6, 0.5, 0.02)
    missing = missing_samples(mesh, sample_surface(mesh, 0.004).points)
    with pytest.raises(NothingMissingError, match="nothing is to be scanned again"):
        rescan_path(mesh, segment_mesh(mesh), SETTINGS, missing)


def test_rescan_of_what_cannot_be_seen_says_so():
    outside = grid(0.6, 0.5, 0.02)
    inside = grid(0.3, 0.3, 0.02)
    mesh = joined(outside, SurfaceMesh(inside.vertices - [0.0, 0.0, 0.02], inside.faces))
    samples = sample_surface(mesh, 0.01)
    hidden = samples.points[:, 2] < -0.01
    with pytest.raises(NothingMissingError, match="can be seen from outside"):
        rescan_path(mesh, segment_mesh(mesh), SETTINGS, some_of(samples, hidden))
