"""Scan frames on disk: read back, cut at every byte, damaged, of another job, on a full disk."""

import resource
import signal
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from skinplan.errors import ResumeRefusedError
from skinplan.inspection.spool import FILE_NAME, FrameSpool, SpoolOwner, read_records
from skinplan.inspection.spool_records import FrameRecord, HiddenRecord, PoseRecord, Record
from skinplan.transforms import transform

OWNER = SpoolOwner("job-1", "panel", "ab" * 32)


def frame(stamp_s: float, count: int = 4, wide: bool = False) -> FrameRecord:
    random = np.random.default_rng(int(stamp_s * 10))
    points = random.normal(size=(count, 3))
    if not wide:
        points = points.astype(np.float32).astype(float)
    intensity, incidence = random.random((2, count)).astype(np.float32).astype(float)
    return FrameRecord(
        stamp_s, np.array([0.6, 0.8, 0.0]), count % 2 == 1, points, intensity, incidence
    )


def same(left: Record, right: Record) -> bool:
    if type(left) is not type(right):
        return False
    return all(
        np.array_equal(a, b) for a, b in zip(vars(left).values(), vars(right).values(), strict=True)
    )


RECORDS: list[Record] = [
    frame(1.0),
    HiddenRecord(),
    PoseRecord(3.5, transform((1.0, 2.0, 3.0))),
    frame(1.1, 0),
    frame(1.2, 5, wide=True),
]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    spool = FrameSpool.create(tmp_path, OWNER)
    for record in RECORDS:
        spool.add(record)
    spool.close()
    return tmp_path / FILE_NAME


def resumed(path: Path) -> list[Record]:
    spool, records = FrameSpool.resume(path.parent, OWNER)
    found = list(records)
    spool.close()
    return found


def all_same(left: list[Record], right: list[Record]) -> bool:
    return len(left) == len(right) and all(map(same, left, right))


def test_what_was_kept_is_read_back(path: Path) -> None:
    assert all_same(resumed(path), RECORDS)


def test_single_precision_is_kept_in_half_the_bytes(tmp_path: Path) -> None:
    sizes = []
    for wide in (False, True):
        spool = FrameSpool.create(tmp_path / str(wide), OWNER)
        spool.add(frame(1.0, 1000, wide))
        spool.close()
        sizes.append((tmp_path / str(wide) / FILE_NAME).stat().st_size)
    assert sizes[1] - sizes[0] == 3 * 4 * 1000


def test_a_tail_cut_at_any_byte_is_dropped_and_the_file_goes_on(path: Path) -> None:
    whole = path.read_bytes()
    spool = FrameSpool.create(path.parent / "shorter", OWNER)
    for record in RECORDS[:-1]:
        spool.add(record)
    spool.close()
    begin = (path.parent / "shorter" / FILE_NAME).stat().st_size
    for cut in range(begin, len(whole)):
        path.write_bytes(whole[:cut])
        spool, records = FrameSpool.resume(path.parent, OWNER)
        assert all_same(list(records), RECORDS[:-1]), cut
        spool.add(RECORDS[-1])
        spool.close()
        assert path.read_bytes() == whole, cut


def test_a_flipped_byte_costs_its_record_only(path: Path) -> None:
    whole = path.read_bytes()
    first = whole.index(b"\xa5FR\x5a", whole.index(b"}"))
    for place in range(first, len(whole)):
        damaged = bytearray(whole)
        damaged[place] ^= 0x41
        path.write_bytes(damaged)
        found = resumed(path)
        assert len(found) == len(RECORDS) - 1, place
        rest = iter(RECORDS)
        assert all(any(same(record, other) for other in rest) for record in found), place


def test_a_mark_inside_of_a_frame_is_no_record(tmp_path: Path) -> None:
    spool = FrameSpool.create(tmp_path, OWNER)
    points = np.frombuffer(b"\xa5FR\x5a" * 30, "<f4").reshape(-1, 3).astype(float)
    none = np.zeros(len(points))
    records: list[Record] = [FrameRecord(1.0, np.zeros(3), False, points, none, none), frame(2.0)]
    for record in records:
        spool.add(record)
    spool.close()
    path = tmp_path / FILE_NAME
    assert all_same(resumed(path), records)
    damaged = bytearray(path.read_bytes())
    damaged[damaged.index(b"\xa5FR\x5a" * 3) - 1] ^= 1
    path.write_bytes(damaged)
    assert all_same(resumed(path), records[1:])


def test_frames_of_another_job_or_part_are_refused_by_name(path: Path) -> None:
    whole = path.read_bytes()
    for other, word in (
        (SpoolOwner("job-2", "panel", "ab" * 32), "job-1"),
        (SpoolOwner("job-1", "panel", "cd" * 32), "abababababab"),
    ):
        with pytest.raises(ResumeRefusedError, match=word):
            FrameSpool.resume(path.parent, other)
    with pytest.raises(ResumeRefusedError, match="job-1"):
        FrameSpool.create(path.parent, SpoolOwner("job-2", "panel", "ab" * 32))
    assert path.read_bytes() == whole


def test_anew_replaces_what_the_same_job_had(path: Path) -> None:
    FrameSpool.create(path.parent, OWNER).close()
    assert resumed(path) == []


@pytest.mark.parametrize("content", [b"", b"skinplan", b"\0" * 500, b"skinplan frames 1\nnonsense"])
def test_a_file_that_is_none_is_begun_anew(tmp_path: Path, content: bytes) -> None:
    (tmp_path / FILE_NAME).write_bytes(content)
    spool, records = FrameSpool.resume(tmp_path, OWNER)
    assert list(records) == []
    spool.add(RECORDS[0])
    spool.close()
    assert all_same(list(read_records(tmp_path / FILE_NAME)), RECORDS[:1])


@pytest.fixture
def most_bytes() -> Iterator[int]:
    """No file may grow beyond so many bytes: the kernel cuts the write off, as on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2000, before[1]))
    yield 2000
    resource.setrlimit(resource.RLIMIT_FSIZE, before)
    signal.signal(signal.SIGXFSZ, handler)


def test_a_full_disk_is_named_and_leaves_a_whole_file(tmp_path: Path, most_bytes: int) -> None:
    spool = FrameSpool.create(tmp_path, OWNER)
    kept = 0
    while not spool.failure:
        spool.add(frame(1.0 + kept, 20))
        kept += not spool.failure
        assert kept < 100
    assert str(tmp_path / FILE_NAME) in spool.failure
    assert "memory" in spool.failure
    spool.add(frame(99.0))
    spool.sync()
    spool.close()
    assert (tmp_path / FILE_NAME).stat().st_size <= most_bytes
    found = resumed(tmp_path / FILE_NAME)
    assert all_same(found, [frame(1.0 + number, 20) for number in range(kept)])
    assert kept >= 2
