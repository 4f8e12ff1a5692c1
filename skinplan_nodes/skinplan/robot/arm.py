"""The arm: limits from its URDF, forward kinematics in batch, all branches of the inverse.

The URDF is read by Pinocchio. Batches of forward kinematics run vectorised over Pinocchio's joint
placements; the inverse kinematics is analytic (EAIK) and every branch is checked against the
forward kinematics before it is given out.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
from eaik.IK_HP import HPRobot
from numpy.typing import NDArray

from skinplan.errors import JointsInvalidError, RobotModelError
from skinplan.robot.cell import CellConfig
from skinplan.transforms import Array, inverse

_LOG = logging.getLogger(__name__)
_MODELS = Path(__file__).parent / "models"
#: Joints of a UR arm, from the base to the flange: the order of all joint arrays of the library.
JOINT_NAMES = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)
_BRANCHES = 8
_AGREEMENT = 1e-9  # largest difference of an inverse solution's pose from the one asked for [m, 1]


@dataclass(frozen=True, eq=False)
class Body:
    """A capsule that stands for a part of a link.

    Attributes:
        link: Name of the link.
        joint: Number of joints before the link, 0 = fixed to the arm base.
        ends: End points of the axis in the frame of joint ``joint``, shape (2, 3) [m].
        radius: Radius [m].
    """

    link: str
    joint: int
    ends: Array
    radius: float


class ArmModel:
    """A six-axis arm with a scanner on its flange.

    Attributes:
        joint_names: In the order of every joint array of the library.
        lower: Joint limits, shape (6,) [rad].
        upper: Joint limits, shape (6,) [rad].
        velocity: Joint velocity limits, shape (6,) [rad/s].
        T_tool0_scanner: Scanner on the flange, shape (4, 4) [m].
        bodies: Capsules of the arm's links.
        pairs_left_out: Pairs of link names that are not checked against each other
            (``<model>.srdf`` beside the URDF).
    """

    def __init__(
        self,
        model: pin.Model,
        bodies: tuple[Body, ...],
        pairs_left_out: frozenset[frozenset[str]],
        cell: CellConfig,
    ) -> None:
        if model.njoints != 7 or model.nq != 6:
            raise RobotModelError(
                f"an arm of 6 revolute joints is accepted, found {model.nq} in model {model.name!r}"
            )
        if not model.existFrame("tool0"):
            raise RobotModelError(
                f"model {model.name!r} has no link 'tool0'; the flange must have that name"
            )
        self.model = model
        self.bodies = bodies
        self.pairs_left_out = pairs_left_out
        self.joint_names: tuple[str, ...] = tuple(model.names[1:])
        self.lower: Array = np.array(model.lowerPositionLimit, dtype=float)
        self.upper: Array = np.array(model.upperPositionLimit, dtype=float)
        self.velocity: Array = np.minimum(model.velocityLimit, cell.velocity_max_rad_s)
        self.T_tool0_scanner = cell.T_tool0_scanner
        self._read_chain()
        self._levers = self._lever_arms()

    @classmethod
    def load(cls, cell: CellConfig) -> "ArmModel":
        """Loads the arm that the cell names.

        Raises:
            RobotModelError: No such model, or a URDF that is no six-axis arm.
        """
        return cls(*_read_urdf(cell.robot), cell)

    @property
    def tool_axis_is_view(self) -> bool:
        """True when the last joint turns about the view axis: then roll adds no reach."""
        axis = self._T_tool0_6[:3, :3] @ self._axes[5]
        offset = self.T_tool0_scanner[:3, 3] - self._T_tool0_6[:3, 3]
        return bool(
            abs(axis @ self.T_tool0_scanner[:3, 0]) > 1.0 - 1e-9
            and np.linalg.norm(np.cross(axis, offset)) < 1e-9
        )

    @property
    def axes(self) -> Array:
        """Unit axis of each joint in its own frame, shape (6, 3)."""
        return self._axes

    @property
    def first_axis(self) -> Array:
        """Origin of the first joint in the arm base, shape (3,) [m]."""
        return np.asarray(self._placements[0][:3, 3])

    def links(self, q: Array) -> Array:
        """Returns the joint frames in the arm base, shape (n, 7, 4, 4) [m]; number 0 is the base.

        Args:
            q: Joint positions, shape (n, 6) [rad].
        """
        q = self.require_joints(q)
        result = np.empty((len(q), 7, 4, 4))
        result[:, 0] = np.eye(4)
        for joint in range(6):
            turn = _turns(self._axes[joint], q[:, joint])
            fixed = self._placements[joint]
            result[:, joint + 1, :3, :3] = result[:, joint, :3, :3] @ (fixed[:3, :3] @ turn)
            result[:, joint + 1, :3, 3] = (
                result[:, joint, :3, :3] @ fixed[:3, 3] + result[:, joint, :3, 3]
            )
            result[:, joint + 1, 3] = (0.0, 0.0, 0.0, 1.0)
        return result

    def forward(self, q: Array) -> Array:
        """Returns ``T_arm_base_tool0``, (n, 4, 4) [m], of joint positions, (n, 6) [rad]."""
        return np.asarray(self.links(q)[:, 6] @ self._T_6_tool0)

    def forward_scanner(self, q: Array) -> Array:
        """Returns ``T_arm_base_scanner``, (n, 4, 4) [m], of joint positions, (n, 6) [rad]."""
        return np.asarray(self.forward(q) @ self.T_tool0_scanner)

    def inverse(self, T_arm_base_tool0: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Returns all branches of the inverse kinematics.

        Args:
            T_arm_base_tool0: Flange poses, shape (n, 4, 4) [m].

        Returns:
            Joint positions in (-pi, pi], shape (n, 8, 6) [rad], NaN where there is none; and which
            of them are solutions, shape (n, 8): those whose forward kinematics agrees to 1e-9. EAIK
            answers unreachable poses by a least-squares fit, flagged; those are dropped.
        """
        poses = np.asarray(T_arm_base_tool0, dtype=float)
        if poses.ndim != 3 or poses.shape[1:] != (4, 4) or not np.all(np.isfinite(poses)):
            raise RobotModelError(
                f"finite flange poses of shape (n, 4, 4) are accepted, found shape {poses.shape}"
            )
        branches = self.unchecked_inverse(poses)
        found = np.isfinite(branches[:, :, 0])
        row, column = np.nonzero(found)
        reached = self.forward(branches[row, column])
        error = np.abs(reached - poses[row]).max(axis=(1, 2), initial=0.0)
        valid = np.zeros_like(found)
        valid[row, column] = error < _AGREEMENT
        branches[~valid] = np.nan
        return branches, valid

    def unchecked_inverse(self, T_arm_base_tool0: Array) -> Array:
        """Returns all branches as the solver gives them, shape (n, 8, 6) [rad], NaN where none.

        For those who check what they choose; `inverse` checks all.
        """
        branches = np.full((len(T_arm_base_tool0), _BRANCHES, 6), np.nan)
        if not len(branches):
            return branches
        asked = T_arm_base_tool0.copy()
        asked[:, :3, :3] = T_arm_base_tool0[:, :3, :3] @ self._zero_rotation.T
        answers = self._solver.IK_batched(asked, 1)
        sizes = np.array([answer.num_solutions() for answer in answers])
        exact = ~np.concatenate([answer.is_LS for answer in answers]).astype(bool)
        row = np.repeat(np.arange(len(branches)), sizes)
        column = np.arange(len(row)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
        kept = np.flatnonzero(exact & (column < _BRANCHES))
        branches[row[kept], column[kept]] = np.concatenate([answer.Q for answer in answers])[kept]
        return branches

    def require_joints(self, q: Array) -> Array:
        """Returns joint positions as array of shape (n, 6) [rad], or says why they are none.

        Raises:
            JointsInvalidError: Shape or a value that is not finite.
        """
        q = np.asarray(q, dtype=float)
        if q.ndim != 2 or q.shape[1] != 6 or not np.all(np.isfinite(q)):
            raise JointsInvalidError(
                f"finite joint positions of shape (n, 6) are accepted, found shape {q.shape}"
            )
        return q

    def within_limits(self, q: Array) -> NDArray[np.bool_]:
        """Tells which joint positions, (n, 6) [rad], respect the position limits, shape (n,)."""
        return np.all((q >= self.lower - 1e-9) & (q <= self.upper + 1e-9), axis=-1)

    def names_to_order(self, names: Sequence[str]) -> NDArray[np.int64]:
        """Returns the index for values named so: ``values[index]`` is in the library's order.

        Raises:
            JointsInvalidError: A joint is missing, unknown or named twice.
        """
        if sorted(names) != sorted(self.joint_names):
            raise JointsInvalidError(
                f"joints {list(self.joint_names)} are accepted in any order, found {list(names)}"
            )
        given = list(names)
        return np.array([given.index(name) for name in self.joint_names], dtype=np.int64)

    def lever_arms(self) -> Array:
        """Returns how far from each joint's axis anything behind it can be at most, (6,) [m]."""
        return self._levers

    def _lever_arms(self) -> Array:
        far = np.linalg.norm(self.T_tool0_scanner[:3, 3]) + np.linalg.norm(self._T_6_tool0[:3, 3])
        result = np.empty(6)
        for joint in range(5, -1, -1):
            own = [
                np.linalg.norm(b.ends, axis=1).max() + b.radius
                for b in self.bodies
                if b.joint == joint + 1
            ]
            far = max(far, *own) if own else far
            result[joint] = far
            far = far + np.linalg.norm(self._placements[joint][:3, 3])
        return result

    def _read_chain(self) -> None:
        data = self.model.createData()
        zero = np.zeros(6)
        pin.computeJointJacobians(self.model, data, zero)
        pin.framesForwardKinematics(self.model, data, zero)
        self._axes = np.array(
            [pin.getJointJacobian(self.model, data, j, pin.LOCAL)[3:, j - 1] for j in range(1, 7)]
        )
        self._placements = np.array(
            [self.model.jointPlacements[j].homogeneous for j in range(1, 7)]
        )
        frames = np.array([data.oMi[j].homogeneous for j in range(7)])
        T_base_tool0 = data.oMf[self.model.getFrameId("tool0")].homogeneous.copy()
        self._T_6_tool0 = inverse(frames[6]) @ T_base_tool0
        self._T_tool0_6 = inverse(self._T_6_tool0)
        self._zero_rotation = T_base_tool0[:3, :3]
        # EAIK takes the joint axes and the offsets between them at zero, in base coordinates.
        world_axes = np.einsum("jab,jb->ja", frames[1:, :3, :3], self._axes)
        places = np.vstack([frames[:, :3, 3], T_base_tool0[:3, 3]])
        self._solver = HPRobot(world_axes, np.diff(places, axis=0))
        if not self._solver.hasKnownDecomposition():
            raise RobotModelError(
                f"no analytic inverse kinematics is known for the geometry of {self.model.name!r}"
            )


def _turns(axis: Array, angles: Array) -> Array:
    """Rotations about one unit axis, shape (n, 3, 3) (Rodrigues)."""
    cross = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
    sine, cosine = np.sin(angles)[:, None, None], np.cos(angles)[:, None, None]
    return np.asarray(np.eye(3) + sine * cross + (1.0 - cosine) * (cross @ cross))


@lru_cache(maxsize=4)
def _read_urdf(robot: str) -> tuple[pin.Model, tuple[Body, ...], frozenset[frozenset[str]]]:
    path = Path(robot) if robot.endswith(".urdf") else _MODELS / f"{robot}.urdf"
    if not path.is_file():
        known = sorted(p.stem for p in _MODELS.glob("*.urdf"))
        raise RobotModelError(
            f"no robot model {robot!r}; {known} or the path of a .urdf file are accepted"
        )
    try:
        model = pin.buildModelFromUrdf(str(path))
        geometry = pin.buildGeomFromUrdf(model, str(path), pin.GeometryType.COLLISION)
    except (ValueError, RuntimeError) as error:
        raise RobotModelError(f"{path} can't be read as URDF: {error}") from error
    _LOG.debug("robot model %s: %d joints, %d bodies", path, model.nq, geometry.ngeoms)
    bodies = tuple(_body(model, thing) for thing in geometry.geometryObjects)
    return model, bodies, _read_srdf(path.with_suffix(".srdf"))


def _read_srdf(path: Path) -> frozenset[frozenset[str]]:
    if not path.is_file():
        return frozenset()
    try:
        root = ElementTree.parse(path).getroot()
    except ElementTree.ParseError as error:
        raise RobotModelError(f"{path} can't be read as SRDF: {error}") from error
    pairs = root.iter("disable_collisions")
    return frozenset(frozenset((pair.get("link1", ""), pair.get("link2", ""))) for pair in pairs)


def _body(model: pin.Model, thing: pin.GeometryObject) -> Body:
    """Reads a cylinder or capsule (its axis becomes the capsule's) or a sphere."""
    shape = thing.geometry
    link = model.frames[thing.parentFrame].name
    if not hasattr(shape, "radius"):
        found = type(shape).__name__
        raise RobotModelError(
            f"link {link!r}: cylinders and spheres are accepted as collision shapes, found {found}"
        )
    half = float(getattr(shape, "halfLength", 0.0))
    ends = (
        np.array([[0.0, 0.0, -half], [0.0, 0.0, half]]) @ thing.placement.rotation.T
        + thing.placement.translation
    )
    return Body(link, int(thing.parentJoint), ends, float(shape.radius))
