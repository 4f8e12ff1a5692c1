"""The part file: what is known about a part, as YAML.

Units are in the keys; unknown keys are refused.

::

    id: scene4                       # required; letters, digits, _ . -
    mesh:                            # required
      file: scene4.stl               # required; STL, PLY or OBJ; relative to the part file, or
          absolute
      unit: m                        # required; m, cm, mm or inch
      sha256: 0123...                # hash of the mesh file's bytes; checked when given
    points: points.csv               # left out: none; CSV, see skinplan.part.points_file; relative
        to the part file, or absolute
    fixture:                         # left out: a row of markers below the part
        (skinplan.part.defaults)
      dictionary: DICT_5X5_100       # required; ArUco dictionary as OpenCV names it
      pose_in_workpiece:             # T_workpiece_fixture; left out: fixture = workpiece
        translation_m: [0, -0.5, 0]
        rotation_xyzw: [0, 0, 0, 1]  # left out: no rotation
      markers:                       # required: at least one, or the word none (and no
          dictionary): the part is then located by its shape
        - id: 0                      # required, unique
          size_m: 0.10               # required; side of the black square
          pose_in_fixture:           # required; T_fixture_marker (x right, y up, z out of the
              print)
            translation_m: [0, 0, 0]
    placement:                       # T_map_workpiece; left out: upright at the origin of the shop
      translation_m: [0, 0, 1.05]
      rotation_xyzw: [0.707, 0, 0, 0.707]
    scan:                            # every key of skinplan.part.model.ScanSettings; what is left
        out has its default
      standoff_m: 0.3
    inspection:                      # tolerances and characteristics, see
        skinplan.part.inspection_plan; left out: measured, but not judged
      deviation_max_m: 0.0005
    recognition:                     # whether the cell makes sure that it is this part, see
        skinplan.part.recognition_plan; left out: it does not
      check: true
"""

import re
from pathlib import Path
from typing import Any

import yaml

from skinplan.errors import MeshHashError, PartInvalidError
from skinplan.mesh.check import check_mesh
from skinplan.mesh.load import UNITS_M, file_sha256, load_mesh
from skinplan.mesh.model import SurfaceMesh
from skinplan.part.defaults import default_fixture, default_placement
from skinplan.part.fields import Fields, pose_fields
from skinplan.part.fixture_file import fixture_fields, read_fixture, read_yaml
from skinplan.part.inspection_plan import InspectionPlan, plan_fields, read_plan
from skinplan.part.inspection_points import InspectionPoints
from skinplan.part.model import Part, ScanSettings
from skinplan.part.points_file import read_points, write_points
from skinplan.part.recognition_plan import (
    RecognitionPlan,
    read_recognition,
    recognition_fields,
)
from skinplan.part.settings import read_settings, settings_fields
from skinplan.transforms import Array

PART_ID = re.compile(r"[A-Za-z0-9_.-]{1,64}")
PART_KEYS = ("id", "mesh", "points", "fixture", "placement", "scan", "inspection", "recognition")


def load_part(path: Path | str) -> Part:
    """Reads a part file.

    Args:
        path: The YAML file.

    Returns:
        The part; its mesh exists and has the stated hash, but is not loaded unless fixture or
        placement need its box, or measuring points have to be on it.

    Raises:
        PartNotFoundError: No such file.
        PartInvalidError: A key is unknown or missing, or a value is out of range.
        InspectionPointsError: The measuring points can't be used.
        MeshError: The mesh is missing, can't be read, or has another hash.
    """
    file = Path(path)
    fields = Fields(read_yaml(file), "", file.name, PART_KEYS)
    part_id = fields.text("id")
    if not PART_ID.fullmatch(part_id):
        raise fields.error("id", repr(part_id), "1 to 64 letters, digits, '_', '.' or '-'")
    mesh_path, unit, digest = _read_mesh(fields, file.parent)
    placed = fields.has("fixture") and fields.has("placement")
    bounds, points = None, None
    if fields.has("points") or not placed:
        mesh = load_mesh(mesh_path, unit)
        points = _read_points(fields, file.parent, unit, mesh)
        bounds = None if placed else check_mesh(mesh)[0].bounds
    return Part(
        id=part_id,
        mesh_path=mesh_path,
        unit=unit,
        mesh_sha256=digest,
        fixture=read_fixture(fields, file.parent)
        if fields.has("fixture")
        else default_fixture(_box(bounds)),
        T_map_workpiece=fields.pose("placement")
        if fields.has("placement")
        else default_placement(_box(bounds)),
        scan=read_settings(fields.values["scan"], "scan", file.name)
        if fields.has("scan")
        else ScanSettings(),
        source=file.resolve(),
        points=points,
        inspection=read_plan(fields.values["inspection"], file.name)
        if fields.has("inspection")
        else InspectionPlan(),
        recognition=read_recognition(fields.values["recognition"], file.parent, file.name)
        if fields.has("recognition")
        else RecognitionPlan(),
    )


