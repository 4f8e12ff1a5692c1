"""The accuracy experiment of the paper (Table 2) on the mock's tracker and scanner node.

Prints diameter and distance of two spheres for six runs, with base and arm errors once and ten
times as large. Run with ``.venv/bin/python benchmarks/accuracy.py``.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from nodes.ball_bar import APART_M, DIAMETER_M, BallBar, Errors, write_ball_bar
from nodes.bench import Bench

RUNS = 6


def main() -> None:
    """Prints the table."""
    print("errors of base and arm | run | diameter 1 [mm] | diameter 2 [mm] | distance [mm]")
    with tempfile.TemporaryDirectory() as folder:
        part = write_ball_bar(Path(folder))
        for factor in (1.0, 10.0):
            bench = Bench()
            try:
                bar = BallBar(bench, part, seed=3)
                found = [bar.measure(Errors().times(factor)) for _ in range(RUNS)]
            finally:
                bench.close()
            rows = np.array([[*run.diameters, run.distance] for run in found]) * 1e3
            for number, row in enumerate(rows, start=1):
                print(f"x{factor:g} | {number} | {row[0]:.4f} | {row[1]:.4f} | {row[2]:.4f}")
            mean = rows.mean(axis=0)
            print(f"x{factor:g} | mean | {mean[0]:.4f} | {mean[1]:.4f} | {mean[2]:.4f}")
    print(f"true | | {1e3 * DIAMETER_M:.4f} | {1e3 * DIAMETER_M:.4f} | {1e3 * APART_M:.4f}")


if __name__ == "__main__":
    main()
