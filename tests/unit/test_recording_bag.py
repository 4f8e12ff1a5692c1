"""What is written is read back: by our reader, by rosbags and by mcap-ros2-support."""

import os
import shutil
import signal
import struct
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader

from skinplan.errors import BagInvalidError, BagNotFoundError, BagNotWritableError
from skinplan.recording.bag import BagSettings, BagWriter
from skinplan.recording.model import BagInfo
from skinplan.recording.qos import QosProfile
from skinplan.recording.reader import open_bag, read_messages

HASH = "RIHS01_" + "0123456789abcdef" * 4
FEEDBACK = (
    "unique_identifier_msgs/UUID goal_id\ndemo/Move_Feedback feedback\n"
    + 80 * "="
    + "\nMSG: unique_identifier_msgs/UUID\nuint8[16] uuid\n"
    + 80 * "="
    + "\nMSG: demo/Move_Feedback\nfloat64 progress\n"
)
LATCHED = QosProfile(depth=1, durability="transient_local")


def string(text: str) -> bytes:
    """The CDR bytes of a std_msgs/String."""
    data = text.encode() + b"\0"
    return b"\x00\x01\x00\x00" + struct.pack("<I", len(data)) + data


def write_bag(folder: Path, count: int = 20, **settings: object) -> None:
    with BagWriter(folder, {"job_id": "j1", "seed": "5"}, BagSettings(**settings)) as bag:  # type: ignore[arg-type]
        bag.add_topic("/chatter", "std_msgs/msg/String", "string data\n", HASH, [QosProfile()])
        bag.add_topic(
            "/status", "std_msgs/msg/String", "string data\n", HASH, [LATCHED, QosProfile()]
        )
        bag.add_topic("/silent", "std_msgs/msg/String", "string data\n", HASH)
        for i in range(count):
            bag.write(
                "/chatter",
                string(f"hello {i} " + "x" * 200),
                10**18 + i * 10**7,
                10**18 + i * 10**7 - 5,
            )
        bag.write("/status", string("done"), 10**18 + count * 10**7)


def logged(bag: BagInfo) -> list[tuple[str, bytes, int]]:
    return [(m.topic, m.data, m.log_time_ns) for m in read_messages(bag)]


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
def test_our_reader_gives_back_what_was_written(tmp_path: Path, compression: str) -> None:
    write_bag(tmp_path / "bag", compression=compression, chunk_bytes=500)
    found = open_bag(tmp_path / "bag")
    assert found.complete
    assert found.messages == 21
    assert (found.start_ns, found.end_ns) == (10**18, 10**18 + 20 * 10**7)
    assert found.custom_data == {"job_id": "j1", "seed": "5"}
    assert {t.name: t.messages for t in found.topics} == {
        "/chatter": 20,
        "/silent": 0,
        "/status": 1,
    }
    status = next(t for t in found.topics if t.name == "/status")
    assert status.qos == (LATCHED, QosProfile())
    assert status.type_hash == HASH
    messages = list(read_messages(found))
    assert [m.data for m in messages[:20]] == [string(f"hello {i} " + "x" * 200) for i in range(20)]
    assert messages[3].publish_time_ns == messages[3].log_time_ns - 5
    assert messages[-1].topic == "/status"


def test_topics_and_times_select(tmp_path: Path) -> None:
    write_bag(tmp_path / "bag")
    found = open_bag(tmp_path / "bag")
    middle = list(read_messages(found, ["/chatter"], 10**18 + 5 * 10**7, 10**18 + 8 * 10**7))
    assert [m.log_time_ns for m in middle] == [10**18 + i * 10**7 for i in (5, 6, 7)]


def test_rosbags_reads_the_same(tmp_path: Path) -> None:
    rosbag2 = pytest.importorskip("rosbags.rosbag2")
    typesys = pytest.importorskip("rosbags.typesys")
    write_bag(tmp_path / "bag")
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    with rosbag2.Reader(tmp_path / "bag") as reader:
        assert reader.message_count == 21
        assert reader.start_time == 10**18
        found = {c.topic: c for c in reader.connections}
        assert found["/status"].digest == HASH
        assert [q.durability.name for q in found["/status"].ext.offered_qos_profiles] == [
            "TRANSIENT_LOCAL",
            "VOLATILE",
        ]
        texts = [store.deserialize_cdr(data, c.msgtype).data for c, _, data in reader.messages()]
    assert texts == [f"hello {i} " + "x" * 200 for i in range(20)] + ["done"]


