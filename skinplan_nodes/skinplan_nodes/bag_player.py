"""Node ``bag_player``: plays a bag, with services and ``/clock`` as ``ros2 bag play`` has them."""

import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rclpy.duration import Duration
from rclpy.time import Time
from rosgraph_msgs.msg import Clock
from skinplan_msgs.msg import Status
from skinplan_msgs.srv import PlayerSeek, PlayerSetRate
from std_srvs.srv import Trigger

from skinplan.recording.model import BagMessage, BagTopic
from skinplan.recording.qos import QosProfile
from skinplan.recording.reader import open_bag
from skinplan_nodes.message_types import message_class
from skinplan_nodes.node import CellNode
from skinplan_nodes.parameters import Parameter, load
from skinplan_nodes.playback import Playback, PlaybackSettings
from skinplan_nodes.qos import STATE
from skinplan_nodes.recording_session import offered_qos
from skinplan_nodes.replies import replies
from skinplan_nodes.run import run_node

_CLOCK = "/clock"
_CLOCK_PERIOD_S = 0.02
_LAST_WORDS_S = 2.0


class BagPlayer(CellNode):
    """Publishes a bag's messages as they were recorded."""

    NAME = "bag_player"
    PARAMETERS = (
        Parameter("bag", "", "Absolute path of a bag folder or an MCAP file."),
        Parameter("rate", 1.0, "Times faster than recorded [1].", 0.001, 1000.0),
        Parameter("start_offset_s", 0.0, "Where to start, from the first message [s].", 0.0, 1e9),
        Parameter("loop", False, "Start again at the end."),
        Parameter("start_paused", False, "Wait for the first player/resume."),
        Parameter("exit_at_end", True, "End the program at the end of the bag."),
        Parameter("topics", [""], "Topics to play; empty = all."),
        Parameter(
            "start_delay_s", 1.0, "Time for others to find the topics, wall time [s].", 0.0, 60.0
        ),
    )

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self._bag = open_bag(Path(self.values.bag))
        self._topics = {
            topic.name: self.create_publisher(
                message_class(topic.type_name),
                topic.name,
                offered_qos(topic.qos[0] if topic.qos else QosProfile()),
            )
            for topic in self._bag.topics
            if self._is_played(topic)
        }
        self._clock_publisher = self.create_publisher(Clock, _CLOCK, STATE)
        self._clock_due_s = 0.0
        settings = load(self.values, PlaybackSettings)
        self.playback = Playback(self._bag, self._topics, settings, self._on_message, self._on_time)
        self._make_services()
        self._thread = threading.Thread(target=self._play, name="player", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stops playing."""
        self.playback.stop()
        self._thread.join(_LAST_WORDS_S)

    def _make_services(self) -> None:
        self.create_service(Trigger, "player/pause", self._on_pause)
        self.create_service(Trigger, "player/resume", self._on_resume)
        self.create_service(Trigger, "player/toggle", self._on_toggle)
        self.create_service(Trigger, "player/stop", self._on_stop)
        self.create_service(PlayerSeek, "player/seek", self._on_seek)
        self.create_service(PlayerSetRate, "player/set_rate", self._on_set_rate)

    def _is_played(self, topic: BagTopic) -> bool:
        wanted = self.values.topics
        if topic.name == _CLOCK or (wanted and topic.name not in wanted):
            return False
        try:
            message_class(topic.type_name)
        except LookupError as error:
            self.get_logger().warning(f"topic {topic.name} is not played: {error}")
            return False
        return True

    def _play(self) -> None:
        time.sleep(self.values.start_delay_s)
        try:
            self.playback.run()
            for publisher in self._topics.values():
                publisher.wait_for_all_acked(Duration(seconds=_LAST_WORDS_S))
        except Exception as error:
            # The context may be gone already: then the end was asked for.
            if not self.ended():
                self.get_logger().error(f"playing ended: {error}")
                self.exit_code = 1
        if self.values.exit_at_end:
            self.asked_to_end.set()

    def _on_message(self, message: BagMessage) -> None:
        self._topics[message.topic].publish(message.data)

    def _on_time(self, now_ns: int) -> None:
        wall_s = time.monotonic()
        if wall_s >= self._clock_due_s:
            self._clock_due_s = wall_s + _CLOCK_PERIOD_S
            self._clock_publisher.publish(Clock(clock=Time(nanoseconds=now_ns).to_msg()))

    @replies
    def _on_pause(self, _: Trigger.Request, response: Trigger.Response) -> None:
        self.playback.pause()
        response.message = "paused"

    @replies
    def _on_resume(self, _: Trigger.Request, response: Trigger.Response) -> None:
        self.playback.resume()
        response.message = "playing"

    @replies
    def _on_toggle(self, _: Trigger.Request, response: Trigger.Response) -> None:
        response.message = "paused" if self.playback.toggle() else "playing"

    @replies
    def _on_stop(self, _: Trigger.Request, response: Trigger.Response) -> None:
        self.playback.stop()
        response.message = "stopped"

    @replies(invalid=Status.REQUEST_INVALID)
    def _on_seek(self, request: PlayerSeek.Request, _: PlayerSeek.Response) -> None:
        self.playback.seek(request.offset)

    @replies(invalid=Status.REQUEST_INVALID)
    def _on_set_rate(self, request: PlayerSetRate.Request, _: PlayerSetRate.Response) -> None:
        self.playback.set_rate(request.rate)


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of the program."""
    return run_node(BagPlayer, arguments)


if __name__ == "__main__":
    sys.exit(main())
