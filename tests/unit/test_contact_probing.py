from dataclasses import replace

import coal
import numpy as np
import pytest

from meshes import grid
from skinplan.contact.probing import StationReach, probe_poses
from skinplan.contact.probing_arm import ProbingArm
from skinplan.contact.settings import (
    AxialRadialSettings,
    ContactSettings,
    ProbeTool,
    TrackerLimits,
    require_settings,
)
from skinplan.contact.transfer import transfer
from skinplan.errors import InputError
from skinplan.mesh.model import SurfaceMesh
from skinplan.robot.dh import GCR14_1400
from skinplan.transforms import apply, inverse, planar, rotate, transform

FACING = np.array([0.0, -1.0, 0.0])


def wall():
    """An upright wall x = 0, outward +x, 2 m long and 1 m high about z = 0.3."""
    flat = grid(2.0, 1.0, 0.02)
    turn = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    T = transform((0.0, 0.0, 0.3), turn)
    return SurfaceMesh(apply(T, flat.vertices), flat.faces)


def wall_points(count=5):
    y, z = np.meshgrid(np.linspace(-0.5, 0.5, count), np.linspace(0.0, 0.6, count))
    points = np.stack([np.zeros(y.size), y.ravel(), z.ravel()], axis=1)
    return points, np.tile([1.0, 0.0, 0.0], (len(points), 1))


@pytest.fixture(scope="module")
def arm():
    return ProbingArm(ContactSettings(), wall())


def random_poses(count, seed=0):
    rng = np.random.default_rng(seed)
    theta = rng.uniform(-1.5, 1.5, (count, 6))
    return GCR14_1400.forward(theta)[:, -1]


def test_flange_of_the_probe_is_equation_3(arm):
    """The flange is the probe's length behind the ball, turned alike."""
    probe = random_poses(20)
    flange = arm.flange_poses(probe)
    assert np.allclose(flange @ arm.settings.tool.T_tool0_probe, probe, atol=1e-12)
    assert np.allclose(probe[:, :3, 3] - flange[:, :3, 3], 0.35 * probe[:, :3, 2], atol=1e-12)


def test_mirror_of_the_probe_is_equation_4(arm):
    """From the ball to the mirror and from the flange to the mirror: the same mirror."""
    probe = random_poses(20, 1)
    x, y, z = arm.settings.tool.mirror_m
    expected = arm.flange_poses(probe) @ transform((x, y, z))
    assert np.allclose(arm.mirror_poses(probe), expected, atol=1e-12)
    assert np.allclose(arm.T_tool0_mirror, transform((x, y, z)), atol=1e-12)


