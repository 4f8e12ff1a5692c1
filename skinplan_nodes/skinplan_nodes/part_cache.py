"""Parts by reference, and their checked meshes, prepared once; shared by the planners."""

import threading
from collections import OrderedDict
from pathlib import Path
from urllib.parse import unquote, urlparse

from skinplan_msgs.msg import PartReference

from skinplan.errors import CloudInvalidError, MeshHashError, PartInvalidError, PartNotFoundError
from skinplan.inspection.gaps import seen_points
from skinplan.mesh.prepare import PreparedMesh, prepare_mesh
from skinplan.part.files import load_part
from skinplan.part.model import Part
from skinplan.transforms import Array


class PartCache:
    """Resolves part references; a mesh is checked and segmented once, however often it is asked.

    Args:
        limit: So many meshes are kept.
    """

    def __init__(self, limit: int = 4) -> None:
        self._limit = limit
        self._meshes: OrderedDict[tuple[str, str], PreparedMesh] = OrderedDict()
        self._lock = threading.Lock()

    def part(self, reference: PartReference) -> Part:
        """Reads the part file of a reference and checks the mesh file against the hash.

        Args:
            reference: Which part is meant.

        Raises:
            PartNotFoundError: No such file.
            PartInvalidError: The URI is empty or none of a file, or the file has errors.
            MeshError: The mesh is missing, or another one than the reference means.
        """
        part = load_part(part_path(reference.uri))
        asked = reference.mesh_sha256.strip().lower()
        if asked and asked != part.mesh_sha256:
            raise MeshHashError(
                f"part {part.id}: the mesh with SHA-256 {asked} was asked for, "
                f"{part.mesh_path} has {part.mesh_sha256}; a request with that hash, or "
                f"none, is accepted"
            )
        return part

    def prepared(self, reference: PartReference) -> tuple[Part, PreparedMesh]:
        """Returns a part with its checked and segmented mesh.

        Raises:
            MeshError: The mesh can't be used; else as `part`.
        """
        part = self.part(reference)
        key = (part.mesh_sha256, part.unit)
        with self._lock:
            found = self._meshes.pop(key, None) or prepare_mesh(part)
            self._meshes[key] = found
            while len(self._meshes) > self._limit:
                self._meshes.popitem(last=False)
        return part, found


def part_path(uri: str) -> Path:
    """Returns the path that a part's URI means.

    Args:
        uri: Absolute path or ``file://`` URI.

    Raises:
        PartInvalidError: Empty, of another scheme, or relative.
        PartNotFoundError: No such file.
    """
    path = _local_path(uri)
    if path is None:
        raise PartInvalidError(
            f"part {uri!r} was asked for; an absolute path or a file:// URI of a part.yaml is "
            f"accepted"
        )
    if not _is_file(path):
        raise PartNotFoundError(
            f"part {uri!r} was asked for, there is no such file; an existing part.yaml is accepted"
        )
    return path


def cloud_points(uri: str) -> Array | None:
    """Reads the cloud that a URI means.

    Args:
        uri: Absolute path or ``file://`` URI of a PLY cloud in the workpiece frame, or of a run's
            folder; empty = none.

    Returns:
        Points, workpiece frame, shape (n, 3) [m]; None without a URI.

    Raises:
        CloudInvalidError: Another URI, no such file, or no such cloud.
    """
    if not uri.strip():
        return None
    path = _local_path(uri)
    if path is None:
        raise CloudInvalidError(
            f"the cloud {uri!r} was given; an absolute path or a file:// URI of a PLY cloud is "
            f"accepted"
        )
    return seen_points(path)


def _local_path(uri: str) -> Path | None:
    """Returns the path of an absolute path or file URI; None for anything else."""
    text = uri.strip()
    if text.startswith("file:"):
        parsed = urlparse(text)
        text = unquote(parsed.path) if parsed.netloc in ("", "localhost") else ""
    return Path(text) if text and "\0" not in text and Path(text).is_absolute() else None


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except OSError:
        return False
