"""Which storage files a bag has, in which order, and how they are compressed."""

from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from skinplan.errors import BagInvalidError, BagNotFoundError
from skinplan.recording.metadata import read_metadata

#: How the names of storage files end.
SUFFIXES = {"mcap": (".mcap",), "sqlite3": (".db3",)}
#: How they end when they are compressed as a whole.
PACKED = ".zstd"
PACKED = ".zstd"
_ACCEPTED = "a folder with metadata.yaml or storage files (.mcap, .db3) is accepted"


@dataclass(frozen=True)
class BagFiles:
    """The storage files of a bag.

    Attributes:
        place: Folder or file that was asked for.
        paths: The files in the order of recording.
        metadata: Fields of ``metadata.yaml``; None = there is none.
        message_compression: Compression of each message; empty = none.
    """

    place: Path
    paths: tuple[Path, ...]
    metadata: dict[str, Any] | None
    message_compression: str


def bag_files(path: Path | str) -> BagFiles:
    """Finds the storage files of a bag.

    Args:
        path: Bag folder or storage file.

    Raises:
        BagNotFoundError: Nothing is there, or a file that ``metadata.yaml`` names is missing.
        BagInvalidError: No bag.
    """
    place = Path(path).absolute()
    if not place.exists():
        raise BagNotFoundError(
            f"bag {place} was asked for; a bag folder or a storage file (.mcap, .db3) is "
            "accepted, nothing is there"
        )
    if place.is_file():
        return BagFiles(place, (place,), None, "")
    metadata = read_metadata(place)
    if metadata is None:
        return BagFiles(place, _found_files(place), None, "")
    return BagFiles(place, _named_files(place, metadata), metadata, compression_of(metadata))


def compression_of(metadata: dict[str, Any] | None) -> str:
    """Returns the compression of each message that metadata tell; empty = none.

    Raises:
        BagInvalidError: One that can't be read.
    """
    mode = str((metadata or {}).get("compression_mode") or "").lower()
    name = str((metadata or {}).get("compression_format") or "").lower()
    if mode in ("", "none") or not name:
        return ""
    if mode not in ("file", "message") or name not in ("zstd", "lz4"):
        raise BagInvalidError(
            f"metadata: compression of files or messages with zstd is accepted, found {mode} "
            f"with {name}"
        )
    return name if mode == "message" else ""


def kind_of(path: Path) -> str:
    """Returns the storage of a file by its name, without a suffix for compression.

    Raises:
        BagInvalidError: Neither MCAP nor SQLite.
    """
    name = path.name.removesuffix(PACKED)
    for kind, suffixes in SUFFIXES.items():
        if name.endswith(suffixes):
            return kind
    raise BagInvalidError(f"{path}: a file that ends in .mcap or .db3 is accepted")


def _found_files(place: Path) -> tuple[Path, ...]:
    for suffixes in SUFFIXES.values():
        endings = tuple(f"{suffix}{packed}" for suffix in suffixes for packed in ("", PACKED))
        files = [path for path in place.iterdir() if path.name.endswith(endings)]
        # rosbag2 keeps no unpacked file beside a packed one; after its player one may be left.
        names = {path.name for path in files}
        files = [path for path in files if path.name.removesuffix(PACKED) == path.name
                 or path.name.removesuffix(PACKED) not in names]  # fmt: skip
        if files:
            return tuple(sorted(files, key=_split_number))
    raise BagInvalidError(f"{place}: {_ACCEPTED}, it has neither")


def _named_files(place: Path, metadata: dict[str, Any]) -> tuple[Path, ...]:
    storage = metadata.get("storage_identifier")
    if storage not in SUFFIXES:
        raise BagInvalidError(
            f"{place}: storage {' or '.join(SUFFIXES)} is accepted, found {storage!r}"
        )
    names = metadata.get("relative_file_paths")
    if not isinstance(names, list) or not names or not all(isinstance(name, str) for name in names):
        raise BagInvalidError(
            f"{place}: metadata.yaml with relative_file_paths is accepted, found {names!r:.120}"
        )
    # Older versions put the bag's folder before the name; never follow a name out of the folder.
    return tuple(_existing(place, PurePosixPath(name).name) for name in names)


def _existing(place: Path, name: str) -> Path:
    """Returns a named file; also one that was packed or unpacked after the metadata."""
    for candidate in (name, f"{name}{PACKED}", name.removesuffix(PACKED)):
        if name and (place / candidate).is_file():
            return place / candidate
    raise BagNotFoundError(f"{place}: metadata.yaml names {name}, but the file is missing")


def _split_number(path: Path) -> tuple[int, str]:
    stem = path.name.split(".")[0]
    tail = stem.rsplit("_", 1)[-1]
    return (int(tail) if tail.isdecimal() else -1, path.name)