def test_the_probe_touches_along_the_inward_normal_at_any_roll():
    rng = np.random.default_rng(2)
    normals = rng.normal(size=(50, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    points, rolls = rng.normal(size=(50, 3)), rng.uniform(-np.pi, np.pi, 50)
    poses = probe_poses(points, normals, rolls, 0.003, FACING)
    assert np.allclose(poses[:, :3, 2], -normals)
    assert np.allclose(poses[:, :3, 3] - points, 0.003 * normals)
    assert np.allclose(poses[:, :3, :3] @ np.swapaxes(poses[:, :3, :3], 1, 2), np.eye(3))
    assert np.allclose(np.linalg.det(poses[:, :3, :3]), 1.0)
    level = probe_poses(points, normals, 0.0, 0.003, FACING)
    cosine = np.einsum("ni,ni->n", level[:, :3, 0], poses[:, :3, 0])
    assert np.allclose(cosine, np.cos(rolls))
    # At roll 0 no turn about the probe brings x nearer to where it should look.
    assert np.all(level[:, :3, 0] @ FACING >= poses[:, :3, 0] @ FACING - 1e-12)


def test_facing_along_the_normal_still_gives_a_frame():
    poses = probe_poses(np.zeros((1, 3)), -FACING[None], 0.0, 0.0, FACING)
    assert np.allclose(poses[0, :3, :3] @ poses[0, :3, :3].T, np.eye(3))


def test_options_bring_the_ball_to_the_points_inside_all_ranges_and_free(arm):
    points, normals = wall_points()
    place = planar(0.9, 0.1, 0.4)
    found = StationReach(arm, place, points, normals, FACING).options()
    assert len(np.unique(found.point)) > 15
    # GCR14 by its table, not by the model under test.
    flange = place @ GCR14_1400.forward(found.q)[:, -1]
    ball = flange[:, :3, 3] + 0.35 * flange[:, :3, 2]
    assert np.abs(ball - points[found.point] - 0.003 * normals[found.point]).max() < 1e-9
    assert np.abs(flange[:, :3, 2] + normals[found.point]).max() < 1e-9
    low, high = ([getattr(r, k) for r in GCR14_1400.rows] for k in ("lower_rad", "upper_rad"))
    assert np.all(found.q >= np.array(low) - 1e-9) and np.all(found.q <= np.array(high) + 1e-9)
    assert not touching(arm, found.q[::40], place)


def touching(arm, q, T_part_arm):
    """A fresh check of every capsule against the part, by coal alone."""
    mesh = arm._mesh
    model = coal.BVHModelOBBRSS()
    model.beginModel(len(mesh.faces), len(mesh.vertices))
    model.addVertices(mesh.vertices)
    model.addTriangles(mesh.faces)
    model.endModel()
    for row in arm.segments(q, T_part_arm):
        for ends, radius in zip(row, arm.radii, strict=True):
            for share in np.linspace(0.0, 1.0, 12):
                ball = coal.Transform3s(np.eye(3), ends[0] + share * (ends[1] - ends[0]))
                result = coal.DistanceResult()
                request = coal.DistanceRequest()
                gap = coal.distance(
                    model, coal.Transform3s(), coal.Sphere(radius), ball, request, result
                )
                if gap < arm.settings.margin_m - 1e-6:
                    return True
    return False


def test_reached_is_what_has_an_option_and_the_rest_has_a_reason(arm):
    points, normals = wall_points(7)
    points = points * (1.0, 2.5, 1.6)
    here = StationReach(arm, planar(0.85, 0.0, 0.0), points, normals, FACING)
    reached = here.reached()
    assert 0 < reached.sum() < len(points)
    assert np.array_equal(np.flatnonzero(reached), np.unique(here.options().point))
    assert np.all(here.kinematic() | ~reached)
    reasons = here.reasons()
    assert [bool(reason) for reason in reasons] == (~reached).tolist()
    assert any("inverse kinematics" in reason for reason in reasons)


def test_reach_does_not_depend_on_where_the_world_stands(arm):
    points, normals = wall_points()
    T = planar(3.0, -2.0, 0.7)
    here = StationReach(arm, planar(0.9, 0.0, 0.0), points, normals, FACING).kinematic()
    moved = ProbingArm(ContactSettings(), None)
    turned = StationReach(
        moved, T @ planar(0.9, 0.0, 0.0), apply(T, points), rotate(T, normals), T[:3, :3] @ FACING
    )
    assert np.array_equal(here, turned.kinematic())


def test_a_vehicle_in_the_part_reaches_nothing(arm):
    points, normals = wall_points()
    low_wall = wall()
    low_wall = SurfaceMesh(low_wall.vertices - (0.0, 0.0, 0.6), low_wall.faces)
    blocked = ProbingArm(ContactSettings(), low_wall)
    here = StationReach(blocked, planar(0.3, 0.0, 0.0), points, normals, FACING)
    assert not here.reached().any() and len(here.options().point) == 0
    assert set(here.reasons()) == {"collision of vehicle with part"}
    assert here.kinematic().any()


def test_collisions_name_what_meets_what():
    free = ProbingArm(ContactSettings(), None)
    level = np.array([[0.0, 0.2, 0.0, -1.5, 0.0, 0.0]])  # stretched out, a little down
    assert "with vehicle" in free.problems(level, np.eye(4))[0]
    down = np.array([[0.0, 1.2, 0.0, 0.0, 0.0, 0.0]])
    assert "with floor" in free.problems(down, np.eye(4))[0]
    up = GCR14_1400.drawn[None]
    assert free.problems(up, np.eye(4)) == [""]


def test_links_and_tool_that_meet_are_those_whose_capsules_do():
    """Brute force over 200 random postures: a named pair overlaps, without a name none does."""
    arm = ProbingArm(ContactSettings(base_height_m=5.0, base_size_m=(0.01, 0.01)), None)
    q = np.random.default_rng(7).uniform(arm.arm.lower, arm.arm.upper, (200, 6))
    names = [body.link for body in arm.bodies]
    order = [body.joint for body in arm.bodies[:-3]] + [7, 7, 7]
    share = np.linspace(0.0, 1.0, 40)[:, None]
    met = 0
    for problem, row in zip(arm.problems(q, np.eye(4)), arm.segments(q, np.eye(4)), strict=True):
        if "vehicle" in problem:
            continue
        lines = row[:, :1] + share * (row[:, 1:] - row[:, :1])
        overlap = set()
        for i, j in zip(*np.triu_indices(len(names), 1), strict=True):
            pair = frozenset((names[i], names[j]))
            if abs(order[i] - order[j]) > 1 and pair not in arm.arm.pairs_left_out:
                gaps = np.linalg.norm(lines[i][:, None] - lines[j][None], axis=2)
                keep = arm.radii[i] + arm.radii[j] + 0.01 * (order[j] == 7)
                if gaps.min() < keep:
                    overlap.add(f"{names[i]} with {names[j]}")
        # Between the samples capsules may be up to a millimetre nearer than found here.
        assert problem in overlap if overlap else True
        assert problem or not overlap
        met += bool(problem)
    assert 10 < met < 190


def test_winding_keeps_the_pose_and_finds_the_range(arm):
    q = np.random.default_rng(5).uniform(-9.0, 9.0, (100, 6))
    wound = arm.wound(q)
    assert np.allclose(arm.arm.forward(wound), arm.arm.forward(q), atol=1e-9)
    free = np.delete(np.arange(6), 2)  # every range but the elbow's is a full turn
    low, high = arm.arm.lower[free], arm.arm.upper[free]
    assert np.all((wound[:, free] >= low - 1e-9) & (wound[:, free] <= high + 1e-9))


def test_roll_turns_about_the_probe(arm):
    q = np.random.default_rng(6).uniform(-1.0, 1.0, (20, 6))
    rolls = np.linspace(-3.0, 3.0, 20)
    before = arm.arm.forward(q) @ arm.settings.tool.T_tool0_probe
    after = arm.arm.forward(arm.rolled(q, rolls)) @ arm.settings.tool.T_tool0_probe
    relative = inverse(before) @ after
    assert np.allclose(relative[:, :3, 3], 0.0, atol=1e-12)
    assert np.allclose(np.arctan2(relative[:, 1, 0], relative[:, 0, 0]), rolls)


def test_transfer_around_a_cylinder_keeps_its_distance(arm):
    """Between two places above a cylinder the ball stays on the circle through both."""
    radius, angle = 0.3, np.array([0.9, 1.5])
    normals = np.stack([np.sin(angle), np.zeros(2), np.cos(angle)], axis=1)
    middle = np.array([0.1, 0.0, 0.2])
    poses = probe_poses(middle + radius * normals, normals, 0.0, 0.0, FACING)
    q, valid, inside = arm.solve(inverse(planar(1.0, 0.1, 0.0)) @ poses)
    gaps = np.abs(q[0][:, None] - q[1][None]).max(axis=2)
    gaps[~(inside[0][:, None] & inside[1][None])] = np.inf
    a, b = np.unravel_index(np.argmin(gaps), gaps.shape)
    way = transfer(arm, q[0, a], q[1, b])
    assert len(way) > 4
    ball = (planar(1.0, 0.1, 0.0) @ arm.arm.forward(way) @ arm.settings.tool.T_tool0_probe)[
        :, :3, 3
    ]
    assert np.abs(np.linalg.norm((ball - middle)[:, [0, 2]], axis=1) - radius).max() < 1e-3
    assert np.allclose(way[0], q[0, a]) and np.allclose(way[-1], q[1, b])


def test_transfer_between_branches_is_only_its_ends(arm):
    start = np.array([0.0, -1.0, 1.0, 0.5, 1.0, 0.0])
    end = np.array([2.5, 0.5, -1.0, 0.5, -1.0, 2.0])
    assert np.array_equal(transfer(arm, start, end), np.stack([start, end]))


@pytest.mark.parametrize(
    "settings",
    [
        replace(ContactSettings(), tool=ProbeTool(probe_length_m=350.0)),
        replace(ContactSettings(), tracker=TrackerLimits(incidence_max_rad=45.0)),
        replace(ContactSettings(), tracker=TrackerLimits(range_min_m=5.0, range_max_m=2.0)),
        replace(ContactSettings(), stations=AxialRadialSettings(step_m=200.0)),
        replace(ContactSettings(), stations=AxialRadialSettings(k_max=0)),
        replace(ContactSettings(), base_height_m=752.0),
        replace(ContactSettings(), approach_m=float("nan")),
        replace(ContactSettings(), rolls=0),
    ],
)
def test_figures_out_of_range_are_refused(settings):
    with pytest.raises(InputError, match="contact settings"):
        require_settings(settings)


def test_the_figures_of_the_paper_are_the_defaults():
    settings = require_settings(ContactSettings())
    assert settings.robot == "gcr14_1400" and settings.base_height_m == 0.752
    assert (settings.stations.k_max, settings.stations.step_m) == (10, 0.2)
