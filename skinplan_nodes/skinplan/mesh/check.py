"""The mesh doctor: what is wrong with a mesh, what is repaired, what is refused.

Repairs, in this order; each is safe and doing them twice changes nothing:

1. Faces without area and faces that name the same three vertices as another are removed.
2. Connected parts smaller than 1 % of the largest are debris and removed.
3. The faces of each connected part are wound alike; the part then looks outward, which in the
   workpiece frame is +z: it is turned when its area-weighted mean normal has a negative z.

Noted only: holes, non-manifold edges, several parts, a surface of which much looks away from the
scanner.
Refused: nothing left, closed solids, more than 10 million faces.
"""

import logging

import numpy as np
from numpy.typing import NDArray

from skinplan.errors import MeshEmptyError, MeshNotFiniteError, MeshRefusedError
from skinplan.mesh.model import Finding, SurfaceMesh
from skinplan.mesh.topology import EdgeTable, compact, components, edge_table, winding_signs

DEBRIS_RATIO = 0.01
_LEAST_HEIGHT_M = 1e-7
_MOST_FACES = 10_000_000
_AWAY_RATIO = 0.1
_log = logging.getLogger(__name__)


def check_mesh(mesh: SurfaceMesh) -> tuple[SurfaceMesh, tuple[Finding, ...]]:
    """Examines and repairs a mesh.

    Args:
        mesh: As loaded.

    Returns:
        The repaired mesh (same hash: it names the file), and what was found.

    Raises:
        MeshEmptyError: No faces.
        MeshNotFiniteError: A vertex is NaN or infinite.
        MeshRefusedError: It can't be planned on.
    """
    _require_faces(mesh)
    findings: list[Finding] = []
    mesh = _without_useless_faces(mesh, findings)
    mesh = _without_debris(mesh, findings)
    edges = edge_table(mesh.faces)
    mesh = _wound_alike(mesh, edges, findings)
    _note(mesh, edges, findings)
    for finding in findings:
        _log.info(
            "mesh: %d %s, %s: %s", finding.count, finding.name, finding.action, finding.detail
        )
    return mesh, tuple(findings)


def _require_faces(mesh: SurfaceMesh) -> None:
    if len(mesh.faces) == 0 or len(mesh.vertices) == 0:
        raise MeshEmptyError("the mesh has no faces; a mesh with at least one face is accepted")
    if len(mesh.faces) > _MOST_FACES:
        raise MeshRefusedError(
            f"the mesh has {len(mesh.faces)} faces; up to {_MOST_FACES} are accepted: decimate "
            "it, 5 mm triangles are enough"
        )
    broken = int(np.count_nonzero(~np.isfinite(mesh.vertices).all(axis=1)))
    if broken:
        raise MeshNotFiniteError(
            f"{broken} vertices are NaN or infinite; finite numbers are accepted"
        )


def _without_useless_faces(mesh: SurfaceMesh, findings: list[Finding]) -> SurfaceMesh:
    sides = np.linalg.norm(mesh.corners - np.roll(mesh.corners, 1, axis=1), axis=2).max(axis=1)
    flat = 2 * mesh.face_areas <= _LEAST_HEIGHT_M * sides
    names = np.sort(mesh.faces, axis=1)
    _, first = np.unique(names @ _row_weights(len(mesh.vertices)), return_index=True)
    twice = np.ones(len(names), dtype=bool)
    twice[first] = False
    twice &= ~flat
    keep = ~flat & ~twice
    if flat.any():
        findings.append(
            Finding(
                "degenerate faces", int(flat.sum()), "repaired", "faces without area were removed"
            )
        )
    if twice.any():
        findings.append(
            Finding("duplicate faces", int(twice.sum()), "repaired", "the first of each was kept")
        )
    if not keep.any():
        raise MeshRefusedError(
            f"all {len(keep)} faces are degenerate; a mesh with area is accepted"
        )
    return compact(mesh, keep)


