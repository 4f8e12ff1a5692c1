"""A run is recorded, the bag is read by others, and played again; and what is refused."""

import os
import signal
import subprocess
import sys
import threading
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from diagnostic_msgs.msg import KeyValue
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from nav2_msgs.action import NavigateToPose
from rclpy.action import ActionServer
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from rosbags.highlevel import AnyReader
from rosgraph_msgs.msg import Clock
from skinplan_msgs.msg import Heartbeat, Status
from skinplan_msgs.srv import PlayerSeek, PlayerSetRate, RecorderStart, RecorderStop
from std_msgs.msg import String
from std_srvs.srv import Trigger

from nodes.bench import TIMEOUT_S, Bench
from skinplan.errors import BagNotFoundError
from skinplan.recording.bag import BagWriter
from skinplan.recording.reader import open_bag, read_messages
from skinplan.recording.schema import schema_with_dependencies
from skinplan_nodes.bag_player import BagPlayer
from skinplan_nodes.message_types import definition_text, message_class
from skinplan_nodes.qos import LATCHED, SENSOR, STATE
from skinplan_nodes.recording_session import RecordingOrder, RecordingSession
from skinplan_nodes.run_recorder import RunRecorder
from skinplan_nodes.time_ack import TimeAck


def start_recording(bench: Bench, folder: Path | str, **metadata: str) -> Any:
    items = [KeyValue(key=key, value=value) for key, value in metadata.items()]
    request = RecorderStart.Request(folder=str(folder), metadata=items)
    return bench.call(RecorderStart, "recorder/start", request)


def stop_recording(bench: Bench) -> Any:
    return bench.call(RecorderStop, "recorder/stop", RecorderStop.Request())


def texts(folder: Path, topic: str) -> list[str]:
    """Decodes a topic with the schemas that are in the bag."""
    (file,) = folder.glob("*.mcap")
    with file.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        return [m.decoded_message.data for m in reader.iter_decoded_messages(topics=[topic])]


def wait_for_messages(bench: Bench, recorder: RunRecorder, topic: str, count: int) -> None:
    """Waits until so many messages of a topic went to the bag."""
    bag = recorder._session._bag
    bench.wait(lambda: bag.count(topic) >= count)


def test_every_topic_is_recorded_with_type_hash_qos_and_definition(
    bench: Bench, tmp_path: Path
) -> None:
    early = bench.tester.create_publisher(String, "early", LATCHED)
    early.publish(String(data="published before the recorder came"))
    recorder = bench.start(RunRecorder, simulated=False)
    assert start_recording(bench, tmp_path / "bag", job="a").status.code == Status.OK
    late = bench.tester.create_publisher(String, "late", SENSOR)
    truth = bench.tester.create_publisher(String, "truth/late", SENSOR)
    server = ActionServer(bench.tester, NavigateToPose, "go", lambda handle: None)
    bench.wait(lambda: late.get_subscription_count() > 0)
    for number in range(20):
        late.publish(String(data=str(number)))
    wait_for_messages(bench, recorder, "/late", 20)
    wait_for_messages(bench, recorder, "/early", 1)
    wait_for_messages(bench, recorder, "/heartbeat", 1)
    answer = stop_recording(bench)
    server.destroy()
    assert (answer.status.code, answer.dropped) == (Status.OK, 0)
    bag = open_bag(tmp_path / "bag")
    assert (bag.messages, bag.complete) == (answer.messages, True)
    assert bag.custom_data == {"job": "a"}
    assert texts(tmp_path / "bag", "/late") == [str(i) for i in range(20)]
    assert texts(tmp_path / "bag", "/early") == ["published before the recorder came"]
    topics = {topic.name: topic for topic in bag.topics}
    assert topics["/late"].qos[0].reliability == "best_effort"
    assert topics["/early"].qos[0].latched
    (info,) = bench.tester.get_publishers_info_by_topic("/late")
    assert topics["/late"].type_hash == str(info.topic_type_hash)
    assert all(topic.schema_text for topic in bag.topics)
    assert not [name for name in topics if name.startswith("/go")], "hidden topics are left out"
    assert "/truth/late" not in topics and not truth.get_subscription_count()


