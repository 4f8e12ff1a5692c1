"""Which part a file is about: id and mesh, without loading the mesh.

Bounded, so that who asks for it gets an answer at once.
"""

from dataclasses import dataclass
from pathlib import Path

from skinplan.errors import MeshNotFoundError, PartInvalidError
from skinplan.mesh.load import file_sha256
from skinplan.part.fields import Fields
from skinplan.part.files import PART_ID, PART_KEYS
from skinplan.part.fixture_file import read_yaml

# Larger files would take too long here; who loads the part looks at them anyway.
_LARGEST_FILE_BYTES = 100_000
_LARGEST_MESH_BYTES = 64_000_000
_MOST_KEPT = 64


@dataclass(frozen=True)
class PartIdentity:
    """What a part file says about itself.

    Attributes:
        id: Id of the part; empty = the file is too large to be read at once.
        mesh_sha256: Hash of its mesh file; empty = too large to be read at once.
    """

    id: str
    mesh_sha256: str


_Stamp = tuple[int, int, int]


class PartIdentities:
    """Identities of part files; a file that has not changed is read once."""

    def __init__(self) -> None:
        self._known: dict[Path, tuple[_Stamp, Path, _Stamp, PartIdentity]] = {}

    def of(self, file: Path) -> PartIdentity:
        """Returns the identity of a part file that exists.

        Raises:
            PartInvalidError: It is no part file.
            MeshNotFoundError: Its mesh is missing.
        """
        known = self._known.get(file)
        if known is not None and known[0] == _stamp(file) and known[2] == _stamp(known[1]):
            return known[3]
        mesh, found = _identity(file)
        if len(self._known) >= _MOST_KEPT:
            self._known.pop(next(iter(self._known)))
        if mesh is not None:
            self._known[file] = (_stamp(file), mesh, _stamp(mesh), found)
        return found


def _identity(file: Path) -> tuple[Path | None, PartIdentity]:
    if _stamp(file)[2] > _LARGEST_FILE_BYTES:
        return None, PartIdentity("", "")
    fields = Fields(read_yaml(file), "", file.name, PART_KEYS)
    part_id = fields.text("id")
    if not PART_ID.fullmatch(part_id):
        raise fields.error("id", repr(part_id[:80]), "1 to 64 letters, digits, '_', '.' or '-'")
    mesh = Fields(fields.values.get("mesh"), "mesh", fields.source, ("file", "unit", "sha256"))
    path = (file.parent / mesh.text("file", "the path of a mesh file")).resolve()
    digest = file_sha256(path) if _stamp(path)[2] <= _LARGEST_MESH_BYTES else ""
    return path, PartIdentity(part_id, digest)


def _stamp(file: Path) -> _Stamp:
    """Returns what changes when a file does."""
    try:
        found = file.stat()
    except FileNotFoundError as error:
        raise MeshNotFoundError(
            f"no file at {file}; the path of an existing one is accepted"
        ) from (error)
    except (OSError, ValueError) as error:
        raise PartInvalidError(f"{file} can't be read: {error}") from error
    return found.st_ino, found.st_mtime_ns, found.st_size
