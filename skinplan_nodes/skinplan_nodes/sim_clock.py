"""Owner of the cell's time: publishes ``/clock`` from wall time, faster or slower."""

import math
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock as RosClock
from rclpy.clock import ClockType
from rclpy.time import Time
from rosgraph_msgs.msg import Clock
from skinplan_msgs.msg import JobStatus, Status
from skinplan_msgs.srv import InjectFault
from std_msgs.msg import Header

from skinplan.errors import CellInvalidError
from skinplan_nodes.node import CellNode
from skinplan_nodes.parameters import Parameter
from skinplan_nodes.qos import LATCHED, STATE
from skinplan_nodes.replies import RefusedError, replies
from skinplan_nodes.run import run_node
from skinplan_nodes.sim_time import SimTime, SlowNodes, TimeFile
from skinplan_nodes.time_ack import TOPIC

# A tick that comes late makes time go slower, not jump: the mocks take their steps per tick.
_LATE_TICKS = 3
# Sub-states of a job in which the cell waits for a computer; without a job there is none.
_COMPUTING = ("", "starting", "planning", "inspecting", "closing")
# So long it takes until all nodes have found a clock that was started again, wall time [s].
_SETTLE_S = 2.5
_JUMP = "clock_jump"
_LONGEST_JUMP_S = 86400.0


