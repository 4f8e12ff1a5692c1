import numpy as np
import pytest

from meshes import grid, joined, moved, random_transform
from skinplan.errors import InputError
from skinplan.mesh.model import SurfaceMesh
from skinplan.scanner.rays import RayCaster
from skinplan.transforms import apply, rotate, transform

PANEL = grid(1.0, 0.6, 0.05, lambda x, y: 0.1 * np.sin(5 * x) * np.cos(4 * y))


def rays(seed, count=500):
    rng = np.random.default_rng(seed)
    origins = np.column_stack([rng.uniform(-0.6, 0.6, (count, 2)), rng.uniform(0.2, 0.5, count)])
    aims = rng.uniform(-0.6, 0.6, (count, 3)) * [1, 1, 0.2]
    directions = aims - origins
    return origins, directions / np.linalg.norm(directions, axis=1, keepdims=True)


def brute_force(mesh, origins, directions):
    """Every ray against every face (Moeller and Trumbore)."""
    a, b, c = (mesh.corners[:, corner] for corner in range(3))
    distance = np.full(len(origins), np.inf)
    for number, (origin, direction) in enumerate(zip(origins, directions, strict=True)):
        side = np.cross(direction, c - a)
        scale = np.einsum("ij,ij->i", b - a, side)
        with np.errstate(divide="ignore", invalid="ignore"):
            u = np.einsum("ij,ij->i", origin - a, side) / scale
            turn = np.cross(origin - a, b - a)
            v = turn @ direction / scale
            t = np.einsum("ij,ij->i", c - a, turn) / scale
        hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)
        distance[number] = t[hit].min(initial=np.inf)
    return distance


def test_first_hits_agree_with_brute_force():
    origins, directions = rays(1)
    distance, face = RayCaster(PANEL).hits(origins, directions)
    wanted = brute_force(PANEL, origins, directions)
    np.testing.assert_array_equal(np.isfinite(distance), np.isfinite(wanted))
    hit = np.isfinite(wanted)
    np.testing.assert_allclose(distance[hit], wanted[hit], atol=1e-6)
    np.testing.assert_array_equal(face >= 0, hit)
    assert 0.2 < hit.mean() < 1.0


def test_occlusion_ends_at_the_distance():
    origins, directions = rays(2)
    caster = RayCaster(PANEL)
    distance, _ = caster.hits(origins, directions)
    hit = np.isfinite(distance)
    far = np.where(hit, distance, 1.0)
    np.testing.assert_array_equal(caster.occluded(origins, directions, far + 1e-4), hit)
    assert not caster.occluded(origins, directions, far - 1e-4).any()


def test_hits_move_with_the_mesh():
    origins, directions = rays(3)
    T = random_transform(3)
    first, _ = RayCaster(PANEL).hits(origins, directions)
    second, _ = RayCaster(moved(PANEL, T)).hits(apply(T, origins), rotate(T, directions))
    both = np.isfinite(first) & np.isfinite(second)
    assert np.mean(np.isfinite(first) == np.isfinite(second)) > 0.995
    np.testing.assert_allclose(first[both], second[both], atol=1e-5)


def test_both_sides_are_hit_and_no_rays_are_no_error():
    caster = RayCaster(grid(1.0, 1.0, 0.5))
    distance, _ = caster.hits(np.array([[0.1, 0.2, -1.0]]), np.array([[0.0, 0.0, 1.0]]))
    assert distance[0] == pytest.approx(1.0)
    empty = np.zeros((0, 3))
    assert caster.hits(empty, empty)[0].shape == (0,)
    assert caster.occluded(empty, empty, 1.0).shape == (0,)


def test_obstacles_are_hit_and_have_numbers_of_their_own():
    low = moved(grid(0.2, 0.2, 0.1), transform((0.0, 0.0, 0.3)))
    high = moved(grid(0.4, 0.4, 0.2), transform((0.1, 0.0, 0.5)))
    nothing = SurfaceMesh(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64))
    caster = RayCaster(PANEL, (low, nothing, high))
    assert caster.part_faces == len(PANEL.faces)
    origins, directions = rays(4)
    distance, face = caster.hits(origins + [0.0, 0.0, 0.3], directions)
    wanted = brute_force(joined(PANEL, low, high), origins + [0.0, 0.0, 0.3], directions)
    hit = np.isfinite(wanted)
    np.testing.assert_array_equal(face >= 0, hit)
    np.testing.assert_allclose(distance[hit], wanted[hit], atol=1e-6)
    firsts = caster.part_faces + np.array([0, len(low.faces), len(low.faces) + len(high.faces)])
    assert face.max() < firsts[2]
    heights = (origins + [0.0, 0.0, 0.3] + np.where(hit, distance, 0.0)[:, None] * directions)[:, 2]
    for first, after, height in ((firsts[0], firsts[1], 0.3), (firsts[1], firsts[2], 0.5)):
        among = (face >= first) & (face < after)
        assert among.any()
        np.testing.assert_allclose(heights[among], height, atol=1e-6)
    with pytest.raises(InputError, match="finite"):
        RayCaster(PANEL, (moved(low, np.diag([np.nan, 1.0, 1.0, 1.0])),))


def test_what_can_not_be_used():
    with pytest.raises(InputError, match="face"):
        RayCaster(SurfaceMesh(np.zeros((3, 3)), np.zeros((0, 3), dtype=np.int64)))
    caster = RayCaster(PANEL)
    with pytest.raises(InputError, match="shape"):
        caster.hits(np.zeros((2, 3)), np.zeros((3, 3)))
    with pytest.raises(InputError, match="shape"):
        caster.occluded(np.zeros(3), np.zeros(3), 1.0)
