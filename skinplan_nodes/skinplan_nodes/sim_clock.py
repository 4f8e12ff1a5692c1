"""Owner of the cell's time: publishes ``/clock`` from wall time, faster or slower."""

import sys
from collections.abc import Sequence
from typing import Any

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock as RosClock
from rclpy.clock import ClockType
from rclpy.time import Time
from rosgraph_msgs.msg import Clock

from skinplan_nodes.node import CellNode
from skinplan_nodes.parameters import Parameter
from skinplan_nodes.qos import STATE
from skinplan_nodes.run import run_node

# A tick that comes late makes time go slower, not jump: the mocks take their steps per tick.
_LATE_TICKS = 3


class SimTime:
    """Simulated time as a function of wall time.

    Args:
        start_s: Time at the first tick [s].
        factor: Times faster than wall time.
        longest_step_s: Longest step of wall time that counts [s].
    """

    def __init__(self, start_s: float, factor: float, longest_step_s: float) -> None:
        self._now_ns = round(start_s * 1e9)
        self._factor = factor
        self._longest_ns = round(longest_step_s * 1e9)
        self._wall_ns: int | None = None

    def tick(self, wall_ns: int) -> int:
        """Moves on to a wall time [ns]; returns the simulated time [ns], which never runs back."""
        if self._wall_ns is not None:
            step = min(max(wall_ns - self._wall_ns, 0), self._longest_ns)
            self._now_ns += round(step * self._factor)
        self._wall_ns = wall_ns
        return self._now_ns


class SimClock(CellNode):
    """Publishes ``/clock`` at a fixed rate of wall time; faster time has larger steps."""

    NAME = "sim_clock"
    THREADS = 1
    PARAMETERS = (
        Parameter("time_factor", 1.0, "Times faster than real time [1].", 0.1, 50.0),
        Parameter("rate_hz", 50.0, "Ticks per second of wall time [Hz].", 1.0, 50.0),
        Parameter(
            "start_s",
            1.0,
            "Time of the first tick [s]; not 0, which means unknown time.",
            0.001,
            4e9,
        ),
    )

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        period_s = 1.0 / self.values.rate_hz
        self._time = SimTime(self.values.start_s, self.values.time_factor, _LATE_TICKS * period_s)
        self._wall = RosClock(clock_type=ClockType.STEADY_TIME)
        self._publisher = self.create_publisher(Clock, "/clock", STATE)
        self.create_timer(
            period_s,
            self._on_tick,
            callback_group=MutuallyExclusiveCallbackGroup(),
            clock=self._wall,
        )

    def _on_tick(self) -> None:
        now_ns = self._time.tick(self._wall.now().nanoseconds)
        self._publisher.publish(Clock(clock=Time(nanoseconds=now_ns).to_msg()))


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of the program."""
    return run_node(SimClock, arguments)


if __name__ == "__main__":
    sys.exit(main())
