"""The states of a station: all joint positions in which the arm may take its views.

All branches of the inverse kinematics, of the straight view and of views tilted about the target,
wound by full turns where that may help, within limits, away from singular positions, free of
collision and, where the tracker's place is known, seen by it. Roll is free where the last joint
turns about the view axis: that joint then rests at home. Otherwise a few rolls are states, too.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skinplan.robot.collision import CollisionWorld
from skinplan.robot.dexterity import Dexterity
from skinplan.robot.reach import Reached, Views, reach
from skinplan.robot.tracker import TrackerSight
from skinplan.trajectory.straight import Poses
from skinplan.transforms import Array

Indices = NDArray[np.int64]

_TILTS = ((0.5, 8), (1.0, 16))  # in shares of the largest, each to so many sides
_WINDING_RAD = 0.5  # joints so near to half a turn from home get their other winding, too
_TILT_S = 1.0  # what the largest tilt costs: planned views see what was certified
_DEXTERITY_S = 0.15  # what a state at the edge of the singular ones costs
_DEXTEROUS = 0.4  # from this measure on a state costs nothing
_SINGULAR = "too close to a singular position of elbow or wrist"


@dataclass(frozen=True, eq=False)
class States:
    """States of n views.

    Attributes:
        view: Number of the view, rising, shape (m,).
        poses: Joint positions and scanner poses, m of them.
        tilt_rad: Angle between the view direction and the planned one, shape (m,) [rad].
        cost_s: What a state costs besides the motion, shape (m,) [s].
        reasons: Why a view has no state, by its number.
    """

    view: Indices
    poses: Poses
    tilt_rad: Array
    cost_s: Array
    reasons: dict[int, str]

    @property
    def least_tilted(self) -> NDArray[np.bool_]:
        """Which states are tilted no more than any other of their view, shape (m,)."""
        least = np.full(int(self.view.max(initial=-1)) + 1, np.inf)
        np.minimum.at(least, self.view, self.tilt_rad)
        return np.asarray(self.tilt_rad <= least[self.view] + 1e-9)

    @property
    def q(self) -> Array:
        """Joint positions, shape (m, 6) [rad]."""
        return self.poses.q

    def of(self, view: int) -> Indices:
        """Returns the numbers of a view's states."""
        first, last = np.searchsorted(self.view, (view, view + 1))
        return np.arange(first, last)


def find_states(
    world: CollisionWorld,
    dexterity: Dexterity,
    views: Views,
    tilt_max_rad: float,
    home: Array,
    sight: TrackerSight | None = None,
    T_map_arm: Array | None = None,
    require_wanted: Callable[[], None] = lambda: None,
) -> States:
    """Finds the states of views.

    Args:
        world: Arm, base and part.
        dexterity: What is singular.
        views: n views in the arm base.
        tilt_max_rad: Largest tilt about the target [rad].
        home: Home joint positions, shape (6,) [rad].
        sight: The tracker; None = it is not asked.
        T_map_arm: Arm base in the shop, shape (4, 4) [m]; needed with a tracker.
        require_wanted: Called now and then; raises when nobody wants the states any more.
    """
    everyone = np.arange(len(views))
    parts, tilts = [reach(world, views, 0.0, home)], [0.0]
    for share, sides in _TILTS if tilt_max_rad > 0.0 else ():
        require_wanted()
        leaned = views.tilted(everyone, share * tilt_max_rad, sides)
        parts.append(_renumbered(reach(world, leaned, 0.0, home), sides))
        tilts.append(share * tilt_max_rad)
    tilt = np.repeat(tilts, [len(part.view) for part in parts])
    view = np.concatenate([part.view for part in parts])
    poses = _joined(parts)
    require_wanted()
    clear = dexterity.clear(poses.q)
    hidden = np.zeros(len(view), dtype=np.int64)
    if sight is not None and T_map_arm is not None and clear.any():
        hidden[clear] = _hidden(world, sight, T_map_arm, poses.q[clear])
    require_wanted()
    reasons = dict(parts[0].reasons)
    for number in np.unique(view[~clear]):
        reasons[int(number)] = _SINGULAR
    for number in np.flatnonzero(hidden)[::-1]:
        reasons[int(view[number])] = sight.names[hidden[number]] if sight else ""
    row, q = _wound(world, poses.q, np.flatnonzero(clear & (hidden == 0)), home)
    row_order = np.lexsort((np.arange(len(row)), view[row]))
    row, q = row[row_order], q[row_order]
    kept = poses.pick(row)
    cost = _cost(dexterity, q, tilt[row], tilt_max_rad)
    left = {v: text for v, text in reasons.items() if v not in set(view[row].tolist())}
    return States(
        view[row], Poses(q, kept.positions, kept.directions, kept.rolls), tilt[row], cost, left
    )


def _cost(dexterity: Dexterity, q: Array, tilt: Array, tilt_max_rad: float) -> Array:
    near = np.clip(1.0 - dexterity.measure(q) / _DEXTEROUS, 0.0, 1.0)
    lean = tilt / tilt_max_rad if tilt_max_rad > 0.0 else np.zeros(len(tilt))
    return np.asarray(_TILT_S * lean + _DEXTERITY_S * near)


def _renumbered(found: Reached, sides: int) -> Reached:
    return Reached(found.view // sides, found.q, found.positions, found.directions, found.rolls, {})


def _joined(parts: list[Reached]) -> Poses:
    return Poses(
        np.concatenate([p.q for p in parts]),
        np.concatenate([p.positions for p in parts]),
        np.concatenate([p.directions for p in parts]),
        np.concatenate([p.rolls for p in parts]),
    )


def _hidden(world: CollisionWorld, sight: TrackerSight, T_map_arm: Array, q: Array) -> Indices:
    segments, T_arm_scanner = world.bodies.placed(q)
    return sight.codes(world.bodies, segments, T_arm_scanner, np.tile(T_map_arm, (len(q), 1, 1)))


def _wound(world: CollisionWorld, q: Array, rows: Indices, home: Array) -> tuple[Indices, Array]:
    """Adds the other winding of joints that are about half a turn from home."""
    arm = world.arm
    q = q[rows]
    for joint in range(5 if arm.tool_axis_is_view else 6):
        off = q[:, joint] - home[joint]
        other = q[:, joint] - 2.0 * np.pi * np.sign(off)
        near = np.abs(off) > np.pi - _WINDING_RAD
        inside = (other >= arm.lower[joint]) & (other <= arm.upper[joint])
        also = np.flatnonzero(near & inside)
        turned = q[also].copy()
        turned[:, joint] = other[also]
        q, rows = np.concatenate([q, turned]), np.concatenate([rows, rows[also]])
    return rows, q
