"""Stations: how many, what they really reach, how long planning takes.

Run as ``python benchmarks/stations.py [--strategy reach] [--path published] [MESH ...]``; prints a
table of the four sample parts (or of meshes in metres). One run each. The first line pays for the
workspace rectangle, derived once; each line for the distance field of its part.
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
from skinplan.stations.rectangle import workspace_rectangle


def measure(file: Path, scan: ScanSettings) -> str:
    """Plans the stations of a mesh and returns a line of the table."""
    cell = load_cell()
    mesh, _ = check_mesh(load_mesh(file, "m"))
    path = plan_scan_path(mesh, segment_mesh(mesh), scan)
    begin = time.perf_counter()
    plan = plan_stations(path, default_placement(mesh.bounds), mesh, scan, cell)
    span = time.perf_counter() - begin
    columns = [f"{file.stem[:26]:26}", f"{len(path):6}", f"{plan.candidates:6}"]
    columns += [f"{len(plan.stations):8}", f"{plan.lower_bound:6}"]
    columns += [f"{'yes' if plan.proven_optimal else 'no':>6}", f"{100 * plan.reached_ratio:8.2f}"]
    columns += [f"{100 * plan.robust_ratio:8.2f}"]
    columns += [f"{len(plan.skipped):7}", f"{span:7.2f}"]
    columns += [" " + "/".join(str(len(station.points)) for station in plan.stations)]
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
    parser.add_argument("mesh", type=Path, nargs="*", help="meshes in metres; none = the samples")
    parser.add_argument("--strategy", default="reach", help="station strategy")
    parser.add_argument("--path", default="published", help="scan path strategy")
    options = parser.parse_args()
    scan = ScanSettings(strategy=options.path, station_strategy=options.strategy)
    found = workspace_rectangle(load_cell(), ScanSettings().standoff_m)
    print(
        f"workspace rectangle {found.length_m:.2f} x {found.depth_m:.2f} m, "
        f"its middle {found.offset_m:.3f} m beside the arm axis"
    )
    heads = [f"{'part':26}", f"{'points':>6}", f"{'cands':>6}", f"{'stations':>8}", f"{'bound':>6}"]
    heads += [
        f"{'proven':>6}",
        f"{'reach %':>8}",
        f"{'robust %':>8}",
        f"{'skipped':>7}",
        f"{'time s':>7}",
    ]
    print(" ".join([*heads, " points of each"]))
    for file in meshes(options.mesh):
        print(measure(file, scan), flush=True)


if __name__ == "__main__":
    main()