def test_a_publisher_that_offers_less_is_recorded_too(bench: Bench, tmp_path: Path) -> None:
    recorder = bench.start(RunRecorder, simulated=False)
    reliable = bench.tester.create_publisher(String, "mixed", STATE)
    assert start_recording(bench, tmp_path / "bag").status.code == Status.OK
    bench.wait(lambda: reliable.get_subscription_count() > 0)
    less = QoSProfile(depth=10, reliability=QoSReliabilityPolicy.BEST_EFFORT)
    poor = bench.tester.create_publisher(String, "mixed", less)
    bench.wait(lambda: poor.get_subscription_count() > 0)
    poor.publish(String(data="heard"))
    wait_for_messages(bench, recorder, "/mixed", 1)
    stop_recording(bench)
    assert texts(tmp_path / "bag", "/mixed") == ["heard"]
    # It gives messages only to topics whose QoS are the same in file and metadata.
    with AnyReader([tmp_path / "bag"]) as reader:
        topics = Counter(connection.topic for connection, _, _ in reader.messages())
        assert topics["/mixed"] == 1
        assert sum(topics.values()) == reader.message_count


def test_recorder_refuses(bench: Bench, tmp_path: Path) -> None:
    bench.start(RunRecorder, simulated=False)
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "file").write_text("x", encoding="utf-8")
    for folder, words in (
        ("", "absolute path"),
        ("bag", "absolute path"),
        (tmp_path / "full", "not empty"),
        ("/proc/none/bag", "can't be created"),
    ):
        answer = start_recording(bench, folder)
        assert answer.status.code == Status.BAG_NOT_WRITABLE
        assert words in answer.status.message
    assert stop_recording(bench).status.code == Status.NOT_RECORDING
    assert start_recording(bench, tmp_path / "a").status.code == Status.OK
    second = start_recording(bench, tmp_path / "b")
    assert second.status.code == Status.RECORDER_BUSY
    assert f"while {tmp_path / 'a'} is recorded" in second.status.message
    again = start_recording(bench, tmp_path / "a")
    assert again.status.code == Status.OK, "its answer was not heard, perhaps"
    assert not (tmp_path / "b").exists()
    assert stop_recording(bench).status.code == Status.OK


def test_recorder_does_not_serve_before_it_is_active(bench: Bench) -> None:
    recorder = bench.start(RunRecorder, simulated=False, autostart=False)
    names = {name for name, _ in recorder.get_service_names_and_types_by_node("run_recorder", "/")}
    assert "/recorder/start" not in names
    recorder.trigger_configure()
    recorder.trigger_activate()
    assert stop_recording(bench).status.code == Status.NOT_RECORDING


def test_sigterm_closes_the_bag(bench: Bench, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "skinplan_nodes.run_recorder"]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    process = subprocess.Popen(command, env=environment)
    try:
        assert start_recording(bench, tmp_path / "bag").status.code == Status.OK
        publisher = bench.tester.create_publisher(String, "said", STATE)
        bench.wait(lambda: publisher.get_subscription_count() > 0)
        publisher.publish(String(data="last words"))
        bench.wait(lambda: publisher.wait_for_all_acked())
        process.send_signal(signal.SIGTERM)
        assert process.wait(TIMEOUT_S) == 0
    finally:
        process.kill()
        process.wait()
    assert open_bag(tmp_path / "bag").complete
    assert (tmp_path / "bag" / "metadata.yaml").is_file()
    assert texts(tmp_path / "bag", "/said") == ["last words"]


def test_what_has_come_before_the_end_is_recorded(bench: Bench, tmp_path: Path) -> None:
    """The executor has not had its turn: a busy machine, or a long callback before the end."""
    ack = TimeAck(bench.tester)
    order = RecordingOrder(tmp_path / "bag", {}, 1_000_000)
    publisher = bench.tester.create_publisher(String, "said", STATE)
    held, ends = threading.Event(), threading.Event()
    bench.tester.create_subscription(
        String, "hold", lambda _: (held.set(), ends.wait(TIMEOUT_S)), STATE
    )
    hold = bench.tester.create_publisher(String, "hold", STATE)
    session = RecordingSession(bench.tester, order, ReentrantCallbackGroup(), ack)
    session.discover()
    bench._executor.wake()
    bench.wait(lambda: publisher.get_subscription_count() == 1)
    bench.wait(lambda: hold.get_subscription_count() == 2)
    hold.publish(String(data="no callback is called any more"))
    assert held.wait(TIMEOUT_S)
    publisher.publish(String(data="last words"))
    bench.wait(lambda: publisher.wait_for_all_acked())
    session.finish()
    ends.set()
    assert texts(tmp_path / "bag", "/said") == ["last words"]


