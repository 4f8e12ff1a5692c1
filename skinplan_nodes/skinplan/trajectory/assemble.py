"""From a way through the points to timed segments, and the last check of every sample of them."""

import logging
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from skinplan.robot.arm import ArmModel
from skinplan.robot.collision import CollisionWorld
from skinplan.strategies import chosen
from skinplan.trajectory.bezier import time_bezier
from skinplan.trajectory.model import SCAN, TRANSIT, Segment
from skinplan.trajectory.search import Way
from skinplan.trajectory.timing import Limits, Timed, rest, tcp_length, time_line, time_path
from skinplan.trajectory.transit import Transit
from skinplan.transforms import Array

Timing = Callable[[ArmModel, Array, Limits], Timed]

TIMINGS: dict[str, Timing] = {"toppra": time_path, "bezier": time_bezier}

_LOG = logging.getLogger(__name__)


def timed_segments(
    arm: ArmModel, way: Way, points: NDArray[np.int64], limits: Limits, timing: str = "toppra"
) -> tuple[list[Segment], list[NDArray[np.int64]]]:
    """Times a way.

    Args:
        arm: The arm.
        way: The way; its points are places in ``points``.
        points: Indices into the scan path, shape (p,).
        limits: Limits while scanning; transits have no limit of the scanner's speed.
        timing: Name of one of `TIMINGS`.

    Returns:
        The segments, and for each the edge of the way that each of its samples lies on.
    """
    time_joints = chosen("timing", timing, TIMINGS)
    free = Limits(limits.velocity, limits.acceleration, np.inf)
    segments: list[Segment] = []
    places: list[NDArray[np.int64]] = []
    run: list[int] = []  # edges of the scan segment being collected
    first = 0  # its first point

    def finish(last: int) -> None:
        timed, edge, point_s = _time_run(arm, way, run, first, limits, time_joints)
        passed = points[way.points[first : last + 1]]
        segments.append(_segment(arm, SCAN, timed, passed, point_s))
        places.append(edge)

    for number, edge in enumerate(way.edges):
        if not isinstance(edge, Transit):
            run.append(number)
            continue
        if number > 0:
            finish(number - 1)
        legs = [_time_leg(arm, leg, free, time_joints) for leg in edge.legs]
        if legs:
            none = np.zeros(0, dtype=np.int64)
            segments.append(_segment(arm, TRANSIT, _joined(legs), none, np.zeros(0)))
            places.append(np.full(len(segments[-1].times), number))
        run, first = [], number
    return segments, places


def collision_edges(
    world: CollisionWorld, segments: list[Segment], places: list[NDArray[np.int64]]
) -> list[int]:
    """Checks every sample, and in between where bodies move far; returns edges that collide."""
    bad: set[int] = set()
    for segment, edges in zip(segments, places, strict=True):
        q, step = world.dense(segment.positions)
        free = world.free(q)
        bad.update(edges[step[~free]].tolist())
    if bad:
        _LOG.debug("timed edges %s collide", sorted(bad))
    return sorted(bad)


def _time_run(
    arm: ArmModel, way: Way, run: list[int], first: int, limits: Limits, time_joints: Timing
) -> tuple[Timed, NDArray[np.int64], Array]:
    """Times one scan segment: its motion, the edge of each sample, when points are passed."""
    pieces = [np.asarray(way.edges[number]) for number in run]
    if not pieces:
        return rest(way.states[first]), np.full(2, first), np.zeros(1)
    owner = np.concatenate([np.full(len(p) - 1, n) for n, p in zip(run, pieces, strict=True)])
    q = np.vstack([pieces[0][:1], *(piece[1:] for piece in pieces)])
    # Coincident points make steps without length: one of each pair is enough.
    moving = np.append(True, np.abs(np.diff(q, axis=0)).max(axis=1) > 1e-9)
    steps = np.cumsum([0, *(len(piece) - 1 for piece in pieces)])
    step = np.cumsum(moving)[steps] - 1  # where on the path the points are
    q, owner = q[moving], owner[moving[1:]]
    if len(q) < 2:
        return rest(way.states[first]), np.full(2, run[0]), np.zeros(len(step))
    timed = time_joints(arm, q, limits)
    edges = owner[np.clip(timed.path.astype(int), 0, len(owner) - 1)]
    return timed, edges, np.interp(step, timed.path, timed.times)


def _time_leg(arm: ArmModel, leg: Array, limits: Limits, time_joints: Timing) -> Timed:
    return time_line(leg[0], leg[1], limits) if len(leg) == 2 else time_joints(arm, leg, limits)


def _joined(legs: list[Timed]) -> Timed:
    """Joins motions that each begin where the one before ends, at rest."""
    times, positions, velocities, path = (
        [legs[0].times],
        [legs[0].positions],
        [legs[0].velocities],
        [legs[0].path],
    )
    for leg in legs[1:]:
        times.append(leg.times[1:] + times[-1][-1])
        positions.append(leg.positions[1:])
        velocities.append(leg.velocities[1:])
        path.append(leg.path[1:])
    return Timed(
        np.concatenate(times), np.vstack(positions), np.vstack(velocities), np.concatenate(path)
    )


def _segment(
    arm: ArmModel, kind: int, timed: Timed, points: NDArray[np.int64], point_s: Array
) -> Segment:
    return Segment(
        kind,
        timed.times,
        timed.positions,
        timed.velocities,
        points,
        tcp_length(arm, timed.positions),
        point_s,
    )
