import numpy as np
import pinocchio as pin
import pytest

from skinplan.errors import JointsInvalidError, RobotModelError
from skinplan.robot import arm as arm_module
from skinplan.robot.arm import ArmModel
from skinplan.robot.cell import CellConfig
from skinplan.transforms import transform

UR5_URDF = "robots/ur5_example_robot_data"


@pytest.fixture(scope="module")
def arm():
    return ArmModel.load(CellConfig())


def joints(count, seed=0):
    return np.random.default_rng(seed).uniform(-2.0 * np.pi, 2.0 * np.pi, (count, 6))


def denavit_hartenberg(q):
    """The controller's base to the flange, by the published table."""
    a = (0.0, -0.425, -0.39225, 0.0, 0.0, 0.0)
    d = (0.089159, 0.0, 0.0, 0.10915, 0.09465, 0.0823)
    alpha = (np.pi / 2, 0.0, 0.0, np.pi / 2, -np.pi / 2, 0.0)
    result = np.eye(4)
    for j in range(6):
        c, s, ca, sa = np.cos(q[j]), np.sin(q[j]), np.cos(alpha[j]), np.sin(alpha[j])
        result = result @ np.array(
            [
                [c, -s * ca, s * sa, a[j] * c],
                [s, c * ca, -c * sa, a[j] * s],
                [0.0, sa, ca, d[j]],
                [0.0, 0.0, 0.0, 1.0],
            ]
        )
    return result


def test_forward_is_the_published_table_turned_half_about_z(arm):
    half_turn = transform((0, 0, 0), np.diag([-1.0, -1.0, 1.0]))
    for q in joints(20):
        expected = half_turn @ denavit_hartenberg(q)
        assert np.allclose(arm.forward(q[None])[0], expected, atol=1e-12)


def test_forward_is_that_of_pinocchio(arm):
    data = arm.model.createData()
    frame = arm.model.getFrameId("tool0")
    q = joints(50, 1)
    batch = arm.forward(q)
    for row, expected in zip(q, batch, strict=True):
        pin.framesForwardKinematics(arm.model, data, row)
        assert np.allclose(data.oMf[frame].homogeneous, expected, atol=1e-12)


def test_forward_is_that_of_an_independent_description(arm, shared_data):
    other = pin.buildModelFromUrdf(str(shared_data / UR5_URDF / "ur5_robot.urdf"))
    assert tuple(other.names[1:]) == arm.joint_names
    data = other.createData()
    frame = other.getFrameId("tool0")
    for q in joints(20, 2):
        pin.framesForwardKinematics(other, data, q)
        assert np.allclose(data.oMf[frame].homogeneous, arm.forward(q[None])[0], atol=1e-6)


def test_every_inverse_branch_leads_back_and_one_is_the_original(arm):
    q = joints(300, 3)
    poses = arm.forward(q)
    branches, valid = arm.inverse(poses)
    assert branches.shape == (300, 8, 6)
    row, column = np.nonzero(valid)
    assert np.abs(arm.forward(branches[row, column]) - poses[row]).max() < 1e-9
    gap = np.abs(np.angle(np.exp(1j * (branches - q[:, None])))).max(axis=2)
    gap[~valid] = np.inf
    # Straight through a singularity (measure zero) branches merge; random poses have none.
    assert np.all(gap.min(axis=1) < 1e-6)


def test_unreachable_poses_have_no_branch_although_the_solver_answers_by_least_squares(arm):
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, :3, 3] = ((2.0, 0.0, 0.0), (0.0, 0.0, 1.5), (0.0, 0.96, 0.3))
    branches, valid = arm.inverse(poses)
    assert not valid.any()
    assert np.all(np.isnan(branches))


def test_no_poses_give_no_branches(arm):
    branches, valid = arm.inverse(np.zeros((0, 4, 4)))
    assert branches.shape == (0, 8, 6) and valid.shape == (0, 8)


@pytest.mark.parametrize("poses", [np.eye(4), np.full((1, 4, 4), np.nan)])
def test_poses_that_are_none_are_refused(arm, poses):
    with pytest.raises(RobotModelError, match="n, 4, 4"):
        arm.inverse(poses)


@pytest.mark.parametrize("q", [np.zeros(6), np.zeros((2, 5)), np.full((1, 6), np.inf)])
def test_joints_that_are_none_are_refused(arm, q):
    with pytest.raises(JointsInvalidError, match="n, 6"):
        arm.forward(q)


def test_names_bring_values_into_order(arm):
    names = sorted(arm.joint_names)
    index = arm.names_to_order(names)
    assert [names[i] for i in index] == list(arm.joint_names)


@pytest.mark.parametrize(
    "change", [lambda n: n[:-1], lambda n: [*n[:-1], "elbow"], lambda n: n * 2]
)
def test_wrong_names_are_refused(arm, change):
    with pytest.raises(JointsInvalidError, match="wrist_3_joint"):
        arm.names_to_order(change(list(arm.joint_names)))


