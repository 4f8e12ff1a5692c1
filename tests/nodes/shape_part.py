"""Files of parts without markers."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh

import meshes
from shape_parts import LENGTH_M, WIDTH_M, two_bumps
from skinplan.part.files import load_part, save_part
from skinplan.part.model import Fixture, Part
from skinplan.part.resolve import resolve_part
from skinplan.transforms import Array, transform

# Low, so that the level camera of the base sees it also from near.
_PLACE = transform((0.0, 0.0, 0.60), np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]))


def write_shape_part(
    folder: Path, name: str = "two_bumps", height: Callable[[Array, Array], Array] = two_bumps
) -> Part:
    """Writes mesh and part file; the fixture has no markers."""
    folder.mkdir(exist_ok=True)
    surface = meshes.grid(LENGTH_M, WIDTH_M, 0.01, height)
    path = folder / "panel.stl"
    trimesh.Trimesh(surface.vertices, surface.faces, process=False).export(path)
    made = resolve_part(str(path), "m", folder)
    assert made.source is not None
    bare = Fixture("", np.eye(4), ())
    save_part(replace(made, id=name, fixture=bare, T_map_workpiece=_PLACE), made.source)
    return load_part(made.source)
