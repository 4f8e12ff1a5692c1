"""Node ``bag_player``: plays a bag, with services and ``/clock`` as ``ros2 bag play`` has them.

What that does not: the latched topics have the state of the place that is played, also after a
start in the middle and after every seek.
"""

import sys
import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.time import Time
from rosgraph_msgs.msg import Clock
from skinplan_msgs.msg import Status
from skinplan_msgs.srv import PlayerBurst, PlayerSeek, PlayerSetRate, PlayerState
from std_srvs.srv import Trigger

from skinplan.recording.model import BagMessage, BagTopic
from skinplan.recording.qos_overrides import read_overrides
from skinplan.recording.reader import BagReader
from skinplan.recording.topic_filter import TopicFilter
from skinplan_nodes.bag_publishers import BagPublishers
from skinplan_nodes.node import CellNode
from skinplan_nodes.parameters import Parameter, load
from skinplan_nodes.playback import Playback, PlaybackSettings
from skinplan_nodes.qos import STATE
from skinplan_nodes.replies import replies, replies_in_thread
from skinplan_nodes.run import run_node

_CLOCK = "/clock"
# Fast DDS asks for the last messages every 3 s.
_LAST_WORDS_S = 3.5
_FOREVER_S = 1e9
# Decompression in one thread holds up the messages of the other by so much at most [s].
_SWITCH_S = 0.0005


