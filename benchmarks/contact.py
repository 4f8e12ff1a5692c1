"""Contact measurement of the sample ``engine``: stations, tracker, motions; what they depend on.

Run as ``python benchmarks/contact.py [--table]``. Without ``--table`` one plan with the default
figures; with it, also how stations change with the length of the probe, the vehicle's footprint and
the rule of step (8), which the paper does not settle. One run each.
"""

import argparse
import time
from collections import Counter
from dataclasses import replace

import numpy as np

from skinplan.contact.plan import ContactPlanner
from skinplan.contact.settings import ContactSettings, ProbeTool, TrackerLimits
from skinplan.part.engine import engine_mesh, engine_placement, engine_points

PUBLISHED_X = (1.087135, 1.098964, 1.347920)
PUBLISHED_TRACKER = np.array([0.411241, -3.472634, 0.695565])
LENGTHS_M = (0.15, 0.20, 0.25, 0.30, 0.35, 0.40, 0.45)


def planner(settings: ContactSettings) -> ContactPlanner:
    """Makes the planner of the sample."""
    points, normals, _ = engine_points()
    return ContactPlanner(points, normals, engine_mesh(), engine_placement(), settings)


def probe(length_m: float) -> ProbeTool:
    """A probe of another length; its body stays at most half of it."""
    return ProbeTool(probe_length_m=length_m, body_length_m=min(0.15, 0.5 * length_m))


def one_plan() -> None:
    """Prints the default plan and the check of the published tracker."""
    begin = time.perf_counter()
    made = planner(ContactSettings())
    print(f"part, ray tree, distance field {time.perf_counter() - begin:6.2f} s")
    begin = time.perf_counter()
    stations = made.stations()
    print(f"stations, steps (1) to (9)     {time.perf_counter() - begin:6.2f} s")
    begin = time.perf_counter()
    plan = made.run()
    print(f"everything, once more          {time.perf_counter() - begin:6.2f} s")
    print(f"history (S_num, N_sum, covered) {plan.history}, complete: {plan.complete}")
    for station, x in zip(plan.stations, PUBLISHED_X, strict=False):
        print(
            f"  x {station.x_m:.6f} y {station.y_m:.6f} k {station.k} "
            f"reaches {int(station.reached.sum())}, measures {len(station.points)}, "
            f"published x {x:.6f}, counts {station.counts.tolist()}"
        )
    tracker = plan.tracker
    assert tracker is not None
    print(
        f"tracker {np.round(tracker.position, 3).tolist()} sees {int(tracker.sees.sum())}, "
        f"emission <= {np.degrees(np.nanmax(tracker.emission_rad)):.1f} deg, "
        f"incidence <= {np.degrees(np.nanmax(tracker.incidence_rad)):.1f} deg, "
        f"range {np.nanmin(tracker.range_m):.2f} to {np.nanmax(tracker.range_m):.2f} m"
    )
    print(f"not measured: {[(entry.point, entry.reason) for entry in plan.missed]}")
    print("motions:", dict(Counter(motion.problem or "held" for motion in plan.motions)))
    for least in (1.5, 0.5):
        limits = TrackerLimits(range_min_m=least)
        other = planner(ContactSettings(tracker=limits))
        seen = other.seen_from(PUBLISHED_TRACKER, stations)
        print(f"published tracker, range from {least} m: sees {int(seen.sees.sum())}")


def table() -> None:
    """Prints how the stations depend on what is not published."""
    print("rule       vehicle x,y  probe  S_num  k            sum  covered  x")
    for size in ((0.90, 0.70), (0.70, 0.90)):
        for length in LENGTHS_M:
            for collisions in (True, False):
                if not collisions and size[0] < 0.9:
                    continue  # kinematics alone does not know the vehicle
                settings = replace(
                    ContactSettings(),
                    base_size_m=size,
                    tool=probe(length),
                    collision_counts=collisions,
                )
                plan = planner(settings).stations()
                x = ", ".join(f"{station.x_m:.3f}" for station in plan.stations)
                print(
                    f"{'collision' if collisions else 'kinematics':10} {size[0]:.2f},{size[1]:.2f}"
                    f"    {length:.2f}   {len(plan.stations)}      "
                    f"{str([s.k for s in plan.stations]):12} {plan.reached_sum}  "
                    f"{int(plan.covered.sum())}      {x}",
                    flush=True,
                )


def main() -> None:
    """Runs what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--table", action="store_true", help="also the table of dependence")
    options = parser.parse_args()
    one_plan()
    if options.table:
        table()


if __name__ == "__main__":
    main()
