"""Parts that nobody wants to scan: debris, and what lies hidden behind the skin."""

import numpy as np

from skinplan.mesh.doctor.patient import Patient, places, summed
from skinplan.mesh.doctor.sight import hidden_shares
from skinplan.mesh.model import Finding

DEBRIS_RATIO = 0.01
FLAP_RATIO = 0.001
_HIDDEN_RATIO = 0.95


def drop_debris(patient: Patient, findings: list[Finding]) -> Patient:
    """Removes parts smaller than 1 % of the largest, and flaps."""
    patient = _drop_flaps(patient, findings)
    _, labels = patient.parts
    areas = patient.part_areas
    debris = areas < DEBRIS_RATIO * areas.max()
    if not debris.any():
        return patient
    gone = debris[labels]
    detail = (
        f"parts below {DEBRIS_RATIO:.0%} of the largest were removed, {np.count_nonzero(gone)} "
        f"faces, {areas[debris].sum() * 1e4:.1f} cm2 in all"
    )
    where = _middles(patient, debris)
    findings.append(Finding("debris", int(debris.sum()), "repaired", detail, where))
    return patient.keeping(~gone)


def _drop_flaps(patient: Patient, findings: list[Finding]) -> Patient:
    """Removes what hangs by edges with more than two faces, is below 0.1 % and mostly free."""
    edges, mesh = patient.edges, patient.mesh
    if not np.any(edges.face_counts > 2):
        return patient
    count, labels = patient.patches
    ends = mesh.vertices[edges.vertices]
    faces_at = edges.face_counts[edges.of_faces]
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)[edges.of_faces]
    free = summed(labels, (lengths * (faces_at == 1)).sum(axis=1), count)
    joined = summed(labels, (lengths * (faces_at > 2)).sum(axis=1), count)
    areas = summed(labels, mesh.face_areas, count)
    flaps = (areas < FLAP_RATIO * areas.max()) & (joined > 0) & (free > joined)
    if not flaps.any():
        return patient
    gone = flaps[labels]
    detail = f"flaps on edges with more than two faces were removed, {np.count_nonzero(gone)} faces"
    where = places(mesh.centroids[gone], mesh.face_areas[gone])
    findings.append(Finding("flaps", int(flaps.sum()), "repaired", detail, where))
    return patient.keeping(~gone)


def drop_hidden_parts(patient: Patient, findings: list[Finding]) -> Patient:
    """Removes parts that can't be seen from the scanner's side: the back of a double skin."""
    count, labels = patient.parts
    if count == 1:
        return patient
    hidden = hidden_shares(patient) >= _HIDDEN_RATIO
    if not hidden.any() or hidden.all():
        return patient
    areas = patient.part_areas
    detail = (
        f"parts of which at least {_HIDDEN_RATIO:.0%} can't be seen from the scanner's side were "
        f"removed, {areas[hidden].sum():.4g} of {areas.sum():.4g} m2"
    )
    where = _middles(patient, hidden)
    findings.append(Finding("hidden parts", int(hidden.sum()), "repaired", detail, where))
    return patient.keeping(~hidden[labels])


def note_parts(patient: Patient, findings: list[Finding]) -> None:
    """Notes that there are several parts."""
    count, _ = patient.parts
    if count == 1:
        return
    areas = np.sort(patient.part_areas)[::-1]
    sizes = ", ".join(f"{area:.3f}" for area in areas[:10]) + (", ..." if count > 10 else "")
    where = _middles(patient, np.ones(count, dtype=bool))
    findings.append(
        Finding("separate parts", count, "noted", f"areas {sizes} m2; all are scanned", where)
    )


def _middles(patient: Patient, which: np.ndarray) -> tuple[tuple[float, float, float], ...]:
    """Returns the centroids of the largest of the parts of a mask, shape (p,)."""
    count, labels = patient.parts
    mesh, areas = patient.mesh, patient.part_areas
    sums = summed(labels, mesh.face_areas[:, None] * mesh.centroids, count)
    middles = sums / np.maximum(areas, np.finfo(float).tiny)[:, None]
    return places(middles[which], areas[which])
