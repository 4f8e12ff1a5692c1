"""One option per point so that the beam holds all the way from point to point (C 4, dynamic check).

From a point the probe goes straight back by `approach_m` (less where the arm ends before), around
the surface to above the next (`transfer`), and straight down. A broken beam costs the absolute
accuracy, so range, emission, incidence, occlusion and collision are checked all along, in steps in
which no body moves far. The options are chosen by least joint motion over the whole station; a
motion that fails is struck out and the choice made again. What still fails then, such as the change
from one posture to another, is led around by a detour that is checked the same way.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from skinplan.contact.detour import detour
from skinplan.contact.model import Motion
from skinplan.contact.order import cheapest, joint_distances, visit_order
from skinplan.contact.probing_arm import ProbingArm
from skinplan.contact.sight import Sight
from skinplan.contact.transfer import along, transfer
from skinplan.transforms import Array

_MOST_ROUNDS = 12
_MOST_ORDERS = 10
_MOST_DETOUR_ROUNDS = 4
_ALIKE_RAD = 0.6  # joint positions so near to each other share what no detour is found around
_APPROACH_SHARES = (1.0, 0.5, 0.25)  # of approach_m, the first that works
_LARGEST_JUMP_RAD = 0.6  # between a point and the place above it, in one branch
_ROOM_WEIGHT = 0.2  # cost of an incidence angle at its limit [rad of joint motion]


@dataclass(frozen=True, eq=False)
class Stances:
    """Options at one station that the tracker holds, and the places above them.

    Attributes:
        point: Number of the point, shape (m,).
        q: Joint positions at the point, shape (m, 6) [rad].
        above: Joint positions off the surface, shape (m, 6) [rad].
        cost: Cost of the option itself [rad], shape (m,).
    """

    point: NDArray[np.int64]
    q: Array
    above: Array
    cost: Array

    def chosen(self, which: NDArray[np.bool_]) -> "Stances":
        """Returns some of the options."""
        return Stances(self.point[which], self.q[which], self.above[which], self.cost[which])


class StationMotion:
    """Chooses among the options of one station.

    Attributes:
        T_axial_arm: Arm's base, shape (4, 4) [m].
    """

    def __init__(
        self, arm: ProbingArm, sight: Sight, tracker: Array, T_axial_arm: Array, number: int
    ) -> None:
        """Takes the station.

        Args:
            arm: Arm and tool.
            sight: Line of sight.
            tracker: The tracker's place, shape (3,) [m], axial frame.
            T_axial_arm: Arm's base, shape (4, 4) [m].
            number: Number of the station.
        """
        self._arm, self._sight, self._tracker = arm, sight, tracker
        self.T_axial_arm, self._number = T_axial_arm, number

    def stances(self, point: NDArray[np.int64], q: Array) -> Stances:
        """Keeps the options that can be approached: held and free off the surface.

        Args:
            point: Number of the point, shape (m,).
            q: Joint positions that the tracker holds, shape (m, 6) [rad].
        """
        above = np.full((len(q), 6), np.nan)
        for share in _APPROACH_SHARES:
            still = np.flatnonzero(np.isnan(above[:, 0]))
            if len(still):
                above[still] = self._lifted(q[still], share * self._arm.settings.approach_m)
        rows = np.flatnonzero(np.isfinite(above[:, 0]))
        beams = self._sight.beams(
            self._tracker, self.T_axial_arm @ self._arm.forward_mirror(q[rows])
        )
        cost = _ROOM_WEIGHT * (beams.incidence_rad / self._sight.incidence_max_rad) ** 2
        return Stances(point[rows], q[rows], above[rows], cost)

    def _lifted(self, q: Array, distance_m: float) -> Array:
        """Joint positions off the surface in the same branch, (m, 6) [rad]; NaN where none is."""
        back = self._arm.arm.forward(q) @ self._arm.settings.tool.T_tool0_probe
        back[:, :3, 3] -= distance_m * back[:, :3, 2]
        branches, _, inside = self._arm.solve(back)
        gaps = np.abs(branches - q[:, None]).max(axis=2)
        gaps[~inside] = np.inf
        nearest = np.argmin(gaps, axis=1)
        rows = np.flatnonzero(gaps[np.arange(len(q)), nearest] < _LARGEST_JUMP_RAD)
        found = branches[rows, nearest[rows]]
        kept = np.array([not reason for reason in self._problems(found)], dtype=bool)
        result = np.full((len(q), 6), np.nan)
        result[rows[kept]] = found[kept]
        return result

    def tour(
        self, stances: Stances, points: Array, group: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], tuple[Motion, ...]]:
        """Chooses an order and one option per point.

        Neighbours between which no motion is found are kept apart and the order made again.

        Args:
            stances: Options; the points to be visited are those that have one.
            points: All points, shape (n, 3) [m].
            group: Posture group of each point, visited one after the other, shape (n,).

        Returns:
            Points in the order of visit, shape (p,), number of the option of each, and the motions.
        """
        apart: set[tuple[int, int]] = set()
        known: dict[tuple[int, int], str] = {}
        best: tuple[NDArray[np.int64], NDArray[np.int64]] | None = None
        least = len(points) + 1
        for _ in range(_MOST_ORDERS):
            order = visit_order(points, np.unique(stances.point), group, apart)
            picked = self.choose(stances, order, known)
            failed = [
                (min(a, b), max(a, b))
                for a, b, pair in zip(order, order[1:], _pairs(picked), strict=False)
                if known[pair]
            ]
            if best is None or len(failed) < least:
                best, least = (order, picked), len(failed)
            fresh = {(int(a), int(b)) for a, b in failed if group[a] == group[b]} - apart
            if not fresh:
                break
            apart |= fresh
        assert best is not None
        order, picked = best
        if least == 0:
            direct = [self._direct(stances, a, b) for a, b in _pairs(picked)]
            return order, picked, tuple(direct)
        return order, *self._led_around(stances, order, known)

    def choose(
        self,
        stances: Stances,
        order: NDArray[np.int64],
        known: dict[tuple[int, int], str],
    ) -> NDArray[np.int64]:
        """Chooses one option per point.

        Args:
            stances: Options; every point of the order has one.
            order: Points in the order of visit, shape (p,).
            known: Problems of the pairs of options checked so far; grows by all that are picked.

        Returns:
            Number of the option of each point, shape (p,).
        """
        layers, steps = _layers(stances, order)
        picked = cheapest(layers, steps, stances.cost)
        for _ in range(_MOST_ROUNDS):
            self._check(stances, picked, known)
            pairs = _pairs(picked)
            failed = [k for k, pair in enumerate(pairs) if known[pair]]
            if not failed:
                break
            for k in failed:
                a = int(np.flatnonzero(layers[k] == pairs[k][0])[0])
                b = int(np.flatnonzero(layers[k + 1] == pairs[k][1])[0])
                steps[k][a, b] += 1e3
            picked = cheapest(layers, steps, stances.cost)
        self._check(stances, picked, known)
        return picked

    def _led_around(
        self, stances: Stances, order: NDArray[np.int64], known: dict[tuple[int, int], str]
    ) -> tuple[NDArray[np.int64], tuple[Motion, ...]]:
        """Chooses one option per point when motions may have detours.

        Where none is found, other options than those and their like are tried.

        Args:
            stances: Options; every point of the order has one.
            order: Points in the order of visit, shape (p,).
            known: Problems of the pairs of options checked so far; grows.

        Returns:
            Number of the option of each point, shape (p,), and the motions: those of the round in
            which the fewest fail.
        """
        layers, steps = _layers(stances, order)
        made: dict[tuple[int, int], Motion] = {}
        best: tuple[NDArray[np.int64], tuple[Motion, ...]] | None = None
        least = len(order) + 1
        for _ in range(_MOST_DETOUR_ROUNDS):
            picked = cheapest(layers, steps, stances.cost)
            self._check(stances, picked, known)
            pairs = _pairs(picked)
            for pair in pairs:
                if pair not in made:
                    made[pair] = self._motion(stances, *pair, known[pair])
            failed = [k for k, pair in enumerate(pairs) if made[pair].problem]
            if len(failed) < least:
                best, least = (picked, tuple(made[pair] for pair in pairs)), len(failed)
            if not failed:
                break
            for k in failed:
                like = [
                    np.abs(stances.above[layers[k + j]] - stances.above[pairs[k][j]]).max(axis=1)
                    < _ALIKE_RAD
                    for j in range(2)
                ]
                steps[k][np.ix_(*like)] += 1e3
        assert best is not None
        return best

    def _direct(self, stances: Stances, start: int, end: int, problem: str = "") -> Motion:
        points = int(stances.point[start]), int(stances.point[end])
        return Motion(self._number, *points, problem, self._corners(stances, start, end))

    def _motion(self, stances: Stances, start: int, end: int, problem: str) -> Motion:
        """The motion between two options, led around what is in its way where that is found."""
        motion = self._direct(stances, start, end, problem)
        if not problem:
            return motion
        way = detour(self._arm.arm, stances.above[start], stances.above[end], self._problems)
        if way is None:
            return motion
        around = np.concatenate([stances.q[[start]], way, stances.q[[end]]])
        if any(self._problems(along(self._arm.arm, around))):
            return motion
        return replace(motion, problem="", corners=around)

    def _corners(self, stances: Stances, start: int, end: int) -> Array:
        """Joint positions from one option back, over and down to another, shape (k, 6) [rad]."""
        over = transfer(self._arm, stances.above[start], stances.above[end])
        return np.concatenate([stances.q[[start]], over, stances.q[[end]]])

    def _check(
        self, stances: Stances, picked: NDArray[np.int64], known: dict[tuple[int, int], str]
    ) -> None:
        fresh = [pair for pair in _pairs(picked) if pair not in known]
        if not fresh:
            return
        ways = [along(self._arm.arm, self._corners(stances, a, b)) for a, b in fresh]
        problems = self._problems(np.concatenate(ways))
        begin = 0
        for pair, way in zip(fresh, ways, strict=True):
            part = problems[begin : begin + len(way)]
            known[pair] = next((reason for reason in part if reason), "")
            begin += len(way)

    def _problems(self, q: Array) -> list[str]:
        """First problem of each configuration, (n, 6) [rad]: collision or the beam."""
        if not len(q):
            return []
        reasons = self._sight.holds(self._tracker, q, self.T_axial_arm)
        held = np.flatnonzero([not reason for reason in reasons])
        for row, pair in zip(held, self._arm.problems(q[held], self.T_axial_arm), strict=True):
            reasons[row] = f"collision of {pair}" if pair else ""
        return reasons


def _layers(
    stances: Stances, order: NDArray[np.int64]
) -> tuple[list[NDArray[np.int64]], list[Array]]:
    """Options of each point in its turn, and the cost of the motion between those of neighbours."""
    layers = [np.flatnonzero(stances.point == point) for point in order]
    steps = [
        joint_distances(stances.above[a], stances.above[b])
        for a, b in zip(layers, layers[1:], strict=False)
    ]
    return layers, steps


def _pairs(picked: NDArray[np.int64]) -> list[tuple[int, int]]:
    """Options that follow one another."""
    return list(zip(picked.tolist(), picked.tolist()[1:], strict=False))


def T_axial_probe(arm: ProbingArm, q: Array, T_axial_arm: Array) -> Array:
    """Returns the poses of the ball at joint positions, (n, 6) [rad], shape (n, 4, 4) [m]."""
    return np.asarray(T_axial_arm @ arm.arm.forward(q) @ arm.settings.tool.T_tool0_probe)
