"""The ways in which each view may be taken: straight or tilted, with one or several rolls."""

from dataclasses import dataclass

import numpy as np

from skinplan.robot.arm import ArmModel
from skinplan.robot.scanner_pose import mean_direction, tilted, tool_poses
from skinplan.transforms import Array, apply, rotate

ROLLS = 8
TILT_SIDES = 16


@dataclass(frozen=True, eq=False)
class ViewOptions:
    """All options of all views, in the shop; options first.

    Attributes:
        tilts: Tilt about the target of each option, shape (o,) [rad].
        rolls: Roll of each option from the reference direction, shape (o,) [rad].
        T_map_tool0: Flange poses, shape (o, n, 4, 4) [m].
        roll_is_free: The roll of the options is without meaning: the last joint turns about the
            view axis and may rest anywhere.
        straight: Number of options without tilt; they come first.
    """

    tilts: Array
    rolls: Array
    T_map_tool0: Array
    roll_is_free: bool
    straight: int

    @classmethod
    def of(
        cls,
        arm: ArmModel,
        views: tuple[Array, Array, Array],
        T_map_workpiece: Array,
        tilt_max_rad: float,
        shares: tuple[float, ...] = (1.0,),
        roll_rad: float | None = None,
    ) -> "ViewOptions":
        """Makes the options of views.

        Args:
            arm: The arm.
            views: Scanner origins, unit view directions and targets in the workpiece frame, each
                (n, 3) [m].
            T_map_workpiece: Part in the shop, shape (4, 4) [m].
            tilt_max_rad: Largest tilt [rad]; 0 = straight views only.
            shares: Tilts tried after the straight view, in shares of the largest, 16 sides each.
            roll_rad: The roll, counted as `scanner_frames` does; None = free.
        """
        positions, targets = apply(T_map_workpiece, views[0]), apply(T_map_workpiece, views[2])
        directions = rotate(T_map_workpiece, views[1])
        reference = mean_direction(directions)
        free = roll_rad is None and arm.tool_axis_is_view
        rolls = np.zeros(1) if free else 2.0 * np.pi * np.arange(ROLLS) / ROLLS
        if roll_rad is not None:
            rolls = np.array([roll_rad])
        places, looks, tilts = [positions], [directions], [0.0]
        distance = np.linalg.norm(targets - positions, axis=1)[:, None]
        for share in shares if tilt_max_rad > 0.0 else ():
            leaned = tilted(directions, share * tilt_max_rad, TILT_SIDES).swapaxes(0, 1)
            looks += list(leaned)
            places += [targets - distance * look for look in leaned]
            tilts += [share * tilt_max_rad] * TILT_SIDES
        frames = [
            tool_poses(place, look, np.full(len(place), roll), arm.T_tool0_scanner, reference)
            for place, look in zip(places, looks, strict=True)
            for roll in rolls
        ]
        return cls(
            np.repeat(tilts, len(rolls)),
            np.tile(rolls, len(tilts)),
            np.array(frames),
            free,
            len(rolls),
        )