def _row_weights(vertices: int) -> NDArray[np.uint64]:
    """Weights that make one number of three vertex numbers; exact below 2 million vertices."""
    base = np.uint64(max(vertices, 1))
    if vertices < 2_000_000:
        return np.array([base * base, base, 1], dtype=np.uint64)
    return np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], dtype=np.uint64)


def _without_debris(mesh: SurfaceMesh, findings: list[Finding]) -> SurfaceMesh:
    found, labels = components(len(mesh.faces), edge_table(mesh.faces).pairs)
    areas = np.bincount(labels, weights=mesh.face_areas, minlength=found)
    debris = areas < DEBRIS_RATIO * areas.max()
    if debris.any():
        detail = (
            f"parts below {DEBRIS_RATIO:.0%} of the largest were removed, "
            f"{int(np.isin(labels, np.flatnonzero(debris)).sum())} faces, "
            f"{areas[debris].sum() * 1e4:.1f} cm2 in all"
        )
        findings.append(Finding("debris", int(debris.sum()), "repaired", detail))
        mesh = compact(mesh, ~debris[labels])
    if np.count_nonzero(~debris) > 1:
        sizes = ", ".join(f"{area:.3f}" for area in np.sort(areas[~debris])[::-1])
        findings.append(
            Finding(
                "separate parts",
                int((~debris).sum()),
                "noted",
                f"areas {sizes} m2; all are scanned",
            )
        )
    return mesh


def _wound_alike(mesh: SurfaceMesh, edges: EdgeTable, findings: list[Finding]) -> SurfaceMesh:
    if not np.any(edges.face_counts == 1):
        raise MeshRefusedError(
            "the mesh is a closed solid; an open skin is accepted: export only the surface that "
            "is to be scanned"
        )
    signs = winding_signs(len(mesh.faces), edges)
    found, labels = components(len(mesh.faces), edges.pairs)
    upward = np.bincount(
        labels, weights=signs * mesh.face_areas * mesh.face_normals[:, 2], minlength=found
    )
    turned = signs * np.where(upward < 0, -1, 1)[labels] < 0
    if not turned.any():
        return mesh
    inverted = np.bincount(labels, weights=turned, minlength=found) == np.bincount(
        labels, minlength=found
    )
    if inverted.any():
        count = int(inverted.sum())
        findings.append(
            Finding("inverted parts", count, "repaired", "looked to -z as a whole and were turned")
        )
    single = int(np.count_nonzero(turned & ~inverted[labels]))
    if single:
        findings.append(
            Finding(
                "flipped faces", single, "repaired", "were turned to agree with their neighbours"
            )
        )
    faces = np.where(turned[:, None], mesh.faces[:, ::-1], mesh.faces)
    return SurfaceMesh(mesh.vertices, faces, mesh.sha256)


def _note(mesh: SurfaceMesh, edges: EdgeTable, findings: list[Finding]) -> None:
    crowded = int(np.count_nonzero(edges.face_counts > 2))
    if crowded:
        findings.append(
            Finding("non-manifold edges", crowded, "noted", "edges with more than two faces")
        )
    parts, _ = components(len(mesh.faces), edges.pairs)
    loops = _loops(edges, len(mesh.vertices)) - parts
    if loops > 0:
        findings.append(
            Finding("holes", loops, "noted", "rows stop at holes wider than half a row interval")
        )
    away = float(mesh.face_areas[mesh.face_normals[:, 2] < 0].sum()) / mesh.area
    if away > _AWAY_RATIO:
        detail = f"{away:.0%} of the area looks to -z, away from the scanner"
        findings.append(Finding("surface facing away", 1, "noted", detail))


def _loops(edges: EdgeTable, vertices: int) -> int:
    boundary = edges.boundary
    on_boundary = np.unique(boundary)
    rank = np.zeros(vertices, dtype=np.int64)
    rank[on_boundary] = np.arange(len(on_boundary))
    return components(len(on_boundary), rank[boundary])[0]
