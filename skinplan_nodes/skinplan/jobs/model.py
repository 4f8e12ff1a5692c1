"""Jobs: ISA-95 job control states (OPC 10031-4) with our sub-states."""

from dataclasses import dataclass, field
from enum import IntEnum


class JobState(IntEnum):
    """State of a job; the numbers are those of ``skinplan_msgs/JobStatus``."""

    NOT_ALLOWED_TO_START = 0
    ALLOWED_TO_START = 1
    RUNNING = 2
    INTERRUPTED = 3
    ENDED = 4
    ABORTED = 5

    @property
    def title(self) -> str:
        """Name as ISA-95 writes it, e.g. ``Ended``."""
        return "".join(word.capitalize() for word in self.name.split("_"))


class JobCommand(IntEnum):
    """Command to a job; the numbers are those of ``skinplan_msgs/srv/JobCommand``."""

    START = 1
    PAUSE = 2
    RESUME = 3
    STOP = 4
    ABORT = 5
    CANCEL = 6
    CLEAR = 7


@dataclass(frozen=True)
class Job:
    """An order to measure one part.

    Attributes:
        job_id: Unique, 1 to 64 of [A-Za-z0-9_.-].
        part_uri: Absolute path of the part file.
        mesh_sha256: Hash that the mesh must have; empty = not checked.
        order_id: The customer's order; may be empty.
        serial_number: Of the individual part; may be empty.
        operator_name: Who asked; may be empty.
        priority: Higher runs first.
        attributes: Free key/values, carried into the result.
        part_id: Id that the part file must have; empty = not checked.
        recipe_version: Of the measuring recipe that the order was made for; may be empty.
        earliest_start_ns: Does not start before [ns since the epoch]; 0 = at once.
        accept_due_calibration: Measure also where a calibration is missing or out of date.
    """

    job_id: str
    part_uri: str
    mesh_sha256: str = ""
    order_id: str = ""
    serial_number: str = ""
    operator_name: str = ""
    priority: int = 0
    attributes: tuple[tuple[str, str], ...] = ()
    part_id: str = ""
    recipe_version: str = ""
    earliest_start_ns: int = 0
    accept_due_calibration: bool = False


@dataclass(frozen=True)
class JobRecord:
    """A job and how far it is.

    Attributes:
        job: The order.
        state: ISA-95 state.
        sub_state: starting, driving, localizing, identifying, planning, moving, scanning,
            inspecting, closing; while it stands still stopping, paused, waiting, recovering; on its
            way back restoring; aborting; empty when it is over or has not begun.
        station: Number of the station being worked on, from 1; 0 = none.
        station_count: Stations of the plan; 0 = not planned yet.
        rescan: Number of the re-scan of what was missing, from 1; 0 = first scan.
        progress: 0 to 1.
        time_left_s: Estimate on the cell's clock [s]; NaN = unknown.
        run_folder: Absolute path; empty = none yet.
        error_code: Status code; 1 = all is well.
        error: One sentence; empty = all is well.
        changed_ns: Time of the last change, nanoseconds since the epoch.
        step: Number of the step of the plan, from 1; 0 = not begun.
        step_count: Steps of the plan, as far as it is known; 0 = not begun.
        expected_end_ns: Estimate, wall time, nanoseconds since the epoch; 0 = unknown.
        cleared: Somebody has fetched the result and acknowledged it.
    """

    job: Job
    state: JobState
    sub_state: str = ""
    station: int = 0
    station_count: int = 0
    progress: float = 0.0
    time_left_s: float = field(default=float("nan"))
    run_folder: str = ""
    error_code: int = 1
    error: str = ""
    changed_ns: int = 0
    rescan: int = 0
    step: int = 0
    step_count: int = 0
    expected_end_ns: int = 0
    cleared: bool = False


@dataclass(frozen=True)
class HistoryEntry:
    """One change of a job.

    Attributes:
        at_ns: When [ns since the epoch].
        state: State from then on.
        sub_state: Sub-state from then on.
        station: Station from then on, from 1; 0 = none.
        reason: Why, or the error; may be empty.
    """

    at_ns: int
    state: JobState
    sub_state: str
    station: int
    reason: str