class SimClock(CellNode):
    """Publishes ``/clock`` at a fixed rate of wall time; faster time has larger steps."""

    NAME = "sim_clock"
    THREADS = 1
    PARAMETERS = (
        Parameter(
            "time_factor",
            1.0,
            "Times faster than real time, where no node lags behind [1].",
            0.1,
            50.0,
        ),
        Parameter(
            "computing_factor",
            0.0,
            "Time runs no faster than that while nothing moves because the job's plan or result is "
            "computed, or because there is no job; 0 = as ever [1].",
            0.0,
            50.0,
        ),
        Parameter("rate_hz", 50.0, "Ticks per second of wall time [Hz].", 1.0, 50.0),
        Parameter(
            "start_s",
            1.0,
            "Time of the first tick [s]; not 0, which means unknown time.",
            0.001,
            4e9,
        ),
        Parameter(
            "time_file",
            "",
            "Absolute path of a file from which a clock that is started again goes on; empty = it "
            "begins anew.",
        ),
        Parameter(
            "wait_for",
            [""],
            "Names of the nodes that time waits for when they lag behind; empty = for none.",
        ),
        Parameter(
            "lag_max_s", 2.0, "They may be so far behind, on the cell's clock [s].", 0.05, 60.0
        ),
        Parameter(
            "wait_max_s",
            2.0,
            "Longest stand-still for a node that makes no progress, wall time [s].",
            0.1,
            60.0,
        ),
    )

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        values = self.values
        period_s = 1.0 / values.rate_hz
        try:
            self._file = TimeFile(Path(values.time_file) if values.time_file else None)
        except OSError as error:
            raise CellInvalidError(
                f"time_file {values.time_file!r}: a file that can be written is accepted "
                f"({error.strerror or error})"
            ) from error
        kept_ns = self._file.read()
        start_s = values.start_s if kept_ns is None else kept_ns * 1e-9
        # A clock that was started again stands until everybody hears it: they would see a jump.
        self._stands_until_s = 0.0 if kept_ns is None else time.monotonic() + _SETTLE_S
        self._time = SimTime(start_s, values.time_factor, _LATE_TICKS * period_s)
        if kept_ns is not None:
            # To the nanosecond: seconds are rounded.
            self._time.now_ns = kept_ns
        self._run_at("")
        self._slow = SlowNodes(values.wait_for, values.lag_max_s, values.wait_max_s)
        self._held = 0
        # When to jump and how far [s].
        self._jumps: list[tuple[float, float]] = []
        self._wall = RosClock(clock_type=ClockType.STEADY_TIME)
        self._publisher = self.create_publisher(Clock, "/clock", STATE)
        self.create_subscription(Header, TOPIC, self._on_progress, STATE)
        self.create_subscription(JobStatus, "job_status", self._on_status, LATCHED)
        self.create_service(InjectFault, "sim_clock/inject_fault", self._on_fault)
        group = MutuallyExclusiveCallbackGroup()
        self.create_timer(period_s, self._on_tick, callback_group=group, clock=self._wall)

    def close(self) -> None:
        """Ends keeping the time."""
        self._file.close()

    def health_values(self) -> dict[str, Any]:
        """Returns how often time was held back."""
        return {"ticks_held_back": getattr(self, "_held", 0)}

    def _on_tick(self) -> None:
        standing = time.monotonic() < self._stands_until_s
        limit_ns = self._time.now_ns if standing else self._slow.limit_ns()
        self._time.tick(self._wall.now().nanoseconds, limit_ns)
        if self._time.held and not standing:
            self._held += 1
            self._give_up()
        self._jump_where_due()
        self._keep()
        self._publisher.publish(Clock(clock=Time(nanoseconds=self._time.now_ns).to_msg()))

    def _give_up(self) -> None:
        for name in self._slow.give_up(self._time.now_ns, time.monotonic()):
            text = (
                f"time stood still for node {name}, which made no progress within "
                f"{self.values.wait_max_s:g} s; it goes on without it"
            )
            self.get_logger().warning(text)
            self.set_health("warning", text)

    def _keep(self) -> None:
        # Before it is told: what was told must not be told again.
        try:
            self._file.write(self._time.now_ns)
        except OSError as error:
            self.get_logger().warning(
                f"{self.values.time_file}: the time can't be kept ({error.strerror or error}); a "
                f"clock that is started again would run back",
                throttle_duration_sec=60.0,
            )

    def _jump_where_due(self) -> None:
        now_s = self._time.now_ns * 1e-9
        for jump in [jump for jump in self._jumps if jump[0] <= now_s]:
            self._jumps.remove(jump)
            self._time.jump(round(jump[1] * 1e9))
            self.get_logger().warning(f"the clock jumps ahead by {jump[1]:g} s")

    def _on_status(self, message: JobStatus) -> None:
        self._run_at(message.sub_state)

    def _run_at(self, sub_state: str) -> None:
        factor, most = self.values.time_factor, self.values.computing_factor
        computing = most > 0.0 and sub_state in _COMPUTING
        self._time.run_at(min(factor, most) if computing else factor)

    def _on_progress(self, message: Header) -> None:
        stamp_ns = message.stamp.sec * 10**9 + message.stamp.nanosec
        self._slow.tell(message.frame_id, stamp_ns, time.monotonic())

    @replies(invalid=Status.REQUEST_INVALID)
    def _on_fault(self, request: InjectFault.Request, response: InjectFault.Response) -> None:
        if request.fault == "":
            self._jumps.clear()
        else:
            self._jumps.append((request.at, _jump_of(request)))
            # A jump that is due now has happened when the answer goes out.
            self._jump_where_due()
        response.pending = [_JUMP] * len(self._jumps)


def _jump_of(request: InjectFault.Request) -> float:
    """Returns how far to jump [s].

    Raises:
        RefusedError: Another fault, another value, or a jump that is none.
    """
    if request.fault != _JUMP:
        raise RefusedError(
            Status.FAULT_UNKNOWN,
            f"fault {request.fault!r} was asked for; {_JUMP} with value jump [s] is accepted",
        )
    values = {item.key: item.value for item in request.values}
    try:
        jump_s = float(values.pop("jump", "nan"))
    except ValueError:
        jump_s = math.nan
    if values or request.radius or request.duration or not math.isfinite(request.at):
        raise RefusedError(
            Status.REQUEST_INVALID,
            f"{_JUMP}: the value jump and a time are accepted, no place, no duration, found "
            f"{sorted(values)}",
        )
    if not 0.0 < jump_s <= _LONGEST_JUMP_S:
        raise RefusedError(
            Status.REQUEST_INVALID,
            f"a jump of the clock by {jump_s:g} s was asked for; above 0 up to "
            f"{_LONGEST_JUMP_S:g} s is accepted: the cell's time never runs back",
        )
    return jump_s


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of the program."""
    return run_node(SimClock, arguments)


if __name__ == "__main__":
    sys.exit(main())
