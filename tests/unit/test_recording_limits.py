"""Splits, full disks, the bounded queue, the snapshot ring, and which topics are taken."""

import resource
import subprocess
import sys
import time
from pathlib import Path

import pytest
import yaml

from skinplan.errors import BagNotWritableError, DiskFullError
from skinplan.recording.bag import BagSettings, BagWriter
from skinplan.recording.heal import heal_bag, is_finished
from skinplan.recording.message_queue import MessageQueue, QueuedMessage
from skinplan.recording.reader import open_bag, read_messages
from skinplan.recording.ring import SnapshotRing
from skinplan.recording.selection import TopicSelection
from skinplan.recording.unfinished import UnfinishedBags
from unit.test_recording_heal import LATCHED, string, texts, texts_of_mcap, texts_of_rosbags

TYPE = "std_msgs/msg/String"


def write_split(folder: Path, **settings: object) -> None:
    given = BagSettings(chunk_bytes=500, **settings)  # type: ignore[arg-type]
    with BagWriter(folder, {"seed": "1"}, given) as bag:
        bag.add_topic("/state", TYPE, "string data\n", qos=[LATCHED])
        bag.add_topic("/chatter", TYPE, "string data\n")
        bag.write("/state", string("ready"), 10**9, 7)
        for i in range(100):
            bag.write("/chatter", string(f"{i} {'x' * 80}"), 10**9 + i * 10**8)


@pytest.mark.parametrize("settings", [{"split_bytes": 2000}, {"split_s": 2.0}])
def test_every_split_begins_with_the_latched_messages(tmp_path: Path, settings: object) -> None:
    write_split(tmp_path / "bag", compression="none", **settings)  # type: ignore[arg-type]
    found = open_bag(tmp_path / "bag")
    assert len(found.files) >= 5 and found.complete
    assert [file.name for file in found.files] == [f"bag_{i}.mcap" for i in range(len(found.files))]
    for number, file in enumerate(found.files):
        first = next(iter(read_messages(open_bag(file))))
        assert (first.topic, first.data, first.publish_time_ns) == ("/state", string("ready"), 7)
        if number:
            assert first.log_time_ns >= open_bag(found.files[number - 1]).end_ns
    chatter = [m.data for m in read_messages(found, ["/chatter"])]
    assert chatter == [string(f"{i} {'x' * 80}") for i in range(100)]
    text = (tmp_path / "bag" / "metadata.yaml").read_text()
    listed = yaml.safe_load(text)["rosbag2_bagfile_information"]
    assert listed["message_count"] == 100 + len(found.files)
    assert sum(file["message_count"] for file in listed["files"]) == listed["message_count"]
    assert len(texts_of_rosbags(tmp_path / "bag")) == listed["message_count"]
    assert texts_of_mcap(tmp_path / "bag") == texts(tmp_path / "bag")


FULL = """
import resource, sys
from pathlib import Path
from skinplan.recording.bag import BagWriter, BagSettings
from skinplan.errors import DiskFullError
import os
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]), int(sys.argv[2])))
settings = BagSettings(compression="none", chunk_bytes=5000, flush_s=3600.0)
bag = BagWriter(Path(sys.argv[1]), {"job_id": "j7"}, settings)
bag.add_topic("/chatter", "std_msgs/msg/String", "string data\\n")
text = b"x" * 999 + b"\\0"
taken = 0
try:
    for i in range(10_000):
        bag.write("/chatter", b"\\0\\1\\0\\0\\xe8\\3\\0\\0" + text, 1000 + i)
        taken += 1
except DiskFullError as error:
    print(error)
summary = bag.finish()
print(type(summary.failure).__name__, summary.messages, sum(summary.lost.values()), taken + 1)
"""


