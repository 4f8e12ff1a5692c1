"""Trajectories: cycle time by its parts, breaks, what is skipped, how long planning takes.

Run as ``python benchmarks/trajectory.py [MESH ...]``; prints a table of the four sample parts (or
of meshes in metres) with the base at its nominal poses. One run each.
"""

import argparse
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from skinplan.mesh.check import check_mesh
from skinplan.mesh.load import load_mesh
from skinplan.mesh.segment import segment_mesh
from skinplan.part.defaults import default_placement
from skinplan.part.model import ScanSettings
from skinplan.part.samples import PANELS, write_sample
from skinplan.robot.cell import load_cell
from skinplan.scan_path.plan import plan_scan_path
from skinplan.stations.plan import plan_stations
from skinplan.trajectory.cycle import cycle_time
from skinplan.trajectory.plan import plan_trajectories


def measure(file: Path, tcp_speed_m_s: float) -> str:
    """Plans the trajectories of a mesh and returns a line of the table."""
    scan, cell = ScanSettings(tcp_speed_m_s=tcp_speed_m_s), load_cell()
    mesh, _ = check_mesh(load_mesh(file, "m"))
    path = plan_scan_path(mesh, segment_mesh(mesh), scan)
    place = default_placement(mesh.bounds)
    stations = plan_stations(path, place, mesh, scan, cell)
    begin = time.perf_counter()
    found = plan_trajectories(path, stations, place, mesh, scan, cell)
    span = time.perf_counter() - begin
    cycle = cycle_time(stations, found, cell, scan, path)
    columns = [f"{file.stem[:26]:26}", f"{len(path):6}", f"{len(stations.stations):8}"]
    times = (cycle.cycle_s, cycle.scan_s, cycle.transit_s, cycle.base_s, cycle.lower_bound_s)
    columns += [f"{value:8.1f}" for value in times]
    columns += [f"{cycle.breaks:6}", f"{sum(len(t.skipped) for t in found):7}"]
    columns += [f"{cycle.tcp_path_m:7.1f}", f"{span:7.2f}"]
    return " ".join(columns)


def meshes(given: list[Path]) -> Iterator[Path]:
    """Yields the given meshes, or the samples, freshly written."""
    if given:
        yield from given
        return
    with tempfile.TemporaryDirectory() as folder:
        for name in PANELS:
            yield write_sample(name, Path(folder) / name).mesh_path


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tcp-speed", type=float, default=0.2, help="scanner speed limit [m/s]")
    parser.add_argument("mesh", type=Path, nargs="*", help="meshes in metres; none = the samples")
    options = parser.parse_args()
    heads = [f"{'part':26}", f"{'points':>6}", f"{'stations':>8}", f"{'cycle s':>8}"]
    heads += [f"{'scan s':>8}", f"{'transit':>8}", f"{'base s':>8}", f"{'bound s':>8}"]
    heads += [f"{'breaks':>6}", f"{'skipped':>7}", f"{'way m':>7}", f"{'plan s':>7}"]
    print(" ".join(heads))
    print(f"scanner at most {options.tcp_speed} m/s; bound = rows at that speed")
    for file in meshes(options.mesh):
        print(measure(file, options.tcp_speed), flush=True)


if __name__ == "__main__":
    main()
