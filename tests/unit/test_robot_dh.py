from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from skinplan.errors import JointsInvalidError, RobotModelError
from skinplan.robot import arm as arm_module
from skinplan.robot import gcr14_1400
from skinplan.robot.arm import ArmModel
from skinplan.robot.cell import CellConfig
from skinplan.robot.dh import GCR14_1400, Capsule, DhRow, DhTable, write_urdf

MODEL = Path(arm_module.__file__).parent / "models" / "gcr14_1400.urdf"


@pytest.fixture(scope="module")
def arm():
    return ArmModel.load(CellConfig(robot="gcr14_1400"))


def angles(count, seed=0):
    rows = GCR14_1400.rows
    low, high = [r.lower_rad for r in rows], [r.upper_rad for r in rows]
    return np.random.default_rng(seed).uniform(low, high, (count, 6))


def product(theta):
    """The table multiplied out: Rx(alpha) Tx(a) Rz(theta) Tz(d), in mm and degrees as printed."""
    a = (0.0, 0.0, 650.0, 612.5, 0.0, 0.0)
    alpha = (0.0, -90.0, 0.0, 0.0, 90.0, -90.0)
    d = (160.5, 0.0, 0.0, 146.5, 137.5, 116.7)
    result = np.eye(4)
    for j in range(6):
        for axis, angle, shift in ((0, np.radians(alpha[j]), a[j]), (2, theta[j], d[j])):
            step = np.eye(4)
            i, k = ((axis + 1) % 3, (axis + 2) % 3)
            step[i, i] = step[k, k] = np.cos(angle)
            step[k, i], step[i, k] = np.sin(angle), -np.sin(angle)
            step[axis, 3] = shift / 1000.0
            result = result @ step
    return result


def test_forward_is_the_product_of_the_published_rows():
    for theta in angles(30):
        frames = GCR14_1400.forward(theta[None])[0]
        assert np.allclose(frames[-1], product(theta), atol=1e-12)


def test_the_drawn_posture_stands_straight_up():
    """C Fig. 3: upper arm and forearm vertical, so the wrist is d1 + a2 + a3 high."""
    frames = GCR14_1400.forward(GCR14_1400.drawn[None])[0]
    assert frames[4][2, 3] == pytest.approx(0.1605 + 0.650 + 0.6125, abs=1e-12)
    assert np.hypot(*frames[3][:2, 3]) == pytest.approx(0.0, abs=1e-12)


def test_reach_is_that_of_the_product_name():
    """Stretched, the centre of the wrist is sqrt((a2 + a3)^2 + d4^2) from the shoulder."""
    theta = np.array([[0.3, 0.7, 0.0, 0.2, 0.0, 0.0]])
    frames = GCR14_1400.forward(theta)[0]
    far = np.linalg.norm(frames[4][:3, 3] - frames[2][:3, 3])
    assert far == pytest.approx(np.hypot(1.2625, 0.1465), abs=1e-12)


def test_urdf_of_the_package_is_the_table(arm):
    assert MODEL.read_text() == gcr14_1400.urdf()
    theta = angles(50, 1)
    assert np.abs(arm.forward(theta) - GCR14_1400.forward(theta)[:, -1]).max() < 1e-12
    assert np.allclose(arm.lower, [r.lower_rad for r in GCR14_1400.rows])
    assert np.allclose(arm.upper, [r.upper_rad for r in GCR14_1400.rows])


def test_urdf_agrees_with_pinocchio(arm):
    model = pin.buildModelFromUrdf(str(MODEL))
    data, frame = model.createData(), model.getFrameId("tool0")
    for theta in angles(20, 2):
        pin.framesForwardKinematics(model, data, theta)
        assert np.allclose(data.oMf[frame].homogeneous, product(theta), atol=1e-12)


def test_every_branch_leads_back_to_1e_9_and_one_is_the_original(arm):
    theta = angles(300, 3)
    poses = GCR14_1400.forward(theta)[:, -1]
    branches, valid = arm.inverse(poses)
    row, column = np.nonzero(valid)
    assert np.abs(GCR14_1400.forward(branches[row, column])[:, -1] - poses[row]).max() < 1e-9
    gaps = np.abs(np.angle(np.exp(1j * (branches - theta[:, None])))).max(axis=2)
    assert np.all(np.where(valid, gaps, np.inf).min(axis=1) < 1e-6)


def test_out_of_reach_has_no_branch(arm):
    pose = np.eye(4)
    pose[:3, 3] = (1.75, 0.0, 0.2)
    assert not arm.inverse(pose[None])[1].any()


def test_capsules_of_a_link_are_written_where_they_are(arm):
    assert {body.link for body in arm.bodies} == set(gcr14_1400.LINKS)
    for link, capsules in gcr14_1400.BODIES.items():
        found = [body for body in arm.bodies if body.link == link]
        for body, capsule in zip(found, capsules, strict=True):
            ends = {tuple(np.round(end, 9) + 0.0) for end in body.ends}
            assert ends == {capsule.start_m, capsule.end_m}
            assert body.radius == capsule.radius_m


def test_another_table_makes_another_arm(tmp_path):
    rows = [DhRow(r.a_m * 0.5, r.alpha_rad, r.d_m * 0.5, 0.0, -3.0, 3.0) for r in GCR14_1400.rows]
    small = DhTable("small", tuple(rows))
    file = tmp_path / "small.urdf"
    file.write_text(write_urdf(small, gcr14_1400.JOINTS, gcr14_1400.LINKS, {}, 1.0))
    arm = ArmModel.load(CellConfig(robot=str(file)))
    theta = angles(20, 4)
    big = GCR14_1400.forward(theta)[:, -1]
    assert np.allclose(arm.forward(theta)[:, :3, 3], 0.5 * big[:, :3, 3], atol=1e-12)
    assert np.allclose(arm.upper, 3.0)


@pytest.mark.parametrize("theta", [np.zeros(6), np.zeros((2, 5)), np.full((1, 6), np.nan)])
def test_angles_that_fit_no_joint_are_refused(theta):
    with pytest.raises(JointsInvalidError, match=r"\(n, 6\)"):
        GCR14_1400.forward(theta)


def test_names_and_bodies_that_do_not_fit_are_refused():
    joints, links = gcr14_1400.JOINTS, gcr14_1400.LINKS
    with pytest.raises(RobotModelError, match="5 joints"):
        write_urdf(GCR14_1400, joints[:5], links, {}, 1.0)
    with pytest.raises(RobotModelError, match="elbow"):
        bodies = {"elbow": (Capsule((0, 0, 0), (0, 0, 1), 0.1),)}
        write_urdf(GCR14_1400, joints, links, bodies, 1.0)
    with pytest.raises(RobotModelError, match="parallel to x, y or z"):
        bodies = {"arm_base": (Capsule((0, 0, 0), (1, 0, 1), 0.1),)}
        write_urdf(GCR14_1400, joints, links, bodies, 1.0)
