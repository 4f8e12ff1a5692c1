"""Heals bags whose recording was cut off: valid files with an index, ``metadata.yaml`` rebuilt.

A file is written anew beside the old one and then takes its place in one step, so that a second
power cut costs nothing. Where something in the middle was damaged the old file stays beside it as
``NAME.damaged``; what the end of the file cut off is of no use to anybody.
"""

import contextlib
import logging
import os
import re
import struct
import zlib
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

from mcap.opcode import Opcode
from mcap.reader import SeekingReader

from skinplan.errors import BagInvalidError, BagNotFoundError, BagNotWritableError
from skinplan.recording.disk import lock_file, sync_folder, write_error
from skinplan.recording.heal_file import Salvage, Salvaged, read_header
from skinplan.recording.heal_metadata import (
    custom_data,
    described_topics,
    metadata_fits,
    rebuild_metadata,
    recorded_document,
)
from skinplan.recording.heal_report import HealedFile, HealReport
from skinplan.recording.mcap_output import McapOutput
from skinplan.recording.mcap_storage import McapStorage
from skinplan.recording.metadata import (
    FILE_NAME,
    RECORD_NAME,
    FileFigures,
    metadata_document,
    metadata_text,
)
from skinplan.recording.salvage import MAGIC, Source, walk
from skinplan.recording.storage import StorageInfo, naming_damage

_LOG = logging.getLogger(__name__)
_FOOTER = struct.Struct("<BQQQI")
_TEMPORARY = ".heal"
#: Key of ``custom_data`` with the sentence about what was lost.
HEALED_KEY = "healed"


def heal_bag(path: Path | str, thorough: bool = False) -> HealReport:
    """Heals a bag; one that is in order stays as it is.

    Args:
        path: Bag folder, or one MCAP file.
        thorough: Read files that were closed in order, too, and heal those with damaged chunks.

    Raises:
        BagNotFoundError: Nothing is there.
        BagInvalidError: There is no MCAP file.
        BagNotWritableError: It is being recorded, or the disk does not take the healed file.
        DiskFullError: The disk is full; the bag is as it was.
    """
    place = Path(path).absolute()
    if not place.exists():
        raise BagNotFoundError(
            f"bag {place} was asked for; a bag folder or an MCAP file is accepted, nothing is there"
        )
    files = _files(place) if place.is_dir() else [place]
    healed = [_heal_file(file, thorough) for file in files]
    rebuilt = place.is_dir() and _rebuild(place, healed)
    report = HealReport(place, tuple(healed), rebuilt)
    if report.healed:
        _LOG.warning("bag %s: %s", place, report.sentence())
    return report


def is_finished(path: Path | str) -> bool:
    """Tells whether a bag was closed in order, without reading its messages."""
    place = Path(path)
    if not place.is_dir():
        return _ends_in_order(place)
    if not (place / FILE_NAME).exists():
        return False
    return all(_ends_in_order(file) for file in place.glob("*.mcap"))


def _files(folder: Path) -> list[Path]:
    for left in folder.glob(f".*{_TEMPORARY}"):
        # Of a healing that was cut off itself.
        left.unlink(missing_ok=True)
    found = sorted(folder.glob("*.mcap"), key=_order)
    if not found:
        raise BagInvalidError(
            f"{folder}: a folder with MCAP files is accepted, there is none in it"
        )
    return found


def _order(path: Path) -> tuple[str, int]:
    match = re.fullmatch(r"(.*?)(\d+)", path.stem)
    return (match[1], int(match[2])) if match else (path.stem, -1)


def _heal_file(path: Path, thorough: bool) -> HealedFile:
    with _opened(path) as source:
        _require_mcap(path, source)
        if _ends_in_order(path) and not (thorough and _is_damaged(source)):
            found = _usable(path, thorough)
            if found is not None:
                return HealedFile(
                    path, False, found.messages, found.start_ns, found.end_ns, source.size
                )
        return _healed(path, source)


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[Source]:
    try:
        handle = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    except OSError as error:
        raise BagInvalidError(f"{path}: a readable file is accepted ({error.strerror})") from error
    with Source(handle) as source:
        if not lock_file(handle):
            raise BagNotWritableError(
                f"{path}: the bag is being recorded; it can be healed when that has ended"
            )
        yield source


def _require_mcap(path: Path, source: Source) -> None:
    found = source.read(0, len(MAGIC))
    if not MAGIC.startswith(found):
        raise BagInvalidError(f"{path}: an MCAP file is accepted, but its first bytes are others")


