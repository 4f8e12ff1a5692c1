"""Which station measures which point, in which order and in which pose."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skinplan.contact.axial_radial import AxialRadialPlan
from skinplan.contact.model import Motion
from skinplan.contact.motion import Stances, StationMotion
from skinplan.contact.postures import NEAR_RAD, fewest_groups, postures
from skinplan.contact.tracker import SightOptions
from skinplan.transforms import Array

_MOST_GROUPS = 2  # at a station on the average; more are a sign that the points are far apart


@dataclass(frozen=True, eq=False)
class Tours:
    """The tours of all stations.

    Attributes:
        q: Joint positions at each point, shape (n, 6) [rad]; NaN where it is not measured.
        station_of: Station of each point, -1 = none, shape (n,).
        orders: Points of each station in the order of visit.
        motions: Between the points of one station.
    """

    q: Array
    station_of: NDArray[np.int64]
    orders: tuple[NDArray[np.int64], ...]
    motions: tuple[Motion, ...]


def preference(plan: AxialRadialPlan, points: Array) -> Array:
    """Cost of measuring each point from each station, shape (s, n), in [0, 1]: 0 = its own.

    Args:
        plan: The stations.
        points: Measuring points, axial frame, shape (n, 3) [m].
    """
    span = max(float(np.ptp(points[:, 1])), 1e-9)
    rows = []
    for station in plan.stations:
        gaps = np.abs(station.y_m - points[:, 1]) / (2.0 * span)
        rows.append(np.where(station.own, 0.0, np.clip(0.5 + gaps, 0.0, 1.0)))
    return np.array(rows)


def plan_tours(
    movers: list[StationMotion], held: SightOptions, points: Array, cost: Array
) -> Tours:
    """Gives each point to a station and a posture, and makes the tours.

    Args:
        movers: Of the stations, in their order.
        held: Options that the tracker sees.
        points: Measuring points, axial frame, shape (n, 3) [m].
        cost: Of measuring each point from each station, shape (s, n), in [0, 1].
    """
    all_stances = [
        mover.stances(held.point[held.station == number], held.q[held.station == number])
        for number, mover in enumerate(movers)
    ]
    labels, group = _grouped(all_stances, cost)
    q = np.full((len(points), 6), np.nan)
    owner = np.full(len(points), -1, dtype=np.int64)
    orders: list[NDArray[np.int64]] = []
    motions: list[Motion] = []
    for number, (mover, stances) in enumerate(zip(movers, all_stances, strict=True)):
        mine = stances.chosen(group[stances.point] == labels[number])
        order, picked, made = mover.tour(mine, points, group)
        q[order], owner[order] = mine.q[picked], number
        orders.append(order)
        motions += made
    return Tours(q, owner, tuple(orders), tuple(motions))


def _grouped(
    all_stances: list[Stances], cost: Array
) -> tuple[list[NDArray[np.int64]], NDArray[np.int64]]:
    """Posture group of each option, and of each point (-1 = none), shape (n,)."""
    for near in NEAR_RAD:
        labels = _labels(all_stances, near)
        group = _groups(all_stances, labels, cost)
        if len(np.unique(group[group >= 0])) <= _MOST_GROUPS * len(all_stances):
            break
    return labels, group


def _groups(
    all_stances: list[Stances], labels: list[NDArray[np.int64]], cost: Array
) -> NDArray[np.int64]:
    """Group of each point, -1 = none, shape (n,)."""
    count = 1 + max((int(label.max(initial=-1)) for label in labels), default=-1)
    member = np.zeros((count, cost.shape[1]), dtype=bool)
    prices = np.zeros(member.shape)
    for here, label, row in zip(all_stances, labels, cost, strict=True):
        member[label, here.point] = True
        prices[np.unique(label)] = row
    return fewest_groups(member, prices)


def _labels(stances: list[Stances], near_rad: float) -> list[NDArray[np.int64]]:
    """Groups of the options of all stations, numbered through."""
    labels: list[NDArray[np.int64]] = []
    first = 0
    for here in stances:
        labels.append(first + postures(here.above, near_rad))
        first += 1 + int(labels[-1].max(initial=first - 1) - first)
    return labels
