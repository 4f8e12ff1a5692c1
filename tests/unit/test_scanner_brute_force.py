"""The certificate against every ray and every face, rule by rule, in double precision."""

import dataclasses

import numpy as np
import pytest

from meshes import bump, grid, joined, moved, random_transform
from skinplan.mesh.model import Segmentation
from skinplan.scan_path.model import ROW, ScanPath
from skinplan.scanner.certifier import Certifier
from skinplan.scanner.coverage import visible_pairs
from skinplan.scanner.model import ScannerModel
from skinplan.scanner.rays import RayCaster
from skinplan.scanner.samples import sample_surface
from skinplan.scanner.sight import Sight
from skinplan.scanner.views import in_field_sideways
from skinplan.transforms import transform

CYLINDER = ScannerModel(0.2, 0.2, 0.4, 0.3, np.radians(60))
CONE = dataclasses.replace(CYLINDER, field="cone")
# Nearer to a gate than this [m, rad, share of an edge], single precision may decide otherwise.
NEAR = 1e-5
# Rays start so high above the surface [m].
LIFT_M = 0.002


class BruteForce:
    """All views against all samples: each array has shape (views, samples)."""

    def __init__(self, part, obstacles, samples, positions, directions, scanner):
        offset = samples.points[None] - positions[:, None]
        depth = np.einsum("vsi,vi->vs", offset, directions)
        aside = np.linalg.norm(offset - depth[..., None] * directions[:, None], axis=2)
        cosine = -np.einsum("si,vi->vs", samples.normals, directions)
        self.axis_rad = np.arccos(np.clip(cosine, -1, 1))
        cosine = -np.einsum("si,vsi->vs", samples.normals, offset) / np.linalg.norm(offset, axis=2)
        self.ray_rad = np.arccos(np.clip(cosine, -1, 1))
        cone = scanner.field == "cone"
        radius = 0.2 * depth / 0.2 if cone else 0.2
        limits = [depth - 0.2, 0.4 - depth, radius - aside, np.radians(60) - self.axis_rad]
        limits += [np.pi / 2 - self.ray_rad] if cone else []
        self.beside = (aside <= radius) & (depth > 0)
        self.in_range = self.beside & (depth >= 0.2) & (depth <= 0.4)
        self.facing = self.in_range & np.all(np.array(limits[3:]) >= 0, axis=0)
        starts = np.broadcast_to(samples.points + LIFT_M * samples.normals, offset.shape)
        if cone:
            toward = positions[:, None] - starts
            length = np.linalg.norm(toward, axis=2)
            toward = toward / length[..., None]
        else:
            toward, length = np.broadcast_to(-directions[:, None], starts.shape), depth
        self.by_part, first, near_part = self.hits(part, starts, toward, length)
        self.by_fixture = np.zeros_like(self.by_part)
        near = near_part
        if obstacles is not None:
            other, second, near_other = self.hits(obstacles, starts, toward, length)
            self.by_fixture = other & (second < first)
            self.by_part &= ~self.by_fixture
            near = near | near_other
        self.seen = self.facing & ~self.by_part & ~self.by_fixture
        self.doubtful = (np.abs(limits).min(axis=0) < NEAR) | (self.facing & near)

    @staticmethod
    def hits(mesh, starts, toward, length):
        """Moeller and Trumbore, without any structure: hit before the end, distance, doubt."""
        a, b, c = (mesh.corners[:, corner] for corner in range(3))
        blocked = np.zeros(length.shape, dtype=bool)
        nearest = np.full(length.shape, np.inf)
        near = np.zeros(length.shape, dtype=bool)
        for view in range(len(starts)):
            side = np.cross(toward[view][:, None], (c - a)[None])
            scale = np.einsum("fi,sfi->sf", b - a, side)
            lever = starts[view][:, None] - a[None]
            turn = np.cross(lever, (b - a)[None])
            with np.errstate(divide="ignore", invalid="ignore"):
                u = np.einsum("sfi,sfi->sf", lever, side) / scale
                v = np.einsum("sfi,si->sf", turn, toward[view]) / scale
                t = np.einsum("fi,sfi->sf", c - a, turn) / scale
            edge = np.minimum(np.minimum(u, v), 1 - u - v)
            end = np.minimum(t, length[view][:, None] - t)
            hit = (edge >= 0) & (end > 0)
            nearest[view] = np.where(hit, t, np.inf).min(axis=1)
            blocked[view] = hit.any(axis=1)
            # A ray through an edge of a face may hit the neighbour as well as this one: only a
            # free ray that almost hits, or a hit that almost misses, is in doubt.
            touch = (np.abs(np.minimum(edge, end)) < NEAR).any(axis=1)
            inner = ((edge > NEAR) & (end > NEAR)).any(axis=1)
            near[view] = touch & ~inner
        return blocked, nearest, near

    def reasons(self):
        """Sight of each sample by the views alone, SEEN where seen."""
        hidden = self.facing & ~self.seen
        first = hidden.argmax(axis=0)
        by_fixture = self.by_fixture[first, np.arange(len(first))]
        return np.select(
            [
                self.seen.any(axis=0),
                hidden.any(axis=0) & by_fixture,
                hidden.any(axis=0),
                self.in_range.any(axis=0),
                self.beside.any(axis=0),
            ],
            [
                Sight.SEEN,
                Sight.HIDDEN_BY_FIXTURE,
                Sight.HIDDEN_BY_PART,
                Sight.TOO_OBLIQUE,
                Sight.OUT_OF_RANGE,
            ],
            Sight.NOT_REACHED,
        )