class BagPlayer(CellNode):
    """Publishes a bag's messages as they were recorded."""

    NAME = "bag_player"
    LARGE_MESSAGES = True
    PARAMETERS = (
        Parameter("bag", "", "Absolute path of a bag folder or a storage file (.mcap, .db3)."),
        Parameter("rate", 1.0, "Times faster than recorded [1].", 0.001, 1000.0),
        Parameter("start_offset_s", 0.0, "Where to start, from the first message [s].", 0.0, 1e9),
        Parameter("duration_s", 0.0, "How much is played [s] of the recording; 0 = all.", 0.0, 1e9),
        Parameter(
            "until_s", 0.0, "Where to end, from the first message [s]; 0 = at the end.", 0.0, 1e9
        ),
        Parameter("loop", False, "Start again at the end."),
        Parameter("start_paused", False, "Wait for the first player/resume."),
        Parameter("exit_at_end", True, "End the program at the end of the bag, else wait there."),
        Parameter("topics", [""], "Topics to play; empty = all."),
        Parameter("regex", "", "Pattern of further topics to play; empty = none."),
        Parameter("exclude_topics", [""], "Topics not to play; empty = none."),
        Parameter("exclude_regex", "", "Pattern of topics not to play; empty = none."),
        Parameter("qos_overrides", "", "Path of a YAML file of QoS by topic; empty = as recorded."),
        Parameter(
            "start_delay_s", 1.0, "Time for others to find the topics, wall time [s].", 0.0, 60.0
        ),
        Parameter(
            "clock_rate_hz",
            50.0,
            "The clock is published so often, wall time [Hz]; 0 = not.",
            0.0,
            1000.0,
        ),
        Parameter(
            "clock_topics", [""], "The clock is published before every message of these topics."
        ),
        Parameter("clock_per_message", False, "The clock is published before every message."),
        Parameter(
            "ack_timeout_s",
            2.0,
            "Longest wait at the end until every reliable subscriber has everything [s]; -1 = "
            "for ever.",
            -1.0,
            3600.0,
        ),
        Parameter("read_ahead_bytes", 2**26, "So much is read in advance [B].", 2**10, 2**36),
    )

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        values = self.values
        overrides = read_overrides(Path(values.qos_overrides)) if values.qos_overrides else {}
        self._reader = BagReader(Path(values.bag))
        self._played = BagPublishers(self, self._chosen_topics(), overrides)
        for name, reason in self._played.refused.items():
            self.get_logger().warning(f"topic {name} is not played: {reason}")
        self._clock_publisher = self.create_publisher(Clock, _CLOCK, STATE)
        self._clock_due_s = 0.0
        self._clock_topics = frozenset(values.clock_topics)
        self.playback = Playback(
            self._reader, self._played.names, self._played.latched, self._settings(), self
        )
        self._make_services()
        self._thread = threading.Thread(target=self._play, name="player", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stops playing."""
        self.playback.stop()
        self._thread.join(_LAST_WORDS_S)

    def on_message(self, message: BagMessage, late: bool) -> None:
        """Publishes a message, the clock before it where that is wanted."""
        if self.values.clock_per_message or message.topic in self._clock_topics:
            self._publish_clock(message.log_time_ns)
        self._played.publish(message, late)

    def on_time(self, now_ns: int) -> None:
        """Publishes the clock at its rate."""
        wall_s = time.monotonic()
        if self.values.clock_rate_hz > 0.0 and wall_s >= self._clock_due_s:
            self._clock_due_s = wall_s + 1.0 / self.values.clock_rate_hz
            self._publish_clock(now_ns)

    def on_state(self, state: Mapping[str, list[BagMessage]]) -> None:
        """Publishes the state of the latched topics."""
        self._played.restore(state)

    def _publish_clock(self, now_ns: int) -> None:
        self._clock_publisher.publish(Clock(clock=Time(nanoseconds=now_ns).to_msg()))

    def _settings(self) -> PlaybackSettings:
        values = self.values
        values.hold_at_end = not values.exit_at_end
        if values.clock_rate_hz > 0.0:
            values.tick_s = min(0.02, 1.0 / values.clock_rate_hz)
        return load(values, PlaybackSettings)

    def _make_services(self) -> None:
        for name, kind, handler in (
            ("pause", Trigger, self._on_pause),
            ("resume", Trigger, self._on_resume),
            ("toggle_paused", Trigger, self._on_toggle_paused),
            ("is_paused", PlayerState, self._on_state_asked),
            ("get_rate", PlayerState, self._on_state_asked),
            ("set_rate", PlayerSetRate, self._on_set_rate),
            ("seek", PlayerSeek, self._on_seek),
            ("stop", Trigger, self._on_stop),
        ):
            self.create_service(kind, f"player/{name}", handler)
        # They answer when the messages are out.
        group = MutuallyExclusiveCallbackGroup()
        self.create_service(Trigger, "player/play_next", self._on_play_next, callback_group=group)
        self.create_service(PlayerBurst, "player/burst", self._on_burst, callback_group=group)

    def _chosen_topics(self) -> list[BagTopic]:
        values = self.values
        chosen = TopicFilter(
            tuple(values.topics), values.regex, tuple(values.exclude_topics), values.exclude_regex
        )
        topics = self._reader.info.topics
        chosen.require_known(topic.name for topic in topics)
        has_clock = bool(
            values.clock_rate_hz > 0.0 or values.clock_per_message or values.clock_topics
        )
        return [t for t in topics if chosen.takes(t.name) and not (has_clock and t.name == _CLOCK)]

    def _play(self) -> None:
        try:
            # A stop during the delay ends it, too.
            self.playback.wait_stopped(self.values.start_delay_s)
            self.playback.run()
            wait_s = self.values.ack_timeout_s
            if not self._played.wait_for_all_acked(_FOREVER_S if wait_s < 0.0 else wait_s):
                self.get_logger().warning(f"not every subscriber has everything after {wait_s:g} s")
        except Exception as error:
            # The context may be gone already: then the end was asked for.
            if not self.ended():
                self.get_logger().error(f"playing ended: {error}")
                self.exit_code = 1
                self.asked_to_end.set()
        finally:
            self._reader.close()
        if self.values.exit_at_end:
            self.asked_to_end.set()

    @replies
    def _on_pause(self, _: Trigger.Request, response: Trigger.Response) -> None:
        self.playback.pause()
        response.message = "paused"

    @replies
    def _on_resume(self, _: Trigger.Request, response: Trigger.Response) -> None:
        self.playback.resume()
        response.message = "playing"

    @replies
    def _on_toggle_paused(self, _: Trigger.Request, response: Trigger.Response) -> None:
        response.message = "paused" if self.playback.toggle() else "playing"

    @replies
    def _on_stop(self, _: Trigger.Request, response: Trigger.Response) -> None:
        self.playback.stop()
        response.message = "stopped"

    @replies
    def _on_state_asked(self, _: PlayerState.Request, response: PlayerState.Response) -> None:
        playback = self.playback
        response.paused, response.rate = playback.paused, playback.rate
        response.offset = playback.offset_s

    @replies(invalid=Status.REQUEST_INVALID)
    def _on_seek(self, request: PlayerSeek.Request, _: PlayerSeek.Response) -> None:
        self.playback.seek(request.offset)

    @replies(invalid=Status.REQUEST_INVALID)
    def _on_set_rate(self, request: PlayerSetRate.Request, _: PlayerSetRate.Response) -> None:
        self.playback.set_rate(request.rate)

    @replies_in_thread(invalid=Status.REQUEST_INVALID)
    def _on_play_next(self, _: Trigger.Request, response: Trigger.Response) -> Status | None:
        if self.playback.burst(1) == 0:
            return Status(code=Status.REQUEST_INVALID, message="the bag has no further message")
        response.message = f"at {self.playback.offset_s:.6f} s"
        return None

    @replies_in_thread(invalid=Status.REQUEST_INVALID)
    def _on_burst(self, request: PlayerBurst.Request, response: PlayerBurst.Response) -> None:
        response.played = self.playback.burst(request.messages)


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of the program."""
    sys.setswitchinterval(_SWITCH_S)
    return run_node(BagPlayer, arguments)


if __name__ == "__main__":
    sys.exit(main())
