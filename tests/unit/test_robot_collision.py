import dataclasses

import coal
import numpy as np
import pinocchio as pin
import pytest

from reach_scene import flat_panel, in_arm_base, upright
from skinplan.errors import InputError, JointsInvalidError
from skinplan.robot.arm import _MODELS
from skinplan.robot.cell import CellConfig
from skinplan.robot.collision import FIXTURE_DEPTH_M, CollisionWorld
from skinplan.robot.exact import coal_mesh, touches
from skinplan.transforms import apply, inverse, planar, transform

CELL = CellConfig()
HOME = np.array(CELL.home_rad)


def world_at(distance, heading=0.0, cell=CELL, height=0.8):
    panel = flat_panel(2.9, height)
    T = in_arm_base(cell, planar(0.0, -distance, heading), upright(height))
    return CollisionWorld(cell, panel, T)


def poses(count, seed=0):
    low, high = (-1.0, -2.5, -2.5, -3.0, -3.0, -3.0), (2.5, -0.2, 2.5, 3.0, 3.0, 3.0)
    return np.random.default_rng(seed).uniform(low, high, (count, 6))


@pytest.mark.parametrize("distance", [0.65, 0.8, 1.2, 2.0])
@pytest.mark.parametrize("heading", [-0.3, 0.0, 0.3])
def test_home_is_free_beside_the_part(distance, heading):
    assert world_at(distance, heading, height=1.6).pair(HOME) is None


def test_the_filter_never_decides_otherwise_than_the_exact_check():
    world = world_at(0.6)
    q = poses(400)
    segments = world.bodies.segments(q)
    in_part = apply(world._T_part_arm, segments.reshape(-1, 3)).reshape(segments.shape)
    decided = world._part_check.part_hits(in_part).any(axis=1)
    for row, found in zip(segments, decided, strict=True):
        ends = apply(world._T_part_arm, row.reshape(-1, 3)).reshape(-1, 2, 3)
        exact = any(
            touches(world._mesh, b, e, CELL.collision_margin_m)
            for b, e in zip(world.bodies.items, ends, strict=True)
        )
        assert exact == found
    assert 0.02 < decided.mean() < 0.98
    assert world.exact_checks < 0.2 * len(q) * len(world.bodies)


def test_whatever_is_free_is_free_for_pinocchio_and_coal_too():
    """Real cylinders instead of capsules, Pinocchio's kinematics, coal's distances."""
    world = world_at(0.7)
    q = poses(300, 1)
    free = q[world.free(q)]
    assert len(free) > 20
    path = str(_MODELS / "ur5.urdf")
    model = pin.buildModelFromUrdf(path)
    geometry = pin.buildGeomFromUrdf(model, path, pin.GeometryType.COLLISION)
    T = world._T_arm_part
    part = pin.GeometryObject("part", 0, pin.SE3(T[:3, :3], T[:3, 3]), coal_mesh(world._mesh))
    number = geometry.addGeometryObject(part)
    for other in range(number):
        geometry.addCollisionPair(pin.CollisionPair(other, number))
    data, places = model.createData(), geometry.createData()
    for row in free:
        pin.updateGeometryPlacements(model, data, geometry, places, row)
        assert pin.computeDistances(geometry, places) is not None
        least = min(result.min_distance for result in places.distanceResults)
        assert least >= CELL.collision_margin_m - 1e-6


def test_a_pose_through_the_panel_is_named():
    world = world_at(0.5)
    stretched = np.array([np.pi / 2, 0.0, 0.0, 0.0, 0.0, 0.0])  # along +y of the base
    assert not world.free(stretched[None])[0]
    assert "part" in world.pair(stretched) or "fixture" in world.pair(stretched)
    assert CollisionWorld(CELL, None).pair(stretched) is None


def test_the_floor_the_base_and_the_arm_itself_are_in_the_way():
    world = CollisionWorld(CELL, None)
    low = dataclasses.replace(CELL, T_base_link_arm_base=transform((0.0, 0.0, 0.5)))
    down = np.array([0.0, 1.2, 0.0, 0.0, 0.0, 0.0])
    assert "floor" in (CollisionWorld(low, None).pair(down) or "")
    folded = np.array([0.0, -1.57, 3.1, 0.0, 0.0, 0.0])
    assert world.pair(folded) == "arm_base with forearm_link"
    hanging = np.array([0.0, np.pi / 2, 0.0, 0.0, 0.0, 0.0])
    assert "pedestal" in world.pair(hanging) or "base" in world.pair(hanging)


def test_the_space_behind_the_part_is_forbidden():
    world = world_at(0.6)
    behind, in_front = (0.0, 0.0, -0.5 * FIXTURE_DEPTH_M), (0.0, 0.0, 0.3)
    ends = np.tile(behind, (len(world.bodies), 2, 1))[None]
    assert np.all(world._part_check.fixture_hits(ends))
    ends = np.tile(in_front, (len(world.bodies), 2, 1))[None]
    assert not np.any(world._part_check.fixture_hits(ends))


def test_no_motion_slips_through_the_skin():
    """Even the thinnest body moves less between two checks than it is thick, with its margin."""
    world = world_at(0.6)
    q = world.between(HOME, HOME + np.array([1.5, 1.0, -1.2, 0.4, 0.7, 0.0]))
    ends = world.bodies.segments(q)
    step = np.linalg.norm(np.diff(ends, axis=0), axis=3).max()
    assert step < 2.0 * CELL.collision_margin_m
    assert step < 2.0 * world.bodies.radii.min()
    assert np.allclose(q[0], HOME) and np.allclose(q[-1], HOME + [1.5, 1.0, -1.2, 0.4, 0.7, 0.0])


