from dataclasses import replace

import numpy as np
import pytest

from meshes import grid
from skinplan.contact.postures import fewest_groups, postures
from skinplan.contact.probing_arm import ProbingArm
from skinplan.contact.settings import ContactSettings, TrackerLimits
from skinplan.contact.sight import Sight
from skinplan.contact.tracker import SightOptions, find_tracker, seen_options, tracker_candidates
from skinplan.mesh.model import SurfaceMesh
from skinplan.robot.dh import GCR14_1400
from skinplan.transforms import planar, transform

LIMITS = TrackerLimits(range_min_m=0.5, range_max_m=10.0)
UP = GCR14_1400.drawn


def upright_grid(x):
    """A square of 1 m at x, facing +x, about (x, 0, 1)."""
    flat = grid(1.0, 1.0, 0.1)
    vertices = np.stack([np.full(len(flat.vertices), x), *flat.vertices[:, :2].T], axis=1)
    return SurfaceMesh(vertices + (0.0, 0.0, 1.0), flat.faces)


@pytest.fixture(scope="module")
def arm():
    return ProbingArm(replace(ContactSettings(), tracker=LIMITS), None)


def mirror(position, normal):
    """A mirror at a place that looks along a unit vector."""
    x = np.asarray(normal, dtype=float)
    y = np.cross((0.0, 0.0, 1.0) if abs(x[2]) < 0.9 else (1.0, 0.0, 0.0), x)
    y /= np.linalg.norm(y)
    return transform(position, np.stack([x, y, np.cross(x, y)], axis=1))


def test_angles_and_range_in_closed_form(arm):
    """A 3-4-5 beam: 3 up, 4 away, the mirror looks level."""
    beam = Sight(arm, None).beams(np.zeros(3), mirror((4.0, 0.0, 3.0), (-1.0, 0.0, 0.0))[None])
    assert beam.range_m[0] == pytest.approx(5.0)
    assert beam.emission_rad[0] == pytest.approx(np.arcsin(0.6))
    assert beam.incidence_rad[0] == pytest.approx(np.arccos(0.8))
    assert beam.allowed[0]


@pytest.mark.parametrize(
    ("position", "normal", "allowed"),
    [
        ((3.0, 0.0, 0.0), (-1.0, 0.0, 0.0), True),
        ((3.0, 0.0, 0.0), (1.0, 0.0, 0.0), False),  # looks away
        ((3.0, 0.0, 0.0), (-np.cos(0.78), np.sin(0.78), 0.0), True),
        ((3.0, 0.0, 0.0), (-np.cos(0.80), np.sin(0.80), 0.0), False),
        ((2.0, 0.0, 1.99), (-0.7071067811865476, 0.0, -0.7071067811865476), True),
        ((2.0, 0.0, 2.01), (-0.7071067811865476, 0.0, -0.7071067811865476), False),
        ((0.0, -3.0, 0.0), (0.0, 1.0, 0.0), True),  # it turns all around
        ((0.49, 0.0, 0.0), (-1.0, 0.0, 0.0), False),
        ((10.1, 0.0, 0.0), (-1.0, 0.0, 0.0), False),
    ],
)
def test_each_limit_holds_on_both_sides(arm, position, normal, allowed):
    beam = Sight(arm, None).beams(np.zeros(3), mirror(position, normal)[None])
    assert bool(beam.allowed[0]) is allowed


def test_the_part_breaks_the_beam_and_beside_it_does_not(arm):
    sight = Sight(arm, upright_grid(1.5))
    tracker = np.array([0.0, 0.0, 1.0])
    mirrors = np.array([[3.0, 0.0, 1.0], [3.0, 1.1, 1.0], [1.4, 0.0, 1.0], [3.0, 0.9, 1.0]])
    assert sight.past_part(tracker, mirrors).tolist() == [False, True, True, False]


def test_the_arm_and_the_vehicle_break_the_beam(arm):
    """The arm stands up; the beam goes through it, beside it, through the vehicle."""
    sight = Sight(arm, None)
    tracker = np.array([-3.0, 0.16, 0.6])  # the upper arm is 0.16 m beside the first axis
    ends = np.array([[3.0, 0.16, 0.6], [3.0, 2.0, 0.6], [3.0, 0.16, -1.4]])
    q = np.tile(UP, (3, 1))
    assert sight.past_arm(tracker, ends, q, np.eye(4)).tolist() == [False, True, False]
    moved = planar(0.0, 5.0, 0.0)
    assert sight.past_arm(tracker, ends, q, moved).all()


def test_the_tmac_itself_does_not_hide_its_mirror(arm):
    T = arm.forward_mirror(UP[None])[0]
    tracker = T[:3, 3] + 3.0 * T[:3, 0]
    assert Sight(arm, None).holds(tracker, UP[None], np.eye(4)) == [""]
    behind = T[:3, 3] - 3.0 * T[:3, 0]
    assert "incidence" in Sight(arm, None).holds(behind, UP[None], np.eye(4))[0]
    near = T[:3, 3] + 0.3 * T[:3, 0]
    assert "out of range" in Sight(arm, None).holds(near, UP[None], np.eye(4))[0]
    screen = SurfaceMesh(
        np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) @ T[:3, [1, 2, 0]].T
        + T[:3, 3] + T[:3, 0],
        np.array([[0, 1, 2], [0, 2, 3]]),
    )  # fmt: skip
    assert "by the part" in Sight(arm, screen).holds(tracker, UP[None], np.eye(4))[0]


