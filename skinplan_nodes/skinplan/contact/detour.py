"""A way around what is in the way of a motion, on which the tracker holds the T-Mac throughout.

Two random trees in joint space grow toward each other; every edge is checked for collisions and for
the beam. That finds changes of posture too, which no straight motion makes.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import cast

import numpy as np

from skinplan.contact.transfer import along
from skinplan.robot.arm import ArmModel
from skinplan.robot.collision import CollisionWorld
from skinplan.trajectory.tree_search import connect
from skinplan.transforms import Array

_ITERATIONS = 400


@dataclass(frozen=True)
class _Held:
    """What the trees ask.

    Attributes:
        arm: The arm.
        problems: First problem of each of some joint positions, empty where there is none.
    """

    arm: ArmModel
    problems: Callable[[Array], list[str]]

    def free_motion(self, start: Array, end: Array) -> bool:
        """Says whether the straight motion between joint positions, shape (6,) [rad], is free."""
        return not any(self.problems(along(self.arm, np.stack([start, end]))))


def detour(
    arm: ArmModel, start: Array, end: Array, problems: Callable[[Array], list[str]]
) -> Array | None:
    """Finds a way between joint positions.

    Args:
        arm: The arm.
        start: Joint positions without problem, shape (6,) [rad].
        end: Same.
        problems: First problem of each of some joint positions, shape (n, 6) [rad]; empty where
            there is none.

    Returns:
        Corners of the way, both ends included, shape (k, 6) [rad]; None = none was found.
    """
    # The trees use the arm's limits and free motion only.
    world = cast(CollisionWorld, _Held(arm, problems))
    corners = connect(world, start, end, _ITERATIONS)
    return None if corners is None else np.array(corners)
