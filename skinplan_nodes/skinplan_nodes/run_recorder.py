"""Node ``run_recorder``: records the topics of a run into a bag."""

import sys
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import State, TransitionCallbackReturn
from skinplan_msgs.msg import Status
from skinplan_msgs.srv import RecorderStart, RecorderStop
from std_srvs.srv import Trigger

from skinplan.errors import BagNotWritableError
from skinplan.recording.bag import BagSettings
from skinplan.recording.model import BagSummary
from skinplan.recording.selection import TopicSelection
from skinplan.recording.unfinished import UnfinishedBags
from skinplan_nodes.conversions import key_values_from_msg, key_values_to_msg
from skinplan_nodes.node import AUTOSTART, CellLifecycleNode
from skinplan_nodes.parameters import Parameter
from skinplan_nodes.recording_session import RecordingOrder, RecordingSession
from skinplan_nodes.replies import RefusedError, replies, status_of
from skinplan_nodes.run import run_node
from skinplan_nodes.time_ack import TimeAck

_SNAPSHOT_BYTES = 256 * 2**20


class RunRecorder(CellLifecycleNode):
    """Serves ``recorder/start``, ``stop``, ``split`` and ``snapshot`` while it is active.

    When it is configured it heals the bags of recordings that were cut off.
    """

    NAME = "run_recorder"
    # Many small messages: one thread is faster than several that wait for each other.
    THREADS = 1
    LARGE_MESSAGES = True
    PARAMETERS = (
        AUTOSTART,
        Parameter("discovery_period_s", 0.25, "Search for new topics, wall time [s].", 0.05, 10.0),
        Parameter(
            "queue_bytes", 268_435_456, "Messages that wait for the disk [B].", 1_000_000, 2**40
        ),
        Parameter(
            "min_free_bytes",
            268_435_456,
            "A recording ends before its disk has less left [B]; 0 = when it is full.",
            0,
            2**50,
        ),
        Parameter(
            "state_folder",
            "",
            "Notes of the bags under way; empty = skinplan/recording in the user's state folder.",
        ),
    )

    # The heart begins to beat, and asks for figures, before the constructor has ended.
    _session: RecordingSession | None = None

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self._reported = 0
        folder = str(self.values.state_folder)
        self._unfinished = UnfinishedBags(Path(folder) if folder else None)
        self._group = MutuallyExclusiveCallbackGroup()
        self._ack = TimeAck(self)
        self.autostart()

    def on_configure(self, state: State) -> TransitionCallbackReturn:
        """Heals what was cut off, in the background; a bag is opened by a request."""
        threading.Thread(target=self._heal, name="heal", daemon=True).start()
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: State) -> TransitionCallbackReturn:
        """Begins to serve."""
        period_s = self.values.discovery_period_s
        wall = Clock(clock_type=ClockType.STEADY_TIME)
        self._discovery = self.create_timer(period_s, self._on_discover, self._group, clock=wall)
        self._served = [
            self.create_service(
                RecorderStart, "recorder/start", self._on_start, callback_group=self._group
            ),
            self.create_service(
                RecorderStop, "recorder/stop", self._on_stop, callback_group=self._group
            ),
            self.create_service(
                Trigger, "recorder/split", self._on_split, callback_group=self._group
            ),
            self.create_service(
                Trigger, "recorder/snapshot", self._on_snapshot, callback_group=self._group
            ),
        ]
        return super().on_activate(state)

    def on_deactivate(self, state: State) -> TransitionCallbackReturn:
        """Closes the bag and ends serving."""
        self.close()
        self.destroy_timer(self._discovery)
        for service in self._served:
            self.destroy_service(service)
        return super().on_deactivate(state)

    def on_shutdown(self, state: State) -> TransitionCallbackReturn:
        """Closes the bag."""
        self.close()
        return TransitionCallbackReturn.SUCCESS

    def close(self) -> None:
        """Closes the bag, when there is one; called at SIGTERM, too."""
        if self._session is not None:
            session, self._session = self._session, None
            try:
                self._closed(session)
            except BagNotWritableError as error:
                self.get_logger().error(str(error))

    def health_values(self) -> dict[str, Any]:
        """Returns how the recording is going."""
        session = self._session
        return {} if session is None else session.figures()

    def _heal(self) -> None:
        for sentence in self._unfinished.heal():
            self.get_logger().warning(sentence)

    def _on_discover(self) -> None:
        session = self._session
        if session is None:
            return
        session.discover()
        if session.failure is not None:
            self.set_health("error", str(session.failure))
        elif session.dropped > self._reported:
            self._reported = session.dropped
            text = f"{session.dropped} messages are missing: disk or machine are too slow"
            self.set_health("warning", text)

    @replies(invalid=Status.BAG_NOT_WRITABLE)
    def _on_start(self, request: RecorderStart.Request, _: RecorderStart.Response) -> None:
        if self._session is not None:
            if request.folder and Path(request.folder) == self._session.folder:
                # Asked again by somebody who has not heard the answer.
                return
            raise RefusedError(
                Status.RECORDER_BUSY,
                f"a bag in {request.folder!r} was asked for while {self._session.folder} is "
                f"recorded; stop that one first",
            )
        order = self._order(request)
        self._session = RecordingSession(self, order, self._group, self._ack)
        self._reported = 0
        self._unfinished.begin(order.folder)
        self._session.discover()
        self.set_health("ok", f"recording to {order.folder}")

    def _order(self, request: RecorderStart.Request) -> RecordingOrder:
        """Returns what a request asks for."""
        if request.split_s < 0.0 or request.snapshot_s < 0.0:
            raise BagNotWritableError(
                f"split_s {request.split_s:g} and snapshot_s {request.snapshot_s:g} were asked "
                f"for; 0 or more is accepted"
            )
        settings = BagSettings(
            compression=request.compression or BagSettings.compression,
            split_bytes=request.split_bytes,
            split_s=request.split_s,
            least_free_bytes=request.min_free_bytes or self.values.min_free_bytes,
        )
        return RecordingOrder(
            folder=_folder(request.folder),
            metadata=dict(key_values_from_msg(request.metadata)),
            queue_bytes=self.values.queue_bytes,
            settings=settings,
            selection=TopicSelection(
                topics=tuple(request.topics),
                pattern=request.pattern,
                types=tuple(request.types),
                exclude_topics=tuple(request.exclude_topics),
                exclude_pattern=request.exclude_pattern,
                exclude_types=tuple(request.exclude_types),
                include_hidden=request.include_hidden,
            ),
            snapshot_bytes=(request.snapshot_bytes or _SNAPSHOT_BYTES) if request.snapshot else 0,
            snapshot_s=request.snapshot_s,
        )

    @replies(invalid=Status.BAG_NOT_WRITABLE)
    def _on_stop(self, _: RecorderStop.Request, response: RecorderStop.Response) -> Status | None:
        session, self._session = self._required("the end of a recording"), None
        summary = self._closed(session)
        response.folder = str(summary.folder)
        response.messages = summary.messages
        response.dropped = session.dropped
        response.dropped_topics = key_values_to_msg(
            {topic: str(count) for topic, count in sorted(session.dropped_topics.items())}
        )
        response.bytes = summary.bytes
        response.topics = summary.topics
        response.files = summary.files
        response.repeated = summary.repeated
        return None if summary.failure is None else status_of(summary.failure)

    @replies(invalid=Status.BAG_NOT_WRITABLE)
    def _on_split(self, _: Trigger.Request, response: Trigger.Response) -> None:
        closed = self._required("the next file of a recording").split()
        response.message = f"closed {closed}"

    @replies(invalid=Status.BAG_NOT_WRITABLE)
    def _on_snapshot(self, _: Trigger.Request, response: Trigger.Response) -> None:
        session = self._required("a snapshot of a recording")
        messages, span_s = session.snapshot()
        response.message = f"{messages} messages of {span_s:.3f} s go to {session.folder}"

    def _required(self, asked: str) -> RecordingSession:
        if self._session is None:
            raise RefusedError(
                Status.NOT_RECORDING,
                f"{asked} was asked for, but none is under way; recorder/start begins one",
            )
        return self._session

    def _closed(self, session: RecordingSession) -> BagSummary:
        summary = session.finish()
        self._unfinished.end(summary.folder)
        text = f"recorded {summary.messages} messages to {summary.folder}"
        if summary.failure is not None:
            self.set_health("error", f"{text}; {summary.failure}", dropped=session.dropped)
            self.get_logger().error(f"{text}; {summary.failure}")
            return summary
        self.set_health("ok", text, dropped=session.dropped)
        self.get_logger().info(text)
        return summary


def _folder(asked: str) -> Path:
    folder = Path(asked.removeprefix("file://"))
    if not asked or "\0" in asked or not folder.is_absolute():
        raise RefusedError(
            Status.BAG_NOT_WRITABLE,
            f"a bag in {asked!r} was asked for; the absolute path of a new or empty folder is "
            f"accepted",
        )
    return folder


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of the program."""
    return run_node(RunRecorder, arguments)


if __name__ == "__main__":
    sys.exit(main())
