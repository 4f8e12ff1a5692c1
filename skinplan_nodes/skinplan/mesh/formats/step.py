"""STEP files, through the optional package ``cadquery-ocp`` (Open CASCADE).

Open CASCADE runs in a process of its own: a broken file can make it crash or never end, and then
only that process is lost.
"""

import importlib.util
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from skinplan.errors import InputError, MeshExtraMissingError
from skinplan.mesh.formats.raw import FormatError, RawMesh
from skinplan.mesh.model import Finding

_MAGIC = b"ISO-10303-21;"
_MILLIMETRE_M = 1e-3
_LONGEST_S = 300.0


@dataclass(frozen=True)
class Tessellation:
    """How near triangles have to be to the surfaces of a STEP file.

    Attributes:
        distance_m: Largest distance between a triangle and its surface [m].
        angle_rad: Largest angle between the normals of neighbouring triangles [rad].
    """

    distance_m: float = 1e-4
    angle_rad: float = 0.1

    def __post_init__(self) -> None:
        if not (1e-7 <= self.distance_m <= 1.0 and 1e-3 <= self.angle_rad <= 1.6):
            raise InputError(
                f"a tessellation within {self.distance_m} m and {self.angle_rad} rad was asked "
                "for; 1e-7 m to 1 m and 0.001 rad to 1.6 rad are accepted"
            )


def read_step(data: bytes, tessellation: Tessellation) -> RawMesh:
    """Reads a STEP file.

    Args:
        data: The file.
        tessellation: How fine the triangles are to be.

    Returns:
        The mesh in millimetres, whatever the unit of the file is.

    Raises:
        FormatError: It is none, or Open CASCADE can't read it.
        MeshExtraMissingError: The optional package is not installed.
    """
    if not data.lstrip()[: len(_MAGIC)] == _MAGIC:
        raise FormatError(f"it does not begin with {_MAGIC.decode()}")
    if importlib.util.find_spec("OCP") is None:
        raise MeshExtraMissingError(
            "STEP files need the optional package cadquery-ocp, which is not installed; `make "
            "extras` installs it; STL, PLY and OBJ files are accepted without it"
        )
    with tempfile.TemporaryDirectory(prefix="skinplan-step-") as folder:
        source, result = Path(folder) / "part.step", Path(folder) / "part.npz"
        source.write_bytes(data)
        _tessellate(source, result, tessellation)
        with np.load(result) as arrays:
            vertices, faces = arrays["vertices"], arrays["faces"]
    detail = (
        f"STEP surfaces were made triangles within {tessellation.distance_m * 1e3:g} mm and "
        f"{tessellation.angle_rad:g} rad; the unit is the file's own, the stated one is not used"
    )
    finding = Finding("tessellated", len(faces), "noted", detail)
    return RawMesh(vertices, faces, (finding,), _MILLIMETRE_M)


def _tessellate(source: Path, result: Path, tessellation: Tessellation) -> None:
    command = [sys.executable, "-m", "skinplan.mesh.formats.step_worker", str(source), str(result)]
    command += [str(tessellation.distance_m / _MILLIMETRE_M), str(tessellation.angle_rad)]
    try:
        done = subprocess.run(command, capture_output=True, timeout=_LONGEST_S, check=False)
    except subprocess.TimeoutExpired as error:
        raise FormatError(f"Open CASCADE did not end within {_LONGEST_S:g} s") from error
    if done.returncode != 0 or not result.is_file():
        said = done.stderr.decode(errors="replace").strip().splitlines()
        reason = said[-1][:200] if said and done.returncode > 0 else f"code {done.returncode}"
        raise FormatError(f"Open CASCADE gave up: {reason}")
