"""Node ``run_recorder``: records every topic of a run into a bag."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import State, TransitionCallbackReturn
from skinplan_msgs.msg import Status
from skinplan_msgs.srv import RecorderStart, RecorderStop

from skinplan.errors import BagNotWritableError
from skinplan.recording.model import BagSummary
from skinplan_nodes.conversions import key_values_from_msg
from skinplan_nodes.node import AUTOSTART, CellLifecycleNode
from skinplan_nodes.parameters import Parameter
from skinplan_nodes.recording_session import RecordingSession
from skinplan_nodes.replies import RefusedError, replies
from skinplan_nodes.run import run_node
from skinplan_nodes.time_ack import TimeAck


class RunRecorder(CellLifecycleNode):
    """Serves ``recorder/start`` and ``recorder/stop`` while it is active."""

    NAME = "run_recorder"
    # Many small messages: one thread is faster than several that wait for each other.
    THREADS = 1
    PARAMETERS = (
        AUTOSTART,
        Parameter("discovery_period_s", 0.25, "Search for new topics, wall time [s].", 0.05, 10.0),
        Parameter(
            "queue_bytes", 268_435_456, "Messages that wait for the disk [B].", 1_000_000, 2**40
        ),
    )

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self._session: RecordingSession | None = None
        self._group = MutuallyExclusiveCallbackGroup()
        self._ack = TimeAck(self)
        self.autostart()

    def on_configure(self, state: State) -> TransitionCallbackReturn:
        """Nothing to prepare: a bag is opened by a request."""
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

    def _on_discover(self) -> None:
        session = self._session
        if session is None:
            return
        session.discover()
        if session.failure is not None:
            self.set_health("error", str(session.failure))
        elif session.dropped:
            self.set_health("warning", f"{session.dropped} messages dropped, the disk is slow")

    @replies(invalid=Status.BAG_NOT_WRITABLE)
    def _on_start(self, request: RecorderStart.Request, _: RecorderStart.Response) -> None:
        if self._session is not None:
            raise RefusedError(
                Status.RECORDER_BUSY,
                f"a bag in {request.folder!r} was asked for while another one is recorded; stop "
                f"that one first",
            )
        folder = Path(request.folder.removeprefix("file://"))
        if not request.folder or "\0" in request.folder or not folder.is_absolute():
            raise RefusedError(
                Status.BAG_NOT_WRITABLE,
                f"a bag in {request.folder!r} was asked for; the absolute path of a new or empty "
                f"folder is accepted",
            )
        metadata = dict(key_values_from_msg(request.metadata))
        self._session = RecordingSession(
            self, folder, metadata, self.values.queue_bytes, self._group, self._ack
        )
        self._session.discover()
        self.set_health("ok", f"recording to {folder}")

    @replies(invalid=Status.BAG_NOT_WRITABLE)
    def _on_stop(self, _: RecorderStop.Request, response: RecorderStop.Response) -> None:
        if self._session is None:
            raise RefusedError(
                Status.NOT_RECORDING,
                "the end of a recording was asked for, but none is under way; recorder/start "
                "begins one",
            )
        session, self._session = self._session, None
        summary = self._closed(session)
        response.folder = str(summary.folder)
        response.messages = summary.messages
        response.dropped = session.dropped
        response.bytes = summary.bytes
        response.topics = summary.topics

    def _closed(self, session: RecordingSession) -> BagSummary:
        summary = session.finish()
        text = f"recorded {summary.messages} messages to {summary.folder}"
        self.set_health("ok", text, dropped=session.dropped)
        self.get_logger().info(text)
        return summary


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of the program."""
    return run_node(RunRecorder, arguments)


if __name__ == "__main__":
    sys.exit(main())
