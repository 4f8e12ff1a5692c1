"""Writes a coverage certificate as a mesh with colours."""

from pathlib import Path

import numpy as np

from skinplan.errors import InputError
from skinplan.mesh.model import SurfaceMesh
from skinplan.scanner.facet_states import facet_states
from skinplan.scanner.model import Coverage
from skinplan.whole_file import whole_file

_NOT_JUDGED = (255, 255, 255)
_FACE = np.dtype(
    [("count", "u1"), ("corners", "<i4", 3), ("colour", "u1", 3), ("sight", "i1")], align=False
)


def write_coverage_ply(path: Path, mesh: SurfaceMesh, coverage: Coverage) -> None:
    """Writes the part with a colour for each facet as binary little-endian PLY, in one step.

    The comments of the file are the legend. The state stands beside the colour as ``sight``
    (`skinplan.scanner.sight.Sight`).

    Args:
        path: The file; a reader sees the old one or the whole new one.
        mesh: The mesh that was certified, or one with the same faces (moved, for example).
        coverage: The certificate.

    Raises:
        InputError: Another mesh, or a file that can't be written.
    """
    states = facet_states(coverage)
    if len(mesh.faces) != len(states.codes):
        raise InputError(
            f"{path}: the certified mesh of {len(states.codes)} faces is accepted, found one of "
            f"{len(mesh.faces)} faces"
        )
    faces = np.zeros(len(mesh.faces), dtype=_FACE)
    faces["count"], faces["corners"], faces["sight"] = 3, mesh.faces, states.codes
    # Code -1, not judged, takes the last colour.
    faces["colour"] = np.vstack([states.colours, [_NOT_JUDGED]])[states.codes]
    try:
        with whole_file(path) as temporary, temporary.open("wb") as stream:
            stream.write(_header(mesh, states.names, states.colours).encode("ascii"))
            stream.write(mesh.vertices.astype("<f4").tobytes())
            stream.write(faces.tobytes())
    except OSError as error:
        raise InputError(
            f"{path}: a file in a folder that can be written is accepted, but it can't be "
            f"written ({error.strerror or error})"
        ) from error


def _header(mesh: SurfaceMesh, names: tuple[str, ...], colours: np.ndarray) -> str:
    legend = [
        f"comment sight {code} {name}: red {red} green {green} blue {blue}"
        for code, (name, (red, green, blue)) in enumerate(zip(names, colours, strict=True))
    ]
    lines = [
        "ply",
        "format binary_little_endian 1.0",
        "comment frame workpiece, unit m",
        *legend,
        f"element vertex {len(mesh.vertices)}",
        "property float x",
        "property float y",
        "property float z",
        f"element face {len(mesh.faces)}",
        "property list uchar int vertex_indices",
        "property uchar red",
        "property uchar green",
        "property uchar blue",
        "property char sight",
        "end_header",
    ]
    return "\n".join(lines) + "\n"