def test_the_end_does_not_meet_the_search_for_topics(bench: Bench, tmp_path: Path) -> None:
    """The end comes from the main thread at SIGTERM, topics are found in the executor's."""
    ack = TimeAck(bench.tester)
    group = ReentrantCallbackGroup()
    publishers = [bench.tester.create_publisher(String, f"t{n}", STATE) for n in range(40)]
    for number in range(5):
        order = RecordingOrder(tmp_path / str(number), {}, 2**20)
        session = RecordingSession(bench.tester, order, group, ack)
        failures: list[BaseException] = []

        def search(session: RecordingSession = session, into: Any = failures) -> None:
            try:
                for _ in range(20):
                    session.discover()
            except BaseException as error:
                into.append(error)

        thread = threading.Thread(target=search)
        thread.start()
        while session.topics < 20 and thread.is_alive():
            pass
        session.finish()
        topics = session.topics
        thread.join(TIMEOUT_S)
        assert not failures and not thread.is_alive()
        assert open_bag(order.folder).complete
        assert session.topics == topics, "nothing is subscribed after the end"
    assert all(publisher.get_subscription_count() == 0 for publisher in publishers)


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """A bag of 2 s of recorded time: 21 texts, and a clock that the player replaces."""
    from rclpy.serialization import serialize_message

    with BagWriter(tmp_path / "bag") as writer:
        for name, kind in (("/said", "std_msgs/msg/String"), ("/clock", "rosgraph_msgs/msg/Clock")):
            writer.add_topic(name, kind, schema_with_dependencies(kind, definition_text))
        for number in range(21):
            at = 5_000_000_000 + number * 100_000_000
            writer.write("/said", serialize_message(String(data=str(number))), at)
            writer.write("/clock", serialize_message(Clock()), at)
    return tmp_path / "bag"


def play(bench: Bench, bag: Path, **parameters: Any) -> tuple[BagPlayer, list[Any], list[Any]]:
    said = bench.collect_before(String, "/said", STATE)
    clock = bench.collect_before(Clock, "/clock", STATE)
    player = bench.start(BagPlayer, simulated=False, bag=str(bag), start_delay_s=0.5, **parameters)
    return player, said, clock


def seconds(clock: list[Any]) -> list[float]:
    return [tick.clock.sec + tick.clock.nanosec * 1e-9 for tick in clock]


def test_player_plays_all_in_order_with_its_own_clock(bench: Bench, bag: Path) -> None:
    player, said, clock = play(bench, bag, rate=10.0)
    bench.wait(player.asked_to_end.is_set)
    bench.wait(lambda: len(said) == 21)
    assert [m.data for m in said] == [str(i) for i in range(21)]
    found = seconds(clock)
    assert found == sorted(found)
    assert 5.0 <= found[0] and found[-1] <= 7.0 + 1e-6
    assert player.exit_code == 0


def test_player_start_offset(bench: Bench, bag: Path) -> None:
    player, said, _ = play(bench, bag, rate=100.0, start_offset_s=1.0)
    bench.wait(player.asked_to_end.is_set)
    bench.wait(lambda: said and said[-1].data == "20")
    assert [m.data for m in said] == [str(i) for i in range(10, 21)]


