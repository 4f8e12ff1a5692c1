"""What the planning nodes have in common: the cell's figures, checks of a request's scan path."""

from pathlib import Path

from skinplan_msgs import msg as messages

from skinplan.errors import MeshHashError
from skinplan.part.model import Part
from skinplan.robot.cell import CellConfig, load_cell
from skinplan.scan_path.model import ScanPath
from skinplan_nodes import conversions


def configured_cell(cell_file: str) -> CellConfig:
    """Loads the cell of the parameter ``cell_file``.

    Raises:
        CellInvalidError: The file is missing or has errors.
    """
    return load_cell(Path(cell_file) if cell_file else None)


def requested_path(msg: messages.ScanPath, part: Part) -> ScanPath:
    """Returns the scan path of a request.

    Raises:
        ScanPathInvalidError: No points, another frame, or numbers that can't be used.
        MeshHashError: It was planned on another mesh than the part's.
    """
    # Looked up when it is needed: most nodes need the cell's figures only.
    path = conversions.require_points(conversions.scan_path_from_msg(msg))
    if msg.mesh_sha256 and msg.mesh_sha256 != part.mesh_sha256:
        raise MeshHashError(
            f"the scan path was planned on the mesh with SHA-256 {msg.mesh_sha256}, part {part.id} "
            f"has {part.mesh_sha256}; a path of that mesh is accepted"
        )
    return path