def test_mcap_ros2_decodes_the_same(tmp_path: Path) -> None:
    decoder = pytest.importorskip("mcap_ros2.decoder")
    write_bag(tmp_path / "bag")
    with (tmp_path / "bag" / "bag_0.mcap").open("rb") as stream:
        reader = make_reader(
            stream, validate_crcs=True, decoder_factories=[decoder.DecoderFactory()]
        )
        assert (reader.get_header().profile, reader.get_header().library) == ("ros2", "skinplan")
        texts = [m.decoded_message.data for m in reader.iter_decoded_messages()]
        records = [m for m in reader.iter_metadata() if m.name == "rosbag2"]
    assert texts == [f"hello {i} " + "x" * 200 for i in range(20)] + ["done"]
    counts = [yaml.safe_load(r.metadata["serialized_metadata"])["message_count"] for r in records]
    assert counts == [0, 21]


def test_an_action_s_feedback_is_decoded(tmp_path: Path) -> None:
    # By rosbags; mcap-ros2-support refuses every type whose name ends in _FeedbackMessage.
    rosbag2 = pytest.importorskip("rosbags.rosbag2")
    typesys = pytest.importorskip("rosbags.typesys")
    data = b"\x00\x01\x00\x00" + bytes(range(16)) + struct.pack("<d", 0.25)
    name = "demo/action/Move_FeedbackMessage"
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("/move/_action/feedback", name, FEEDBACK, HASH, [QosProfile()])
        bag.write("/move/_action/feedback", data, 5)
    store = typesys.get_typestore(typesys.Stores.EMPTY)
    store.register(typesys.get_types_from_msg(FEEDBACK, name))
    with rosbag2.Reader(tmp_path / "bag") as reader:
        (connection, _, raw) = next(iter(reader.messages()))
        message = store.deserialize_cdr(raw, connection.msgtype)
    assert message.feedback.progress == 0.25
    assert np.array_equal(message.goal_id.uuid, np.arange(16))


def test_metadata_has_the_fields_of_rosbag2(tmp_path: Path) -> None:
    write_bag(tmp_path / "bag")
    text = (tmp_path / "bag" / "metadata.yaml").read_text()
    found = yaml.safe_load(text)["rosbag2_bagfile_information"]
    assert list(found) == [
        "version",
        "storage_identifier",
        "duration",
        "starting_time",
        "message_count",
        "topics_with_message_count",
        "compression_format",
        "compression_mode",
        "relative_file_paths",
        "files",
        "custom_data",
        "ros_distro",
    ]
    assert found["version"] == 9
    assert found["duration"] == {"nanoseconds": 20 * 10**7}
    assert found["relative_file_paths"] == ["bag_0.mcap"]
    assert found["files"][0]["message_count"] == 21
    topic = found["topics_with_message_count"][0]["topic_metadata"]
    assert topic["offered_qos_profiles"][0]["reliability"] == "reliable"
    assert topic["type_description_hash"] == HASH
    assert '  compression_format: ""\n' in text
    assert "  relative_file_paths:\n    - bag_0.mcap\n" in text


