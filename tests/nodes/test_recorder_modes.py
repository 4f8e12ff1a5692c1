"""What is published is what three readers find; split, snapshot, selection, drops, full disk."""

import hashlib
import threading
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import Image, JointState
from skinplan_msgs.msg import Status
from skinplan_msgs.srv import RecorderStart, RecorderStop
from std_msgs.msg import String
from std_srvs.srv import Trigger

from nodes.bench import TIMEOUT_S, Bench
from skinplan.recording.reader import open_bag, read_messages
from skinplan_nodes.qos import LATCHED, STATE
from skinplan_nodes.run_recorder import RunRecorder


def start(bench: Bench, folder: Path, tmp_path: Path, **asked: Any) -> RunRecorder:
    recorder: RunRecorder = bench.start(
        RunRecorder, simulated=False, state_folder=str(tmp_path / "state"), min_free_bytes=0
    )
    request = RecorderStart.Request(folder=str(folder), **asked)
    answer = bench.call(RecorderStart, "recorder/start", request)
    assert answer.status.code == Status.OK, answer.status.message
    return recorder


def stop(bench: Bench) -> Any:
    return bench.call(RecorderStop, "recorder/stop", RecorderStop.Request())


KINDS = {"/text": String, "/image": Image, "/joints": JointState}


def digest(topic: str, data: bytes) -> tuple[str, str]:
    """The hash of all that a message says; its padding is whatever was in memory."""
    message = deserialize_message(bytes(data), KINDS[topic])
    return topic, hashlib.sha256(repr(message).encode()).hexdigest()


