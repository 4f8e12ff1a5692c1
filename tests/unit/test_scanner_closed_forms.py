"""Areas seen from one pose, against closed forms, within the stated sampling error."""

import dataclasses

import numpy as np
import pytest

from meshes import grid, half_cylinder, joined, moved, random_transform
from skinplan.mesh.model import SurfaceMesh
from skinplan.scanner.coverage import visible
from skinplan.scanner.model import ScannerModel
from skinplan.scanner.rays import RayCaster
from skinplan.scanner.samples import sample_surface
from skinplan.transforms import apply, rotate, transform

CYLINDER = ScannerModel(0.2, 0.2, 0.4, 0.3, np.radians(60))
CONE = dataclasses.replace(CYLINDER, field="cone")
SPACING_M = 0.004
DOWN = np.array([0.0, 0.0, -1.0])


def seen_area(mesh, position, direction, scanner, spacing=SPACING_M):
    samples = sample_surface(mesh, spacing)
    positions, directions = np.array([position], float), np.array([direction], float)
    views = visible(samples, RayCaster(mesh), positions, directions, scanner)
    return samples.weights[views > 0].sum()


def assert_area(found, wanted, boundary, spacing=SPACING_M):
    """The stated bound: the boundary's length times the spacing."""
    assert abs(found - wanted) <= boundary * spacing
    # Not a bound, but usual: a fifth of it.
    assert abs(found - wanted) <= 0.2 * boundary * spacing


@pytest.mark.parametrize("depth", [0.21, 0.3, 0.39])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_plane_is_seen_as_a_disc(depth, seed):
    T = random_transform(seed)
    plane = moved(grid(1.0, 1.0, 0.02), T)
    place = apply(T, np.array([[0.03, -0.02, depth]]))[0]
    direction = rotate(T, DOWN[None])[0]
    for scanner, radius in ((CYLINDER, 0.2), (CONE, depth)):
        found = seen_area(plane, place, direction, scanner)
        assert_area(found, np.pi * radius**2, 2 * np.pi * radius)


@pytest.mark.parametrize("spacing", [0.02, 0.01, 0.005, 0.0025])
@pytest.mark.parametrize("cell", [0.5, 0.05, 0.006])
def test_the_error_shrinks_with_the_spacing_whatever_the_triangles(cell, spacing):
    errors = [
        seen_area(grid(1.0, 1.0, cell), [x, y, 0.3], DOWN, CYLINDER, spacing) - np.pi * 0.04
        for x, y in np.random.default_rng(5).uniform(-0.25, 0.25, (6, 2))
    ]
    assert np.abs(errors).max() <= 2 * np.pi * 0.2 * spacing


def test_a_plane_out_of_range_is_not_seen():
    plane = grid(1.0, 1.0, 0.02)
    for scanner in (CYLINDER, CONE):
        for height in (0.199, 0.401, -0.3):
            assert seen_area(plane, [0, 0, height], DOWN, scanner) == 0.0


def test_a_leaning_view_of_a_plane_is_an_ellipse():
    lean = np.radians(20.0)
    direction = np.array([np.sin(lean), 0.0, -np.cos(lean)])
    half = 0.2 / np.cos(lean)
    found = seen_area(grid(2.0, 2.0, 0.02), -0.3 * direction, direction, CYLINDER)
    assert_area(found, np.pi * 0.2 * half, 2 * np.pi * half)


def test_a_leaning_view_is_cut_by_the_range():
    # At 45 degrees the depth runs from 0.1 to 0.5 m over the ellipse: half of it is in range.
    direction = np.array([1.0, 0.0, -1.0]) / np.sqrt(2)
    strip = 2 * (0.1 * np.sqrt(0.03) + 0.04 * np.arcsin(0.5)) * np.sqrt(2)
    found = seen_area(grid(2.0, 2.0, 0.02), -0.3 * direction, direction, CYLINDER)
    assert_area(found, strip, 4 * 0.4 * np.sqrt(2))


@pytest.mark.parametrize("degrees", [59.9, 60.1])
def test_a_plane_is_seen_up_to_the_incidence_limit(degrees):
    lean = np.radians(degrees)
    direction = np.array([np.sin(lean), 0.0, -np.cos(lean)])
    for scanner in (CYLINDER, CONE):
        found = seen_area(grid(2.0, 2.0, 0.02), -0.3 * direction, direction, scanner)
        assert (found > 0) == (degrees < 60)


