import dataclasses

import numpy as np
import pytest

from meshes import bump, grid, joined, moved, random_transform
from skinplan.errors import InputError
from skinplan.scanner.coverage import visible
from skinplan.scanner.model import ScannerModel
from skinplan.scanner.rays import RayCaster
from skinplan.scanner.samples import sample_surface
from skinplan.scanner.seeable import seeable
from skinplan.transforms import transform

SCANNER = ScannerModel(0.2, 0.2, 0.4, 0.3, np.radians(60))
CONE = dataclasses.replace(SCANNER, field="cone")


def found_on(mesh, clearance, scanner=SCANNER, spacing=0.01, caster=None):
    samples = sample_surface(mesh, spacing)
    return samples, seeable(mesh, samples, scanner, clearance, caster)


@pytest.mark.parametrize("scanner", [SCANNER, CONE])
def test_a_panel_with_a_bump_can_all_be_seen(scanner):
    mesh = grid(0.8, 0.6, 0.02, lambda x, y: bump(x, y, 0.1, 0.15, 0.05))
    assert found_on(mesh, 0.15, scanner)[1].all()


@pytest.mark.parametrize("degrees", [30.0, 45.0, 60.0])
def test_below_a_roof_as_deep_as_the_limit_allows(degrees):
    half, low = 0.3, 0.08
    roof = moved(grid(2 * half, 4.0, 0.1), transform((0.0, 0.0, low)))
    scanner = dataclasses.replace(SCANNER, incidence_max_rad=np.radians(degrees))
    samples, found = found_on(joined(grid(1.6, 4.0, 0.1), roof), 0.0, scanner, 0.012)
    x, y, z = samples.points.T
    floor = (z < 0.01) & (np.abs(y) < 1.0)
    inside = half - np.abs(x)
    # A ray under the limit comes in as deep as low tan(limit). Axes stand 15 degrees apart about
    # the normal, the outmost at 0.999 of the limit: at worst cos 7.5 of the depth is found.
    depth = low * np.tan(np.radians(degrees))
    # Rays start 2 mm higher than the sample.
    assert found[floor & (inside < 0.96 * 0.99 * depth)].all()
    assert not found[floor & (inside > depth)].any()
    assert found[z > 0.01].all()


def test_between_walls_the_scanner_has_no_room():
    walls = [
        moved(
            grid(0.8, 2.0, 0.1),
            transform((side * 0.12, 0.0, 0.4), [[0, 0, side], [0, 1, 0], [-side, 0, 0]]),
        )
        for side in (-1, 1)
    ]
    corridor = joined(grid(0.24, 2.0, 0.08), *walls)
    # A field so narrow that the scanner can't stand behind a wall and look past it.
    narrow = dataclasses.replace(SCANNER, field_radius_m=0.01)
    samples, free = found_on(corridor, 0.0, narrow, 0.02)
    floor = samples.normals[:, 2] > 0.5
    assert free[floor].all()
    # At 0.4 m above the floor the walls are 0.12 m away at most.
    assert found_on(corridor, 0.11, narrow, 0.02)[1][floor].any()
    middle = np.abs(samples.points[:, 1]) < 0.5
    assert not found_on(corridor, 0.13, narrow, 0.02)[1][floor & middle].any()


def test_a_view_beside_the_axis_keeps_the_clearance():
    # A column of 0.3 m on a plate: from right above its foot the scanner is too near to it.
    column = moved(
        grid(0.35, 0.6, 0.05), transform((0.0, 0.0, 0.175), [[0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    )
    mesh = joined(grid(1.0, 0.6, 0.05), column)
    narrow = dataclasses.replace(SCANNER, field_radius_m=0.005, incidence_max_rad=np.radians(2))
    samples, found = found_on(mesh, 0.15, narrow)
    foot = (np.abs(samples.points[:, 0]) < 0.1) & (samples.points[:, 2] < 0.01)
    foot &= np.abs(samples.points[:, 1]) < 0.2
    assert not found[foot & (samples.points[:, 0] > 0.002)].any()
    wide = dataclasses.replace(SCANNER, incidence_max_rad=np.radians(2))
    assert found_on(mesh, 0.15, wide)[1][foot & (samples.points[:, 0] > 0.02)].all()


@pytest.mark.parametrize("scanner", [SCANNER, CONE], ids=["cylinder", "cone"])
def test_what_random_poses_see_is_found(scanner):
    """What any pose with the clearance sees can be seen: nearly all of it has to be found."""
    T = random_transform(3)
    roof = moved(grid(0.5, 0.5, 0.05), transform((0.1, 0.0, 0.06)))
    mesh = moved(joined(grid(1.0, 0.8, 0.05), roof), T)
    samples, found = found_on(mesh, 0.1, scanner, 0.02)
    rng = np.random.default_rng(8)
    directions = rng.normal(0, 0.7, (4000, 3)) - [0.0, 0.0, 1.0]
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    directions = directions @ T[:3, :3].T
    targets = samples.points[rng.integers(0, len(samples.points), 4000)]
    places = targets - rng.uniform(0.2, 0.4, (4000, 1)) * directions
    far = np.linalg.norm(places[:, None] - sample_surface(mesh, 0.02).points, axis=2).min(axis=1)
    clear = far > 0.1
    views = visible(samples, RayCaster(mesh), places[clear], directions[clear], scanner)
    assert clear.sum() > 1000
    # From a cone's origin one looks deeper below the roof than its axis leans.
    assert 0.5 < np.mean(found) < (0.99 if scanner is SCANNER else 1.01)
    assert np.mean(found[views > 0]) > 0.985


def test_the_fixture_hides_too():
    mesh = grid(0.4, 0.4, 0.05)
    lid = moved(grid(2.0, 2.0, 0.1), transform((0.0, 0.0, 0.05)))
    assert found_on(mesh, 0.1)[1].all()
    assert not found_on(mesh, 0.1, caster=RayCaster(mesh, (lid,)))[1].any()


def test_the_same_after_a_motion_of_the_part():
    roof = moved(grid(0.5, 0.5, 0.05), transform((0.1, 0.0, 0.06)))
    mesh = joined(grid(1.0, 0.8, 0.05), roof)
    first = found_on(mesh, 0.1)[1]
    second = found_on(moved(mesh, random_transform(2)), 0.1)[1]
    assert np.mean(first != second) < 2e-3
    assert 0.5 < first.mean() < 0.98


@pytest.mark.parametrize("clearance", [-0.1, np.nan, np.inf])
def test_a_clearance_that_can_not_be(clearance):
    with pytest.raises(InputError, match="clearance"):
        found_on(grid(0.2, 0.2, 0.05), clearance)
