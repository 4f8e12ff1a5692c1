"""Faces and vertices that say nothing: without area, given twice, used by nobody."""

import numpy as np
from numpy.typing import NDArray

from skinplan.errors import MeshRefusedError
from skinplan.mesh.doctor.patient import Patient, places
from skinplan.mesh.model import Finding
from skinplan.mesh.topology import Indices, Mask
from skinplan.transforms import Array

_LEAST_HEIGHT_M = 1e-7
_EXACT_BELOW = 2_000_000


def drop_unused_vertices(patient: Patient, findings: list[Finding]) -> Patient:
    """Removes vertices that no face uses."""
    mesh = patient.mesh
    used = np.zeros(len(mesh.vertices), dtype=bool)
    used[mesh.faces] = True
    if used.all():
        return patient
    where = places(mesh.vertices[~used])
    count = int(np.count_nonzero(~used))
    findings.append(
        Finding("unreferenced vertices", count, "repaired", "no face used them; removed", where)
    )
    return patient.keeping(np.ones(len(mesh.faces), dtype=bool))


def drop_flat_faces(patient: Patient, findings: list[Finding]) -> Patient:
    """Removes faces whose height is below 0.1 um.

    Raises:
        MeshRefusedError: No other face is left.
    """
    mesh = patient.mesh
    flat = 2 * mesh.face_areas <= _LEAST_HEIGHT_M * _longest_sides(patient)
    count = int(np.count_nonzero(flat))
    if not count:
        return patient
    where = places(mesh.centroids[flat])
    if flat.all():
        finding = Finding("degenerate faces", count, "refused", "no face has an area", where)
        raise MeshRefusedError(
            f"all {count} faces are degenerate; a mesh with area is accepted",
            (*findings, finding),
        )
    detail = "faces without area were removed"
    findings.append(Finding("degenerate faces", count, "repaired", detail, where))
    return patient.keeping(~flat)


def drop_repeated_faces(patient: Patient, findings: list[Finding]) -> Patient:
    """Removes all but one of the faces that name the same three vertices.

    The one that faces the scanner is kept, of several the first.
    """
    repeated = _repeated(patient.mesh.faces, patient.facing, len(patient.mesh.vertices))
    count = int(np.count_nonzero(repeated))
    if not count:
        return patient
    where = places(patient.mesh.centroids[repeated])
    detail = "one of each was kept"
    findings.append(Finding("duplicate faces", count, "repaired", detail, where))
    return patient.keeping(~repeated)


def _longest_sides(patient: Patient) -> Array:
    corners = patient.mesh.corners
    longest = np.zeros(len(corners))
    for first, second in ((0, 1), (1, 2), (2, 0)):
        side = corners[:, first] - corners[:, second]
        np.maximum(longest, np.einsum("ij,ij->i", side, side), out=longest)
    return np.sqrt(longest)


def _repeated(faces: Indices, facing: Array, vertices: int) -> Mask:
    low = np.minimum(np.minimum(faces[:, 0], faces[:, 1]), faces[:, 2])
    high = np.maximum(np.maximum(faces[:, 0], faces[:, 1]), faces[:, 2])
    names = np.stack([low, faces.sum(axis=1) - low - high, high], axis=1)
    keys = _keys(names, vertices)
    ordered = np.sort(keys)
    several = np.unique(ordered[1:][ordered[1:] == ordered[:-1]])
    repeated = np.zeros(len(faces), dtype=bool)
    if len(several):
        # Few are left: they are compared exactly.
        suspects = np.flatnonzero(np.isin(keys, several))
        suspects = suspects[np.argsort(-facing[suspects], kind="stable")]
        _, first = np.unique(names[suspects], axis=0, return_index=True)
        repeated[suspects] = True
        repeated[suspects[first]] = False
    return repeated


def _keys(names: Indices, vertices: int) -> NDArray[np.uint64]:
    """Makes one number of three vertex numbers; two may share one by chance in huge meshes."""
    if vertices < _EXACT_BELOW:
        factors = [vertices * vertices, vertices, 1]
    else:
        factors = [0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9]
    columns = names.astype(np.uint64)
    keys = columns[:, 0] * np.uint64(factors[0])
    keys += columns[:, 1] * np.uint64(factors[1])
    keys += columns[:, 2] * np.uint64(factors[2])
    return keys
