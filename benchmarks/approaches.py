"""Whole approaches: up to 3 m away and 60 degrees aside, lost images, slips of the wheels.

    python benchmarks/approaches.py [--first 0] [--count 500] [--slips 0.1] [--lost 0.05]

Prints how they end, how many looks and drives they take, and how near the camera came on the whole
way of the base. One takes 2 s.
"""

import argparse
import sys
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from approach_cell import CELL, SimulatedCell, random_start
from skinplan.errors import LocalizationError


@dataclass(frozen=True)
class End:
    """How an approach ended.

    Attributes:
        name: SUCCESS, or the error.
        quality: E reached; NaN = none.
        attempts: Estimates.
        drives: Drives, the way back included.
        nearest_m: Least distance of the camera from the marker plane [m].
        seen: Whether a pose was ever estimated.
    """

    name: str
    quality: float
    attempts: int
    drives: int
    nearest_m: float
    seen: bool


def approach(seed: int, slips: float, lost: float) -> End:
    """Runs one."""
    cell = SimulatedCell(seed, random_start(seed), slips=slips, lost=lost)
    loop, name, quality = cell.loop(), "SUCCESS", float("nan")
    try:
        quality = loop.run().quality
    except LocalizationError as error:
        name = type(error).__name__
    seen = any(item.pose is not None for item in cell.told_estimates)
    return End(name, quality, loop.attempts, len(cell.goals), float(cell.nearest_m), seen)


def main() -> None:
    """Runs all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--count", type=int, default=500)
    parser.add_argument("--slips", type=float, default=0.1, help="share of drives that slip")
    parser.add_argument("--lost", type=float, default=0.05, help="share of images that are lost")
    given = parser.parse_args()
    cv2.setNumThreads(1)
    seeds = range(given.first, given.first + given.count)
    ends = [approach(seed, given.slips, given.lost) for seed in seeds]
    good = [end for end in ends if end.name == "SUCCESS"]
    for name, count in Counter(end.name for end in ends).most_common():
        print(f"{name}: {count}")
    print(f"failed though a marker was seen: {sum(e.seen for e in ends if e.name != 'SUCCESS')}")
    print(f"least E of the good ones: {min((end.quality for end in good), default=np.nan):.3f}")
    nearest = min(end.nearest_m for end in ends)
    print(f"nearest place: {nearest:.3f} m, d_min {CELL.quality.distance_min_m} m")
    for what in ("attempts", "drives"):
        values = [getattr(end, what) for end in good] or [0]
        print(f"{what}: median {np.median(values):.0f}, most {max(values)}")


if __name__ == "__main__":
    main()
