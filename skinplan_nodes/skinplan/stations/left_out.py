"""Points that could be reached, but only from where the part could not be located."""

import numpy as np
from numpy.typing import NDArray

from skinplan.robot.batch import ReachEngine
from skinplan.stations.problem import StationProblem
from skinplan.transforms import Array


def reasons_of_left_out(
    problem: StationProblem, engine: ReachEngine, blind: Array, missing: NDArray[np.int64]
) -> dict[int, str]:
    """Says of points that no candidate reaches which the places left out do reach.

    Args:
        problem: What stations are wanted for.
        engine: Finds what they reach.
        blind: Places left out only for what the camera sees there, ``T_map_base_link``, shape
            (b, 4, 4) [m].
        missing: Points that no station reaches, shape (m,).

    Returns:
        The reason, with the best of those places, of each point that one of them reaches.
    """
    if problem.markers is None or not len(blind) or not len(missing):
        return {}
    useful = blind[engine.promising(blind)[:, missing].any(axis=1)]
    if not len(useful):
        return {}
    reached = engine.table(useful, is_cancelled=problem.is_cancelled).reached
    quality = problem.markers.quality(problem.cell, problem.T_map_workpiece, useful)
    result: dict[int, str] = {}
    for point in missing[reached[:, missing].any(axis=0)]:
        best = int(np.argmax(np.where(reached[:, point], quality, -1.0)))
        x, y = useful[best, :2, 3]
        result[int(point)] = (
            f"reached only from where {problem.markers.words(problem.cell)} "
            f"(at best {quality[best]:.3f}, from ({x:.2f}, {y:.2f}) m)"
        )
    return result