@pytest.mark.parametrize("limit", [30.0, 50.0, 60.0])
def test_the_outside_of_a_cylinder_is_seen_up_to_the_incidence_limit(limit):
    radius, half_angle = 0.12, np.radians(80)
    # Facets of 2.5 degrees: the limit lies on an edge.
    mesh = half_cylinder(radius, 1.0, 2 * half_angle * radius / 64, half_angle)
    scanner = dataclasses.replace(CYLINDER, incidence_max_rad=np.radians(limit))
    angles = np.linspace(-np.radians(limit), np.radians(limit), 2001)
    chords = 2 * np.sqrt(0.2**2 - (radius * np.sin(angles)) ** 2)
    wanted = np.trapezoid(chords, radius * angles)
    boundary = 2 * chords[0] + 4 * radius * np.radians(limit)
    found = seen_area(mesh, [0, 0, radius + 0.25], DOWN, scanner)
    assert_area(found, wanted, boundary)


def cap(radius, polar_max, cell):
    """A cap of a sphere about the origin, its pole on +z, of facets about as wide as a cell."""
    length, width = 2 * np.pi, polar_max
    flat = grid(length, width, cell / radius)
    azimuth, polar = flat.vertices[:, 0], polar_max / 2 - flat.vertices[:, 1]
    vertices = radius * np.column_stack(
        [np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)]
    )
    return SurfaceMesh(vertices, flat.faces)


def test_a_sphere_is_seen_as_a_cap_as_wide_as_the_field():
    radius = 0.5
    wanted = 2 * np.pi * radius**2 * (1 - np.sqrt(1 - 0.4**2))
    found = seen_area(cap(radius, 0.5, 0.01), [0, 0, radius + 0.25], DOWN, CYLINDER)
    assert_area(found, wanted, 2 * np.pi * 0.2)


@pytest.mark.parametrize("scanner", [CYLINDER, CONE], ids=["cylinder", "cone"])
@pytest.mark.parametrize("limit", [20.0, 40.0])
def test_a_sphere_is_seen_as_a_cap_up_to_the_incidence_limit(limit, scanner):
    radius = 0.2
    limited = dataclasses.replace(scanner, incidence_max_rad=np.radians(limit))
    wanted = 2 * np.pi * radius**2 * (1 - np.cos(np.radians(limit)))
    found = seen_area(cap(radius, 1.0, 0.002), [0, 0, radius + 0.25], DOWN, limited)
    assert_area(found, wanted, 2 * np.pi * radius * np.sin(np.radians(limit)))


def test_a_cone_sees_a_sphere_up_to_its_horizon():
    # From a point at the height h above the middle the horizon is where cos = r / h: 68 degrees.
    radius, height = 0.15, 0.4
    scanner = dataclasses.replace(CONE, incidence_max_rad=np.pi / 2)
    wanted = 2 * np.pi * radius**2 * (1 - radius / height)
    boundary = 2 * np.pi * np.sqrt(radius**2 - (radius**2 / height) ** 2)
    found = seen_area(cap(radius, 1.5, 0.001), [0, 0, height], DOWN, scanner)
    assert_area(found, wanted, boundary)


@pytest.mark.parametrize("scanner", [CYLINDER, CONE], ids=["cylinder", "cone"])
def test_the_shadow_of_a_plate(scanner):
    low, side, height = 0.05, 0.1, 0.3
    roof = moved(grid(side, side, 0.01), transform((0.0, 0.0, low)))
    mesh = joined(grid(1.2, 1.2, 0.02), roof)
    # Parallel rays: as large as the plate; from one point: grown with the distance.
    grown = 1.0 if scanner is CYLINDER else height / (height - low)
    radius = 0.2 if scanner is CYLINDER else height
    wanted = np.pi * radius**2 - (grown * side) ** 2 + side**2
    found = seen_area(mesh, [0, 0, height], DOWN, scanner)
    assert_area(found, wanted, 2 * np.pi * radius + 4 * side * (grown + 1))