def test_results_do_not_depend_on_where_the_shop_has_its_origin():
    q = poses(100, 2)
    reference = world_at(0.7).free(q)
    shift = planar(3.0, -4.0, 1.1)
    T_map_part = shift @ upright()
    T = inverse(shift @ planar(0.0, -0.7, 0.0) @ CELL.T_base_link_arm_base) @ T_map_part
    assert np.array_equal(CollisionWorld(CELL, flat_panel(), T).free(q), reference)


def test_a_larger_margin_never_frees_a_pose():
    q = poses(200, 3)
    wide = dataclasses.replace(CELL, collision_margin_m=0.06)
    assert not np.any(world_at(0.7, cell=wide).free(q) & ~world_at(0.7).free(q))


def test_the_base_in_the_part_is_named():
    assert world_at(0.9).base_problem() is None
    low = CollisionWorld(
        CELL,
        flat_panel(),
        in_arm_base(CELL, planar(0, -0.2, 0), transform((0, 0, -0.3)) @ upright()),
    )
    assert low.base_problem() is not None


def test_batches_of_any_size_and_bad_ones():
    world = CollisionWorld(CELL, None)
    assert world.free(np.zeros((0, 6))).shape == (0,)
    many = poses(4500, 4)
    assert np.array_equal(world.free(many)[3000:3010], world.free(many[3000:3010]))
    with pytest.raises(JointsInvalidError):
        world.free(np.full((1, 6), np.nan))
    with pytest.raises(InputError, match="T_arm_base_workpiece"):
        CollisionWorld(CELL, flat_panel())
    with pytest.raises(InputError, match="orthonormal"):
        CollisionWorld(CELL, flat_panel(), np.diag([2.0, 1.0, 1.0, 1.0]))


def test_home_keeps_the_camera_view_free():
    """No body stands in the picture nearer than the part could be."""
    world = CollisionWorld(CELL, None)
    segments = world.bodies.segments(HOME[None])[0]
    camera = CELL.camera
    for (first, second), radius in zip(segments, world.bodies.radii, strict=True):
        line = first + np.linspace(0, 1, 20)[:, None] * (second - first)
        seen = apply(inverse(camera.T_base_link_optical) @ CELL.T_base_link_arm_base, line)
        ahead = seen[seen[:, 2] > 0.05]
        pixel = ahead @ camera.K.T
        u, v = pixel[:, 0] / pixel[:, 2], pixel[:, 1] / pixel[:, 2]
        rim = camera.K[0, 0] * radius / ahead[:, 2]
        outside = (
            (u + rim < 0) | (u - rim > camera.width) | (v + rim < 0) | (v - rim > camera.height)
        )
        assert np.all(outside)


def test_coal_agrees_with_capsule_distances():
    sphere = coal.Sphere(0.1)
    panel = flat_panel(1.0, 1.0)
    for height, expected in ((0.15, False), (0.11, True)):
        place = coal.Transform3s(np.eye(3), np.array([0.0, 0.0, height]))
        request = coal.CollisionRequest()
        request.security_margin = 0.02
        args = (coal_mesh(panel), coal.Transform3s(), sphere, place, request)
        assert bool(coal.collide(*args, coal.CollisionResult())) == expected


@pytest.mark.parametrize("seed", range(4))
def test_a_dense_path_is_the_given_one_in_steps_that_no_body_leaves(seed):
    world = world_at(0.9)
    q = HOME + np.cumsum(np.random.default_rng(seed).uniform(-0.3, 0.3, (7, 6)), axis=0)
    dense, step = world.dense(q)
    assert np.array_equal(dense[0], q[0]) and np.array_equal(dense[-1], q[-1])
    assert step.shape == (len(dense),) and step[0] == 0 and step[-1] == len(q) - 2
    assert np.all((np.diff(step) == 0) | (np.diff(step) == 1))
    for number in range(len(q) - 1):
        # Each step as `between` has it: both look at the same places.
        mine = np.vstack([dense[step == number], q[number + 1]])
        mine = mine[: len(mine) - (number == len(q) - 2)]
        assert np.abs(mine - world.between(q[number], q[number + 1])).max() < 1e-12
    # By means of its own: where the ends of all bodies are.
    ends = world.bodies.segments(dense)
    moved = np.linalg.norm(np.diff(ends, axis=0), axis=-1)
    assert moved.max() <= world.step_m + 1e-9
    assert len(dense) < 40 * len(q)


def test_dense_paths_of_one_position_and_of_none_moving():
    world = CollisionWorld(CELL, None)
    dense, step = world.dense(HOME[None])
    assert np.array_equal(dense, HOME[None]) and step.tolist() == [0]
    dense, step = world.dense(np.stack([HOME, HOME]))
    assert np.array_equal(dense, np.stack([HOME, HOME])) and step.tolist() == [0, 0]


def test_dense_finds_a_wall_that_lies_between_two_free_positions():
    world = world_at(0.8)
    below, above = HOME.copy(), HOME.copy()
    below[1], above[1] = -2.4, 0.6
    blocked = not world.free_motion(below, above)
    assert blocked == (not np.all(world.free(world.dense(np.stack([below, above]))[0])))
    assert blocked
