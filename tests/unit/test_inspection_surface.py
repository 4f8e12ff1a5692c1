"""Local deviations, regions, missing areas and characteristics against closed forms."""

import math

import numpy as np
import pytest

from meshes import bump, grid
from scanned_part import dented
from skinplan.inspection.characteristics import FAIL, NOT_MEASURED, PASS, evaluate
from skinplan.inspection.measure import InspectionSettings, coverage_so_far, inspect
from skinplan.inspection.surface import SurfaceFigures
from skinplan.mesh.model import Segmentation
from skinplan.part.inspection_plan import Characteristic
from skinplan.part.inspection_points import InspectionPoints
from skinplan.scanner.samples import sample_surface


def measured(mesh, count, noise=3e-5, seed=0):
    rng = np.random.default_rng(seed)
    face = rng.choice(len(mesh.faces), count, p=mesh.face_areas / mesh.area)
    points = np.einsum("nc,nci->ni", rng.dirichlet(np.ones(3), count), mesh.corners[face])
    return points + rng.normal(size=(count, 1)) * noise * mesh.face_normals[face]


@pytest.fixture(scope="module")
def dent():
    """A bumpy plate with a dent and a round area left out."""
    mesh = grid(0.5, 0.4, 0.005, bump)
    points = measured(dented(mesh, (0.15, 0.1, 0.03, -5e-4)), 150_000)
    points = points[np.hypot(points[:, 0] + 0.18, points[:, 1] + 0.12) > 0.04]
    region = (np.hypot(*mesh.centroids[:, :2].T) < 0.12).astype(np.int64)
    segmentation = Segmentation(region, mesh)
    coverage = coverage_so_far(sample_surface(mesh), segmentation)
    found = inspect(points, mesh, segmentation, np.eye(4), InspectionSettings(), None, coverage)
    return found, coverage


def test_regions_add_up_to_the_part(dent):
    found, coverage = dent
    whole, smooth, feature = found.surface.regions(coverage.measured, 2e-4)
    assert (whole.region, smooth.region, feature.region) == (-1, 0, 1)
    assert whole.points == smooth.points + feature.points
    assert whole.area_m2 == pytest.approx(smooth.area_m2 + feature.area_m2)
    assert whole.area_ratio == pytest.approx(found.area_ratio)
    assert feature.area_ratio == pytest.approx(found.feature_area_ratio)
    known = found.deviation[np.isfinite(found.deviation)]
    assert whole.mean_m == pytest.approx(known.mean(), abs=1e-9)
    assert whole.sigma_m == pytest.approx(known.std(), abs=1e-9)
    assert (whole.min_m, whole.max_m) == (known.min(), known.max())
    assert feature.sigma_m == pytest.approx(3e-5, rel=0.1)


def test_the_worst_place_is_the_dent_and_its_share_is_out_of_tolerance(dent):
    found, coverage = dent
    whole = found.surface.regions(coverage.measured, 2e-4)[0]
    assert whole.worst_m == pytest.approx(-5e-4, abs=4e-5)
    assert np.hypot(*(whole.worst_at[:2] - [0.15, 0.1])) < 0.03
    share = math.pi * 0.03**2 / (whole.area_m2 * whole.area_ratio)
    assert 1.0 - whole.within_ratio == pytest.approx(share, rel=0.15)
    assert whole.density_per_m2 == pytest.approx(150_000 / whole.area_m2, rel=0.1)
    assert math.isnan(found.surface.regions(coverage.measured, math.nan)[0].within_ratio)


def test_the_missing_area_is_found_where_it_is(dent):
    found, coverage = dent
    areas = found.surface.missing(coverage.measured)
    assert areas[0].centre[:2] == pytest.approx([-0.18, -0.12], abs=0.003)
    # Points count within 8 mm of a sample.
    assert areas[0].area_m2 == pytest.approx(math.pi * 0.032**2, rel=0.15)
    assert areas[0].size[:2] == pytest.approx([0.064, 0.064], abs=0.01)
    assert sum(area.area_m2 for area in areas) == pytest.approx(
        (1.0 - found.area_ratio) * coverage.samples.weights.sum()
    )
    assert found.surface.missing(np.ones_like(coverage.measured)) == ()


