"""Inspection: speed of comparing points with a part, and of coverage beside the scanner.

Run as ``python benchmarks/inspection.py [--points N]``; prints a table.
"""

import argparse
import resource
import time

import numpy as np

from skinplan.inspection.coverage import CoverageSoFar
from skinplan.inspection.measure import inspect
from skinplan.mesh.model import Segmentation, SurfaceMesh
from skinplan.scanner.samples import sample_surface

WIDTH_M, HEIGHT_M, STEP_M = 2.9, 0.8, 0.0068  # about 100,000 triangles


def panel() -> SurfaceMesh:
    """A curved panel with three bumps."""
    x, y = np.meshgrid(
        np.arange(-WIDTH_M / 2, WIDTH_M / 2, STEP_M),
        np.arange(-HEIGHT_M / 2, HEIGHT_M / 2, STEP_M),
        indexing="ij",
    )
    z = np.sqrt(4.0 - y**2) - 2.0
    for centre in (-0.9, 0.0, 0.9):
        z += 0.08 * np.exp(-((x - centre) ** 2 + y**2) / 0.1**2)
    number = np.arange(x.size).reshape(x.shape)
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    faces = np.concatenate(
        [np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)]
    )
    return SurfaceMesh(np.stack([x, y, z], axis=-1).reshape(-1, 3), faces)


def measured(mesh: SurfaceMesh, count: int, rng: np.random.Generator) -> np.ndarray:
    """Points on the panel with 0.03 mm of noise along the normal."""
    face = rng.integers(0, len(mesh.faces), count)
    points = np.einsum("nc,nci->ni", rng.dirichlet(np.ones(3), count), mesh.corners[face])
    return points + rng.normal(size=(count, 1)) * 3e-5 * mesh.face_normals[face]


def stream(
    mesh: SurfaceMesh, rng: np.random.Generator, frames: int = 500, per_frame: int = 900
) -> float:
    """Returns the mean time of a frame of a scanner that sweeps the panel [s]."""
    coverage = CoverageSoFar(sample_surface(mesh))
    points = measured(mesh, 400_000, rng)
    spent = 0.0
    for k in range(frames):
        centre = np.array([-WIDTH_M / 2 + WIDTH_M * k / frames, 0.3 * np.sin(k / 10.0)])
        seen = points[np.hypot(*(points[:, :2] - centre).T) < 0.2]
        frame = seen[rng.choice(len(seen), min(per_frame, len(seen)), replace=False)]
        begin = time.perf_counter()
        coverage.add(frame, np.array([0.0, 0.0, -1.0]))
        spent += time.perf_counter() - begin
    return spent / frames


def main() -> None:
    """Runs both and prints the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--points", type=int, default=1_000_000)
    count = parser.parse_args().points
    mesh, rng = panel(), np.random.default_rng(0)
    per_frame = stream(mesh, rng)
    points = measured(mesh, count, rng)
    begin = time.perf_counter()
    found = inspect(
        points, mesh, Segmentation(np.zeros(len(mesh.faces), np.int64), mesh), np.eye(4)
    )
    whole = time.perf_counter() - begin
    print(f"triangles                         {len(mesh.faces):>12,}")
    print(
        f"coverage of a frame of 900 points {per_frame * 1e3:>12.2f} ms  "
        f"({per_frame * 50 * 100:.0f} % of a core at 50/s)"
    )
    print(
        f"inspection of {count:>9,} points   {whole:>12.1f} s   ({count / whole / 1e3:,.0f} "
        "thousand points/s)"
    )
    print(f"alignment residual                {found.alignment.rms_m * 1e6:>12.1f} um")
    print(
        "peak memory                       "
        f"{resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20:>12.2f} GiB"
    )


if __name__ == "__main__":
    main()
