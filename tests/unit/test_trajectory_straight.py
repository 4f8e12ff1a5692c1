import numpy as np

from reach_scene import flat_panel, flat_path, in_arm_base, upright
from skinplan.robot.cell import CellConfig
from skinplan.robot.collision import CollisionWorld
from skinplan.robot.reach import Views, reach
from skinplan.trajectory.straight import JUMP_RAD, STEP_M, Poses, follow, same_joints
from skinplan.trajectory.tree_search import connect, shorten
from skinplan.transforms import planar

CELL = CellConfig()
HOME = np.array(CELL.home_rad)
PATH = flat_path(1.0, 0.6, 0.1)
T = in_arm_base(CELL, planar(0.0, -0.9, 0.0), upright(0.6))
WORLD = CollisionWorld(CELL, flat_panel(1.0, 0.6), T)
VIEWS = Views.placed(PATH.positions, PATH.directions, PATH.targets, T)
FOUND = reach(WORLD, VIEWS, 0.0, HOME)


def state(view, near=HOME):
    options = np.flatnonzero(FOUND.view == view)
    best = options[np.argmin(np.abs(FOUND.q[options] - near).max(axis=1))]
    return Poses(FOUND.q, FOUND.positions, FOUND.directions, FOUND.rolls).pick(np.array([best]))


def test_the_scanner_goes_along_the_line_without_jumps():
    for a, b in ((0, 5), (3, 40), (20, 21), (70, 10)):
        start, end = state(a), state(b)
        move = follow(WORLD, start, end, VIEWS.reference, HOME)[0]
        if move.problem:
            continue
        frames = WORLD.arm.forward_scanner(move.q)
        way = end.positions[0] - start.positions[0]
        gone = frames[:, :3, 3] - start.positions[0]
        share = gone @ way / (way @ way)
        assert np.abs(gone - share[:, None] * way).max() < 1e-8
        assert np.allclose(share[[0, -1]], (0, 1))
        assert np.linalg.norm(np.diff(gone, axis=0), axis=1).max() <= STEP_M + 1e-9
        assert np.abs(frames[:, :3, 0] - start.directions[0]).max() < 1e-8
        assert np.abs(np.diff(move.q, axis=0)).max() <= JUMP_RAD
        assert np.all(WORLD.free(move.q))


def test_most_short_moves_can_be_driven():
    moves = [
        follow(WORLD, state(i), state(i + 1), VIEWS.reference, HOME)[0] for i in range(0, 60, 2)
    ]
    assert sum(not move.problem for move in moves) > 25


def test_a_move_out_of_reach_and_one_through_the_part_say_so():
    start = state(30)
    out = Poses(start.q, start.positions + [3.0, 0, 0], start.directions, start.rolls)
    assert "inverse kinematics" in follow(WORLD, start, out, VIEWS.reference, HOME)[0].problem
    through = Poses(start.q, start.positions + [0, 0.28, 0], start.directions, start.rolls)
    assert "collision" in follow(WORLD, start, through, VIEWS.reference, HOME)[0].problem


def test_many_moves_at_once_are_the_same_as_one_by_one():
    a = [state(i) for i in range(10)]
    b = [state(i + 11) for i in range(10)]

    def stack(poses):
        return Poses(
            *(
                np.concatenate([getattr(p, n) for p in poses])
                for n in ("q", "positions", "directions", "rolls")
            )
        )

    together = follow(WORLD, stack(a), stack(b), VIEWS.reference, HOME)
    for first, second, move in zip(a, b, together, strict=True):
        alone = follow(WORLD, first, second, VIEWS.reference, HOME)[0]
        assert alone.problem == move.problem and np.allclose(alone.q, move.q)


def test_same_joints_knows_windings():
    assert same_joints(HOME, HOME + 1e-9)
    assert not same_joints(HOME, HOME + [2 * np.pi, 0, 0, 0, 0, 0])


def test_the_tree_search_finds_free_ways_and_always_the_same():
    goal = state(5).q[0]
    ways = [connect(WORLD, HOME, goal, 200) for _ in range(2)]
    assert ways[0] is not None and np.array_equal(np.array(ways[0]), np.array(ways[1]))
    assert np.array_equal(ways[0][0], HOME) and np.array_equal(ways[0][-1], goal)
    assert all(WORLD.free_motion(a, b) for a, b in zip(ways[0], ways[0][1:], strict=False))


def test_the_tree_search_gives_up_on_a_goal_in_collision():
    stretched = np.array([np.pi / 2, 0.0, 0.0, 0.0, 0.0, HOME[5]])
    assert connect(WORLD, HOME, stretched, 30) is None


def test_shortening_leaves_out_needless_corners():
    corners = [HOME, HOME + 0.02, HOME - 0.02, HOME + 0.03]
    assert len(shorten(WORLD, corners)) == 2