def bumpy(seed):
    """A part with random hills, and a random plate above it, both somewhere in space."""
    rng = np.random.default_rng(seed)
    hills = rng.uniform([-0.4, -0.3, 0.02, 0.05], [0.4, 0.3, 0.12, 0.2], (5, 4))

    def height(x, y):
        return sum(bump(x - a, y - b, h, r, 0.4 * r) for a, b, h, r in hills)

    # A bridge over the hills is part of it.
    bridge = moved(grid(0.2, 0.5, 0.1), transform((*rng.uniform(-0.2, 0.2, 2), 0.13)))
    part = joined(grid(1.0, 0.6, 0.06, height), bridge)
    plate = moved(grid(0.2, 0.15, 0.05), transform((*rng.uniform(-0.2, 0.2, 2), 0.2)))
    T = random_transform(seed)
    return moved(part, T), moved(plate, T), T[:3, 2]


def poses(seed, points, up, count):
    """Views of random places from above, the first ones too far or too near."""
    rng = np.random.default_rng(seed)
    directions = rng.normal(0, 0.35, (count, 3)) - up
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    depth = rng.uniform(0.22, 0.38, count)
    depth[:2] = 0.05, 0.7
    return points[rng.integers(0, len(points), count)] - depth[:, None] * directions, directions


def certified(part, plate, positions, directions, scanner, spacing):
    region = Segmentation(np.zeros(len(part.faces), dtype=np.int64), part)
    path = ScanPath(
        positions, directions, positions + 0.3 * directions, np.full(len(positions), ROW),
        np.zeros(len(positions), dtype=np.int64), "test", 0,
    )  # fmt: skip
    return Certifier(part, region, scanner, spacing, occluders=(plate,)).points(path)


@pytest.mark.parametrize("scanner", [CYLINDER, CONE], ids=["cylinder", "cone"])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_same_samples_for_the_same_views_and_the_same_reasons(scanner, seed):
    part, plate, up = bumpy(seed)
    samples = sample_surface(part, 0.025)
    positions, directions = poses(seed, samples.points, up, 14)
    truth = BruteForce(part, plate, samples, positions, directions, scanner)
    caster = RayCaster(part, (plate,))
    found = np.zeros_like(truth.seen)
    for views, seen in visible_pairs(samples, caster, positions, directions, scanner):
        found[views, seen] = True
    sure = ~truth.doubtful
    assert np.mean(sure) > 0.998
    np.testing.assert_array_equal(found[sure], truth.seen[sure])
    assert 0.02 < found.mean() < 0.5

    coverage = certified(part, plate, positions, directions, scanner, 0.025)
    sure = ~truth.doubtful.any(axis=0)
    assert np.mean(sure) > 0.98
    np.testing.assert_array_equal(coverage.views[sure], truth.seen.sum(axis=0)[sure])
    np.testing.assert_array_equal(coverage.reasons[sure], truth.reasons()[sure])
    for angles, truths in ((coverage.axis_rad, truth.axis_rad), (coverage.ray_rad, truth.ray_rad)):
        best = np.where(truth.seen, truths, np.inf).min(axis=0)
        wanted = np.where(np.isfinite(best), best, np.nan)
        np.testing.assert_allclose(angles[sure], wanted[sure], atol=1e-7)


def test_every_reason_occurs_in_the_comparison():
    met = set()
    for seed in (1, 2, 3):
        part, plate, up = bumpy(seed)
        samples = sample_surface(part, 0.025)
        positions, directions = poses(seed, samples.points, up, 14)
        for scanner in (CYLINDER, CONE):
            truth = BruteForce(part, plate, samples, positions, directions, scanner)
            met.update(truth.reasons().tolist())
    assert met == set(Sight) - {Sight.SEEN_OFTEN, Sight.CANNOT_BE_SEEN}


def test_the_brute_force_itself_knows_a_roof():
    part = joined(grid(0.4, 0.4, 0.1), moved(grid(0.1, 0.1, 0.1), transform((0.01, 0.01, 0.05))))
    samples = sample_surface(part, 0.02)
    truth = BruteForce(
        part, None, samples, np.array([[0.0, 0.0, 0.3]]), np.array([[0.0, 0.0, -1.0]]), CYLINDER
    )
    below = (np.abs(samples.points[:, :2] - 0.01).max(axis=1) < 0.05) & (
        samples.points[:, 2] < 0.01
    )
    in_disc = np.hypot(*samples.points[:, :2].T) < 0.2
    np.testing.assert_array_equal(truth.seen[0], in_disc & ~below)


@pytest.mark.parametrize("scanner", [CYLINDER, CONE], ids=["cylinder", "cone"])
def test_the_same_points_are_beside_the_axes(scanner):
    rng = np.random.default_rng(11)
    points = rng.uniform(-1, 1, (3000, 3))
    positions = rng.uniform(-1.5, 1.5, (5, 3))
    directions = rng.normal(size=(5, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    offset = points[None] - positions[:, None]
    depth = np.einsum("vpi,vi->vp", offset, directions)
    aside = np.linalg.norm(np.cross(offset, directions[:, None]), axis=2)
    wide = depth if scanner is CONE else 0.2
    wanted = np.any((depth > 0) & (aside <= wide), axis=0)
    np.testing.assert_array_equal(in_field_sideways(points, positions, directions, scanner), wanted)
    assert 0.05 < wanted.mean() < 0.95
    none = np.zeros((0, 3))
    assert not in_field_sideways(points, none, none, scanner).any()
    assert in_field_sideways(none, positions, directions, scanner).shape == (0,)
