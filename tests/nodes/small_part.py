"""A part that is planned in a moment: a panel of 0.5 m x 0.3 m with a bump."""

from pathlib import Path

import trimesh
from skinplan_msgs.msg import PartReference

import meshes
from skinplan.part.model import Part
from skinplan.part.resolve import resolve_part


def write_small_part(
    folder: Path, height_m: float = 0.03, size_m: tuple[float, float] = (0.5, 0.3)
) -> Part:
    """Writes mesh and part file; the bump is so high."""
    surface = meshes.grid(*size_m, 0.01, lambda x, y: meshes.bump(x, y, height_m, 0.06))
    path = folder / "panel.stl"
    trimesh.Trimesh(surface.vertices, surface.faces, process=False).export(path)
    return resolve_part(str(path), "m", folder)


def reference(part: Part, **changes: str) -> PartReference:
    """The reference of a part, with changes."""
    fields = {"uri": str(part.source), "mesh_sha256": part.mesh_sha256, **changes}
    return PartReference(**fields)