def save_part(part: Part, path: Path | str) -> Path:
    """Writes a part file; reading it gives the same part.

    Args:
        part: What to write.
        path: The YAML file; its folder must exist. A mesh in the same folder is named relative to
            it. Measuring points go into a file beside it, ``points.csv`` beside ``part.yaml``.

    Returns:
        The absolute path.

    Raises:
        PartInvalidError: The file can't be written.
    """
    file = Path(path).resolve()
    mesh = part.mesh_path.resolve()
    values = {
        "id": part.id,
        "mesh": {
            "file": mesh.name if mesh.parent == file.parent else str(mesh),
            "unit": part.unit,
            "sha256": part.mesh_sha256,
        },
        **({} if part.points is None else {"points": _points_file(file).name}),
        "fixture": fixture_fields(part.fixture),
        "placement": pose_fields(part.T_map_workpiece),
        "scan": settings_fields(part.scan),
        **(
            {}
            if part.inspection == InspectionPlan()
            else {"inspection": plan_fields(part.inspection)}
        ),
        **(
            {}
            if part.recognition == RecognitionPlan()
            else {"recognition": recognition_fields(part.recognition)}
        ),
    }
    try:
        if part.points is not None:
            write_points(part.points, _points_file(file), part.unit)
        file.write_text(
            yaml.safe_dump(values, sort_keys=False, default_flow_style=None), encoding="utf-8"
        )
    except OSError as error:
        raise PartInvalidError(
            f"the part file {file} can't be written: {error.strerror}"
        ) from error
    return file


def _points_file(file: Path) -> Path:
    return file.with_name("points.csv" if file.stem == "part" else f"{file.stem}.points.csv")


def _read_points(
    fields: Fields, folder: Path, unit: str, mesh: SurfaceMesh
) -> InspectionPoints | None:
    if not fields.has("points"):
        return None
    accepted = "the path of a CSV file with measuring points"
    name = fields.text("points", accepted)
    if "\0" in name:
        raise fields.error("points", repr(name), accepted)
    return read_points((folder / name).resolve(), unit, mesh)


def _read_mesh(fields: Fields, folder: Path) -> tuple[Path, str, str]:
    values: Any = fields.values.get("mesh")
    mesh = Fields(values, "mesh", fields.source, ("file", "unit", "sha256"))
    unit = mesh.text("unit", f"one of {', '.join(UNITS_M)}")
    if unit not in UNITS_M:
        raise mesh.error("unit", repr(unit), f"one of {', '.join(UNITS_M)}")
    path = (folder / mesh.text("file", "the path of a mesh file")).resolve()
    digest = file_sha256(path)
    if mesh.has("sha256"):
        stated = mesh.text("sha256").lower()
        if stated != digest:
            raise MeshHashError(
                f"{fields.source}: the mesh {path.name} should have the SHA-256 "
                f"{stated[:12]}..., found {digest[:12]}...; "
                "the mesh that the part file was written for is accepted, or a part file with "
                "the new hash"
            )
    return path, unit, digest


def _box(bounds: Array | None) -> Array:
    assert bounds is not None
    return bounds
