"""The way back into a job after an interruption: devices, nodes, bag, where to go on. No ROS."""

import math
from dataclasses import dataclass, field

from skinplan.errors import SkinplanError
from skinplan.trajectory.model import SCAN
from skinplan_nodes.supervisor import reentry
from skinplan_nodes.supervisor.control import AbortError, InterruptError, JobControl, StepError
from skinplan_nodes.supervisor.faults import (
    BASE_MAY_HAVE_MOVED,
    DEVICE_FAILED,
    DEVICE_REFUSED,
    DEVICE_TIMEOUT,
    NODE_LOST,
    QUALITY_NOT_REACHED,
    Answer,
    answer_to,
)
from skinplan_nodes.supervisor.machine import Event, State
from skinplan_nodes.supervisor.place import ON_WAY_RAD
from skinplan_nodes.supervisor.steps import Steps

# The base is where it located the part within this [m].
_BASE_MOVED_M = 0.005
# Further away it does not stand at its station any more [m].
_BASE_AWAY_M = 0.15
# What was scanned before a failure is merged, but nobody who ended the job waits long for that.
_SALVAGE_S, _SALVAGE_ABORTED_S = 30.0, 1.0
_AT_STATION = (State.PLANNING_TRAJECTORY, State.MOVING, State.SCANNING)
# These say least about what happened.
_GENERAL = (DEVICE_FAILED, DEVICE_REFUSED, DEVICE_TIMEOUT)


