"""Which point is measured from which station in which posture of the arm.

A change of branch between two points, or of the winding of a joint, swings the whole arm, and no
tracker follows that. Options that small joint motions lead to from one another make a group; as few
groups as can be take all points.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import LinearConstraint, milp
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from skinplan.transforms import Array

#: Largest joint motion between neighbours of a chain, tried in this order: points that are far from
#: one another make no chains of small motions.
NEAR_RAD = (0.5, 1.0, 1.5)


def postures(q: Array, near_rad: float = NEAR_RAD[0]) -> NDArray[np.int64]:
    """Numbers the groups of joint positions that chains of small motions connect.

    Args:
        q: Joint positions, shape (m, 6) [rad].
        near_rad: Neighbours in a chain are at most so far apart in every joint [rad].

    Returns:
        Number of the group, from 0 in the order of appearance, shape (m,).
    """
    if not len(q):
        return np.zeros(0, dtype=np.int64)
    pairs = cKDTree(q).query_pairs(near_rad, p=np.inf, output_type="ndarray")
    graph = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(q), len(q)))
    _, labels = connected_components(graph, directed=False)
    _, first, numbers = np.unique(labels, return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first))[numbers].astype(np.int64)


def fewest_groups(member: NDArray[np.bool_], cost: Array) -> NDArray[np.int64]:
    """Chooses the fewest groups that hold every point that some group holds.

    Args:
        member: Which group holds which point, shape (g, n).
        cost: Preference among choices of equal number: sum over points of the chosen group's cost,
            shape (g, n), in [0, 1].

    Returns:
        Group of each point, -1 where none holds it, shape (n,).
    """
    groups, count = member.shape
    result = np.full(count, -1, dtype=np.int64)
    points = np.flatnonzero(member.any(axis=0))
    row, column = np.nonzero(member[:, points])
    if not len(row):
        return result
    # Variables: group used (g), point taken by group (one per membership).
    pairs = len(row)
    used = np.zeros((pairs, groups + pairs))
    used[np.arange(pairs), groups + np.arange(pairs)] = 1.0
    used[np.arange(pairs), row] = -1.0
    taken = np.zeros((len(points), groups + pairs))
    taken[column, groups + np.arange(pairs)] = 1.0
    price = 0.5 * cost[row, points[column]] / len(points)
    found = milp(
        np.concatenate([np.ones(groups), price]),
        constraints=[LinearConstraint(used, -np.inf, 0.0), LinearConstraint(taken, 1.0, 1.0)],
        integrality=np.concatenate([np.ones(groups), np.zeros(pairs)]),
        bounds=(0, 1),
        options={"time_limit": 20.0},
    )
    if found.x is None:
        chosen = np.ones(groups, dtype=bool)
    else:
        chosen = np.round(found.x[:groups]) > 0
    ranked = np.where(member & chosen[:, None], cost, np.inf)
    result[points] = np.argmin(ranked[:, points], axis=0)
    return result
