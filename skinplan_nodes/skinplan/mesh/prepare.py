"""The stage ``mesh``: load, check, segment."""

from dataclasses import dataclass

from skinplan.errors import MeshHashError
from skinplan.mesh.check import check_mesh
from skinplan.mesh.load import read_mesh
from skinplan.mesh.model import Finding, Segmentation, SurfaceMesh
from skinplan.mesh.segment import segment_mesh
from skinplan.part.model import Part


@dataclass(frozen=True, eq=False)
class PreparedMesh:
    """What the stage ``mesh`` hands on.

    Attributes:
        mesh: Repaired mesh [m].
        findings: What was noticed when reading the file, and what the mesh doctor found.
        segmentation: Complex regions.
    """

    mesh: SurfaceMesh
    findings: tuple[Finding, ...]
    segmentation: Segmentation


def prepare_mesh(part: Part) -> PreparedMesh:
    """Loads, checks and segments a part's mesh.

    Raises:
        MeshError: The mesh can't be used, or is another one than the part file means.
    """
    mesh, noticed = read_mesh(part.mesh_path, part.unit)
    if part.mesh_sha256 and mesh.sha256 != part.mesh_sha256:
        raise MeshHashError(
            f"mesh {part.mesh_path}: SHA-256 {part.mesh_sha256} was asked for, found "
            f"{mesh.sha256}; the mesh that the part was described with is accepted"
        )
    checked, findings = check_mesh(mesh)
    return PreparedMesh(checked, noticed + findings, segment_mesh(checked))
