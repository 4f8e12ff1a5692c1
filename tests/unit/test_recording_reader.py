"""Bags of others: SQLite, packed, split, without metadata, of old versions, damaged ones."""

import itertools
import os
import resource
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import zstandard
from mcap.writer import CompressionType, IndexType, Writer

from bags import Row, write_metadata, write_sqlite
from skinplan.errors import BagInvalidError, BagNotFoundError, InputError
from skinplan.recording.bag import BagSettings, BagWriter
from skinplan.recording.latched import latched_depth, latched_state
from skinplan.recording.model import BagTopic
from skinplan.recording.qos import QosProfile
from skinplan.recording.qos_overrides import read_overrides
from skinplan.recording.read_ahead import ReadAhead
from skinplan.recording.reader import BagReader, open_bag
from skinplan.recording.topic_filter import TopicFilter

ROWS = [Row("/latched" if i % 7 == 0 else "/said", 10**9 + i * 10**7, bytes([i]) * 50)
        for i in range(60)]  # fmt: skip


def rows_of(path: Path, **choice: object) -> list[Row]:
    with BagReader(path) as reader:
        return [Row(m.topic, m.log_time_ns, m.data) for m in reader.messages(**choice)]


@pytest.mark.parametrize("version", range(4, 10))
def test_sqlite_of_every_version(tmp_path: Path, version: int) -> None:
    write_sqlite(tmp_path / "bag_0.db3", ROWS, version)
    write_metadata(tmp_path, ["bag_0.db3"], ROWS, version)
    found = open_bag(tmp_path)
    assert (found.messages, found.start_ns, found.end_ns) == (60, 10**9, 10**9 + 59 * 10**7)
    assert found.custom_data == ({"job": "a"} if version >= 6 else {})
    topics = {topic.name: topic for topic in found.topics}
    assert [topics[name].messages for name in ("/latched", "/said")] == [9, 51]
    assert topics["/latched"].qos[0].latched and not topics["/said"].qos[0].latched
    assert topics["/said"].schema_text == ("string data" if version >= 7 else "")
    assert rows_of(tmp_path) == ROWS


@pytest.mark.parametrize("with_metadata", [True, False])
def test_split_sqlite_in_order(tmp_path: Path, with_metadata: bool) -> None:
    names = [f"bag_{i}.db3" for i in range(12)]
    for number, name in enumerate(names):
        write_sqlite(tmp_path / name, ROWS[number * 5 : number * 5 + 5])
    if with_metadata:
        write_metadata(tmp_path, [f"bag/{name}" for name in names], ROWS, 4)
    assert rows_of(tmp_path) == ROWS
    first = ROWS[13].at_ns
    assert rows_of(tmp_path, topics={"/said"}, start_ns=first, end_ns=ROWS[40].at_ns) == [
        row for row in ROWS[13:40] if row.topic == "/said"
    ]


def test_files_that_overlap_in_time_are_merged(tmp_path: Path) -> None:
    write_sqlite(tmp_path / "bag_0.db3", ROWS[::2])
    write_sqlite(tmp_path / "bag_1.db3", ROWS[1::2])
    assert rows_of(tmp_path) == ROWS