@pytest.mark.parametrize("limit", [20_000, 20_400, 50_000, 300_000])
def test_a_full_disk_ends_the_recording_in_order(tmp_path: Path, limit: int) -> None:
    command = [sys.executable, "-c", FULL, str(tmp_path / "bag"), str(limit)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    reason, figures = done.stdout.splitlines()
    assert "can't be written" in reason and "up to here" in reason
    kind, messages, lost, asked = figures.split()
    assert kind == "DiskFullError"
    assert int(messages) + int(lost) == int(asked)
    assert int(messages) > 0 and int(lost) <= 15
    assert is_finished(tmp_path / "bag") and open_bag(tmp_path / "bag").complete
    assert len(texts(tmp_path / "bag")) == int(messages) == len(texts_of_rosbags(tmp_path / "bag"))
    assert (tmp_path / "bag" / "bag_0.mcap").stat().st_size <= limit


NEVER = """
import resource, sys
from pathlib import Path
from skinplan.recording.bag import BagWriter
from skinplan.errors import DiskFullError
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]), int(sys.argv[2])))
try:
    BagWriter(Path(sys.argv[1]))
except DiskFullError as error:
    print(error)
"""


@pytest.mark.parametrize("limit", [3, 30, 300], ids=["magic", "header", "metadata"])
def test_a_bag_that_can_not_begin_leaves_nothing_behind(tmp_path: Path, limit: int) -> None:
    (tmp_path / "there").mkdir()
    for name in ("new", "there"):
        command = [sys.executable, "-c", NEVER, str(tmp_path / name), str(limit)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60)
        assert "can't be written" in done.stdout, done.stderr
    assert [path.name for path in tmp_path.rglob("*")] == ["there"]


def test_a_disk_with_too_little_left_is_refused_before_and_during(tmp_path: Path) -> None:
    with pytest.raises(DiskFullError, match="have to stay free"):
        BagWriter(tmp_path / "never", settings=BagSettings(least_free_bytes=2**60))
    assert not (tmp_path / "never").exists()
    bag = BagWriter(tmp_path / "bag", settings=BagSettings(chunk_bytes=1000, flush_s=3600.0))
    bag.add_topic("/chatter", TYPE, "string data\n")
    for i in range(30):
        bag.write("/chatter", string("x" * 100), i)
    bag._files.least_free_bytes = 2**60  # as if others had filled the disk meanwhile
    with pytest.raises(DiskFullError, match="have to stay free"):
        for i in range(30):
            bag.write("/chatter", string("x" * 100), 30 + i)
    summary = bag.finish()
    assert isinstance(summary.failure, DiskFullError)
    assert summary.messages + summary.lost["/chatter"] > 30
    assert len(texts(tmp_path / "bag")) == summary.messages >= 20


def test_heal_on_a_full_disk_leaves_the_bag_as_it_was(tmp_path: Path) -> None:
    write_split(tmp_path / "bag", compression="none")
    file = tmp_path / "bag" / "bag_0.mcap"
    file.write_bytes(file.read_bytes()[:9000])
    before = file.read_bytes()
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4000, hard))
    try:
        with pytest.raises(DiskFullError, match="bag_0"):
            heal_bag(tmp_path / "bag")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert file.read_bytes() == before
    assert not [*(tmp_path / "bag").glob(".*")]
    assert heal_bag(tmp_path / "bag").healed


def test_what_does_not_fit_into_the_queue_is_counted_by_topic(tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / "bag")
    for topic in ("/a", "/b"):
        bag.add_topic(topic, TYPE, "string data\n")
    queue = MessageQueue(bag, 3000)
    with bag._lock:  # the disk stands still
        for i in range(20):
            queue.put("/a", string("x" * 300), 1000 + i, 1000 + i)
            queue.put("/b", string("y" * 300), 1000 + i, 1000 + i)
        assert queue.waiting_bytes <= 3000
    queue.finish()
    written = bag.finish().messages
    assert written >= 5
    assert set(queue.dropped) == {"/a", "/b"}
    assert written + sum(queue.dropped.values()) == 40


