"""Cycle times, certificates and planning times of the sample parts, and the speed of the ladder.

Run as ``python benchmarks/trajectory.py [--speeds 0.2 0.5] [--parts scene1 ...] [--all]``; prints
Table 1 of M beside what is planned here: the published strategies and the defaults, the base at its
nominal poses; with ``--all`` also the other order strategies and the Bézier timing. One run each.
"""

import argparse
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from skinplan.part.samples import PANELS, write_sample
from skinplan.pipeline import Plan, plan_part
from skinplan.robot.cell import load_cell
from skinplan.scan_path.model import ROW
from skinplan.trajectory.ladder import Ladder
from skinplan.trajectory.model import SCAN

#: Automatic and by hand, means of four runs (M, Table 1) [s].
TABLE_1 = {"scene1": (123, 158), "scene2": (91, 127), "scene3": (259, 265), "scene4": (256, 272)}
PUBLISHED = ("published", "rectangles", "published", "toppra")
DEFAULT = ("coverage", "reach", "tour", "toppra")
OTHERS = (
    ("coverage", "reach", "published", "toppra"),
    ("coverage", "reach", "ants", "toppra"),
    ("coverage", "reach", "tour", "bezier"),
    ("published", "reach", "tour", "toppra"),
)
HEADER = (
    f"{'part':7} {'v':>4} {'strategies':37} {'Table 1':>8} {'points':>6} {'st.':>3} {'cycle':>6} "
    f"{'scan':>6} {'transit':>7} {'base':>5} {'bound':>6} {'breaks':>6} {'in rows':>7} "
    f"{'skipped':>7} {'way m':>6} {'seen %':>7} {'feat. %':>7} {'gap %':>6} {'motion s':>8} "
    f"{'plan s':>6}"
)


def line(name: str, strategies: tuple[str, str, str, str], speed: float, folder: Path) -> str:
    """Plans a part and returns a line of the table."""
    part = write_sample(name, folder)
    path, stations, order, timing = strategies
    scan = replace(
        part.scan,
        strategy=path,
        station_strategy=stations,
        order_strategy=order,
        timing=timing,
        tcp_speed_m_s=speed,
    )
    plan = plan_part(replace(part, scan=scan), load_cell())
    cycle, timed = plan.cycle, plan.timed
    assert cycle is not None and timed is not None and plan.station_plan is not None
    seen = 100.0 * timed.coverage.area_ratio_of_seeable
    features = 100.0 * timed.coverage.feature_area_ratio_of_seeable
    cost = sum(t.order_cost for t in plan.trajectories)
    bound = sum(t.order_bound for t in plan.trajectories)
    skipped = len(plan.station_plan.skipped) + sum(len(t.skipped) for t in plan.trajectories)
    return (
        f"{name:7} {speed:4.1f} {' + '.join(strategies):37} "
        f"{'{}/{}'.format(*TABLE_1[name]):>8} {len(plan.path):6} "
        f"{len(plan.station_plan.stations):3} {cycle.cycle_s:6.1f} {cycle.scan_s:6.1f} "
        f"{cycle.transit_s:7.1f} {cycle.base_s:5.1f} {cycle.lower_bound_s:6.1f} "
        f"{cycle.breaks:6} {breaks_in_rows(plan):7} {skipped:7} {cycle.tcp_path_m:6.1f} "
        f"{seen:7.2f} {features:7.2f} {100.0 * (cost / bound - 1.0):6.1f} "
        f"{plan.planning_s['trajectory']:8.1f} {sum(plan.planning_s.values()):6.1f}"
    )


def breaks_in_rows(plan: Plan) -> int:
    """Counts breaks between two neighbours of a row."""
    count = 0
    for trajectory in plan.trajectories:
        scans = [s for s in trajectory.segments if s.kind == SCAN]
        for before, after in zip(scans, scans[1:], strict=False):
            a, b = int(before.points[-1]), int(after.points[0])
            same = plan.path.groups[a] == plan.path.groups[b]
            count += abs(a - b) == 1 and bool(same) and plan.path.kinds[a] == ROW
    return count


def ladder_seconds(layers: int = 450, states: int = 16 * 8) -> tuple[float, float]:
    """Times making and solving a ladder of points with 16 rolls and 8 branches each [s]."""
    random = np.random.default_rng(0)
    begin = time.perf_counter()
    shape = (layers - 1, states, states)
    edges = [list(random.random(shape)) for _ in range(2)]
    made = time.perf_counter()
    ladder = Ladder([np.zeros(states)] * layers, *edges)
    ladder.solve()
    return time.perf_counter() - made, made - begin


def main() -> None:
    """Prints the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--speeds", type=float, nargs="*", default=[0.2, 0.5])
    parser.add_argument("--parts", nargs="*", default=list(PANELS))
    parser.add_argument("--all", action="store_true", help="the other strategies, too")
    options = parser.parse_args()
    solved, filled = ladder_seconds()
    print(f"ladder of 450 points x 16 rolls x 8 branches: {solved:.2f} s (costs {filled:.2f} s)")
    print(HEADER)
    with tempfile.TemporaryDirectory() as folder:
        for speed in options.speeds:
            for strategies in (PUBLISHED, DEFAULT, *(OTHERS if options.all else ())):
                for name in options.parts:
                    place = Path(folder) / name
                    print(line(name, strategies, speed, place), flush=True)


if __name__ == "__main__":
    main()