def test_a_bag_without_messages_is_a_bag(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("/chatter", "std_msgs/msg/String", "string data\n")
    found = open_bag(tmp_path / "bag")
    assert (found.messages, found.duration_s, found.complete) == (0, 0.0, True)
    assert [t.name for t in found.topics] == ["/chatter"]
    assert list(read_messages(found)) == []


def test_finish_twice_is_once(tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / "bag")
    first = bag.finish()
    content = (tmp_path / "bag" / "bag_0.mcap").read_bytes()
    assert bag.finish() == first
    assert (tmp_path / "bag" / "bag_0.mcap").read_bytes() == content
    with pytest.raises(BagNotWritableError, match="closed"):
        bag.write("/chatter", b"", 0)
    bag.flush()


def test_an_error_inside_still_closes_the_bag(tmp_path: Path) -> None:
    with pytest.raises(KeyError), BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("/chatter", "std_msgs/msg/String", "string data\n")
        bag.write("/chatter", string("a"), 1)
        raise KeyError("stop")
    assert open_bag(tmp_path / "bag").complete


def test_illegal_writes_are_named(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as bag:
        number = bag.add_topic("/chatter", "std_msgs/msg/String", "string data\n")
        assert bag.add_topic("/chatter", "std_msgs/msg/String", "string data\n") == number
        with pytest.raises(BagNotWritableError, match="std_msgs/msg/Bool"):
            bag.add_topic("/chatter", "std_msgs/msg/Bool", "bool data\n")
        with pytest.raises(BagNotWritableError, match="/other"):
            bag.write("/other", b"", 0)
        with pytest.raises(BagNotWritableError, match="-1"):
            bag.write("/chatter", b"", -1)
    with pytest.raises(BagNotWritableError, match="not empty"):
        BagWriter(tmp_path / "bag")
    with pytest.raises(BagNotWritableError, match="brotli"):
        BagWriter(tmp_path / "b", settings=BagSettings(compression="brotli"))
    (tmp_path / "file").write_text("x")
    with pytest.raises(BagNotWritableError, match="can't be created"):
        BagWriter(tmp_path / "file" / "bag")


def test_many_threads_write_one_bag(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", settings=BagSettings(chunk_bytes=2000, flush_s=0.001)) as bag:

        def work(name: str) -> None:
            bag.add_topic(name, "std_msgs/msg/String", "string data\n")
            for i in range(300):
                bag.write(name, string(f"{name} {i}"), 1000 + i)

        threads = [threading.Thread(target=work, args=(f"/t{k}",)) for k in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    found = open_bag(tmp_path / "bag")
    assert {t.messages for t in found.topics} == {300}
    assert sorted(m.data for m in read_messages(found, ["/t2"])) == sorted(
        string(f"/t2 {i}") for i in range(300)
    )


def test_a_killed_recorder_leaves_what_was_flushed(tmp_path: Path) -> None:
    script = f"""
import sys, time
from pathlib import Path
from skinplan.recording.bag import BagWriter, BagSettings
bag = BagWriter(Path({str(tmp_path / "bag")!r}), {{"job_id": "j7"}}, BagSettings(flush_s=0.05))
bag.add_topic("/chatter", "std_msgs/msg/String", "string data\\n")
for i in range(50):
    bag.write("/chatter", b"\\x00\\x01\\x00\\x00" + bytes([2, 0, 0, 0, 97, 0]), 1000 + i)
bag.flush()
print("flushed", flush=True)
bag.write("/chatter", b"", 5000)
time.sleep(60)
"""
    process = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None and process.stdout.readline() == "flushed\n"
    os.kill(process.pid, signal.SIGKILL)
    process.wait(10)
    found = open_bag(tmp_path / "bag")
    assert not found.complete
    assert found.messages >= 50
    assert found.custom_data == {"job_id": "j7"}
    assert [t for _, _, t in logged(found)][:50] == [1000 + i for i in range(50)]


def test_a_message_reaches_the_disk_without_another_call(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", settings=BagSettings(flush_s=0.02)) as bag:
        bag.add_topic("/chatter", "std_msgs/msg/String", "string data\n")
        bag.write("/chatter", string("a"), 1)
        until = time.monotonic() + 10.0
        while open_bag(tmp_path / "bag").messages == 0:
            assert time.monotonic() < until, "the message stayed in memory"
            time.sleep(0.01)


def test_a_file_cut_anywhere_gives_its_complete_chunks_or_a_named_error(tmp_path: Path) -> None:
    write_bag(tmp_path / "bag", count=60, chunk_bytes=1000)
    whole = (tmp_path / "bag" / "bag_0.mcap").read_bytes()
    everything = logged(open_bag(tmp_path / "bag"))
    counts = []
    for length in np.random.default_rng(3).integers(0, len(whole) - 1, 60):
        path = tmp_path / "cut.mcap"
        path.write_bytes(whole[:length])
        try:
            found = open_bag(path)
        except BagInvalidError:
            counts.append(0)
            continue
        assert not found.complete
        messages = logged(found)
        assert messages == everything[: len(messages)]
        assert len(messages) == found.messages
        counts.append(len(messages))
    assert 0 < max(counts) <= 61 and len(set(counts)) > 5


@pytest.mark.parametrize(
    "content", [b"", b"hello", b"\x89MCAP0\r\n", bytes(5000), b"\x89MCAP0\r\n" * 9]
)
def test_garbage_is_named(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "bad.mcap"
    path.write_bytes(content)
    with pytest.raises(BagInvalidError, match=r"bad\.mcap"):
        open_bag(path)


def test_flipped_bytes_never_give_a_traceback(tmp_path: Path) -> None:
    write_bag(tmp_path / "bag", count=10, chunk_bytes=600)
    whole = (tmp_path / "bag" / "bag_0.mcap").read_bytes()
    rng = np.random.default_rng(1)
    refused = 0
    for _ in range(150):
        damaged = bytearray(whole)
        for place in rng.integers(0, len(whole), 3):
            damaged[place] ^= int(rng.integers(1, 256))
        path = tmp_path / "flipped.mcap"
        path.write_bytes(bytes(damaged))
        try:
            list(read_messages(open_bag(path)))
        except BagInvalidError:
            refused += 1
    assert refused > 30


def test_missing_bags_are_named(tmp_path: Path) -> None:
    with pytest.raises(BagNotFoundError, match="nowhere"):
        open_bag(tmp_path / "nowhere")
    with pytest.raises(BagInvalidError, match="neither"):
        open_bag(tmp_path)
    write_bag(tmp_path / "bag")
    (tmp_path / "bag" / "bag_0.mcap").unlink()
    with pytest.raises(BagNotFoundError, match=r"bag_0\.mcap"):
        open_bag(tmp_path / "bag")


@pytest.mark.parametrize(
    "text", ["", "a: 1", "[", "rosbag2_bagfile_information: 3", "rosbag2_bagfile_information: {}"]
)
def test_damaged_metadata_is_named(tmp_path: Path, text: str) -> None:
    write_bag(tmp_path / "bag")
    (tmp_path / "bag" / "metadata.yaml").write_text(text)
    with pytest.raises(BagInvalidError, match=r"metadata\.yaml|storage"):
        open_bag(tmp_path / "bag")


@pytest.mark.parametrize("name", ["rosbag2_talker", "rosbag2_wbag", "rosbag2_cdr_test"])
def test_bags_of_rosbag2_have_the_counts_of_their_metadata(shared_data: Path, name: str) -> None:
    folder = shared_data / "bags" / name
    listed = yaml.safe_load((folder / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    found = open_bag(folder)
    assert found.complete
    assert found.messages == listed["message_count"] == len(list(read_messages(found)))
    counts = {
        t["topic_metadata"]["name"]: t["message_count"] for t in listed["topics_with_message_count"]
    }
    assert {t.name: t.messages for t in found.topics} == counts
    types = {
        t["topic_metadata"]["name"]: t["topic_metadata"]["type"]
        for t in listed["topics_with_message_count"]
    }
    assert {t.name: t.type_name for t in found.topics} == types


def test_a_split_bag_without_metadata_is_read_in_order(shared_data: Path, tmp_path: Path) -> None:
    found = open_bag(shared_data / "bags" / "rosbag2_multiple_files")
    assert [f.name for f in found.files] == [f"multiple_files_{i}.mcap" for i in range(3)]
    times = [m.log_time_ns for m in read_messages(found)]
    assert len(times) == found.messages > 0
    assert times == sorted(times)
    # Without its metadata the split bag has the same counts.
    folder = tmp_path / "wbag"
    shutil.copytree(shared_data / "bags" / "rosbag2_wbag", folder)
    (folder / "metadata.yaml").unlink()
    assert open_bag(folder).messages == open_bag(shared_data / "bags" / "rosbag2_wbag").messages
