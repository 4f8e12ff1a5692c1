"""What can be seen from the scanner's side, by rays."""

import numpy as np

from skinplan.mesh.doctor.patient import Patient
from skinplan.mesh.model import SurfaceMesh
from skinplan.mesh.topology import Indices, Mask
from skinplan.scanner.rays import RayCaster
from skinplan.transforms import Array

_TILTS_DEG = (30.0, 50.0)
_TURNS = 8
_SAMPLES = 1000
_START_RATIO = 2e-6  # of the part's size; more than the rays' single precision


def sides_by_sight(patient: Patient, faces: Indices) -> Array:
    """Says which faces look to the scanner's side where nothing is above them.

    Args:
        patient: The mesh.
        faces: Numbers of the faces asked for, shape (n,).

    Returns:
        shape (n,): +1 when the face's outward side is seen from the scanner's side, -1 when its
        inward side is, 0 when neither is.
    """
    side = np.where(patient.facing[faces] >= 0, 1.0, -1.0)
    start = patient.mesh.centroids[faces]
    start = start + side[:, None] * patient.mesh.face_normals[faces] * _START_RATIO * patient.size
    directions = np.broadcast_to(patient.toward, start.shape)
    blocked = RayCaster(patient.mesh).occluded(start, directions, np.inf)
    return np.where(blocked, 0.0, side)


def hidden_shares(patient: Patient) -> Array:
    """Returns for each part the share of its area that no view from the scanner's side sees.

    Views are straight ones and those tilted by up to 50 degrees.
    """
    count, labels = patient.parts
    faces = _samples(patient)
    hidden = np.ones(len(faces), dtype=bool)
    caster = RayCaster(patient.mesh)
    normals, centroids = patient.mesh.face_normals[faces], patient.mesh.centroids[faces]
    for direction in _views(patient.toward):
        left = np.flatnonzero(hidden)
        side = np.where(normals[left] @ direction >= 0, 1.0, -1.0)[:, None]
        start = centroids[left] + side * normals[left] * _START_RATIO * patient.size
        along = np.broadcast_to(direction, start.shape)
        hidden[left] = caster.occluded(start, along, np.inf)
    seen = np.bincount(labels[faces], weights=hidden, minlength=count)
    return seen / np.maximum(np.bincount(labels[faces], minlength=count), 1)


def reaches_outside(mesh: SurfaceMesh, faces: Indices, directions: Array, start_m: float) -> Mask:
    """Says from which faces a ray leaves the mesh for good.

    Args:
        mesh: What the rays may hit.
        faces: Numbers of the faces that they start from, shape (n,).
        directions: Unit vectors, shape (n, 3).
        start_m: How far outside of the face they start [m].

    Returns:
        shape (n,), bool.
    """
    start = mesh.centroids[faces] + start_m * mesh.face_normals[faces]
    return ~RayCaster(mesh).occluded(start, directions, np.inf)


def _samples(patient: Patient) -> Indices:
    """Chooses up to 1000 faces of each part, evenly by area."""
    count, labels = patient.parts
    chosen = []
    for part in range(count):
        faces = np.flatnonzero(labels == part)
        if len(faces) > _SAMPLES:
            passed = np.cumsum(patient.mesh.face_areas[faces])
            steps = (np.arange(_SAMPLES) + 0.5) / _SAMPLES * passed[-1]
            faces = faces[np.searchsorted(passed, steps)]
        chosen.append(faces)
    return np.concatenate(chosen)


def _views(toward: Array) -> list[Array]:
    across = np.cross(toward, np.eye(3)[np.argmin(np.abs(toward))])
    across /= np.linalg.norm(across)
    third = np.cross(toward, across)
    views = [toward]
    for tilt in np.deg2rad(_TILTS_DEG):
        for turn in 2 * np.pi / _TURNS * np.arange(_TURNS):
            aside = np.cos(turn) * across + np.sin(turn) * third
            views.append(np.cos(tilt) * toward + np.sin(tilt) * aside)
    return views
