"""Coverage certificate: how long each part of it takes, for points and along the motion.

Run as ``python benchmarks/certificate.py [--triangles N] [--poses N] [--field cone]``; the part is
the sample scene4 (2.9 x 0.8 m), samples every 5 mm, with the fixture. Everything of a certificate
is counted: rays, samples, what can be seen at all, views, figures, facets and both files. The poses
are those of row cutting on a grid over the part, so that not all of it is seen. Best of three runs,
wall time and processor time of each part (on a busy machine the second one counts).
"""

import argparse
import json
import resource
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from skinplan.mesh.load import load_mesh
from skinplan.mesh.model import Segmentation, SurfaceMesh
from skinplan.mesh.segment import segment_mesh
from skinplan.part.model import Part, ScanSettings
from skinplan.part.samples import write_sample
from skinplan.scan_path.model import ROW, ScanPath
from skinplan.scanner.coverage_ply import write_coverage_ply
from skinplan.scanner.document import coverage_document
from skinplan.scanner.facet_states import unseen_facets
from skinplan.scanner.figures import all_figures
from skinplan.scanner.predict import part_certifier


def grid_path(mesh: SurfaceMesh, poses: int, standoff_m: float) -> ScanPath:
    """Makes rows of poses over the part, all looking down its mean normal, z."""
    low, high = mesh.bounds
    length, width = (high - low)[:2]
    rows = max(1, round(np.sqrt(poses * width / length)))
    columns = -(-poses // rows)
    x, y = np.meshgrid(
        np.linspace(low[0], high[0], columns), np.linspace(low[1], high[1], rows), indexing="xy"
    )
    places = np.column_stack([x.ravel(), y.ravel()])[:poses]
    _, near = cKDTree(mesh.centroids[:, :2]).query(places)
    targets = np.column_stack([places, mesh.centroids[near, 2]])
    directions = np.tile([0.0, 0.0, -1.0], (len(targets), 1))
    return ScanPath(
        targets - standoff_m * directions,
        directions,
        targets,
        np.full(len(targets), ROW),
        np.repeat(np.arange(rows), columns)[: len(targets)],
        "grid",
        0,
    )


def measure(
    mesh: SurfaceMesh, segmentation: Segmentation, path: ScanPath, part: Part, scan: ScanSettings
) -> tuple[dict[str, np.ndarray], str]:
    """Runs one certificate; returns wall and processor time of its parts [s], and what is seen."""
    spans: dict[str, np.ndarray] = {}

    def timed(name: str, call: Callable[[], Any]) -> Any:
        begin = np.array([time.perf_counter(), time.process_time()])
        result = call()
        spans[name] = np.array([time.perf_counter(), time.process_time()]) - begin
        return result

    # A fresh mesh keeps nothing from the run before.
    fresh = SurfaceMesh(mesh.vertices, mesh.faces)
    certifier = timed(
        "samples, rays", lambda: part_certifier(fresh, segmentation, scan, part.fixture)
    )
    timed("can be seen", lambda: certifier.can_be_seen)
    points = timed("points", lambda: certifier.points(path))
    timed("figures", lambda: all_figures(points))
    timed("facets", lambda: unseen_facets(points))
    with tempfile.TemporaryDirectory() as folder:
        timed("document", lambda: json.dumps(coverage_document(points)))
        timed("ply", lambda: write_coverage_ply(Path(folder) / "c.ply", fresh, points))
    spans["whole"] = np.sum(list(spans.values()), axis=0)
    motion = timed("motion too", lambda: certifier.motion(path))
    return spans, f"seen: {points.area_ratio:.2%} of the area, with motion {motion.area_ratio:.2%}"


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--triangles", type=int, default=100_000)
    parser.add_argument("--poses", type=int, default=500)
    parser.add_argument("--field", default="cylinder", help="cylinder or cone")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        part = write_sample("scene4", Path(folder), options.triangles)
        mesh = load_mesh(part.mesh_path, part.unit)
    scan = ScanSettings(field_of_view=options.field)
    path = grid_path(mesh, options.poses, scan.standoff_m)
    segmentation = segment_mesh(mesh)
    runs = [measure(mesh, segmentation, path, part, scan) for _ in range(3)]
    print(f"{len(mesh.faces)} triangles, {len(path)} poses, field of view {options.field}")
    print(f"{'part':14} {'wall s':>8} {'cpu s':>8} share")
    best = {name: np.min([spans[name] for spans, _ in runs], axis=0) for name in runs[0][0]}
    for name, (wall, cpu) in best.items():
        print(f"{name:14} {wall:8.3f} {cpu:8.3f} {cpu / best['whole'][1]:5.0%}")
    print(runs[0][1])
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"largest memory {peak:.0f} MiB")


if __name__ == "__main__":
    main()
