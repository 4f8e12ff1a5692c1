"""The cover solver: time to the proof.

Run as ``python benchmarks/cover.py [MATRIX.npz ...]``: instances like those of stations before a
panel, and of cameras about a surface; or sparse matrices saved by ``scipy.sparse.save_npz``, rows =
what is to be covered. One run each, at most 60 s of search.
"""

import argparse
import time
from pathlib import Path

import numpy as np
from scipy.sparse import csr_matrix, load_npz

from skinplan.cover.minimum import minimum_cover

_LIMIT_S = 60.0


def stations(count: int, points: int) -> csr_matrix:
    """Windows along a panel that grow with its length, narrower far from the panel."""
    rng = np.random.default_rng(0)
    length = 2.9 * max(1.0, points / 2000.0)
    p = np.stack([rng.uniform(0.0, length, points), rng.uniform(-0.4, 0.4, points)], axis=1)
    s = np.stack([rng.uniform(0.0, length, count), rng.uniform(0.6, 1.1, count)], axis=1)
    half = 0.65 - np.abs(s[:, 1] - 0.8)[None] - 0.3 * np.abs(p[:, 1])[:, None]
    return csr_matrix(np.abs(p[:, :1] - s[:, 0][None]) < half)


def views(count: int, cells: int, radius: float) -> csr_matrix:
    """Discs of different sizes on a square."""
    rng = np.random.default_rng(1)
    p, c = rng.uniform(0.0, 1.0, (cells, 2)), rng.uniform(0.0, 1.0, (count, 2))
    gap = np.linalg.norm(p[:, None] - c[None], axis=2)
    return csr_matrix(gap < radius * (0.8 + 0.4 * rng.random((1, count))))


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("matrix", type=Path, nargs="*", help="sparse matrices (.npz)")
    files = parser.parse_args().matrix
    cases = {file.stem: csr_matrix(load_npz(file)) for file in files} or {
        "stations 500": stations(500, 2000),
        "stations 1000": stations(1000, 2000),
        "stations 5000": stations(5000, 5000),
        "views 250": views(250, 900, 0.16),
        "views 400": views(400, 1800, 0.12),
        "views 600": views(600, 3000, 0.09),
        "views 900": views(900, 4760, 0.12),
    }
    print(
        f"{'instance':16} {'rows':>6} {'columns':>8} {'cover':>6} {'bound':>6} {'proven':>7} time s"
    )
    for name, matrix in cases.items():
        begin = time.perf_counter()
        found = minimum_cover(matrix, _LIMIT_S)
        span = time.perf_counter() - begin
        print(
            f"{name[:16]:16} {matrix.shape[0]:6} {matrix.shape[1]:8} {found.cost:6g} "
            f"{found.lower_bound:6g} {'yes' if found.proven else 'no':>7} {span:6.2f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
