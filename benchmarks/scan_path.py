"""Scan path: how long the stages take, how much memory, and what the paths see.

Run as ``python benchmarks/scan_path.py [--triangles N ...] [--samples NAME ...] [--large]`` or with
meshes in metres. Prints a table; one run each, every mesh in a process of its own. ``--large`` adds
scene4 with five million triangles. Growth is the exponent of the planning time between two sizes of
the same part: n log n is 1.08 from 100 k to 1 M triangles, 1.07 from there to 5 M.
The certificate has samples every 5 mm; that of 500 poses is made for scene4 (2.9 x 0.8 m).
"""

import argparse
import dataclasses
import json
import math
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from skinplan.mesh.check import check_mesh
from skinplan.mesh.load import load_mesh
from skinplan.mesh.segment import segment_mesh
from skinplan.part.model import ScanSettings
from skinplan.part.samples import PANELS, write_sample
from skinplan.scan_path.plan import plan_scan_path, rows_only_path
from skinplan.scanner.coverage import certify, coverage_figures
from skinplan.scanner.model import ScannerModel

STAGES = ("load", "doctor", "segment", "path")
SIZES = (20_000, 100_000, 1_000_000)
LARGE = 5_000_000
POSES = 500


def peak_mib() -> float:
    """Returns the largest memory of this process so far [MiB].

    The kernel's own mark: that of `getrusage` outlives the start of a new program.
    """
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) / 1024 for line in lines if line.startswith("VmHWM"))


def measure(file: Path, strategy: str) -> dict[str, Any]:
    """Runs all stages on a mesh in metres."""
    settings = dataclasses.replace(ScanSettings(), strategy=strategy)
    scanner = ScannerModel.from_settings(settings)
    times = [time.perf_counter()]
    loaded = load_mesh(file, "m")
    times.append(time.perf_counter())
    mesh, _ = check_mesh(loaded)
    times.append(time.perf_counter())
    segmentation = segment_mesh(mesh)
    times.append(time.perf_counter())
    path = plan_scan_path(mesh, segmentation, settings)
    times.append(time.perf_counter())
    planned = peak_mib()
    seen = certify(mesh, segmentation, path, scanner)
    times.append(time.perf_counter())
    rows = certify(mesh, segmentation, rows_only_path(mesh, segmentation, settings), scanner)
    figures = coverage_figures(seen, rows)
    again = np.arange(POSES) % len(path)
    many = dataclasses.replace(
        path,
        **{
            name: getattr(path, name)[again]
            for name in ("positions", "directions", "targets", "kinds", "groups")
        },
    )
    begin = time.perf_counter()
    certify(mesh, segmentation, many, scanner)
    return {
        "faces": len(mesh.faces),
        "spans": np.diff(times).tolist(),
        "memory": planned,
        "points": [path.row_points, path.feature_points],
        "seen": [
            figures.area_ratio,
            figures.feature_area_ratio,
            figures.rows_only_area_ratio,
            figures.rows_only_feature_area_ratio,
        ],
        "certificate": time.perf_counter() - begin,
    }


def in_own_process(file: Path, strategy: str) -> dict[str, Any]:
    """Measures in a fresh process, so that the memory is that of this mesh alone."""
    command = [sys.executable, __file__, "--one", "--strategy", strategy, str(file)]
    found = subprocess.run(command, check=True, capture_output=True, text=True)
    return dict(json.loads(found.stdout.splitlines()[-1]))


def line(name: str, found: dict[str, Any], earlier: dict[str, Any] | None) -> str:
    """Returns a line of the table."""
    plan = sum(found["spans"][:4])
    growth = "       "
    if earlier is not None:
        ratio = plan / sum(earlier["spans"][:4])
        growth = f"{math.log(ratio) / math.log(found['faces'] / earlier['faces']):7.2f}"
    columns = [f"{name[:24]:24}", f"{found['faces']:9}"]
    columns += [f"{span:8.2f}" for span in found["spans"][:4]] + [f"{plan:8.2f}", growth]
    columns += [f"{found['memory']:7.0f}", *(f"{count:5}" for count in found["points"])]
    columns += [f"{found['spans'][4]:8.2f}", f"{found['certificate']:8.2f}"]
    columns += [f"{100 * share:7.2f}" for share in found["seen"]]
    return " ".join(columns)


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--triangles", type=int, nargs="*", default=SIZES, help="of the samples")
    parser.add_argument("--samples", nargs="*", default=PANELS, choices=PANELS)
    parser.add_argument("--large", action="store_true", help="scene4 with 5 M triangles too")
    parser.add_argument("--strategy", default="published")
    parser.add_argument("--one", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("mesh", type=Path, nargs="*", help="meshes in metres; none = the samples")
    options = parser.parse_args()
    if options.one:
        print(json.dumps(measure(options.mesh[0], options.strategy)))
        return
    heads = [f"{'part':24}", f"{'faces':>9}", *(f"{stage:>8}" for stage in (*STAGES, "plan"))]
    heads += [" growth", f"{'MiB':>7}", f"{'rows':>5}", f"{'feat':>5}", f"{'certify':>8}"]
    heads += [f"{POSES:>8}", f"{'seen':>7}", f"{'feat':>7}", f"{'by rows':>7}", f"{'feat':>7}"]
    print(" ".join(heads))
    print(
        "times in s (plan = load to path; 500 = certificate of so many poses), MiB = peak of the "
        "process up to the path,\nseen in % of the area, by rows = row cutting alone"
    )
    for file in options.mesh:
        print(line(file.stem, in_own_process(file, options.strategy), None), flush=True)
    for name in () if options.mesh else options.samples:
        sizes = [*options.triangles, *([LARGE] if options.large and name == "scene4" else [])]
        earlier = None
        for triangles in sizes:
            with tempfile.TemporaryDirectory() as folder:
                file = write_sample(name, Path(folder) / name, triangles).mesh_path
                found = in_own_process(file, options.strategy)
            print(line(name, found, earlier), flush=True)
            earlier = found


if __name__ == "__main__":
    main()
