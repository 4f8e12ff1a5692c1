"""The player: latched state after every seek, steps, bursts, ends, the clock, choice of topics."""

import time
from pathlib import Path
from typing import Any

import pytest
from geometry_msgs.msg import TransformStamped
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from skinplan_msgs.msg import Status
from skinplan_msgs.srv import PlayerBurst, PlayerSeek, PlayerState
from std_msgs.msg import String
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage

from bags import Row, write_metadata, write_sqlite
from nodes.bench import Bench
from skinplan.recording.bag import BagWriter
from skinplan.recording.qos import QosProfile
from skinplan.recording.reader import BagReader
from skinplan.recording.schema import schema_with_dependencies
from skinplan_nodes.bag_player import BagPlayer
from skinplan_nodes.message_types import definition_text
from skinplan_nodes.qos import LATCHED, STATE, STATIC_TF

LATCHED_QOS = QosProfile(depth=1, durability="transient_local")
BEGIN_NS = 5_000_000_000


def transforms(*children: str, x: float = 0.0) -> bytes:
    items = []
    for child in children:
        item = TransformStamped(child_frame_id=child)
        item.header.frame_id = "map"
        item.transform.translation.x = x
        items.append(item)
    return serialize_message(TFMessage(transforms=items))


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """10 s: a text every 0.1 s; latched: "none yet" before 2 s, "a" from 2 s, "b" from 6 s."""
    with BagWriter(tmp_path / "bag") as writer:
        kinds = {"/said": "std_msgs/msg/String", "/plan": "std_msgs/msg/String"}
        for name, kind in {**kinds, "/tf_static": "tf2_msgs/msg/TFMessage"}.items():
            qos = () if name == "/said" else (LATCHED_QOS,)
            schema = schema_with_dependencies(kind, definition_text)
            writer.add_topic(name, kind, schema, qos=qos)
        for number in range(101):
            at = BEGIN_NS + number * 100_000_000
            if number in (20, 60):
                plan = String(data="a" if number == 20 else "b")
                writer.write("/plan", serialize_message(plan), at)
            if number == 10:
                writer.write("/tf_static", transforms("arm", "camera"), at)
            if number == 50:
                writer.write("/tf_static", transforms("camera", x=5.0), at)
            writer.write("/said", serialize_message(String(data=str(number))), at)
    return tmp_path / "bag"


def play(bench: Bench, bag: Path, **parameters: Any) -> BagPlayer:
    given = {"start_delay_s": 0.0, "exit_at_end": False, **parameters}
    player: BagPlayer = bench.start(BagPlayer, simulated=False, bag=str(bag), **given)
    return player


def seek(bench: Bench, offset: float) -> None:
    answer = bench.call(PlayerSeek, "player/seek", PlayerSeek.Request(offset=offset))
    assert answer.status.code == Status.OK


def trigger(bench: Bench, name: str) -> Any:
    return bench.call(Trigger, f"player/{name}", Trigger.Request())


def test_latched_state_is_restored_at_the_start_and_after_every_seek(
    bench: Bench, bag: Path
) -> None:
    plans = bench.collect_before(String, "/plan", LATCHED)
    frames = bench.collect_before(TFMessage, "/tf_static", STATIC_TF)
    play(bench, bag, start_paused=True, start_offset_s=3.0)
    bench.wait(lambda: [m.data for m in plans] == ["a"])
    bench.wait(lambda: len(frames) == 1)
    for offset, wanted in ((7.0, "b"), (2.05, "a"), (9.9, "b"), (5.5, "a")):
        plans.clear()
        seek(bench, offset)
        bench.wait(lambda: plans)
        assert [m.data for m in plans] == [wanted]
    # What was said about a frame earlier still holds where a later message says nothing of it.
    bench.wait(lambda: frames and len(frames[-1].transforms) == 2)
    found = {t.child_frame_id: t.transform.translation.x for t in frames[-1].transforms}
    assert found == {"arm": 0.0, "camera": 5.0}


def test_who_comes_late_gets_the_state_of_the_place_and_nothing_of_the_future(
    bench: Bench, bag: Path
) -> None:
    play(bench, bag, start_paused=True, start_offset_s=7.0)
    assert late(bench, String, "/plan", LATCHED, 1)[0].data == "b"
    seek(bench, 3.0)
    bench.wait(lambda: late(bench, String, "/plan", LATCHED, 1)[0].data == "a")
    # Until it has ended, a seek has old publishers beside the new ones.
    bench.wait(lambda: bench.tester.count_publishers("/tf_static") == 1)
    frames = late(bench, TFMessage, "/tf_static", STATIC_TF, 1)
    assert len(frames) == 1 and len(frames[0].transforms) == 2
    seek(bench, 1.5)
    bench.wait(lambda: bench.tester.count_publishers("/plan") == 1)
    assert late(bench, TFMessage, "/tf_static", STATIC_TF, 1)
    assert late(bench, String, "/plan", LATCHED, 0) == [], "nothing was planned at 1.5 s"


def late(bench: Bench, kind: Any, topic: str, qos: Any, count: int) -> list[Any]:
    """What a new subscriber gets."""
    found: list[Any] = []
    subscription = bench.tester.create_subscription(kind, topic, found.append, qos)
    bench._executor.wake()
    if count:
        bench.wait(lambda: len(found) >= count)
    deadline = time.monotonic() + 0.3
    bench.wait(lambda: time.monotonic() > deadline)
    bench.tester.destroy_subscription(subscription)
    return found


