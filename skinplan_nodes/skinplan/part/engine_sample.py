"""The files of the sample part ``engine``: its shell, its measuring points, its cell.

The shell is open at both ends, as that of an engine is: the mesh doctor would keep one side of a
closed solid only, and measuring points are on all sides. It lies as the panels stand: the side with
the points faces the tracker of the default cell, the middle is at the origin of the shop.
"""

from pathlib import Path

import numpy as np

from skinplan.mesh.load import load_mesh
from skinplan.part.engine import ARM_BASE_HEIGHT_M, LENGTH_M, engine_mesh, engine_points
from skinplan.part.inspection_points import InspectionPoints
from skinplan.part.model import Fixture, Marker, Part, ScanSettings
from skinplan.part.shapes import write_stl
from skinplan.transforms import Array, transform

MESH, POINTS, CELL = "engine.stl", "points.csv", "cell.yaml"
_DECIMALS = 9
_DICTIONARY = "DICT_5X5_100"
_MARKER_SIZE_M, _MARKER_PITCH_M, _MARKERS = 0.10, 0.40, 6
# The stand is narrow and low: scanner and arm go below the engine, and the camera sees over 0.2 m.
_MARKER_HEIGHT_M = 0.30  # above the floor
_MARKER_X_M = 0.0
_CELL_TEXT = """\
# The arm of the example that the sample part engine is taken from, on a vehicle as high as its
# base: robot and height are published, the rest is estimated. The camera looks to the left.
robot: gcr14_1400
home_rad: {home}
T_base_link_arm_base: {{translation_m: [0.0, 0.0, {height}]}}
base_size_m: [0.9, 0.7, {height}]
camera:
  T_base_link_camera_link:
    translation_m: [0.3, 0.36, 0.45]
    rotation_xyzw: [0.0, 0.0, 0.7071067811865476, 0.7071067811865476]
"""
_HOME_RAD = [1.57, -2.6, -2.2, 1.65, -1.57, 0.0]


def write_engine(folder: Path, triangles: int) -> Part:
    """Writes mesh and cell file of the sample to a folder.

    Args:
        folder: An existing folder.
        triangles: About how many triangles the mesh has.

    Returns:
        The part, without part file.
    """
    made = engine_mesh(triangles, ends=False)
    write_stl(folder / MESH, made.vertices, made.faces)
    cell = _CELL_TEXT.format(height=ARM_BASE_HEIGHT_M, home=_HOME_RAD)
    (folder / CELL).write_text(cell, encoding="utf-8")
    return Part(
        id="engine",
        mesh_path=folder / MESH,
        unit="m",
        mesh_sha256=load_mesh(folder / MESH, "m").sha256,
        fixture=shop_fixture(),
        T_map_workpiece=shop_placement(),
        scan=ScanSettings(strategy="points", station_strategy="axial_radial"),
        points=inspection_points(),
    )


def inspection_points() -> InspectionPoints:
    """Returns the 150 points, rounded to nanometres: every machine writes the same."""
    points, normals, surfaces = engine_points()
    return InspectionPoints(np.round(points, _DECIMALS), np.round(normals, _DECIMALS), surfaces)


def shop_placement() -> Array:
    """Returns ``T_map_workpiece``, shape (4, 4) [m]: the engine lies along x, its points at -y."""
    turn = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    return transform((0.5 * LENGTH_M, 0.0, ARM_BASE_HEIGHT_M), turn)


def shop_fixture() -> Fixture:
    """Makes the stand below the engine, with a row of markers that face the points' side."""
    # Fixture x to the right of who looks at the markers (workpiece y), y up, z out of the print.
    turn = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    place = (_MARKER_X_M, -0.5 * LENGTH_M, _MARKER_HEIGHT_M - ARM_BASE_HEIGHT_M)
    offsets = (np.arange(_MARKERS) - 0.5 * (_MARKERS - 1)) * _MARKER_PITCH_M
    markers = tuple(
        Marker(number, _MARKER_SIZE_M, transform((round(float(x), 6), 0.0, 0.0)))
        for number, x in enumerate(offsets)
    )
    return Fixture(_DICTIONARY, transform(place, turn), markers)
