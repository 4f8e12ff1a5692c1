"""Reach records of many stations: time and memory, and how both grow.

Run as ``python benchmarks/reach.py [--growth]``: sample part ``scene4``, its published scan path,
17 views of each point (straight and 16 tilted), 500 places before the part, with collision, without
and with the tracker. ``--growth`` also measures more points and more stations. One run each.
"""

import argparse
import resource
import tempfile
import time
from pathlib import Path

import numpy as np

from skinplan.mesh.check import check_mesh
from skinplan.mesh.load import load_mesh
from skinplan.mesh.model import SurfaceMesh
from skinplan.mesh.segment import segment_mesh
from skinplan.part.defaults import default_placement
from skinplan.part.model import ScanSettings
from skinplan.part.samples import write_sample
from skinplan.robot.batch import ReachEngine
from skinplan.robot.cell import load_cell
from skinplan.robot.distance_field import distance_field
from skinplan.robot.tracker import TrackerSight
from skinplan.scan_path.model import ScanPath
from skinplan.scan_path.plan import plan_scan_path
from skinplan.transforms import Array, planar


def scene() -> tuple[SurfaceMesh, ScanPath]:
    """Returns mesh and published scan path of the largest sample."""
    with tempfile.TemporaryDirectory() as folder:
        file = write_sample("scene4", Path(folder)).mesh_path
        mesh, _ = check_mesh(load_mesh(file, "m"))
    return mesh, plan_scan_path(mesh, segment_mesh(mesh), ScanSettings(strategy="published"))


def places(count: int) -> Array:
    """Returns base poses evenly over the strip before the part, shape (count, 4, 4) [m]."""
    rows = 8
    columns = -(-count // rows)
    x, y = np.linspace(-1.5, 1.5, columns), np.linspace(-1.15, -0.7, rows)
    return np.array([planar(u, v, 0.0) for u in x for v in y])[:count]


def measure(mesh: SurfaceMesh, path: ScanPath, stations: int, points: int, tracker: bool) -> str:
    """Fills one table and returns a line about it."""
    cell, T = load_cell(), default_placement(mesh.bounds)
    which = np.arange(points) % len(path)
    # Repeated points are moved a little along the part, so that none is the same as another.
    shift = 1e-3 * (np.arange(points) // len(path))[:, None] * np.array([1.0, 0.0, 0.0])
    views = (path.positions[which] + shift, path.directions[which], path.targets[which] + shift)
    sight = TrackerSight(cell, mesh, T) if tracker else None
    engine = ReachEngine(cell, mesh, T, views, ScanSettings().tilt_max_rad, sight)
    begin, cpu = time.perf_counter(), time.process_time()
    table = engine.table(places(stations))
    span, cpu = time.perf_counter() - begin, time.process_time() - cpu
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    return (
        f"{stations:8} {points:7} {'yes' if tracker else 'no':>8} {span:8.2f} {cpu:8.2f} "
        f"{1e6 * span / (stations * points):9.1f} {100.0 * table.reached.mean():8.1f} {memory:8.0f}"
    )


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--growth", action="store_true", help="up to 5,000 points and stations")
    growth = parser.parse_args().growth
    mesh, path = scene()
    begin = time.perf_counter()
    distance_field(mesh)
    print(f"distance field, once for a part: {time.perf_counter() - begin:.2f} s")
    print("stations  points  tracker   time s    CPU s   us/pair  reached % peak MiB")
    sizes = [(500, 450, False), (500, 450, True)]
    if growth:
        sizes += [(500, 1000, True), (500, 5000, True), (1000, 450, True), (5000, 450, True)]
    for stations, points, tracker in sizes:
        print(measure(mesh, path, stations, points, tracker), flush=True)


if __name__ == "__main__":
    main()