def test_three_readers_find_every_message_as_it_was_published(bench: Bench, tmp_path: Path) -> None:
    rosbag2 = pytest.importorskip("rosbags.rosbag2")
    typesys = pytest.importorskip("rosbags.typesys")
    recorder = start(bench, tmp_path / "bag", tmp_path, topics=["/text", "/image", "/joints"])
    publishers = {
        "/text": bench.tester.create_publisher(String, "/text", LATCHED),
        "/image": bench.tester.create_publisher(Image, "/image", STATE),
        "/joints": bench.tester.create_publisher(JointState, "/joints", STATE),
    }
    bench.wait(lambda: all(p.get_subscription_count() for p in publishers.values()))
    sent: Counter[tuple[str, str]] = Counter()
    for i in range(10):
        for topic, message in (
            ("/text", String(data=f"text {i} äöü")),
            ("/image", Image(height=90, width=120, step=360, data=bytes([i]) * 32400)),
            ("/joints", JointState(name=["a", "b"], position=[0.5 * i, -1.0])),
        ):
            publishers[topic].publish(message)
            sent[digest(topic, serialize_message(message))] += 1
        bench.wait(lambda: recorder._session._bag.messages >= 3 * i + 2)  # noqa: B023
    bench.wait(lambda: recorder._session._bag.messages == 30)
    answer = stop(bench)
    assert (answer.messages, answer.dropped, answer.files, answer.topics) == (30, 0, 1, 3)
    ours = [*read_messages(open_bag(tmp_path / "bag"))]
    assert Counter(digest(m.topic, m.data) for m in ours) == sent
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    with rosbag2.Reader(tmp_path / "bag") as reader:
        found = [(c, data) for c, _, data in reader.messages()]
        assert Counter(digest(c.topic, data) for c, data in found) == sent
        raw = [(c.msgtype, data) for c, data in found if c.topic == "/image"]
        images = [store.deserialize_cdr(data, kind) for kind, data in raw]
    assert sorted(int(image.data[0]) for image in images) == list(range(10))
    with (tmp_path / "bag" / "bag_0.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        decoded = [*reader.iter_decoded_messages()]
    assert Counter(digest(m.channel.topic, m.message.data) for m in decoded) == sent
    texts = [m.decoded_message.data for m in decoded if m.channel.topic == "/text"]
    assert texts == [f"text {i} äöü" for i in range(10)]


def test_split_and_snapshot_on_demand(bench: Bench, tmp_path: Path) -> None:
    recorder = start(bench, tmp_path / "bag", tmp_path, topics=["state", "data"])
    state = bench.tester.create_publisher(String, "/state", LATCHED)
    bench.wait(lambda: state.get_subscription_count() > 0)
    state.publish(String(data="ready"))
    bench.wait(lambda: recorder._session._bag.messages == 1)
    refused = bench.call(Trigger, "recorder/snapshot", Trigger.Request())
    assert not refused.success and "snapshot mode" in refused.message
    answer = bench.call(Trigger, "recorder/split", Trigger.Request())
    assert answer.success and "bag_0.mcap" in answer.message
    answer = stop(bench)
    assert (answer.files, answer.messages, answer.repeated) == (2, 2, 1)
    assert not bench.call(Trigger, "recorder/split", Trigger.Request()).success


def test_a_snapshot_holds_the_last_messages_and_what_is_latched(
    bench: Bench, tmp_path: Path
) -> None:
    recorder = start(
        bench,
        tmp_path / "bag",
        tmp_path,
        topics=["/state", "/data"],
        snapshot=True,
        snapshot_bytes=5000,
    )
    state = bench.tester.create_publisher(String, "/state", LATCHED)
    data = bench.tester.create_publisher(String, "/data", STATE)
    bench.wait(lambda: state.get_subscription_count() and data.get_subscription_count())
    ring = recorder._session._ring
    state.publish(String(data="ready"))
    bench.wait(lambda: ring.size_bytes > 0)
    for i in range(30):
        data.publish(String(data=f"{i:03d}" + "x" * 200))
        bench.wait(lambda: any(f"{i:03d}".encode() in m.data for m in [*ring._items]))  # noqa: B023
    assert recorder._session._bag.messages == 0
    answer = bench.call(Trigger, "recorder/snapshot", Trigger.Request())
    assert answer.success and answer.message.split()[0] == "13", answer.message
    assert stop(bench).messages == 13
    found = [m.data[8:-1].decode() for m in read_messages(open_bag(tmp_path / "bag"))]
    assert found == ["ready"] + [f"{i:03d}" + "x" * 200 for i in range(18, 30)]


def test_a_request_that_makes_no_sense_is_named(bench: Bench, tmp_path: Path) -> None:
    bench.start(RunRecorder, simulated=False, state_folder=str(tmp_path / "state"))
    for asked, words, code in (
        ({"pattern": "("}, "regular expression", Status.BAG_NOT_WRITABLE),
        ({"compression": "brotli"}, "zstd, lz4, none", Status.BAG_NOT_WRITABLE),
        ({"split_s": -1.0}, "0 or more", Status.BAG_NOT_WRITABLE),
        ({"min_free_bytes": 2**60}, "have to stay free", Status.DISK_FULL),
    ):
        request = RecorderStart.Request(folder=str(tmp_path / "bag"), **asked)
        answer = bench.call(RecorderStart, "recorder/start", request)
        assert answer.status.code == code and words in answer.status.message


def test_what_the_middleware_drops_is_counted(bench: Bench, tmp_path: Path) -> None:
    recorder = start(bench, tmp_path / "bag", tmp_path, topics=["/text"])
    publisher = bench.tester.create_publisher(String, "/text", QoSProfile(depth=10_000))
    bench.wait(lambda: publisher.get_subscription_count())
    for number in range(10):
        publisher.publish(String(data=str(number)))
    bench.wait(lambda: recorder._session._bag.count("/text") == 10)
    held, go_on = threading.Event(), threading.Event()

    def hold(_: Any) -> None:
        held.set()
        go_on.wait(TIMEOUT_S)

    # The recorder's executor is busy with something else for a while.
    bench.tester.create_subscription(String, "/hold", hold, STATE)
    holder = bench.tester.create_publisher(String, "/hold", STATE)
    bench.wait(lambda: holder.get_subscription_count())
    holder.publish(String())
    assert held.wait(TIMEOUT_S)
    for number in range(10, 5010):
        publisher.publish(String(data=str(number)))
    go_on.set()
    publisher.publish(String(data="last"))
    bench.wait(lambda: recorder._session.dropped + recorder._session._bag.count("/text") == 5011)
    answer = stop(bench)
    (lost,) = answer.dropped_topics
    assert lost.key == "/text" and answer.dropped == int(lost.value) >= 2900
    assert answer.messages == 5011 - answer.dropped
    found = open_bag(tmp_path / "bag")
    assert found.custom_data["dropped"] == f"/text: {answer.dropped}"
