"""Strategy ``patches`` beside the others, and what merging the rows of two parts saves.

Run as ``python benchmarks/patches.py [--picture FILE] [MESH ...]`` with meshes in metres; without
any, the sample panels. Prints two tables: rows, points and certificate (samples every 5 mm) of each
strategy per part; rows and turns of two stated layouts of two parts, separate and merged. A turn is
the way from the end of a row to the next. The picture shows the second layout from above.
"""

import argparse
import dataclasses
import time
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from skinplan.mesh.check import check_mesh
from skinplan.mesh.load import load_mesh
from skinplan.mesh.model import SurfaceMesh
from skinplan.mesh.segment import segment_mesh
from skinplan.part.model import ScanSettings
from skinplan.part.samples import PANELS, sample_panel
from skinplan.part.shapes import Panel
from skinplan.scan_path.model import ROW, ScanPath
from skinplan.scan_path.plan import plan_scan_path
from skinplan.scanner.coverage import certify
from skinplan.scanner.model import ScannerModel

STRATEGIES = ("published", "coverage", "patches")
# A curved strip of skin; two of them lean against each other.
LONG, NARROW = Panel((0.6, 0.3), 1.7, 0.0, ()), Panel((0.9, 0.12), 1.7, 0.0, ())
SPRAY = {"standoff_m": 0.25, "field_radius_m": 0.05, "overlap_ratio": 0.0}


def placed(
    panel: Panel, place: tuple[float, float, float], lean_deg: float, axis: str
) -> SurfaceMesh:
    """Returns a part turned about an axis and put at a place [m]."""
    vertices, faces = panel.triangulate(4000)
    turn = Rotation.from_euler(axis, lean_deg, degrees=True).as_matrix()
    return SurfaceMesh(vertices @ turn.T + np.array(place), faces)


def both(first: SurfaceMesh, second: SurfaceMesh) -> SurfaceMesh:
    """Returns one mesh of two parts."""
    faces = np.concatenate([first.faces, second.faces + len(first.vertices)])
    return check_mesh(SurfaceMesh(np.concatenate([first.vertices, second.vertices]), faces))[0]


def layouts() -> dict[str, SurfaceMesh]:
    """Returns the layouts: end to end 60 mm apart, side by side 40 mm apart."""
    return {
        "two of 0.6 x 0.3 m end to end, 60 mm apart, 8 degrees": both(
            placed(LONG, (-0.33, 0.0, 0.0), 4.0, "y"), placed(LONG, (0.33, 0.02, 0.01), -4.0, "y")
        ),
        "two of 0.9 x 0.12 m side by side, 40 mm apart, 12 degrees": both(
            placed(NARROW, (0.0, -0.08, 0.0), 6.0, "x"),
            placed(NARROW, (0.05, 0.08, 0.01), -6.0, "x"),
        ),
    }


def planned(mesh: SurfaceMesh, **changes: object) -> tuple[ScanPath, float, float]:
    """Returns a path, the share of the area that it sees, and the time that planning took [s]."""
    settings = dataclasses.replace(ScanSettings(), **changes)  # type: ignore[arg-type]
    segmentation = segment_mesh(mesh)
    begin = time.perf_counter()
    path = plan_scan_path(mesh, segmentation, settings)
    took = time.perf_counter() - begin
    seen = certify(mesh, segmentation, path, ScannerModel.from_settings(settings))
    return path, seen.area_ratio, took


def rows(path: ScanPath) -> int:
    """Returns the number of rows."""
    return len(np.unique(path.groups[path.kinds == ROW]))


def compare(parts: dict[str, SurfaceMesh]) -> None:
    """Prints the table of the strategies."""
    print(f"{'part':32} {'strategy':10} {'rows':>5} {'points':>6} {'seen %':>8} {'s':>6}")
    for name, mesh in parts.items():
        for strategy in STRATEGIES:
            path, area, took = planned(mesh, strategy=strategy)
            print(
                f"{name:32} {strategy:10} {rows(path):5} {len(path):6} {100 * area:8.3f} "
                f"{took:6.2f}",
                flush=True,
            )


def merging() -> None:
    """Prints the table of the layouts."""
    print(
        f"\n{'layout':60} {'tool':8} {'turns apart':>11} {'merged':>7} {'saved %':>8} {'seen %':>8}"
    )
    for name, mesh in layouts().items():
        for tool, changes in (("scanner", {}), ("spray", SPRAY)):
            apart = planned(mesh, strategy="patches", merge_gap_m=0.0, **changes)[0]
            merged, area, _ = planned(mesh, strategy="patches", **changes)
            before, after = rows(apart) - 1, rows(merged) - 1
            print(
                f"{name:60} {tool:8} {before:11} {after:7} {100 * (1 - after / before):8.0f} "
                f"{100 * area:8.2f}"
            )


def draw(file: Path) -> None:
    """Draws rows of both layouts, separate and merged, from above."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(2, 2, figsize=(11.0, 5.6), layout="constrained")
    for line, (name, mesh) in zip(axes, layouts().items(), strict=True):
        for axis, gap in zip(line, (0.0, ScanSettings().merge_gap_m), strict=True):
            path = planned(mesh, strategy="patches", merge_gap_m=gap)[0]
            axis.tripcolor(
                *mesh.vertices[:, :2].T,
                mesh.faces,
                np.ones(len(mesh.faces)),
                cmap="Greys",
                vmin=0.0,
                vmax=4.0,
            )
            for row in np.unique(path.groups):
                places = path.targets[path.groups == row]
                axis.plot(*places[:, :2].T, ".-", color="tab:blue", linewidth=1.2, markersize=5)
            kind = "each part on its own" if gap == 0.0 else "merged"
            axis.set_title(f"{name}\n{kind}: {rows(path)} rows, {rows(path) - 1} turns", fontsize=9)
            axis.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
    figure.savefig(file, dpi=110)


def main() -> None:
    """Prints the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--picture", type=Path, help="write a picture of the layouts")
    parser.add_argument("mesh", type=Path, nargs="*", help="meshes in metres; none = the samples")
    options = parser.parse_args()
    if options.mesh:
        parts = {file.stem: check_mesh(load_mesh(file, "m"))[0] for file in options.mesh}
    else:
        parts = {
            name: SurfaceMesh(*sample_panel(name).triangulate(100_000)) for name in sorted(PANELS)
        }
    compare(parts)
    merging()
    if options.picture is not None:
        draw(options.picture)


if __name__ == "__main__":
    main()
