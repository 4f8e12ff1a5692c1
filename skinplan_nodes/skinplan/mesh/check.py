"""The mesh doctor: what is wrong with a mesh, what is repaired, what is refused.

Repairs; each is safe, and doing them twice changes nothing:

1. Vertices that no face uses are removed.
2. Vertices on open edges that differ by rounding noise (1e-6 of the part's size) are made one.
3. Faces without area and faces that name the same three vertices as another are removed.
4. Connected parts smaller than 1 % of the largest are debris and removed, flaps below 0.1 % too; so
   are parts that can't be seen from the scanner's side, such as the inner of two parallel skins.
5. The faces of each connected part are wound alike; the part then looks to the scanner's side.
6. Of a closed solid or a double skin only the side that faces the scanner is kept.

Noted only: an unusual size, several parts, holes, open cracks, T-junctions, non-manifold edges,
one-sided parts, a surface of which much looks away from the scanner or stands upright.
Refused: nothing left, nothing that faces the scanner, more than 10 million faces, numbers that are
not finite.
"""

import logging
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from skinplan.errors import InputError, MeshEmptyError, MeshNotFiniteError, MeshRefusedError
from skinplan.mesh.doctor.boundary import note_crowded_edges, note_holes, note_t_junctions
from skinplan.mesh.doctor.faces import drop_flat_faces, drop_repeated_faces, drop_unused_vertices
from skinplan.mesh.doctor.parts import drop_debris, drop_hidden_parts, note_parts
from skinplan.mesh.doctor.patient import Patient
from skinplan.mesh.doctor.sides import keep_one_side, note_facing_away
from skinplan.mesh.doctor.weld import weld_cracks
from skinplan.mesh.doctor.winding import note_one_sided, wind_alike
from skinplan.mesh.formats.raw import MOST_FACES
from skinplan.mesh.model import Finding, SurfaceMesh
from skinplan.mesh.units import unit_doubts
from skinplan.transforms import Array

_REPAIRS: tuple[Callable[[Patient, list[Finding]], Patient], ...] = (
    drop_unused_vertices,
    weld_cracks,
    drop_flat_faces,
    drop_repeated_faces,
    drop_debris,
    drop_hidden_parts,
    wind_alike,
    keep_one_side,
)
_NOTES: tuple[Callable[[Patient, list[Finding]], None], ...] = (
    note_parts,
    note_crowded_edges,
    note_t_junctions,
    note_holes,
    note_one_sided,
    note_facing_away,
)
# One repair can make room for the next; each removes or turns something, so this ends early.
_MOST_ROUNDS = 20
_log = logging.getLogger(__name__)


def check_mesh(
    mesh: SurfaceMesh, toward: ArrayLike = (0.0, 0.0, 1.0)
) -> tuple[SurfaceMesh, tuple[Finding, ...]]:
    """Examines and repairs a mesh.

    Args:
        mesh: As loaded.
        toward: The side that the scanner is on, shape (3,), in the mesh's frame; by convention the
            outward side of a part is +z of its workpiece frame.

    Returns:
        The repaired mesh (same hash: it names the file), and what was found.

    Raises:
        InputError: `toward` is no direction.
        MeshEmptyError: No faces.
        MeshNotFiniteError: A vertex is NaN or infinite.
        MeshRefusedError: It can't be planned on; the error's `findings` say why.
    """
    patient = Patient(_checked(mesh), _direction(toward))
    findings: list[Finding] = []
    try:
        for _ in range(_MOST_ROUNDS):
            before = patient
            for repair in _REPAIRS:
                patient = repair(patient, findings)
            if patient is before:
                break
    except MeshRefusedError as error:
        raise MeshRefusedError(str(error), _merged(error.findings)) from None
    extent = float(np.ptp(patient.mesh.bounds, axis=0).max())
    findings += unit_doubts(extent)
    for note in _NOTES:
        note(patient, findings)
    merged = _merged(findings)
    for finding in merged:
        _log.info(
            "mesh: %d %s, %s: %s", finding.count, finding.name, finding.action, finding.detail
        )
    return patient.mesh, merged


def _direction(toward: ArrayLike) -> Array:
    vector = np.asarray(toward, dtype=float)
    length = float(np.linalg.norm(vector)) if vector.shape == (3,) else 0.0
    if not (np.isfinite(length) and length > 0):
        raise InputError(
            f"the scanner's side {toward!r} was given; a direction of three finite numbers, not "
            "all 0, is accepted"
        )
    return vector / length


def _checked(mesh: SurfaceMesh) -> SurfaceMesh:
    vertices, faces = np.asarray(mesh.vertices, dtype=float), np.asarray(mesh.faces)
    if len(faces) == 0 or len(vertices) == 0:
        raise MeshEmptyError("the mesh has no faces; a mesh with at least one face is accepted")
    if vertices.shape[1:] != (3,) or faces.shape[1:] != (3,) or faces.dtype.kind not in "iu":
        raise InputError(
            f"vertices of shape {vertices.shape} and faces of shape {faces.shape} and type "
            f"{faces.dtype} were given; (v, 3) and whole numbers (f, 3) are accepted"
        )
    if len(faces) > MOST_FACES:
        raise _refusal(
            "huge mesh",
            len(faces),
            f"the mesh has {len(faces)} faces; up to {MOST_FACES} are accepted: decimate it, 5 mm "
            "triangles are enough",
        )
    if faces.min() < 0 or faces.max() >= len(vertices):
        strange = int(np.count_nonzero(((faces < 0) | (faces >= len(vertices))).any(axis=1)))
        raise _refusal(
            "faces without vertices",
            strange,
            f"{strange} faces name vertices that the mesh does not have; numbers from 0 to "
            f"{len(vertices) - 1} are accepted",
        )
    if not np.isfinite(vertices).all():
        broken = int(np.count_nonzero(~np.isfinite(vertices).all(axis=1)))
        message = f"{broken} vertices are NaN or infinite; finite numbers are accepted"
        finding = Finding("vertices not finite", broken, "refused", message)
        raise MeshNotFiniteError(message, (finding,))
    return replace(mesh, vertices=vertices, faces=faces.astype(np.int64, copy=False))


def _refusal(name: str, count: int, message: str) -> MeshRefusedError:
    return MeshRefusedError(message, (Finding(name, count, "refused", message),))


def _merged(findings: list[Finding] | tuple[Finding, ...]) -> tuple[Finding, ...]:
    """Returns one finding of each name and action; the counts of several rounds are added."""
    merged: dict[tuple[str, str], Finding] = {}
    for finding in findings:
        key = (finding.name, finding.action)
        if key in merged:
            finding = replace(merged[key], count=merged[key].count + finding.count)
        merged[key] = finding
    return tuple(merged.values())
