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
    """

    job_id: str
    part_uri: str
    mesh_sha256: str = ""
    order_id: str = ""
    serial_number: str = ""
    operator_name: str = ""
    priority: int = 0
    attributes: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class JobRecord:
    """A job and how far it is.

    Attributes:
        job: The order.
        state: ISA-95 state.
        sub_state: starting, driving, localizing, planning, moving, scanning, inspecting, closing;
            while it stands still stopping, paused, waiting, recovering; on its way back restoring;
            aborting; empty when it is over or has not begun.
        station: Number of the station being worked on, from 1; 0 = none.
        station_count: Stations of the plan; 0 = not planned yet.
        rescan: Number of the re-scan of what was missing, from 1; 0 = first scan.
        progress: 0 to 1.
        time_left_s: Estimate on the cell's clock [s]; NaN = unknown.
        run_folder: Absolute path; empty = none yet.
        error_code: Status code; 1 = all is well.
        error: One sentence; empty = all is well.
        changed_ns: Time of the last change, nanoseconds since the epoch.
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
