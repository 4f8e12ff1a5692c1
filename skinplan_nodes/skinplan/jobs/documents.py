"""Jobs as documents, for those who read them without ROS."""

import json
import math
from dataclasses import asdict
from datetime import UTC, datetime
from typing import Any

from skinplan.jobs.model import JobRecord
from skinplan.jobs.store import JobStore

#: Columns of the table of jobs.
TABLE_COLUMNS = (
    "job_id",
    "state",
    "sub_state",
    "order_id",
    "serial_number",
    "part_id",
    "part_uri",
    "recipe_version",
    "operator_name",
    "priority",
    "station",
    "station_count",
    "rescan",
    "progress",
    "cleared",
    "changed",
    "run_folder",
    "error_code",
    "error",
)


def job_row(record: JobRecord) -> dict[str, Any]:
    """Returns a job as one line, with the keys `TABLE_COLUMNS`."""
    job = record.job
    return {
        "job_id": job.job_id,
        "state": record.state.title,
        "sub_state": record.sub_state,
        "order_id": job.order_id,
        "serial_number": job.serial_number,
        "part_id": job.part_id,
        "part_uri": job.part_uri,
        "recipe_version": job.recipe_version,
        "operator_name": job.operator_name,
        "priority": job.priority,
        "station": record.station,
        "station_count": record.station_count,
        "rescan": record.rescan,
        "progress": record.progress,
        "cleared": record.cleared,
        "changed": iso_time(record.changed_ns),
        "run_folder": record.run_folder,
        "error_code": record.error_code,
        "error": record.error,
    }


def job_document(store: JobStore, job_id: str) -> dict[str, Any]:
    """Returns all that the store knows about a job.

    Raises:
        JobUnknownError: There is no such job.
    """
    record = store.get(job_id)
    order = asdict(record.job)
    order["attributes"] = dict(record.job.attributes)
    earliest_ns = order.pop("earliest_start_ns")
    order["earliest_start"] = iso_time(earliest_ns) if earliest_ns else ""
    status = {key: value for key, value in job_row(record).items() if key not in order}
    left_s = record.time_left_s
    status["time_left_s"] = left_s if math.isfinite(left_s) else None
    result = store.result(job_id)
    return {
        "job": order,
        "status": status,
        "history": [
            {
                "time": iso_time(entry.at_ns),
                "state": entry.state.title,
                "sub_state": entry.sub_state,
                "station": entry.station,
                "reason": entry.reason,
            }
            for entry in store.history(job_id)
        ],
        "result": json.loads(result) if result else None,
    }


def iso_time(at_ns: int) -> str:
    """Returns a time as ISO 8601 in UTC with milliseconds."""
    moment = datetime.fromtimestamp(at_ns / 1e9, UTC)
    return moment.isoformat(timespec="milliseconds").replace("+00:00", "Z")
