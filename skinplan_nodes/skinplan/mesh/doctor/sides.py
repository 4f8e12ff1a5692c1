"""Closed solids and double skins: only the side that faces the scanner is kept.

A part has two sides when its faces away from the scanner can be seen from behind, make up a good
share of what faces the scanner, and either nothing of its surface is open or the two sides lie
close behind one another. A skin that is merely bent round (a leading edge, a folded rim) stays as
it is.

Of such a part go the faces that look away, and the steep walls along its rim, when the way down
along them leads past the part. Walls of grooves, pockets and steps end on the part itself: they
stay.
"""

from dataclasses import dataclass

import numpy as np

from skinplan.errors import MeshRefusedError
from skinplan.mesh.doctor.boundary import boundary_loops
from skinplan.mesh.doctor.patient import Patient, places
from skinplan.mesh.doctor.sight import reaches_outside
from skinplan.mesh.model import Finding, SurfaceMesh
from skinplan.mesh.topology import Indices, Mask, compact, edge_table, parts_of
from skinplan.scanner.rays import RayCaster
from skinplan.transforms import Array

_WALL_COSINE = np.cos(np.deg2rad(85.0))
_AWAY_RATIO = 0.1  # of the area: less can't be a second side
_NOTED_RATIO = 0.01  # of the area that looks away: a folded rim is worth a word
_BACK_RATIO = 0.25  # of the side that faces the scanner
_OPEN_RATIO = 0.02  # area of the holes over that of the part: a solid with a few faces missing
_THIN_RATIO = 0.02  # thickness over size: 2 mm of 0.1 m, 50 mm of 2.5 m
_COVERED_RATIO = 0.9
_DEEP_RATIO = 3.0  # of the thickness: the skin of a thin part has its back nearer than that
_INSIDE_RATIO = 2e-6  # of the size: rays into the part start this far from the face
_UPRIGHT_SLANT = 0.3  # mean cosine: skins that stand steeper than 70 degrees are noted
_SLANTED_COSINE = 1e-6  # upright but for rounding looks nowhere
_LEAST_RATIO = 0.01  # of the area has to be left
_START_RATIO = 1e-4  # of the size: rays beside a wall start this far from it


@dataclass(frozen=True, eq=False)
class _Back:
    """What may be left out of a part.

    Attributes:
        faces: Numbers of all faces to drop, in the mesh, shape (n,).
        area: Their area [m^2].
        closed: Whether the part is a closed solid.
    """

    faces: Indices
    area: float
    closed: bool


def keep_one_side(patient: Patient, findings: list[Finding]) -> Patient:
    """Drops the back of closed solids and double skins.

    Raises:
        MeshRefusedError: Nothing of a closed solid faces the scanner.
    """
    count, labels = patient.parts
    areas = patient.mesh.face_areas
    away = patient.facing < -_WALL_COSINE
    share = np.bincount(labels, weights=areas * away, minlength=count) / patient.part_areas
    suspects = np.flatnonzero(share > _AWAY_RATIO)
    found = (_back(patient, int(part)) for part in suspects)
    backs = [back for back in found if back is not None]
    if not backs:
        return patient
    keep = np.ones(len(labels), dtype=bool)
    for back in backs:
        keep[back.faces] = False
    for name, closed in (("closed solid", True), ("double skin", False)):
        _report(patient, name, [back for back in backs if back.closed == closed], keep, findings)
    return patient.keeping(keep)


def note_facing_away(patient: Patient, findings: list[Finding]) -> None:
    """Notes surface that looks away from the scanner, and skins that stand upright."""
    mesh, facing = patient.mesh, patient.facing
    away = facing < -_SLANTED_COSINE
    share = float(mesh.face_areas[away].sum()) / mesh.area
    if share > _NOTED_RATIO:
        where = places(mesh.centroids[away], mesh.face_areas[away])
        detail = f"{share:.1%} of the area looks away from the scanner's side"
        findings.append(Finding("surface facing away", 1, "noted", detail, where))
    slant = float(np.abs(facing) @ mesh.face_areas) / mesh.area
    if slant < _UPRIGHT_SLANT:
        detail = (
            f"the scanner's side is seen at {np.rad2deg(np.arccos(slant)):.0f} deg on the mean: "
            "does the part's outward side look to +z?"
        )
        findings.append(Finding("upright surface", 1, "noted", detail))


