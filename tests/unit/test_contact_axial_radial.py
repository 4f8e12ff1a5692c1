import numpy as np
import pytest

from skinplan.contact.axial_radial import axial_bins, plan_axial_radial
from skinplan.contact.settings import AxialRadialSettings
from skinplan.errors import InspectionPointsError, NothingReachedError


def disc(points, radius, near=0.0):
    """An arm that reaches what is between two distances from it on the floor."""

    def reach(x, y):
        gaps = np.linalg.norm(points[:, :2] - (x, y), axis=1)
        return (gaps <= radius) & (gaps >= near)

    return reach


def column(count=21, length=2.0):
    y = np.linspace(-length, 0.0, count)
    return np.stack([np.zeros(count), y, np.full(count, 0.3)], axis=1)


def literal(points, reach, settings):
    """Steps (1) to (9) word for word, one point at a time."""
    low, high = min(p[1] for p in points), max(p[1] for p in points)
    for count in range(1, settings.stations_max + 1):
        span = (high - low) / count
        bins = [[] for _ in range(count)]
        for number, point in enumerate(points):
            i = 0
            while i < count - 1 and point[1] >= low + (i + 1) * span:
                i += 1
            bins[i].append(number)
        answer, filled, total = [], set(), 0
        for i, members in enumerate(bins):
            start = sum(points[m][0] for m in members) / len(members)
            y = low + (2 * (i + 1) - 1) * (high - low) / (2 * count)
            best = None
            for k in range(1, settings.k_max + 1):
                row = reach(start + k * settings.step_m, y)
                if best is None or row.sum() > best[1].sum():
                    best = (k, row)
            answer.append((start + best[0] * settings.step_m, y, best[0]))
            total += int(best[1].sum())
            filled |= set(np.flatnonzero(best[1]).tolist())
        if total > len(points) and len(filled) == len(points):
            return answer, total
    return None, 0


@pytest.mark.parametrize("seed", range(30))
def test_the_algorithm_is_the_printed_one(seed):
    rng = np.random.default_rng(seed)
    points = rng.uniform((-0.1, -2.5, 0.0), (0.4, 0.0, 0.5), (40, 3))
    settings = AxialRadialSettings(stations_max=40)
    reach = disc(points, rng.uniform(0.7, 1.4), rng.uniform(0.0, 0.5))
    expected, total = literal(points, reach, settings)
    found = plan_axial_radial(points, reach, settings)
    if expected is None:
        assert not found.complete
        return
    assert found.complete and found.reached_sum == total
    assert [s.k for s in found.stations] == [k for _, _, k in expected]
    places = [(s.x_m, s.y_m) for s in found.stations]
    assert np.allclose(places, [(x, y) for x, y, _ in expected], atol=1e-12)


def test_intervals_are_half_open_and_the_last_point_is_in_the_last():
    bins, middles = axial_bins(np.array([0.0, 1.0, 1.999, 2.0, 3.0]), 3)
    assert bins.tolist() == [0, 1, 1, 2, 2]
    assert np.allclose(middles, [0.5, 1.5, 2.5])


def test_one_station_is_never_enough_as_printed_but_may_be():
    points = column(5, 0.4)
    reach = disc(points, 5.0)
    assert len(plan_axial_radial(points, reach).stations) == 2
    free = AxialRadialSettings(overlap_required=False)
    single = plan_axial_radial(points, reach, free)
    assert single.complete and len(single.stations) == 1 and single.history == ((1, 5, 5),)


def test_of_equal_counts_the_smallest_k_or_the_middle_one():
    points = column(3, 0.1)
    settings = AxialRadialSettings(overlap_required=False)
    reach = disc(points, 1.05, 0.35)
    assert plan_axial_radial(points, reach, settings).stations[0].k == 2
    middle = AxialRadialSettings(overlap_required=False, middle_of_ties=True)
    assert plan_axial_radial(points, reach, middle).stations[0].k == 3


def test_an_interval_without_points_gets_no_station():
    ends = np.concatenate([column(3, 0.2), column(3, 0.2) - (0.0, 4.0, 0.0)])
    settings = AxialRadialSettings(stations_max=5, overlap_required=False)
    plan = plan_axial_radial(ends, disc(ends, 0.6), settings)
    assert plan.complete and plan.history[-1][0] == 4 and len(plan.stations) == 2
    assert sum(int(s.own.sum()) for s in plan.stations) == len(ends)
    assert all(s.own.any() for s in plan.stations)


def test_shifting_the_part_shifts_the_stations():
    points = column()
    shift = np.array([3.0, -7.0, 0.0])
    here = plan_axial_radial(points, disc(points, 1.0))
    there = plan_axial_radial(points + shift, disc(points + shift, 1.0))
    for a, b in zip(here.stations, there.stations, strict=True):
        assert (b.x_m - a.x_m, b.y_m - a.y_m) == pytest.approx((3.0, -7.0))


def test_what_can_not_be_covered_leaves_the_best_and_says_so():
    points = np.concatenate([column(), [[30.0, -1.0, 0.0]]])
    plan = plan_axial_radial(points, disc(points, 1.0), AxialRadialSettings(stations_max=4))
    assert not plan.complete
    assert len(plan.history) == 4
    assert int(plan.covered.sum()) == max(covered for _, _, covered in plan.history)


def test_nothing_reached_is_an_error_that_says_what_was_tried():
    points = column()
    with pytest.raises(NothingReachedError, match="21 points.*10 radial steps of 0.2 m"):
        plan_axial_radial(points, lambda x, y: np.zeros(21, dtype=bool))


@pytest.mark.parametrize(
    ("points", "words"),
    [
        (np.zeros((0, 3)), "none were found"),
        (np.zeros((4, 2)), r"shape \(n, 3\)"),
        (np.array([[0.0, np.nan, 0.0]]), "not finite"),
        (column() * 1000.0, "millimetres"),
    ],
)
def test_points_that_can_not_be_used_are_refused(points, words):
    with pytest.raises(InspectionPointsError, match=words):
        plan_axial_radial(points, lambda x, y: np.ones(len(points), dtype=bool))
