"""The arm for the eye: the bodies of its collision model, and how it stands at a scan point."""

from dataclasses import dataclass

import numpy as np

from skinplan.mesh.model import SurfaceMesh
from skinplan.robot.arm import ArmModel
from skinplan.robot.bodies import Bodies
from skinplan.robot.cell import CellConfig
from skinplan.robot.cell_check import PEDESTAL_RADIUS_M, pedestal_axis
from skinplan.robot.records import ReachRecord
from skinplan.robot.scanner_pose import mean_direction, tool_poses
from skinplan.transforms import Array, apply, inverse, rotate
from skinplan.view import palette
from skinplan.view.subject import Subject

_SIDES = 24
_RINGS = 6  # of each half ball
_LINK_COLOURS: tuple[palette.Colour, ...] = ((0.62, 0.66, 0.70), (0.40, 0.45, 0.52))
SCANNER_COLOUR: palette.Colour = (0.84, 0.37, 0.00)
PEDESTAL_COLOUR: palette.Colour = (0.50, 0.52, 0.54)


@dataclass(frozen=True, eq=False)
class ArmShape:
    """One body.

    Attributes:
        name: Of its link.
        joint: Number of joints before it, 0 = fixed to the arm base.
        mesh: In the frame of that joint.
        colour: Red, green, blue in [0, 1].
    """

    name: str
    joint: int
    mesh: SurfaceMesh
    colour: palette.Colour


@dataclass(frozen=True, eq=False)
class Posture:
    """How the arm stands at a scan point.

    Attributes:
        q: Joint positions, shape (6,) [rad].
        reached: Whether the scanner is at the point; else the arm is at home.
        told: What there is to say about it.
        seen: Whether the tracker sees the scanner; None = not asked.
    """

    q: Array
    reached: bool
    told: str
    seen: bool | None = None


def arm_shapes(cell: CellConfig) -> tuple[ArmShape, ...]:
    """Returns the bodies that the collision check moves: the links' capsules, the scanner's ball.

    Args:
        cell: The cell.
    """
    return tuple(
        ArmShape(
            body.link,
            body.joint,
            capsule_mesh(body.ends, body.radius),
            SCANNER_COLOUR if body.link == "scanner" else _LINK_COLOURS[body.joint % 2],
        )
        for body in Bodies(ArmModel.load(cell), cell).items
    )


def pedestal_shape(cell: CellConfig) -> SurfaceMesh:
    """Returns the capsule below the arm, in the base frame."""
    return capsule_mesh(pedestal_axis(cell), PEDESTAL_RADIUS_M)


def capsule_mesh(ends: Array, radius: float) -> SurfaceMesh:
    """Makes a capsule: all places at a distance from a line.

    Args:
        ends: Of the line, shape (2, 3) [m]; equal ones make a ball.
        radius: The distance [m].
    """
    way = ends[1] - ends[0]
    length = float(np.linalg.norm(way))
    axis = way / length if length > 1e-9 else np.array([0.0, 0.0, 1.0])
    side = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    side /= np.linalg.norm(side)
    half = np.linspace(0.0, 0.5 * np.pi, _RINGS)
    # Both rims of the cylinder; a ball has one.
    tilts = np.concatenate([-half[::-1], half if length > 1e-9 else half[1:]])
    turns = 2.0 * np.pi * np.arange(_SIDES) / _SIDES
    around = np.cos(turns)[:, None] * side + np.sin(turns)[:, None] * np.cross(axis, side)
    middles = np.where(np.arange(len(tilts))[:, None] < _RINGS, ends[0], ends[1])
    centres = middles + radius * np.sin(tilts)[:, None] * axis
    rings = centres[1:-1, None] + radius * np.cos(tilts)[1:-1, None, None] * around
    vertices = np.concatenate([centres[:1], rings.reshape(-1, 3), centres[-1:]])
    return SurfaceMesh(vertices, _capsule_faces(len(rings)))


def posture(subject: Subject, station: int, point: int) -> Posture:
    """Says how the arm stands at a point when the base is at a station.

    The record of the plan is taken; without joint positions the straight view is solved, the branch
    nearest to home.

    Args:
        subject: Has a path and a station plan.
        station: Its place in the order of visit.
        point: Number of the scan path point.
    """
    plan, home = subject.station_plan, np.array(subject.cell.home_rad)
    assert plan is not None
    name = f"station {plan.stations[station].id}"
    if plan.records is None:
        q = _straight(subject, station, point)
        if q is None:
            return Posture(home, False, f"{name}: no straight view; the arm is at home")
        return Posture(q, True, f"{name}: straight view, not checked for collision")
    record = plan.records.record(station, point)
    if not record.reached:
        told = f"{name} does not reach it: {record.reason}; the arm is at home"
        return Posture(home, False, told, record.visible)
    q = record.q if record.q is not None else _straight(subject, station, point)
    if q is None:
        return Posture(home, False, f"{name} reaches it tilted; the arm is at home", record.visible)
    return Posture(q, True, f"{name} reaches it, {_manner(record)}", record.visible)


def arm_pose(subject: Subject, station: int) -> Array:
    """Returns ``T_map_arm_base`` at a station, shape (4, 4) [m]."""
    assert subject.station_plan is not None
    T_map_base_link = subject.station_plan.stations[station].T_map_base_link
    return np.asarray(T_map_base_link @ subject.cell.T_base_link_arm_base)


def _manner(record: ReachRecord) -> str:
    tilt = np.rad2deg(record.tilt_rad)
    tilted = "straight" if tilt < 0.05 else f"tilted by {tilt:.1f}°"
    limit = np.rad2deg(record.limit_margin_rad)
    free = f"{limit:.0f}° from the nearest joint limit, {record.singularity:.2f} from singular"
    return f"{tilted}, {free} (1 = farthest)"


def _straight(subject: Subject, station: int, point: int) -> Array | None:
    """Joint positions of the straight view within limits, the nearest to home; None = none."""
    assert subject.path is not None
    arm = ArmModel.load(subject.cell)
    T_arm_workpiece = inverse(arm_pose(subject, station)) @ subject.T_map_workpiece
    position = apply(T_arm_workpiece, subject.path.positions[point : point + 1])
    looks = rotate(T_arm_workpiece, subject.path.directions)
    tool = tool_poses(
        position, looks[point : point + 1], 0.0, arm.T_tool0_scanner, mean_direction(looks)
    )
    branches, found = arm.inverse(tool)
    usable = branches[0][found[0] & arm.within_limits(branches[0])]
    if not len(usable):
        return None
    return np.asarray(usable[np.argmin(np.abs(usable - subject.cell.home_rad).sum(axis=1))])


def _capsule_faces(rings: int) -> np.ndarray[tuple[int, int], np.dtype[np.int64]]:
    here = np.arange(_SIDES)
    after = (here + 1) % _SIDES
    first, last = 0, 1 + rings * _SIDES
    faces = [np.stack([np.full(_SIDES, first), 1 + after, 1 + here], axis=1)]
    for ring in range(rings - 1):
        low, high = 1 + ring * _SIDES, 1 + (ring + 1) * _SIDES
        faces.append(np.stack([low + here, low + after, high + after], axis=1))
        faces.append(np.stack([low + here, high + after, high + here], axis=1))
    top = 1 + (rings - 1) * _SIDES
    faces.append(np.stack([np.full(_SIDES, last), top + here, top + after], axis=1))
    return np.concatenate(faces).astype(np.int64)