def test_occlusion_by_the_arm_is_that_of_points_on_the_beam(arm):
    """Brute force: 4000 points on the beam against the distance to every capsule."""
    rng = np.random.default_rng(3)
    q = rng.uniform(-1.5, 1.5, (60, 6))
    tracker = np.array([-2.0, 0.0, 0.5])
    ends = rng.uniform((0.3, -0.5, 0.0), (1.5, 0.5, 0.9), (60, 3))
    found = Sight(arm, None).past_arm(tracker, ends, q, np.eye(4))
    low, high = arm.vehicle()
    share = np.linspace(0.0, 1.0, 4000)[:, None]
    for row, (segments, end) in enumerate(zip(arm.segments(q, np.eye(4)), ends, strict=True)):
        line = tracker + share * (end - tracker)
        least = np.linalg.norm(np.maximum(np.maximum(low - line, line - high), 0.0), axis=1).min()
        for (a, b), radius in zip(segments[:-1], arm.radii[:-1], strict=True):
            along = np.clip((line - a) @ (b - a) / max((b - a) @ (b - a), 1e-12), 0.0, 1.0)
            gaps = np.linalg.norm(line - a - along[:, None] * (b - a), axis=1)
            least = min(least, gaps.min() - radius)
        if abs(least - LIMITS.beam_clearance_m) > 1e-3:
            assert bool(found[row]) is bool(least > LIMITS.beam_clearance_m)
    assert 5 < found.sum() < 55


def options_of(arm, faces):
    """Options of the arm standing up, its T-Mac turned so that it looks to angles about z."""
    q = np.tile(UP, (len(faces), 1))
    mirrors = np.array([planar(0, 0, face) @ mirror((0, 0, 1.2), (1, 0, 0)) for face in faces])
    return q, mirrors


def test_a_tracker_that_sees_all_points_is_found_and_one_that_can_not_is_not(arm):
    sight = Sight(arm, None)
    q, mirrors = options_of(arm, [0.0, 0.6, 2.0, 0.3])
    places = (planar(0.0, 0.0, 0.0),)
    candidates = np.array([[-3.0, 0.0, 1.2], [3.0, 0.9, 1.2], [0.0, 3.0, 1.2]])
    options = SightOptions(np.array([0, 1, 1, 2]), np.zeros(4, dtype=np.int64), q, mirrors, 3)
    # Mirrors in the air beside the arm: only the angles count here.
    found = find_tracker(candidates, options, places, _Open(arm), 5)
    assert [place.tolist() for place, _ in found] == [[3.0, 0.9, 1.2]]
    assert np.unique(options.point[found[0][1]]).tolist() == [0, 1, 2]
    assert find_tracker(candidates[:1], options, places, sight, 5) == []
    assert len(seen_options(candidates[0], options, places, sight)) == 0


class _Open(Sight):
    """Line of sight past an arm that is not there."""

    def __init__(self, arm):
        super().__init__(arm, None)

    def past_arm(self, tracker, mirrors, q, T_axial_arm):
        return np.ones(len(q), dtype=bool)


def test_candidates_keep_clear_of_part_and_arm(arm):
    points = np.array([[0.0, -1.0, 0.3], [0.0, 1.0, 0.3]])
    bounds = np.array([[-0.3, -1.2, 0.0], [0.3, 1.2, 0.6]])
    places = tracker_candidates(points, bounds, np.array([[1.0, 0.0]]), arm)
    assert len(places) > 100
    gaps = np.maximum(np.maximum(bounds[0] - places, places - bounds[1]), 0.0)
    assert np.linalg.norm(gaps, axis=1).min() >= 0.5
    reach = arm.arm.lever_arms()[0]
    assert np.linalg.norm(places[:, :2] - (1.0, 0.0), axis=1).min() >= reach


def test_postures_are_chains_of_small_motions():
    chain = np.linspace(0.0, 3.0, 10)[:, None] * np.ones(6)
    apart = np.full((1, 6), -2.0)
    rng = np.random.default_rng(0)
    order = rng.permutation(11)
    labels = postures(np.concatenate([chain, apart])[order])
    assert len(np.unique(labels)) == 2 and labels[0] == 0
    assert len(np.unique(labels[order < 10])) == 1
    assert len(postures(np.zeros((0, 6)))) == 0


def test_fewest_groups_against_all_subsets():
    rng = np.random.default_rng(1)
    for _ in range(40):
        member = rng.random((7, 12)) < 0.35
        cost = rng.random((7, 12))
        group = fewest_groups(member, cost)
        reachable = member.any(axis=0)
        assert np.array_equal(group >= 0, reachable)
        assert member[group[reachable], np.flatnonzero(reachable)].all()
        least = min(
            bin(subset).count("1")
            for subset in range(1, 128)
            if member[[g for g in range(7) if subset >> g & 1]].any(axis=0)[reachable].all()
        )
        assert len(np.unique(group[reachable])) == least


def test_no_groups_at_all():
    assert fewest_groups(np.zeros((2, 3), dtype=bool), np.zeros((2, 3))).tolist() == [-1, -1, -1]
