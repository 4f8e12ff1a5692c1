"""Parts by reference, and their checked meshes, prepared once; shared by the planners."""

import threading
from collections import OrderedDict
from pathlib import Path
from urllib.parse import unquote, urlparse

from skinplan_msgs.msg import PartReference

from skinplan.errors import MeshHashError, PartInvalidError, PartNotFoundError
from skinplan.mesh.prepare import PreparedMesh, prepare_mesh
from skinplan.part.files import load_part
from skinplan.part.model import Part


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
    text = uri.strip()
    if text.startswith("file:"):
        parsed = urlparse(text)
        text = unquote(parsed.path) if parsed.netloc in ("", "localhost") else ""
    if not text or "\0" in text or not Path(text).is_absolute():
        raise PartInvalidError(
            f"part {uri!r} was asked for; an absolute path or a file:// URI of a part.yaml is "
            f"accepted"
        )
    path = Path(text)
    try:
        found = path.is_file()
    except OSError:
        found = False
    if not found:
        raise PartNotFoundError(
            f"part {uri!r} was asked for, there is no such file; an existing part.yaml is accepted"
        )
    return path
