"""A job's walk along the state machine: steps, interruptions, the way back. Needs no ROS."""

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass

from skinplan.errors import SkinplanError
from skinplan.recording.disk import is_full
from skinplan_nodes.supervisor.control import (
    AbortError,
    InterruptError,
    JobControl,
    Request,
    StepError,
)
from skinplan_nodes.supervisor.faults import (
    ENDS_A_START,
    Answer,
    Attempts,
    Interruption,
    answer_to,
)
from skinplan_nodes.supervisor.limits import Limits
from skinplan_nodes.supervisor.machine import (
    FINAL,
    INTERRUPTED,
    Event,
    State,
    after,
    ignored,
    sub_state,
)
from skinplan_nodes.supervisor.progress import Progress
from skinplan_nodes.supervisor.restoring import Restoring
from skinplan_nodes.supervisor.shares import share_of
from skinplan_nodes.supervisor.steps import Steps

# Status codes of errors that are nobody's in particular (``skinplan_msgs/Status``).
_OK, _DISK_FULL, _INTERNAL = 1, 705, 1000
_LOOK_S = 0.1
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class ResumeSettings:
    """How a job goes on after an interruption.

    Attributes:
        automatic: Failures that allow it recover by themselves; otherwise each waits for RESUME.
        attempts: So often a job goes on by itself after the same failure at the same node.
        at_start: A job that another supervisor process has left goes on by itself.
    """

    automatic: bool = True
    attempts: int = 3
    at_start: bool = True