def _back(patient: Patient, part: int) -> _Back | None:
    """Returns what may be left out of a part; None when it has no second side."""
    _, labels = patient.parts
    numbers = np.flatnonzero(labels == part)
    chosen = labels == part
    mesh = patient.mesh if len(numbers) == len(labels) else compact(patient.mesh, chosen)
    facing = patient.facing[numbers]
    steep = np.flatnonzero(facing < _WALL_COSINE)
    outside = reaches_outside(
        mesh, steep, _ways_down(mesh, steep, patient.toward), _START_RATIO * patient.size
    )
    exposed = steep[outside]
    behind = exposed[facing[exposed] < -_WALL_COSINE]
    seen = np.abs(facing) * mesh.face_areas
    if seen[behind].sum() < _BACK_RATIO * seen[facing >= _WALL_COSINE].sum():
        return None
    closed = _is_closed(patient.with_mesh(mesh))
    thickness = _thickness(mesh, behind, patient.size)
    if thickness is None:
        if not closed:
            return None
    else:
        exposed = np.union1d(exposed, _rim_walls(mesh, behind, exposed, thickness))
    return _Back(numbers[exposed], float(mesh.face_areas[exposed].sum()), closed)


def _ways_down(mesh: SurfaceMesh, faces: Indices, toward: Array) -> Array:
    """Returns for each face the way from the scanner: straight, or along a steep face."""
    normals = mesh.face_normals[faces]
    slant = normals @ toward
    ways = np.broadcast_to(-toward, normals.shape).copy()
    wall = np.abs(slant) <= _WALL_COSINE
    ways[wall] += slant[wall, None] * normals[wall]
    return ways / np.linalg.norm(ways, axis=1, keepdims=True)


def _is_closed(part: Patient) -> bool:
    loops = boundary_loops(part)
    return float(loops.areas.sum()) <= _OPEN_RATIO * part.mesh.area


def _thickness(mesh: SurfaceMesh, behind: Indices, size: float) -> float | None:
    """Returns how far the other side lies inside of some faces [m]; None when it is not near."""
    distance = _depths(mesh, behind, _INSIDE_RATIO * size)
    areas = mesh.face_areas[behind]
    near = distance <= _THIN_RATIO * size
    if float(areas[near].sum()) < _COVERED_RATIO * float(areas.sum()):
        return None
    return float(np.median(distance[near]))


def _depths(mesh: SurfaceMesh, faces: Indices, start_m: float) -> Array:
    """Returns how far the mesh goes on inside of faces, from a start inside, shape (n,) [m]."""
    inward = -mesh.face_normals[faces]
    start = mesh.centroids[faces] + inward * start_m
    return RayCaster(mesh).hits(start, inward)[0]


def _rim_walls(mesh: SurfaceMesh, behind: Indices, gone: Indices, thickness: float) -> Indices:
    """Finds the walls along the rim of a thin part that look up because the part is tilted there.

    They join the back, and unlike the skin they have no other side near behind them.
    """
    rest = np.ones(len(mesh.faces), dtype=bool)
    rest[gone] = False
    faces = np.flatnonzero(rest)
    deep = np.zeros(len(rest), dtype=bool)
    deep[faces] = _depths(mesh, faces, 0.01 * thickness) > _DEEP_RATIO * thickness
    at_back = np.zeros(len(rest), dtype=bool)
    at_back[behind] = True
    pairs = edge_table(mesh.faces).pairs
    count, labels = parts_of(deep, pairs)
    both = np.concatenate([pairs, pairs[:, ::-1]])
    touching = both[deep[both[:, 0]] & at_back[both[:, 1]], 0]
    walls = np.zeros(count, dtype=bool)
    walls[labels[np.cumsum(deep)[touching] - 1]] = True
    return np.flatnonzero(deep)[walls[labels]]


def _report(
    patient: Patient, name: str, backs: list[_Back], keep: Mask, findings: list[Finding]
) -> None:
    if not backs:
        return
    mesh = patient.mesh
    dropped = sum(back.area for back in backs)
    gone = np.concatenate([back.faces for back in backs])
    where = places(mesh.centroids[gone], mesh.face_areas[gone])
    side = ", ".join(f"{value:.3g}" for value in patient.toward + 0.0)
    if float(mesh.face_areas[keep].sum()) < _LEAST_RATIO * mesh.area:
        message = f"no side of it faces the scanner, which looks from ({side})"
        finding = Finding(name, len(backs), "refused", message, where)
        raise MeshRefusedError(
            f"the mesh is a {name} and {message}; a skin whose outer side looks there is accepted",
            (*findings, finding),
        )
    detail = f"the side facing ({side}) was kept, {dropped:.4g} of {mesh.area:.4g} m2 were dropped"
    findings.append(Finding(name, len(backs), "repaired", detail, where))
