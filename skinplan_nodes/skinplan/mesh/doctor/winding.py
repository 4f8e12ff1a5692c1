"""Which way the faces look: alike within a patch, and the patch to the scanner's side."""

import numpy as np

from skinplan.mesh.doctor.patient import Patient, places, summed
from skinplan.mesh.doctor.sight import sides_by_sight
from skinplan.mesh.model import Finding
from skinplan.mesh.topology import Indices, Mask, winding_signs
from skinplan.transforms import Array

# A patch whose mean normal is this much shorter than its faces' is decided by sight: a closed one.
_CLEAR_RATIO = 0.2
# Nearly upright patches have no side that faces the scanner.
_UPRIGHT_COSINE = 0.02
_SLANTED_COSINE = 1e-6
_TIE_RATIO = 1e-6


def wind_alike(patient: Patient, findings: list[Finding]) -> Patient:
    """Turns faces so that neighbours agree and every patch looks to the scanner's side."""
    signs, twisted = _agreeing_signs(patient)
    count, labels = patient.patches
    turned = signs * _patch_sides(patient, signs, twisted)[labels] < 0
    if twisted.any():
        # One-sided patches have no consistent winding: each face for itself.
        alone = twisted[labels]
        turned[alone] = patient.facing[alone] < -_SLANTED_COSINE
    if not turned.any():
        return patient
    _report(patient, turned, findings)
    return patient.turning(turned)


def note_one_sided(patient: Patient, findings: list[Finding]) -> None:
    """Notes patches without two sides, such as a Moebius strip."""
    _, twisted = _agreeing_signs(patient)
    if not twisted.any():
        return
    conflicts = _conflicts(patient)
    mesh = patient.mesh
    detail = "have no outer side; each of their faces was turned to the scanner's side by itself"
    where = places(mesh.centroids[patient.edges.pairs[conflicts, 0]])
    count = int(np.count_nonzero(twisted))
    findings.append(Finding("one-sided parts", count, "noted", detail, where))


def _conflicts(patient: Patient) -> Indices:
    """Returns the pairs of neighbours that are not wound alike."""
    return np.flatnonzero(~patient.edges.same_winding)


def _agreeing_signs(patient: Patient) -> tuple[Array, Mask]:
    """Returns a sign per face that makes neighbours agree, and which patches have no such signs."""
    count, labels = patient.patches
    twisted = np.zeros(count, dtype=bool)
    edges = patient.edges
    if edges.same_winding.all():
        return np.ones(len(labels)), twisted
    signs = winding_signs(len(labels), edges).astype(float)
    wanted = np.where(edges.same_winding, 1.0, -1.0)
    wrong = signs[edges.pairs[:, 0]] * signs[edges.pairs[:, 1]] != wanted
    twisted[labels[edges.pairs[wrong, 0]]] = True
    return signs, twisted


def _patch_sides(patient: Patient, signs: Array, twisted: Mask) -> Array:
    """Returns for each patch, with the signs applied, +1 when it looks to the scanner, or -1."""
    count, labels = patient.patches
    areas = patient.mesh.face_areas

    def total(values: Array) -> Array:
        return summed(labels, values * areas, count)

    mean, slant, area = (
        total(signs * patient.facing),
        total(np.abs(patient.facing)),
        total(signs**2),
    )
    upright = slant < _UPRIGHT_COSINE * area
    unclear = (np.abs(mean) < _CLEAR_RATIO * slant) & ~upright & ~twisted
    if unclear.any():
        faces = np.flatnonzero(unclear[labels] & (np.abs(patient.facing) > _UPRIGHT_COSINE))
        seen = np.zeros(len(labels))
        seen[faces] = sides_by_sight(patient, faces) * signs[faces] * np.abs(patient.facing[faces])
        mean = np.where(unclear & ~_tied(total(seen), area), total(seen), mean)
    # What has no side that faces the scanner keeps that of most of its area; so a tie is broken
    # once and for all.
    mean = np.where(upright | _tied(mean, area), total(signs), mean)
    return np.where(mean < 0, -1.0, 1.0)


def _tied(sums: Array, area: Array) -> Mask:
    """Says which sums of areas are nothing but rounding."""
    return np.abs(sums) <= _TIE_RATIO * area


def _report(patient: Patient, turned: Mask, findings: list[Finding]) -> None:
    count, labels = patient.patches
    mesh = patient.mesh
    inverted = np.bincount(labels, weights=turned, minlength=count) == np.bincount(
        labels, minlength=count
    )
    if inverted.any():
        where = places(mesh.centroids[np.unique(labels, return_index=True)[1][inverted]])
        detail = "looked away from the scanner's side as a whole and were turned"
        finding = Finding("inverted parts", int(inverted.sum()), "repaired", detail, where)
        findings.append(finding)
    single = turned & ~inverted[labels]
    if single.any():
        where = places(mesh.centroids[single], mesh.face_areas[single])
        number = int(np.count_nonzero(single))
        detail = "were turned to agree with their neighbours"
        findings.append(Finding("flipped faces", number, "repaired", detail, where))
