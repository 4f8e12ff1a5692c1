"""The sample parts: four panels and an engine.

The panels have the sizes of Table 1 (M4) and the features that its text describes, the engine is
that of C 4.
"""

import functools
import hashlib
import math
import os
import shutil
import tempfile
from pathlib import Path

from skinplan.errors import PartInvalidError, PartNotFoundError
from skinplan.mesh.load import load_mesh
from skinplan.part import (
    defaults,
    engine,
    engine_sample,
    files,
    inspection_points,
    model,
    points_file,
    shapes,
)
from skinplan.part.model import Part
from skinplan.part.shapes import Panel, Plateau, write_stl

TRIANGLES = 100_000
CACHE_VARIABLE = "SKINPLAN_CACHE"


def _plateau(
    centre: tuple[float, float],
    size: tuple[float, float],
    corner: float,
    height: float,
    wall_deg: float,
    fillet: float,
) -> Plateau:
    return Plateau(centre, size, corner, height, math.radians(wall_deg), fillet)


def _grooves() -> tuple[Plateau, ...]:
    return tuple(
        _plateau((x, 0.0), (0.040, 0.48), 0.0199, -0.015, 62.0, 0.003)
        for x in (-0.24, -0.12, 0.0, 0.12, 0.24)
    )


_PANELS = {
    # Upper wing panel: smooth, low curvature.
    "scene1": Panel((1.8, 1.0), 2.6, 12.0, ()),
    # Vertical stabiliser of a helicopter: grooves.
    "scene2": Panel((0.7, 0.6), 3.0, 0.0, _grooves()),
    # Lower wing panel: two recesses and a bump.
    "scene3": Panel(
        (2.5, 0.9),
        3.6,
        0.0,
        (
            _plateau((-0.80, 0.08), (0.26, 0.18), 0.08, -0.045, 62.0, 0.015),
            _plateau((0.05, -0.10), (0.21, 0.21), 0.10, 0.060, 65.0, 0.015),
            _plateau((0.85, 0.06), (0.27, 0.17), 0.07, -0.035, 63.0, 0.015),
        ),
    ),
    # Section of a fuselage: bumps with steep sides.
    "scene4": Panel(
        (2.9, 0.8),
        2.0,
        0.0,
        (
            _plateau((-0.95, 0.05), (0.27, 0.20), 0.08, 0.060, 62.0, 0.025),
            _plateau((0.00, -0.06), (0.22, 0.22), 0.10, 0.080, 65.0, 0.025),
            _plateau((0.95, 0.04), (0.27, 0.22), 0.09, 0.100, 68.0, 0.025),
        ),
    ),
}
ENGINE = "engine"
#: The samples that are panels to be scanned; all have the same default fixture and placement.
PANELS = tuple(_PANELS)
SAMPLES = (*PANELS, ENGINE)
SAMPLE_TITLES = {
    "scene1": "upper wing panel, smooth, 1.8 x 1.0 m",
    "scene2": "vertical stabiliser with grooves, 0.7 x 0.6 m",
    "scene3": "lower wing panel with recesses and a bump, 2.5 x 0.9 m",
    "scene4": "fuselage section with steep-sided bumps, 2.9 x 0.8 m",
    ENGINE: "engine with 150 measuring points on three surfaces, 2.6 m long, 0.6 m thick",
}


def sample_panel(name: str) -> Panel:
    """Returns the shape of a sample panel.

    Raises:
        PartNotFoundError: No panel of that name.
    """
    if name not in _PANELS:
        raise PartNotFoundError(f"no sample panel {name!r}; there are {', '.join(PANELS)}")
    return _PANELS[name]


def write_sample(name: str, folder: Path, triangles: int = TRIANGLES) -> Part:
    """Writes mesh and part file of a sample; the bytes are always the same.

    Args:
        name: One of `SAMPLES`.
        folder: Where ``<name>.stl`` and ``part.yaml`` go, and ``points.csv`` and ``cell.yaml`` of
            the engine; created when missing.
        triangles: About how many triangles the mesh has.

    Returns:
        The part.

    Raises:
        PartNotFoundError: No sample of that name.
        PartInvalidError: The folder can't be written.
    """
    if name not in SAMPLES:
        raise PartNotFoundError(f"no sample part {name!r}; there are {', '.join(SAMPLES)}")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        # Others may read or write the same files now: each appears at once, the part file last.
        work = Path(tempfile.mkdtemp(prefix=".writing-", dir=folder))
        try:
            if name == ENGINE:
                part = engine_sample.write_engine(work, triangles)
            else:
                part = _write_panel(name, work, triangles)
            files.save_part(part, work / "part.yaml")
            for file in sorted(work.iterdir(), key=lambda file: (file.name == "part.yaml", file)):
                os.replace(file, folder / file.name)
        finally:
            shutil.rmtree(work, ignore_errors=True)
    except OSError as error:
        raise PartInvalidError(
            f"the sample {name} can't be written to {folder}: {error.strerror}"
        ) from error
    return files.load_part(folder / "part.yaml")


def _write_panel(name: str, folder: Path, triangles: int) -> Part:
    vertices, faces = sample_panel(name).triangulate(triangles)
    write_stl(folder / f"{name}.stl", vertices, faces)
    mesh = load_mesh(folder / f"{name}.stl", "m")
    return Part(
        id=name,
        mesh_path=folder / f"{name}.stl",
        unit="m",
        mesh_sha256=mesh.sha256,
        fixture=defaults.default_fixture(mesh.bounds),
        T_map_workpiece=defaults.default_placement(mesh.bounds),
    )


def sample_folder() -> Path:
    """Returns the folder that keeps written samples, ``~/.cache/skinplan/<version>``.

    The environment variable SKINPLAN_CACHE replaces ``~/.cache/skinplan``. The version changes with
    everything that shapes the files.
    """
    chosen = os.environ.get(CACHE_VARIABLE)
    root = (
        Path(chosen)
        if chosen
        else Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser() / "skinplan"
    )
    return root / _version()


@functools.cache
def _version() -> str:
    digest = hashlib.sha256()
    rooms = (
        shapes,
        defaults,
        files,
        model,
        engine,
        engine_sample,
        inspection_points,
        points_file,
    )
    for file in (__file__, *(str(room.__file__) for room in rooms)):
        digest.update(Path(file).read_bytes())
    return digest.hexdigest()[:12]