class Mission:
    """One job on its way through the cell.

    Args:
        steps: What is done in each state.
        control: What is asked of the job from outside.
        limits: How long each state may last.
        settings: How it goes on after an interruption.
        code_of: Status code of an error of the library.
        on_progress: Told after every change: state, progress, why it stands still (None = it does
            not).
    """

    def __init__(
        self,
        steps: Steps,
        control: JobControl,
        limits: Limits,
        settings: ResumeSettings,
        code_of: Callable[[SkinplanError], int],
        on_progress: Callable[[State, Progress, StepError | None], None],
    ) -> None:
        self._steps = steps
        self._control = control
        self._limits = limits
        self._settings = settings
        self._code_of = code_of
        self._on_progress = on_progress
        self._attempts = Attempts(settings.attempts)
        self._not_before_s = 0.0
        self._restoring = Restoring(steps, control)
        self._held: tuple[Interruption, float] | None = None
        self.failure: StepError | None = None
        self._actions: dict[State, Callable[[], Event]] = {
            State.STARTING: steps.starting,
            State.DRIVING: steps.driving,
            State.LOCALIZING: steps.localizing,
            State.IDENTIFYING: steps.identifying,
            State.PLANNING_PATH: steps.planning_path,
            State.PLANNING_STATIONS: steps.planning_stations,
            State.PLANNING_TRAJECTORY: steps.planning_trajectory,
            State.MOVING: steps.moving,
            State.SCANNING: steps.scanning,
            State.INSPECTING: steps.inspecting,
            State.FINISHING: steps.finishing,
            State.STOPPING: self._stop,
            State.PAUSED: self._wait_for_operator,
            State.WAITING: self._wait_for_operator,
            State.RECOVERING: self._recover,
            State.RESTORING: self._restore,
            State.CLOSING: steps.closing,
            State.ABORTING: self._abort,
        }

    def run(self, state: State = State.STARTING, why: StepError | None = None) -> State:
        """Walks until the job is over.

        Args:
            state: Where to begin.
            why: Why a job that is taken over stands still.

        Returns:
            ENDED or ABORTED; then `failure` says why.
        """
        event = Event.DONE
        if why is not None:
            self._restoring.taken_over = True
            self._hold(why)
        while True:
            self._enter(state, event)
            if state in FINAL:
                return state
            event = self._perform(state)
            state = after(state, event)

    def _enter(self, state: State, event: Event) -> None:
        steps, place = self._steps, self._steps.place
        if state in FINAL:
            self._write_down(lambda: steps.record.over(state, self._code()))
            return
        self._control.enter(self._limits.late(state, steps.cell.now_s), ignored(state))
        if state not in (*INTERRUPTED, State.RESTORING, State.ABORTING):
            place.state = state
            self._release()
        self._write_down(lambda: steps.record.entered(state, event, place))
        self._report(state)

    def _code(self) -> int:
        return _OK if self.failure is None else self.failure.code

    def _write_down(self, write: Callable[[], None]) -> None:
        try:
            write()
        except OSError as error:
            # What can't be written down can't be resumed, but it can be brought to its end.
            _log.error("the journal can't be written: %s", error)

    def _report(self, state: State) -> None:
        steps = self._steps
        before = steps.progress.title
        name = sub_state(state)
        begun = steps.progress.at_state(name, steps.place.station, steps.cell.now_s())
        steps.progress = share_of(state, begun, steps)
        if steps.progress.title != before:
            steps.record.folder.note(steps.progress.title)
        why = self._why if state in INTERRUPTED else None
        self._on_progress(state, steps.progress, why)

    def _perform(self, state: State) -> Event:
        try:
            if state not in (*INTERRUPTED, State.CLOSING, State.ABORTING):
                self._control.check()
            if state in (State.DRIVING, State.MOVING, State.SCANNING):
                self._steps.bag.tend()
            return self._actions[state]()
        except InterruptError as error:
            return self._interrupted(state, error)
        except Exception as error:  # whatever it is, the job ends with a name and a reason
            return self._failed(state, self._named(error))

    def close_bag(self) -> None:
        """Closes the bag, if it is open, of a mission that ended without its own closing."""
        self._steps.record.data.bag = self._steps.bag.close()

    def _interrupted(self, state: State, error: InterruptError) -> Event:
        event = error.request.event
        self._control.take((event,))
        error.step = error.step or self._steps.progress.title
        if event is Event.ABORT:
            self.failure = error
        elif state is not State.RECOVERING or event is not Event.NODE_LOST:
            self._hold(error)
        return event

    def _failed(self, state: State, error: StepError) -> Event:
        answer = answer_to(error.code)
        nothing_begun = state is State.STARTING and error.code in ENDS_A_START
        if state in (State.CLOSING, State.ABORTING):
            self._steps.record.folder.note(f"{state.value}: {error}")
            # Whatever it was, the bag does not stay open.
            self.close_bag()
            return Event.FAILED
        if state in INTERRUPTED or nothing_begun or answer is Answer.FATAL or self._steps.stopped:
            self.failure = error
            return Event.FAILED
        self._hold(error)
        return Event.FAULT

    def _named(self, error: Exception) -> StepError:
        if not isinstance(error, StepError):
            if not isinstance(error, SkinplanError | OSError):
                _log.error("unexpected error", exc_info=error)
            code = self._code_of(error) if isinstance(error, SkinplanError) else _INTERNAL
            if is_full(error):
                code = _DISK_FULL
            error = StepError(code, str(error) or type(error).__name__)
        error.step = error.step or self._steps.progress.title
        return error

    # --- held ---

    @property
    def _why(self) -> StepError | None:
        return self._restoring.worst()

    def _hold(self, error: StepError) -> None:
        """Notes why the job is to stand still; the first reason of an interruption counts."""
        steps = self._steps
        stop = isinstance(error, InterruptError) and error.request.event is Event.STOP
        if stop:
            steps.stopped = True
        if self._held is None:
            found = Interruption(
                steps.cell.now_s(), steps.place.state.value, error.code, str(error), error.node
            )
            self._held = found, time.monotonic()
            steps.record.data.interruptions.append(found)
        steps.record.interrupted(steps.place.state, error.code, str(error))
        self._restoring.note(error)
        worst = self._why
        if worst is not None:
            found = self._held[0]
            found.code, found.reason, found.node = worst.code, str(worst), worst.node

    def _release(self) -> None:
        """The job goes on: says how long it stood."""
        if self._held is None:
            return
        found, since_s = self._held
        self._held = None
        if not self._steps.stopped:
            found.resumed_after_s = time.monotonic() - since_s
            self._steps.record.resumed(found.resumed_after_s)
        self._restoring.forget()

    def _stop(self) -> Event:
        """Makes everything stand still, and says whose turn it is."""
        steps = self._steps
        if self._restoring.taken_over:
            steps.cell.meet()
        steps.cell.halt(stop_devices=steps.stopped or not self._restoring.only_commands())
        steps.progress = steps.progress.switched(False)
        self._restoring.locate_arm()
        # What came in meanwhile is part of the same interruption.
        breaking = (Event.STOP, Event.FAULT, Event.NODE_LOST, Event.PAUSE)
        while (also := self._control.take(breaking)) is not None:
            self._hold(InterruptError(also))
        return self._whose_turn()

    def _whose_turn(self) -> Event:
        restoring, why = self._restoring, self._why
        if self._steps.stopped:
            return Event.HELD_STOP
        if why is None or restoring.paused():
            return Event.HELD_PAUSED
        by_itself = self._settings.automatic
        if restoring.taken_over:
            by_itself = by_itself and self._settings.at_start
        if not by_itself or answer_to(why.code) is not Answer.AUTOMATIC:
            return Event.HELD_OPERATOR
        patience_s = self._attempts.another(why)
        if patience_s is None:
            self._steps.record.folder.note("went on by itself often enough: RESUME is waited for")
            return Event.HELD_OPERATOR
        # Well before the state itself lasts too long.
        patience_s = min(patience_s, 0.5 * self._limits.recovering_s)
        self._not_before_s = time.monotonic() + patience_s
        return Event.HELD_AUTOMATIC

    def _wait_for_operator(self) -> Event:
        return self._poll(lambda: None)

    def _recover(self) -> Event:
        """Waits until the cause is gone, and longer each time that it comes again."""

        def recovered() -> Event | None:
            missing = self._steps.cell.not_recovered()
            if missing is None:
                return Event.DONE if time.monotonic() >= self._not_before_s else None
            if answer_to(missing.code) is not Answer.AUTOMATIC:
                self._hold(missing)
                return Event.FAULT
            return None

        return self._poll(recovered)

    def _poll(self, done: Callable[[], Event | None]) -> Event:
        while True:
            asked = self._control.take()
            if asked is not None:
                return self._answered(asked)
            event = done()
            if event is not None:
                return event
            self._control.wait(_LOOK_S)

    def _answered(self, asked: Request) -> Event:
        """Takes in what is asked of a job that stands still."""
        if asked.event in (Event.ABORT, Event.TIMED_OUT):
            kind = AbortError if asked.event is Event.ABORT else InterruptError
            self.failure, why = kind(asked), self._why
            if asked.event is Event.TIMED_OUT and why is not None and why.code:
                # The failure that nobody ended is what ends the job.
                self.failure = StepError(why.code, f"{why} ({asked.message})", why.node)
            self.failure.step = self._steps.place.state.value
        elif asked.event is Event.STOP:
            self._steps.stopped = True
        elif asked.event in (Event.FAULT, Event.NODE_LOST):
            self._hold(InterruptError(asked))
        elif asked.event is Event.RESUME:
            self._restoring.by_operator = True
            self._attempts.forget()
        return asked.event

    def _restore(self) -> Event:
        event = self._restoring.run()
        self._steps.place.resuming = True
        return event

    def _abort(self) -> Event:
        """Stops everything, merges what was scanned, closes the bag."""
        steps = self._steps
        try:
            steps.cell.halt(stop_devices=True)
        except StepError as error:
            steps.record.folder.note(f"aborting: {error}")
            _log.error("aborting: %s", error)
        steps.progress = steps.progress.switched(False)
        self._restoring.salvage(self.failure)
        steps.closing()
        return Event.DONE