def test_player_services(bench: Bench, bag: Path) -> None:
    player, said, clock = play(bench, bag, rate=0.001, start_paused=True)
    bench.wait(lambda: clock)
    assert not said, "paused at the start"

    def trigger(name: str) -> str:
        answer = bench.call(Trigger, f"player/{name}", Trigger.Request())
        assert answer.success
        return str(answer.message)

    assert trigger("resume") == "playing"
    bench.wait(lambda: [m.data for m in said] == ["0"])
    assert trigger("toggle_paused") == "paused"
    seek = bench.call(PlayerSeek, "player/seek", PlayerSeek.Request(offset=1.95))
    assert seek.status.code == Status.OK
    rate = bench.call(PlayerSetRate, "player/set_rate", PlayerSetRate.Request(rate=1.0))
    assert rate.status.code == Status.OK
    assert trigger("toggle_paused") == "playing"
    bench.wait(lambda: [m.data for m in said] == ["0", "20"])
    bench.wait(player.asked_to_end.is_set)


def test_player_stop_ends_it(bench: Bench, bag: Path) -> None:
    player, _, _ = play(bench, bag, loop=True, rate=50.0)
    assert bench.call(Trigger, "player/stop", Trigger.Request()).success
    bench.wait(player.asked_to_end.is_set)


def test_player_loops(bench: Bench, bag: Path) -> None:
    _, said, _ = play(bench, bag, loop=True, rate=100.0)
    bench.wait(lambda: [m.data for m in said].count("20") >= 2)
    texts = [m.data for m in said]
    assert texts.index("20") < texts.index("0", 1), "from the begin again, after the end"


@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf")])
def test_player_refuses_rates(bench: Bench, bag: Path, value: float) -> None:
    play(bench, bag, start_paused=True)
    answer = bench.call(PlayerSetRate, "player/set_rate", PlayerSetRate.Request(rate=value))
    assert answer.status.code == Status.REQUEST_INVALID
    assert "above 0" in answer.status.message


@pytest.mark.parametrize("value", [-0.1, 2.5, float("nan")])
def test_player_refuses_places(bench: Bench, bag: Path, value: float) -> None:
    play(bench, bag, start_paused=True)
    answer = bench.call(PlayerSeek, "player/seek", PlayerSeek.Request(offset=value))
    assert answer.status.code == Status.REQUEST_INVALID
    assert "0 to 2.000 s" in answer.status.message


def test_player_refuses_a_bag_that_is_none(bench: Bench, tmp_path: Path) -> None:
    with pytest.raises(BagNotFoundError, match="nothing is there"):
        bench.start(BagPlayer, simulated=False, bag=str(tmp_path / "none"))


@pytest.mark.parametrize("arguments, code", [([], 0), (["-p", "bag:=/no/such/bag"], 2)])
def test_player_as_a_program_ends_by_itself(bag: Path, arguments: list[str], code: int) -> None:
    given = arguments or ["-p", f"bag:={bag}", "-p", "rate:=50.0", "-p", "exit_at_end:=true"]
    command = [sys.executable, "-m", "skinplan_nodes.bag_player", "--ros-args", *given]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run(
        command, env=environment, timeout=TIMEOUT_S * 2, capture_output=True, text=True
    )
    assert done.returncode == code, done.stderr
    assert "Traceback" not in done.stderr


def test_what_is_played_is_what_was_recorded(bench: Bench, bag: Path, tmp_path: Path) -> None:
    bench.start(RunRecorder, simulated=False)
    player, said, _ = play(bench, bag, rate=20.0, start_paused=True)
    assert start_recording(bench, tmp_path / "again").status.code == Status.OK
    bench.wait(lambda: bench.tester.count_subscribers("/said") >= 2)
    bench.call(Trigger, "player/resume", Trigger.Request())
    bench.wait(player.asked_to_end.is_set)
    bench.wait(lambda: len(said) == 21)
    stop_recording(bench)
    first = [m.data for m in read_messages(open_bag(bag), {"/said"})]
    again = [m.data for m in read_messages(open_bag(tmp_path / "again"), {"/said"})]
    assert again == first


def test_types_by_name() -> None:
    assert message_class("skinplan_msgs/msg/Heartbeat") is Heartbeat
    feedback = message_class("nav2_msgs/action/NavigateToPose_FeedbackMessage")
    assert feedback is NavigateToPose.Impl.FeedbackMessage
    for name in ("String", "std_msgs/msg/NoSuchType", "no_such_msgs/msg/String"):
        with pytest.raises(LookupError):
            message_class(name)
    with pytest.raises(LookupError, match="not installed"):
        definition_text("no_such_msgs/msg/String")
