"""Row cutting: skinplan beside trimesh and VTK, same mesh, same planes.

Run as ``python benchmarks/row_cutting.py [--triangles N ...] [--interval M] [--repeats N]``. Every
way cuts the sample part scene4 at the planes of its rows; the best of some repeats counts. The
mesh is loaded and its normals are known before: only cutting is timed. Ways that stop at unordered
segments and ways that end in polylines are told apart. `pyvista` is optional.
"""

import argparse
import time
from collections.abc import Callable

import numpy as np
import trimesh

from skinplan.mesh.model import SurfaceMesh
from skinplan.part.samples import sample_panel
from skinplan.scan_path.cut import cut_mesh
from skinplan.scan_path.frame import RowFrame, base_normal, candidate_frames
from skinplan.scan_path.rows import plane_offsets

try:
    import pyvista
    import vtk
except ImportError:
    pyvista = None


def best(repeats: int, run: Callable[[], int]) -> tuple[float, int]:
    """Returns the shortest time [s] and the number of curves."""
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        curves = run()
        times.append(time.perf_counter() - begin)
    return min(times), curves


def ways_of_trimesh(mesh: SurfaceMesh, frame: RowFrame, offsets: np.ndarray) -> dict:
    """Returns the ways to cut with trimesh, by name."""
    solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)

    def segments() -> int:
        lines, _, _ = trimesh.intersections.mesh_multiplane(
            solid, np.zeros(3), frame.across, offsets
        )
        return sum(len(found) > 0 for found in lines)

    def polylines() -> int:
        sections = solid.section_multiplane(np.zeros(3), frame.across, offsets)
        return sum(len(section.entities) for section in sections if section is not None)

    return {
        "trimesh mesh_multiplane (segments only)": segments,
        "trimesh section_multiplane": polylines,
    }


def ways_of_vtk(mesh: SurfaceMesh, frame: RowFrame, offsets: np.ndarray) -> dict:
    """Returns the ways to cut with VTK, by name."""
    if pyvista is None:
        return {}
    surface = pyvista.PolyData.from_regular_faces(mesh.vertices, mesh.faces)
    surface["height"] = mesh.vertices @ frame.across

    def stripped(cut: object) -> int:
        strip = vtk.vtkStripper()
        strip.SetJoinContiguousSegments(True)
        strip.SetMaximumLength(10_000_000)
        strip.SetInputData(cut)
        strip.Update()
        return int(strip.GetOutput().GetNumberOfLines())

    def cutter() -> int:
        plane = vtk.vtkPlane()
        plane.SetOrigin(0, 0, 0)
        plane.SetNormal(*frame.across)
        found = vtk.vtkCutter()
        found.SetCutFunction(plane)
        found.SetInputData(surface)
        for number, offset in enumerate(offsets):
            found.SetValue(number, offset)
        found.Update()
        return stripped(found.GetOutput())

    def slices() -> int:
        return sum(
            stripped(surface.slice(normal=frame.across, origin=frame.across * offset))
            for offset in offsets
        )

    def plane_cutter() -> int:
        curves = 0
        for offset in offsets:
            plane = vtk.vtkPlane()
            plane.SetOrigin(*(frame.across * offset))
            plane.SetNormal(*frame.across)
            found = vtk.vtkPolyDataPlaneCutter()
            found.SetPlane(plane)
            found.SetInputData(surface)
            found.Update()
            curves += stripped(found.GetOutput())
        return curves

    def contours() -> int:
        return stripped(surface.contour(offsets, scalars="height", compute_normals=False))

    return {
        "VTK vtkCutter, all planes at once": cutter,
        "VTK vtkPolyDataPlaneCutter, plane by plane": plane_cutter,
        "pyvista contour of the height": contours,
        "pyvista slice, plane by plane": slices,
    }


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--triangles", type=int, nargs="*", default=[100_000, 1_000_000])
    parser.add_argument("--interval", type=float, default=0.08, help="distance of the planes [m]")
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    for triangles in options.triangles:
        mesh = SurfaceMesh(*sample_panel("scene4").triangulate(triangles))
        frame = candidate_frames(mesh.vertices, base_normal(mesh))[0]
        use = np.ones(len(mesh.faces), dtype=bool)
        offsets = plane_offsets(mesh, use, frame.across, options.interval) + 1e-7
        normals = mesh.vertex_normals

        def ours(
            mesh: SurfaceMesh = mesh,
            normals: np.ndarray = normals,
            use: np.ndarray = use,
            frame: RowFrame = frame,
            offsets: np.ndarray = offsets,
        ) -> int:
            return len(cut_mesh(mesh, normals, use, frame, offsets).starts) - 1

        ways = {"skinplan cut_mesh (polylines, normals)": ours}
        ways |= ways_of_trimesh(mesh, frame, offsets)
        ways |= ways_of_vtk(mesh, frame, offsets)
        print(f"{len(mesh.faces)} triangles, {len(offsets)} planes")
        own = 0.0
        for name, run in ways.items():
            span, curves = best(options.repeats, run)
            own = own or span
            print(f"  {name:44} {1e3 * span:9.1f} ms {span / own:6.2f} x   {curves} curves")
        if pyvista is None:
            print("  VTK                                             not installed")


if __name__ == "__main__":
    main()