def _ends_in_order(path: Path) -> bool:
    """Tells whether a file has an intact index."""
    try:
        with path.open("rb") as stream:
            size = stream.seek(0, 2)
            tail = _FOOTER.size + len(MAGIC)
            if size < len(MAGIC) + tail:
                return False
            stream.seek(size - tail)
            opcode, _, start, _, crc = _FOOTER.unpack(footer := stream.read(_FOOTER.size))
            if stream.read() != MAGIC or opcode != Opcode.FOOTER or not 0 < start < size - tail:
                return False
            stream.seek(start)
            found = 0
            for _ in range(start, size - tail, 2**20):
                found = zlib.crc32(stream.read(min(2**20, size - tail - stream.tell())), found)
            return crc == 0 or zlib.crc32(footer[:-4], found) == crc
    except OSError:
        return False


def _is_damaged(source: Source) -> bool:
    return any(found.opcode == 0 or found.cut or found.mended for found in walk(source))


def _read_all(path: Path) -> None:
    with naming_damage(path), path.open("rb") as stream:
        size = path.stat().st_size
        reader = SeekingReader(stream, validate_crcs=True, record_size_limit=size)
        for _ in reader.iter_messages():
            pass


def _usable(path: Path, thorough: bool) -> StorageInfo | None:
    """Returns what is in a closed file; None = its index, or what it holds, can't be read.

    Args:
        path: The file.
        thorough: Read it to its end: in a chunk without a CRC nothing else tells that it is
            damaged. By the reader of the format's makers, too: each takes what the other does not.
    """
    try:
        with closing(McapStorage(path)) as storage:
            if thorough:
                for _ in storage.messages(None, None, None):
                    pass
                _read_all(path)
            return storage.info
    except BagInvalidError:
        return None


def _healed(path: Path, source: Source) -> HealedFile:
    temporary = path.with_name(f".{path.name}{_TEMPORARY}")
    try:
        temporary.unlink(missing_ok=True)
        header = read_header(source)
        output = McapOutput(temporary, header.profile, header.library)
        try:
            done = Salvage(source, output).run()
            result = _result(path, source, output, done)
            if done.metadata or header.library == "skinplan":
                _add_record(output, done, result)
            output.end()
        finally:
            output.close()
        if result.kept is not None:
            _keep(path, result.kept)
        temporary.replace(path)
        sync_folder(path.parent)
    except OSError as error:
        raise write_error(path, error) from error
    finally:
        temporary.unlink(missing_ok=True)
    return result


def _result(path: Path, source: Source, output: McapOutput, done: Salvaged) -> HealedFile:
    kept = path.with_name(f"{path.name}.damaged") if done.damaged else None
    return HealedFile(
        path=path,
        healed=True,
        messages=sum(output.counts.values()),
        start_ns=output.start_ns,
        end_ns=output.end_ns,
        bytes_before=source.size,
        bytes_lost=done.bytes_lost,
        messages_undescribed=done.messages_undescribed,
        damaged=tuple(done.damaged),
        kept=kept,
    )


def _keep(path: Path, kept: Path) -> None:
    kept.unlink(missing_ok=True)
    try:
        # A second name: at no moment is the bag without its file.
        os.link(path, kept)
    except OSError:
        # A file system without links.
        path.rename(kept)


def _add_record(output: McapOutput, done: Salvaged, result: HealedFile) -> None:
    """Writes the ``rosbag2`` record that a file closed in order ends with."""
    before = recorded_document(done.metadata.get("serialized_metadata", ""))
    document = metadata_document(
        [FileFigures(result.path.name, result.messages, result.start_ns, result.end_ns)],
        described_topics(output.described, output.counts),
        {**custom_data(before), HEALED_KEY: result.sentence()},
        str(before.get("ros_distro") or "jazzy"),
    )
    output.add_metadata(RECORD_NAME, {"serialized_metadata": metadata_text(document)})


def _rebuild(folder: Path, healed: list[HealedFile]) -> bool:
    for left in folder.glob(f".{FILE_NAME}.*"):
        # Of a closing that was cut off: every file was locked before, so nobody writes it now.
        left.unlink(missing_ok=True)
    files = [file.path for file in healed]
    sentences = [file.sentence() for file in healed if file.healed]
    if not sentences and metadata_fits(folder, files):
        return False
    try:
        rebuild_metadata(folder, files, "; ".join(sentences))
    except OSError as error:
        raise write_error(folder / FILE_NAME, error) from error
    return True