def message(topic: str, log_ns: int, size: int = 100) -> QueuedMessage:
    return QueuedMessage(topic, bytes(size), log_ns, log_ns)


def test_the_ring_is_bounded_by_bytes_and_time_and_keeps_what_is_latched() -> None:
    ring = SnapshotRing(10_000, 0.0)
    ring.latch("/state")
    ring.add(message("/state", 1))
    for i in range(100):
        ring.add(message("/data", 10 + i))
        assert ring.size_bytes <= 10_000
    found = ring.take()
    assert [m.log_time_ns for m in found[1:]] == list(range(110 - len(found) + 1, 110))
    assert (found[0].topic, found[0].log_time_ns) == ("/state", found[1].log_time_ns)
    assert ring.take() == [] and ring.size_bytes == 0
    ring.add(message("/data", 500))
    assert [m.topic for m in ring.take()] == ["/state", "/data"]
    timed = SnapshotRing(10**9, 2.0)
    for i in range(100):
        timed.add(message("/data", i * 10**8))
    assert [m.log_time_ns for m in timed.take()] == [i * 10**8 for i in range(79, 100)]


@pytest.mark.parametrize(
    ("selection", "taken"),
    [
        ({}, "/a /b/x /b/y"),
        ({"topics": ("a", "/go/_action/status")}, "/a /go/_action/status"),
        ({"pattern": "/b/.*"}, "/b/x /b/y"),
        ({"pattern": "/b"}, ""),
        ({"types": ("T/msg/Y",)}, "/b/y"),
        ({"topics": ("/a",), "types": ("T/msg/Y",)}, "/a /b/y"),
        ({"exclude_topics": ("a",), "exclude_types": ("T/msg/Y",)}, "/b/x"),
        ({"exclude_pattern": "/b.*", "topics": ("/b/x", "/a")}, "/a"),
        ({"include_hidden": True}, "/a /b/x /b/y /go/_action/status"),
    ],
)
def test_topics_are_taken_by_name_pattern_and_type(selection: dict, taken: str) -> None:  # type: ignore[type-arg]
    graph = {"/a": "T/msg/A", "/b/x": "T/msg/X", "/b/y": "T/msg/Y", "/go/_action/status": "T/msg/S"}
    chosen = TopicSelection(**selection)
    assert " ".join(t for t, kind in graph.items() if chosen.takes(t, kind)) == taken
    with pytest.raises(BagNotWritableError, match="regular expression"):
        TopicSelection(pattern="(")


def test_bags_under_way_are_healed_at_the_next_start(tmp_path: Path) -> None:
    noted = UnfinishedBags(tmp_path / "state")
    write_split(tmp_path / "cut")
    file = tmp_path / "cut" / "cut_0.mcap"
    file.write_bytes(file.read_bytes()[:-500])
    for name in ("cut", "gone", "live"):
        noted.begin(tmp_path / name)
    with BagWriter(tmp_path / "live"):
        sentences = noted.heal()
    assert len(sentences) == 2 and "being recorded" in sentences[1] + sentences[0]
    assert is_finished(tmp_path / "cut")
    assert noted.heal() == [], "in order by now, so their notes go"
    assert not [*noted.folder.iterdir()]


def test_a_message_that_can_not_be_written_is_named_and_the_others_are_written(tmp_path):
    bag = BagWriter(tmp_path / "bag")
    bag.add_topic("/a", TYPE, "string data\n")
    queue = MessageQueue(bag, 10_000)
    queue.put("/a", string("good"), 1000, 1000)
    queue.put("/unknown", string("bad"), 1001, 1001)
    while queue.waiting_bytes:
        time.sleep(0.01)
    queue.put("/a", string("late"), 1002, 1002)
    queue.finish()
    assert queue.failure is not None and "/unknown" in str(queue.failure)
    assert bag.finish().messages == 2
    assert queue.dropped == {"/unknown": 1}