def test_what_the_part_file_asks_is_judged(dent):
    found, _ = dent
    ball = {"centre_m": (0.15, 0.1, 0.0), "radius_m": 0.05}
    asked = (
        Characteristic("all", "profile", 8e-4),
        Characteristic("dent", "profile", 1.2e-3, **ball),
        Characteristic("gap", "profile", 1e-3, centre_m=(-0.18, -0.12, 0.0), radius_m=0.03),
        Characteristic("flat", "flatness", 1e-4, centre_m=(0.2, -0.15, 0.0), radius_m=0.04),
        Characteristic("points", "points", 1.2e-3),
    )
    targets = np.array([[0.15, 0.1, 0.0], [0.2, -0.15, 0.0], [-0.18, -0.12, 0.0]])
    points = InspectionPoints(targets, np.tile([0.0, 0.0, 1.0], (3, 1)), np.ones(3, np.int64))
    results = {each.id: each for each in evaluate(asked, found.surface, points)}
    assert results["all"].state == FAIL and results["all"].value_m == pytest.approx(1e-3, abs=8e-5)
    assert results["dent"].state == PASS
    assert results["gap"].state == NOT_MEASURED and results["gap"].measured_ratio < 0.2
    assert results["flat"].state == PASS
    assert results["points.1"].value_m == pytest.approx(-5e-4, abs=3e-5)
    assert [results[f"points.{k}"].state for k in (1, 2, 3)] == [PASS, PASS, NOT_MEASURED]
    nobody = evaluate(asked[-1:], found.surface, None)[0]
    assert nobody.state == NOT_MEASURED and "no measuring points" in nobody.reason


def test_the_diameter_of_a_ball_and_its_form():
    radius = 0.05
    mesh = grid(0.06, 0.06, 0.002, lambda x, y: np.sqrt(radius**2 - x**2 - y**2 + 1e-4))
    samples = sample_surface(mesh, 0.003)
    figures = SurfaceFigures(samples, np.zeros(len(samples.points), np.int64))
    true_radius = math.sqrt(radius**2 + 1e-4)
    # As if the ball were 0.1 mm larger in radius everywhere.
    out = 1e-4 + true_radius - np.linalg.norm(samples.points, axis=1)
    out /= np.einsum("ij,ij->i", samples.points / true_radius, samples.normals)
    for _ in range(3):
        figures.add(np.arange(len(out)), out)
    asked = Characteristic("knob", "sphere_diameter", 5e-5, 2 * true_radius, (0.0, 0.0, 0.04), 0.1)
    (found,) = evaluate((asked,), figures)
    assert found.value_m == pytest.approx(2 * (true_radius + 1e-4), abs=1e-6)
    assert found.state == FAIL and found.form_error_m < 1e-5


def test_a_thin_cloud_has_local_deviations_all_over_but_not_where_nothing_is():
    mesh = grid(0.3, 0.2, 0.01)
    points = measured(mesh, 10_000, 0.0)  # four points for each piece
    points = points[points[:, 0] < 0.1]
    flat = Segmentation(np.zeros(len(mesh.faces), np.int64), mesh)
    coverage = coverage_so_far(sample_surface(mesh), flat)
    found = inspect(points, mesh, flat, np.eye(4), InspectionSettings(), None, coverage)
    known = np.isfinite(found.surface.local)
    x = coverage.samples.points[:, 0]
    assert (found.surface.count[x < 0.09] < 3).mean() > 0.1
    assert known[x < 0.09].mean() > 0.995
    assert not known[x > 0.112].any()