@dataclass
class Restoring:
    """Knows why a job stands still, and leads it back.

    Attributes:
        steps: The job's steps.
        control: What is asked of it from outside.
        by_operator: The operator said RESUME: devices that stopped by themselves are reset.
        taken_over: Another supervisor process worked on the job before.
    """

    steps: Steps
    control: JobControl
    by_operator: bool = False
    taken_over: bool = False
    _reasons: list[StepError] = field(default_factory=list)
    _unsure: bool = False

    def note(self, error: StepError) -> None:
        """Takes a reason in."""
        self._reasons.append(error)

    def forget(self) -> None:
        """Forgets the reasons: the job goes on."""
        self._reasons.clear()
        self.by_operator = False

    def worst(self) -> StepError | None:
        """Returns the reason that says most and asks for most; None = there is none."""
        return max(self._reasons, key=_weight, default=None)

    def only_commands(self) -> bool:
        """Whether nothing has failed."""
        return all(error.code == 0 for error in self._reasons)

    def paused(self) -> bool:
        """Whether the operator asked for a pause."""
        return any(
            isinstance(e, InterruptError) and e.request.event is Event.PAUSE for e in self._reasons
        )

    def locate_arm(self) -> None:
        """After a stop in the middle of a segment: notes which points were passed."""
        steps, place = self.steps, self.steps.place
        segment, joints = place.current, steps.cell.arm_joints()
        if place.state not in (State.MOVING, State.SCANNING) or segment is None or joints is None:
            return
        found = reentry.nearest(segment, joints, ON_WAY_RAD)
        if found.distance_rad > ON_WAY_RAD:
            return
        place.note_points(segment, found.time_s, steps.segment_began_s)
        steps.record.points(place, place.segment)

    def run(self) -> Event:
        """Brings the cell back into the state that the job needs, and says where to go on."""
        steps = self.steps
        steps.cell.reset_devices(all_devices=self.by_operator)
        steps.cell.wait_ready()
        steps.bag.open()
        inspector_is_new = self._inspector_is_new()
        if steps.place.state is not State.STARTING and inspector_is_new:
            steps.cell.start_inspection(steps.job, steps.record.folder.frames, resume=True)
        again = self._again(inspector_is_new)
        self.taken_over = False
        return again

    def salvage(self, failure: StepError | None) -> None:
        """Merges what was scanned up to a failure."""
        steps = self.steps
        if not steps.place.passed_s and steps.place.rescan == 0:
            return
        aborted = isinstance(failure, AbortError)
        timeout_s = _SALVAGE_ABORTED_S if aborted else _SALVAGE_S
        try:
            steps.record.data.measured = steps.cell.finish_inspection(
                steps.job, steps.record.folder.cloud, timeout_s
            )
        except SkinplanError as error:
            steps.record.folder.note(f"what was scanned could not be merged: {error}")

    def _inspector_is_new(self) -> bool:
        lost = any(e.code == NODE_LOST and "inspector" in e.node for e in self._reasons)
        missing = any(e.node == "scan_inspector" for e in self._reasons)
        return self.taken_over or lost or missing

    def _again(self, inspector_is_new: bool) -> Event:
        place = self.steps.place
        regular = {
            State.STARTING: Event.AGAIN_START,
            State.DRIVING: Event.AGAIN_DRIVE,
            State.LOCALIZING: Event.AGAIN_LOCALIZE,
            State.IDENTIFYING: Event.AGAIN_IDENTIFY,
            State.PLANNING_PATH: Event.AGAIN_PATH,
            State.PLANNING_STATIONS: Event.AGAIN_STATIONS,
            State.INSPECTING: Event.AGAIN_INSPECT,
            State.FINISHING: Event.AGAIN_FINISH,
        }
        if place.state is State.LOCALIZING and place.plan is not None and self._too_far_off():
            return Event.AGAIN_DRIVE
        if place.state in regular:
            return regular[place.state]
        self._forget_unsure()
        # A new inspector has not seen that the base stood still since it located the part, and
        # takes no place of the part from before.
        if inspector_is_new or self._base_may_have_moved():
            self._cut()
            driven_off = any(error.code in BASE_MAY_HAVE_MOVED for error in self._reasons)
            driven_off = driven_off or self.steps.cell.base_moved_m() > _BASE_AWAY_M
            return Event.AGAIN_DRIVE if driven_off else Event.AGAIN_LOCALIZE
        if place.state in (State.MOVING, State.SCANNING) and self._on_way():
            segment = place.current
            if segment is None:
                return self.steps.next_segment()
            return Event.SCAN if segment.kind == SCAN else Event.MOVE
        self._cut()
        return Event.AGAIN_TRAJECTORY

    def _too_far_off(self) -> bool:
        """Whether the base stopped where the part can't be located well enough.

        At a station it does not move to locate the part: it has to drive there again.
        """
        return any(error.code == QUALITY_NOT_REACHED for error in self._reasons)

    def _base_may_have_moved(self) -> bool:
        moved_m = self.steps.cell.base_moved_m()
        return (
            self.taken_over
            or self.steps.place.located is None
            or any(error.code in BASE_MAY_HAVE_MOVED for error in self._reasons)
            or (math.isfinite(moved_m) and moved_m > _BASE_MOVED_M)
        )

    def _forget_unsure(self) -> None:
        """Points that were passed after a node of the data's way was last heard count as unseen."""
        place = self.steps.place
        since_s = min(
            (e.request.since_s for e in self._reasons if isinstance(e, InterruptError)),
            default=math.inf,
        )
        if math.isfinite(since_s) and place.forget_since(since_s):
            self.steps.record.points(place, place.segment)
            self._unsure = True

    def _on_way(self) -> bool:
        """Whether the arm stands on its segment's way; then what is left of it comes next."""
        place = self.steps.place
        segment, joints = place.current, self.steps.cell.arm_joints()
        if self._unsure or segment is None or joints is None:
            self._unsure = False
            return False
        found = reentry.nearest(segment, joints, ON_WAY_RAD)
        if found.distance_rad > ON_WAY_RAD:
            self.steps.record.folder.note(
                f"the arm stands {found.distance_rad:.3f} rad beside its way: planned anew"
            )
            return False
        place.rest = reentry.rest(segment, found.time_s, joints)
        if place.rest is None:
            place.finish_segment(self.steps.segment_began_s)
        return True

    def _cut(self) -> None:
        """What was executed of the present trajectory becomes history: the rest is planned anew."""
        place = self.steps.place
        if place.trajectory is None:
            return
        done = list(place.trajectory.segments[: place.segment])
        segment, joints = place.current, self.steps.cell.arm_joints()
        if place.state in (State.MOVING, State.SCANNING) and segment is not None:
            if joints is not None:
                found = reentry.nearest(segment, joints, ON_WAY_RAD)
                piece = reentry.until(segment, found.time_s)
                if found.distance_rad <= ON_WAY_RAD and piece is not None:
                    done.append(piece)
        place.executed += done
        place.trajectory, place.segment, place.rest = None, 0, None
        place.state = State.PLANNING_TRAJECTORY


def _weight(error: StepError) -> tuple[bool, bool, bool]:
    """Orders reasons: a failure before a command, a named one before a general one."""
    needs_somebody = answer_to(error.code) is not Answer.AUTOMATIC
    return error.code != 0, error.code not in _GENERAL, needs_somebody
