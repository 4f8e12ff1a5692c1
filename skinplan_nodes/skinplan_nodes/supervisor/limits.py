"""How long each state of a job may last, from the supervisor's parameters. Needs no ROS."""

from collections.abc import Callable
from dataclasses import dataclass
from time import monotonic
from types import SimpleNamespace

from skinplan_nodes.supervisor.control import Request
from skinplan_nodes.supervisor.faults import STEP_TIMEOUT
from skinplan_nodes.supervisor.machine import LIMITS, Event, State

# What a state may take beyond the time-outs of the calls inside it [s].
_SLACK_S = 60.0
_RECORDER_S = 90.0


@dataclass(frozen=True)
class Limits:
    """Longest times of the states, see `machine.LIMITS` [s]."""

    starting_s: float
    driving_s: float
    identifying_s: float
    localizing_s: float
    planning_s: float
    segment_s: float
    inspecting_s: float
    stopping_s: float
    operator_s: float
    recovering_s: float
    restoring_s: float
    closing_s: float

    @classmethod
    def of(cls, values: SimpleNamespace) -> "Limits":
        """Returns the limits that fit to the supervisor's parameters."""
        return cls(
            starting_s=values.start_timeout_s + values.planning_timeout_s + _SLACK_S,
            driving_s=values.drive_timeout_s + _SLACK_S,
            identifying_s=values.localize_timeout_s + values.planning_timeout_s + _SLACK_S,
            localizing_s=values.localize_timeout_s + _SLACK_S,
            planning_s=values.planning_timeout_s + _SLACK_S,
            segment_s=values.segment_timeout_s,
            inspecting_s=values.planning_timeout_s + _SLACK_S,
            stopping_s=values.stop_timeout_s + _SLACK_S,
            operator_s=values.operator_timeout_s,
            recovering_s=values.recovery_timeout_s,
            restoring_s=values.recovery_timeout_s + values.planning_timeout_s + _RECORDER_S,
            closing_s=values.planning_timeout_s + _RECORDER_S,
        )

    def late(self, state: State, now_s: Callable[[], float]) -> Callable[[], Request | None]:
        """Returns what tells that a state that begins now lasts too long.

        Args:
            state: The state.
            now_s: Returns the cell's time [s].
        """
        figure, whose = LIMITS[state]
        clock = monotonic if whose == "wall" else now_s
        longest_s = float(getattr(self, figure))
        end_s = clock() + longest_s

        def too_late() -> Request | None:
            if clock() <= end_s:
                return None
            text = f"{state.value} was not over within {longest_s:g} s of {whose} time"
            return Request(Event.TIMED_OUT, STEP_TIMEOUT, text)

        return too_late
