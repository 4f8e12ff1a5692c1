"""Parts by reference, jobs and their states."""

from collections.abc import Iterable, Mapping, Sequence

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import KeyValue
from skinplan_msgs import msg as messages

from skinplan.errors import JobInvalidError
from skinplan.jobs.model import HistoryEntry, Job, JobRecord, JobState
from skinplan_nodes.conversions.geometry import header_to_msg, stamp_from_msg

_STATES = {int(state) for state in JobState}


def key_values_to_msg(items: Mapping[str, str] | Iterable[tuple[str, str]]) -> list[KeyValue]:
    """Converts key/values."""
    pairs = items.items() if isinstance(items, Mapping) else items
    return [KeyValue(key=str(key), value=str(value)) for key, value in pairs]


def key_values_from_msg(items: Sequence[KeyValue]) -> tuple[tuple[str, str], ...]:
    """Returns key/values in their order."""
    return tuple((item.key, item.value) for item in items)


def job_to_msg(job: Job) -> messages.Job:
    """Converts a job."""
    return messages.Job(
        job_id=job.job_id,
        order_id=job.order_id,
        serial_number=job.serial_number,
        part=messages.PartReference(uri=job.part_uri, mesh_sha256=job.mesh_sha256),
        operator_name=job.operator_name,
        priority=job.priority,
        attributes=key_values_to_msg(job.attributes),
        part_id=job.part_id,
        recipe_version=job.recipe_version,
        earliest_start=_time_to_msg(job.earliest_start_ns),
        accept_due_calibration=job.accept_due_calibration,
    )


def job_from_msg(msg: messages.Job) -> Job:
    """Returns a job, as it was sent: the store checks it."""
    return Job(
        job_id=msg.job_id,
        part_uri=msg.part.uri,
        mesh_sha256=msg.part.mesh_sha256,
        order_id=msg.order_id,
        serial_number=msg.serial_number,
        operator_name=msg.operator_name,
        priority=msg.priority,
        attributes=key_values_from_msg(msg.attributes),
        part_id=msg.part_id,
        recipe_version=msg.recipe_version,
        earliest_start_ns=_time_from_msg(msg.earliest_start),
        accept_due_calibration=msg.accept_due_calibration,
    )


def job_status_to_msg(record: JobRecord) -> messages.JobStatus:
    """Converts how far a job is; the stamp is the time of the last change."""
    return messages.JobStatus(
        header=header_to_msg("", record.changed_ns * 1e-9),
        job_id=record.job.job_id,
        state=int(record.state),
        sub_state=record.sub_state,
        station=record.station,
        station_count=record.station_count,
        rescan=record.rescan,
        step=record.step,
        step_count=record.step_count,
        expected_end=_time_to_msg(record.expected_end_ns),
        cleared=record.cleared,
        progress=float(record.progress),
        time_left=float(record.time_left_s),
        run_folder=record.run_folder,
        status=messages.Status(code=record.error_code, message=record.error),
    )


def job_status_from_msg(msg: messages.JobStatus, job: Job | None = None) -> JobRecord:
    """Returns how far a job is.

    Args:
        msg: The state.
        job: The job; None = one with just the id, the message has no more.

    Raises:
        JobInvalidError: An unknown state.
    """
    if msg.state not in _STATES:
        raise JobInvalidError(
            f"job {msg.job_id!r}: the states {sorted(_STATES)} are accepted, found {msg.state}"
        )
    return JobRecord(
        job=job or Job(msg.job_id, ""),
        state=JobState(msg.state),
        sub_state=msg.sub_state,
        station=msg.station,
        station_count=msg.station_count,
        rescan=msg.rescan,
        progress=msg.progress,
        time_left_s=msg.time_left,
        run_folder=msg.run_folder,
        error_code=msg.status.code,
        error=msg.status.message,
        changed_ns=round(stamp_from_msg(msg.header.stamp) * 1e9),
        step=msg.step,
        step_count=msg.step_count,
        expected_end_ns=_time_from_msg(msg.expected_end),
        cleared=msg.cleared,
    )


def history_entry_to_msg(entry: HistoryEntry) -> messages.JobChange:
    """Converts a change of a job."""
    return messages.JobChange(
        stamp=_time_to_msg(entry.at_ns),
        state=int(entry.state),
        sub_state=entry.sub_state,
        station=entry.station,
        reason=entry.reason,
    )


def _time_to_msg(at_ns: int) -> Time:
    """Wall time to the nanosecond, which a float has no room for."""
    return Time(sec=at_ns // 1_000_000_000, nanosec=at_ns % 1_000_000_000)


def _time_from_msg(msg: Time) -> int:
    return int(msg.sec) * 1_000_000_000 + int(msg.nanosec)