def test_packed_files_and_packed_messages(tmp_path: Path) -> None:
    whole, single = tmp_path / "whole", tmp_path / "single"
    whole.mkdir()
    single.mkdir()
    write_sqlite(whole / "bag_0.db3", ROWS)
    packed = zstandard.compress((whole / "bag_0.db3").read_bytes())
    (whole / "bag_0.db3.zstd").write_bytes(packed)
    (whole / "bag_0.db3").unlink()
    given = {"compression_format": "zstd"}
    write_metadata(whole, ["bag_0.db3.zstd"], ROWS, 9, compression_mode="FILE", **given)
    write_sqlite(single / "bag_0.db3", ROWS, packed=True)
    write_metadata(single, ["bag_0.db3"], ROWS, 9, compression_mode="MESSAGE", **given)
    assert rows_of(whole) == rows_of(single) == ROWS
    (whole / "bag_0.db3.zstd").write_bytes(packed[: len(packed) // 2])
    with pytest.raises(BagInvalidError, match="bag_0"):
        rows_of(whole)


def write_mcap(path: Path, rows: list[Row], **options: object) -> None:
    with path.open("wb") as stream:
        writer = Writer(stream, **options)  # type: ignore[arg-type]
        writer.start(profile="ros2")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        channels = {
            name: writer.register_channel(name, "cdr", schema) for name in ("/latched", "/said")
        }
        for row in rows:
            writer.add_message(channels[row.topic], row.at_ns, row.data, row.at_ns)
        writer.finish()


@pytest.mark.parametrize(
    "options",
    [
        {"use_chunking": False},
        {"use_chunking": False, "use_summary_offsets": False, "use_statistics": False},
        {"index_types": IndexType.NONE},
        {"chunk_size": 200, "index_types": IndexType.ALL},
        {"chunk_size": 200, "compression": CompressionType.LZ4},
        {"chunk_size": 200, "compression": CompressionType.NONE, "enable_crcs": False},
        {"repeat_channels": False, "repeat_schemas": False, "chunk_size": 300},
    ],
)
def test_mcap_of_other_writers_and_out_of_order(tmp_path: Path, options: dict[str, object]) -> None:
    order = np.random.default_rng(3).permutation(len(ROWS))
    write_mcap(tmp_path / "bag.mcap", [ROWS[i] for i in order], **options)
    assert rows_of(tmp_path / "bag.mcap") == ROWS
    found = open_bag(tmp_path / "bag.mcap")
    assert (found.messages, found.complete) == (60, True)
    with BagReader(tmp_path / "bag.mcap") as reader:
        for at, count in itertools.product(range(-1, 61, 4), (1, 3)):
            at_ns = 10**9 + at * 10**7
            wanted = [r.data for r in ROWS if r.topic == "/latched" and r.at_ns <= at_ns][-count:]
            assert [m.data for m in reader.last("/latched", at_ns, count)] == wanted


def test_equal_times_keep_the_order_of_recording(tmp_path: Path) -> None:
    rows = [Row("/said", 10**9 + (i // 20) * 5, bytes([i])) for i in range(100)]
    write_mcap(tmp_path / "bag.mcap", rows, chunk_size=100)
    assert [row.data for row in rows_of(tmp_path / "bag.mcap")] == [row.data for row in rows]


def test_latched_state_before_any_place(tmp_path: Path) -> None:
    for number in range(6):
        write_sqlite(tmp_path / f"bag_{number}.db3", ROWS[number * 10 : number * 10 + 10])
    with BagReader(tmp_path) as reader:
        for at, row in enumerate(ROWS):
            state = latched_state(reader, {"/latched": 1}, row.at_ns)["/latched"]
            wanted = [r.data for r in ROWS[:at] if r.topic == "/latched"][-1:]
            assert [m.data for m in state] == wanted


def test_which_topics_are_latched() -> None:
    volatile, latched = QosProfile(depth=5), QosProfile(depth=5, durability="transient_local")
    unknown = QosProfile(depth=0, durability="transient_local")
    assert latched_depth(BagTopic("/a", "t", 9, qos=(volatile, volatile))) == 0
    assert latched_depth(BagTopic("/a", "t", 9, qos=(volatile, latched))) == 5
    assert latched_depth(BagTopic("/a", "t", 9, qos=(unknown, unknown))) == 2
    assert latched_depth(BagTopic("/tf_static", "t", 9)) == 9
    assert latched_depth(BagTopic("/cell/robot_description", "t", 9)) == 1
    assert latched_depth(BagTopic("/a", "t", 9)) == 0


def test_what_is_missing_or_unknown_is_named(tmp_path: Path) -> None:
    write_sqlite(tmp_path / "bag_0.db3", ROWS)
    write_metadata(tmp_path, ["bag_0.db3", "bag_1.db3"], ROWS, 9)
    with pytest.raises(BagNotFoundError, match=r"bag_1\.db3"):
        open_bag(tmp_path)
    write_metadata(
        tmp_path, ["bag_0.db3"], ROWS, 9, compression_mode="FILE", compression_format="x"
    )
    with pytest.raises(BagInvalidError, match="file with x"):
        open_bag(tmp_path)
    (tmp_path / "other.bin").write_bytes(b"x")
    with pytest.raises(BagInvalidError, match=r"ends in \.mcap or \.db3"):
        open_bag(tmp_path / "other.bin")
    (tmp_path / "other.db3").write_bytes(b"x" * 100)
    with pytest.raises(BagInvalidError, match="SQLite"):
        open_bag(tmp_path / "other.db3")


def test_topics_are_chosen_by_name_and_pattern() -> None:
    names = ["/a", "/a/b", "/c", "/tf"]

    def chosen(**given: object) -> list[str]:
        return [name for name in names if TopicFilter(**given).takes(name)]  # type: ignore[arg-type]

    assert chosen() == names
    assert chosen(topics=("/c",), regex="/a.*") == ["/a", "/a/b", "/c"]
    assert chosen(exclude_topics=("/c",), exclude_regex="/a/.*") == ["/a", "/tf"]
    assert chosen(regex="/a", exclude_regex="/a") == []
    with pytest.raises(InputError, match="regular expression"):
        TopicFilter(regex="(")
    with pytest.raises(InputError, match="/nowhere"):
        TopicFilter(topics=("/nowhere",)).require_known(names)


def test_qos_overrides_as_rosbag2_has_them(tmp_path: Path) -> None:
    path = tmp_path / "qos.yaml"
    path.write_text("/a:\n  depth: 7\n  durability: transient_local\n"
                    "  deadline:\n    sec: 1\n    nsec: 5\n")  # fmt: skip
    changed = read_overrides(path)["/a"](QosProfile(reliability="best_effort"))
    assert changed == QosProfile(
        depth=7, durability="transient_local", reliability="best_effort", deadline_ns=10**9 + 5
    )
    for text, words in (
        ("/a: {colour: red}", "colour"),
        ("/a: {depth: many}", "whole number"),
        ("/a: {history: keep_some}", "keep_last"),
        ("/a: {deadline: {sec: 1}}", "nsec"),
        ("/a: 5", "mapping of QoS"),
        ("[1]", "mapping from topics"),
        ("{", "YAML"),
    ):
        path.write_text(text)
        with pytest.raises(InputError, match=words):
            read_overrides(path)


def test_read_ahead_is_bounded_and_hands_on_errors() -> None:
    taken = []

    def endless():
        from skinplan.recording.model import BagMessage

        for number in itertools.count():
            taken.append(number)
            if number == 500:
                raise BagInvalidError("broken")
            yield BagMessage("/a", "t", bytes(1000), number, number)

    ahead = ReadAhead(endless(), 10_000)
    assert ahead.next() is not None
    ahead.close()
    assert len(taken) < 50
    ahead = ReadAhead(endless(), 10**6)
    with pytest.raises(BagInvalidError, match="broken"):
        for _ in range(600):
            ahead.next()


def damaged(good: bytes, rng: np.random.Generator) -> bytes:
    """One damaged input: cut, flipped, another magic, a huge length, pieces doubled or lost."""
    data = bytearray(good)
    kind = rng.integers(6)
    place = int(rng.integers(len(data)))
    if kind == 0:
        return bytes(data[:place])
    if kind == 1:
        for at in rng.integers(len(data), size=int(rng.integers(1, 9))):
            data[at] ^= 1 << int(rng.integers(8))
    elif kind == 2:
        data[int(rng.integers(8))] ^= 0xFF
    elif kind == 3:
        size = int(rng.choice([4, 8]))
        data[place : place + size] = struct.pack("<Q", int(rng.integers(2**62)) * 2)[:size]
    elif kind == 4:
        del data[place : place + int(rng.integers(1, 400))]
    else:
        data[place:place] = data[place : place + int(rng.integers(1, 400))]
    return bytes(data)


FUZZ = """
import resource, sys
from pathlib import Path
sys.path[:0] = [{tests!r}]
resource.setrlimit(resource.RLIMIT_AS, (3 * 2**30, 3 * 2**30))
import numpy as np
from skinplan.errors import SkinplanError
from skinplan.recording.reader import BagReader
from unit.test_recording_reader import damaged
folder, seed, count = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
goods = [p for p in sorted(folder.iterdir()) if p.suffix in (".mcap", ".db3", ".zstd")]
rng = np.random.default_rng(seed)
named = whole = 0
for number in range(count):
    good = goods[number % len(goods)]
    path = folder / ("bad" + "".join(good.suffixes))
    path.write_bytes(damaged(good.read_bytes(), rng))
    try:
        with BagReader(path) as reader:
            for topic in reader.info.topics:
                reader.last(topic.name, reader.info.end_ns, 3)
            for message in reader.messages():
                pass
        whole += 1
    except SkinplanError as error:
        assert str(path.with_name("bad").name) in str(error), error
        named += 1
    path.unlink()
# Not ru_maxrss: that one comes from the parent, too.
status = Path("/proc/self/status").read_text()
used = int(status.split("VmHWM:")[1].split()[0])
print(named, whole, used)
"""


def fuzz(tmp_path: Path, seed: int, count: int) -> None:
    rng = np.random.default_rng(1)
    rows = [Row(row.topic, row.at_ns, rng.bytes(300)) for row in ROWS]
    write_sqlite(tmp_path / "a.db3", rows)
    (tmp_path / "b.db3.zstd").write_bytes(zstandard.compress((tmp_path / "a.db3").read_bytes()))
    write_mcap(tmp_path / "c.mcap", rows, chunk_size=2000)
    write_mcap(tmp_path / "d.mcap", rows, chunk_size=2000, compression=CompressionType.LZ4)
    write_mcap(tmp_path / "e.mcap", rows, use_chunking=False)
    settings = BagSettings("none", chunk_bytes=2000)
    with BagWriter(tmp_path / "own", settings=settings) as writer:
        writer.add_topic("/said", "std_msgs/msg/String", "string data")
        for row in rows:
            writer.write("/said", row.data, row.at_ns)
    (tmp_path / "own" / "own_0.mcap").rename(tmp_path / "f.mcap")
    script = FUZZ.format(tests=str(Path(__file__).resolve().parents[1]))
    done = subprocess.run(
        [sys.executable, "-c", script, str(tmp_path), str(seed), str(count)],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)},
        capture_output=True,
        text=True,
        timeout=250,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    named, whole, used_kb = map(int, done.stdout.split())
    assert named + whole == count and named > count // 4
    assert used_kb < 700_000, "memory is bounded whatever a file claims"


def test_damaged_files_are_named_within_bounded_memory(tmp_path: Path) -> None:
    assert resource.getrlimit(resource.RLIMIT_AS)
    fuzz(tmp_path, 1, 300)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(2, 12))
def test_many_damaged_files(tmp_path: Path, seed: int) -> None:
    fuzz(tmp_path, seed, 500)
