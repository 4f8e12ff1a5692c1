"""Scan path: how long the stages take, and what the paths see.

Run as ``python benchmarks/scan_path.py [--triangles N] [MESH ...]``; prints a table of the four
sample parts (or of meshes in metres). One run each; the certificate has samples every 5 mm.
"""

import argparse
import resource
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from skinplan.mesh.check import check_mesh
from skinplan.mesh.load import load_mesh
from skinplan.mesh.segment import segment_mesh
from skinplan.part.model import ScanSettings
from skinplan.part.samples import SAMPLES, write_sample
from skinplan.scan_path.plan import plan_scan_path, rows_only_path
from skinplan.scanner.coverage import certify, coverage_figures
from skinplan.scanner.model import ScannerModel

STAGES = ("load", "doctor", "segment", "path", "certify")


def measure(file: Path) -> str:
    """Runs all stages on a mesh and returns a line of the table."""
    settings = ScanSettings()
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
    seen = certify(mesh, segmentation, path, scanner)
    times.append(time.perf_counter())
    rows = certify(mesh, segmentation, rows_only_path(mesh, segmentation, settings), scanner)
    figures = coverage_figures(seen, rows)
    spans = [later - earlier for earlier, later in zip(times[:-1], times[1:], strict=True)]
    columns = [f"{file.stem[:24]:24}", f"{len(mesh.faces):9}"]
    columns += [f"{span:8.2f}" for span in spans] + [f"{sum(spans[:4]):8.2f}"]
    columns += [f"{path.row_points:5}", f"{path.feature_points:5}"]
    columns += [f"{100 * figures.area_ratio:7.2f}", f"{100 * figures.feature_area_ratio:7.2f}"]
    columns += [f"{100 * figures.rows_only_area_ratio:7.2f}"]
    columns += [f"{100 * figures.rows_only_feature_area_ratio:7.2f}"]
    return " ".join(columns)


def meshes(given: list[Path], triangles: int) -> Iterator[Path]:
    """Yields the given meshes, or the samples, freshly written."""
    if given:
        yield from given
        return
    with tempfile.TemporaryDirectory() as folder:
        for name in SAMPLES:
            yield write_sample(name, Path(folder) / name, triangles).mesh_path


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--triangles", type=int, default=100_000, help="of the sample parts")
    parser.add_argument("mesh", type=Path, nargs="*", help="meshes in metres; none = the samples")
    options = parser.parse_args()
    heads = [f"{'part':24}", f"{'faces':>9}", *(f"{stage:>8}" for stage in (*STAGES, "plan"))]
    heads += [f"{'rows':>5}", f"{'feat':>5}", f"{'seen':>7}", f"{'feat':>7}"]
    print(" ".join([*heads, f"{'by rows':>7}", f"{'feat':>7}"]))
    print("times in s (plan = load to path), seen in % of the area, by rows = row cutting alone")
    for file in meshes(options.mesh, options.triangles):
        print(measure(file), flush=True)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"largest memory {peak:.0f} MiB")


if __name__ == "__main__":
    main()
