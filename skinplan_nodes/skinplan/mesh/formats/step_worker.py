"""Makes triangles of a STEP file; run as a process of its own by `skinplan.mesh.formats.step`.

Run as ``python -m skinplan.mesh.formats.step_worker IN.step OUT.npz DISTANCE_MM ANGLE_RAD``.
"""

import importlib
import sys
from typing import Any

import numpy as np

_LARGEST_MM = 100_000.0


def main(source: str, result: str, distance_mm: str, angle_rad: str) -> None:
    """Reads one file and writes the arrays ``vertices`` [mm] and ``faces``.

    Raises:
        SystemExit: With the reason, when there is nothing to read.
    """
    shape = _read(source)
    distance = float(distance_mm)
    if _extent(shape) > _LARGEST_MM:
        # Too large for a part, and refused later: fine triangles would take minutes.
        distance = max(distance, _extent(shape) * 1e-3)
    _module("BRepMesh").BRepMesh_IncrementalMesh(shape, distance, False, float(angle_rad), False)
    points, faces = [np.zeros((0, 3))], [np.zeros((0, 3), dtype=np.int64)]
    before = 0
    for face in _faces(shape):
        found = _triangles(face)
        if found is None:
            continue
        points.append(found[0])
        faces.append(found[1] + before)
        before += len(found[0])
    np.savez(result, vertices=np.concatenate(points), faces=np.concatenate(faces))


def _module(name: str) -> Any:
    return importlib.import_module(f"OCP.{name}")


def _read(source: str) -> Any:
    # Open CASCADE converts every length to millimetres unless told otherwise.
    reader = _module("STEPControl").STEPControl_Reader()
    status = reader.ReadFile(source)
    if status != _module("IFSelect").IFSelect_ReturnStatus.IFSelect_RetDone:
        sys.exit("the file is damaged")
    if reader.TransferRoots() == 0:
        sys.exit("the file has no shape")
    shape = reader.OneShape()
    if shape.IsNull():
        sys.exit("the file has no shape")
    return shape


def _extent(shape: Any) -> float:
    """Returns the diagonal of the shape's box [mm]."""
    box = _module("Bnd").Bnd_Box()
    _module("BRepBndLib").BRepBndLib.Add_s(shape, box)
    return 0.0 if box.IsVoid() else float(box.SquareExtent()) ** 0.5


def _faces(shape: Any) -> Any:
    kinds = _module("TopAbs").TopAbs_ShapeEnum
    explorer = _module("TopExp").TopExp_Explorer(shape, kinds.TopAbs_FACE)
    while explorer.More():
        yield _module("TopoDS").TopoDS.Face(explorer.Current())
        explorer.Next()


def _triangles(face: Any) -> tuple[Any, Any] | None:
    """Returns points, shape (v, 3) [mm], and triangles, shape (f, 3), of a face."""
    location = _module("TopLoc").TopLoc_Location()
    mesh = _module("BRep").BRep_Tool.Triangulation_s(face, location)
    if mesh is None:
        return None
    place = location.Transformation()
    points = [mesh.Node(number + 1).Transformed(place) for number in range(mesh.NbNodes())]
    faces = [mesh.Triangle(number + 1).Get() for number in range(mesh.NbTriangles())]
    corners = np.array(faces, dtype=np.int64).reshape(-1, 3) - 1
    if face.Orientation() == _module("TopAbs").TopAbs_Orientation.TopAbs_REVERSED:
        corners = corners[:, ::-1]
    return np.array([[p.X(), p.Y(), p.Z()] for p in points]).reshape(-1, 3), corners


if __name__ == "__main__":
    main(*sys.argv[1:])