def test_step_and_burst(bench: Bench, bag: Path) -> None:
    said = bench.collect_before(String, "/said", STATE)
    play(bench, bag, start_paused=True, topics=["/said"])
    bench.wait(lambda: bench.tester.count_publishers("/said") == 1)
    assert trigger(bench, "play_next").success
    bench.wait(lambda: [m.data for m in said] == ["0"])
    answer = bench.call(PlayerBurst, "player/burst", PlayerBurst.Request(messages=5))
    assert (answer.status.code, answer.played) == (Status.OK, 5)
    bench.wait(lambda: len(said) == 6)
    state = bench.call(PlayerState, "player/is_paused", PlayerState.Request())
    assert state.paused and state.offset == pytest.approx(0.5) and state.rate == 1.0
    answer = bench.call(PlayerBurst, "player/burst", PlayerBurst.Request(messages=0))
    assert answer.played == 95
    bench.wait(lambda: [m.data for m in said] == [str(i) for i in range(101)])
    answer = trigger(bench, "play_next")
    assert not answer.success and "no further message" in answer.message
    assert trigger(bench, "resume").success
    answer = bench.call(PlayerBurst, "player/burst", PlayerBurst.Request(messages=1))
    assert answer.status.code == Status.REQUEST_INVALID and "paused" in answer.status.message


@pytest.mark.parametrize(
    ("parameters", "first", "last"),
    [
        ({"start_offset_s": 2.0, "duration_s": 1.0}, 20, 30),
        ({"until_s": 1.5}, 0, 15),
        ({"start_offset_s": 9.0, "until_s": 90.0}, 90, 100),
    ],
)
def test_where_it_ends(
    bench: Bench, bag: Path, parameters: dict[str, float], first: int, last: int
) -> None:
    said = bench.collect_before(String, "/said", STATE)
    player = play(
        bench,
        bag,
        rate=20.0,
        exit_at_end=True,
        start_delay_s=0.5,
        exclude_regex="/p.*",
        **parameters,
    )
    bench.wait(player.asked_to_end.is_set)
    bench.wait(lambda: said and said[-1].data == str(last))
    assert [int(m.data) for m in said] == list(range(first, last + 1))
    assert "/plan" not in dict(bench.tester.get_topic_names_and_types())


def test_clock_before_every_message_of_a_topic(bench: Bench, bag: Path) -> None:
    clock = bench.collect_before(Clock, "/clock", STATE)
    player = play(bench, bag, rate=50.0, exit_at_end=True, start_delay_s=0.5,
                  clock_rate_hz=0.0, clock_topics=["/plan"])  # fmt: skip
    bench.wait(player.asked_to_end.is_set)
    bench.wait(lambda: len(clock) >= 2)
    assert [(tick.clock.sec, tick.clock.nanosec) for tick in clock] == [(7, 0), (11, 0)]


def test_qos_overrides_and_names_of_others(bench: Bench, tmp_path: Path) -> None:
    rows = [Row("latched_one", 10**9 + i, serialize_message(String(data=str(i)))) for i in (0, 1)]
    (tmp_path / "bag").mkdir()
    write_sqlite(tmp_path / "bag" / "bag_0.db3", rows, 4)
    write_metadata(tmp_path / "bag", ["bag_0.db3"], rows, 4)
    (tmp_path / "qos.yaml").write_text("latched_one: {durability: transient_local, depth: 2}\n")
    play(bench, tmp_path / "bag", qos_overrides=str(tmp_path / "qos.yaml"))
    both = QoSProfile(depth=5, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
    assert [m.data for m in late(bench, String, "/latched_one", both, 2)] == ["0", "1"]


BAGS = ("cdr_test", "multiple_files", "talker", "wbag")


@pytest.mark.parametrize("name", BAGS)
def test_bags_of_rosbag2_play_with_their_counts_and_order(
    bench: Bench, shared_data: Path, name: str
) -> None:
    path = shared_data / "bags" / f"rosbag2_{name}"
    with BagReader(path) as reader:
        kinds = {t.name: t.type_name for t in reader.info.topics if t.messages}
        wanted: dict[str, list[bytes]] = {topic: [] for topic in kinds}
        for message in reader.messages():
            wanted[message.topic].append(message.data)
    from skinplan_nodes.message_types import message_class

    heard: dict[str, list[bytes]] = {topic: [] for topic in kinds}
    for topic, kind in kinds.items():
        try:
            found = message_class(kind)
        except LookupError:
            pytest.skip(f"{kind} is not installed")
        profile = QoSProfile(depth=10_000, durability=QoSDurabilityPolicy.VOLATILE)
        ros_name = topic if topic.startswith("/") else f"/{topic}"
        bench.tester.create_subscription(found, ros_name, heard[topic].append, profile, raw=True)
    player = play(bench, path, rate=20.0, exit_at_end=True, start_delay_s=1.0)
    bench.wait(player.asked_to_end.is_set)
    mine = {topic: set(data) for topic, data in wanted.items()}
    ours = lambda topic: [data for data in heard[topic] if data in mine[topic]]  # noqa: E731
    bench.wait(lambda: all(len(ours(topic)) >= len(wanted[topic]) for topic in kinds))
    # Other nodes of this process also speak on /rosout.
    assert {topic: ours(topic) for topic in kinds} == wanted