def test_limits_are_two_turns_and_half_a_turn_per_second(arm):
    # The elbow can't turn beyond half a turn: the forearm would pass through the upper arm.
    turns = np.array([2.0, 2.0, 1.0, 2.0, 2.0, 2.0]) * np.pi
    assert np.allclose(arm.upper, turns) and np.allclose(arm.lower, -turns)
    assert np.allclose(arm.velocity, np.pi)
    assert arm.within_limits(np.stack([0.999 * turns, -0.999 * turns])).tolist() == [True, True]
    for joint in range(6):  # one beyond its own limit is enough
        for sign in (1.0, -1.0):
            beyond = np.zeros((1, 6))
            beyond[0, joint] = 1.001 * sign * turns[joint]
            assert not arm.within_limits(beyond)[0]


def test_the_scanner_looks_along_tool_z(arm):
    T_tool0_scanner = np.linalg.inv(arm.forward(joints(1))[0]) @ arm.forward_scanner(joints(1))[0]
    assert np.allclose(T_tool0_scanner[:3, 0], (0, 0, 1), atol=1e-12)
    assert arm.tool_axis_is_view
    aside = CellConfig(T_tool0_scanner=transform((0.1, 0.0, 0.1)))
    assert not ArmModel.load(aside).tool_axis_is_view


def test_nothing_moves_farther_than_lever_arms_say(arm):
    rng = np.random.default_rng(4)
    q = joints(200, 5)
    change = rng.uniform(-0.2, 0.2, q.shape)
    bound = np.abs(change) @ arm.lever_arms()
    for body in arm.bodies:
        ends = np.einsum("nij,ej->nei", arm.links(q)[:, body.joint, :3, :3], body.ends)
        moved = np.einsum("nij,ej->nei", arm.links(q + change)[:, body.joint, :3, :3], body.ends)
        before = ends + arm.links(q)[:, body.joint, None, :3, 3]
        after = moved + arm.links(q + change)[:, body.joint, None, :3, 3]
        assert np.all(np.linalg.norm(after - before, axis=2).max(axis=1) <= bound + 1e-12)


def test_capsules_enclose_the_real_links_and_are_not_much_larger(arm, shared_data):
    trimesh = pytest.importorskip("trimesh")
    other = pin.buildModelFromUrdf(str(shared_data / UR5_URDF / "ur5_robot.urdf"))
    data, own = other.createData(), arm.model.createData()
    pin.framesForwardKinematics(other, data, np.zeros(6))
    pin.framesForwardKinematics(arm.model, own, np.zeros(6))
    links = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
    for number, link in enumerate(links, start=1):
        folder = shared_data / UR5_URDF / "meshes_collision"
        mesh = trimesh.load(folder / f"{link.replace('_', '')}.stl")
        there = data.oMf[other.getFrameId(f"{link}_link")]
        T = (own.oMi[number].inverse() * there).homogeneous
        points = mesh.vertices @ T[:3, :3].T + T[:3, 3]
        bodies = [b for b in arm.bodies if b.joint == number]
        depth = np.max([b.radius - _axis_distance(points, b.ends) for b in bodies], axis=0)
        assert depth.min() > -0.001, link
        for body in bodies:
            assert _axis_distance(points, body.ends).max() < 0.6
            ends = body.ends + np.array([[0.0], [0.0]])
            gap = np.min(np.linalg.norm(points[None] - ends[:, None], axis=2), axis=1)
            assert gap.max() < body.radius + 0.03, link


def _axis_distance(points, ends):
    way = ends[1] - ends[0]
    share = np.clip((points - ends[0]) @ way / max(way @ way, 1e-12), 0.0, 1.0)
    return np.linalg.norm(points - ends[0] - share[:, None] * way, axis=1)


def test_an_unknown_robot_is_refused_and_the_known_ones_are_named():
    with pytest.raises(RobotModelError, match="ur5"):
        ArmModel.load(CellConfig(robot="ur55"))


@pytest.mark.parametrize(
    "text",
    [
        "no xml at all",
        "<robot name='r'><link name='a'/><link name='tool0'/>"
        "<joint name='j' type='revolute'><parent link='a'/><child link='tool0'/>"
        "<axis xyz='0 0 1'/><limit lower='-1' upper='1' velocity='1' effort='1'/></joint></robot>",
    ],
)
def test_a_urdf_that_is_no_six_axis_arm_is_refused(tmp_path, text):
    file = tmp_path / "other.urdf"
    file.write_text(text)
    with pytest.raises(RobotModelError):
        ArmModel.load(CellConfig(robot=str(file)))


def test_a_box_as_collision_shape_is_refused(tmp_path):
    text = (arm_module._MODELS / "ur5.urdf").read_text()
    file = tmp_path / "boxed.urdf"
    file.write_text(text.replace('<cylinder length="0.02" radius="0.078"/>', '<box size="1 1 1"/>'))
    with pytest.raises(RobotModelError, match="cylinders and spheres"):
        ArmModel.load(CellConfig(robot=str(file)))
