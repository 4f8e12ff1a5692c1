"""What a job may look like.

Every text is limited and free of control characters, because others send them.
"""

import re
import secrets
import time
from pathlib import PurePosixPath
from urllib.parse import urlsplit

from skinplan.errors import JobInvalidError, JobTextError
from skinplan.jobs.model import Job

ID_PATTERN = re.compile(r"[A-Za-z0-9_.-]{1,64}")
_HASH_PATTERN = re.compile(r"[0-9a-f]{64}")
# Control characters, line ends, those that turn the direction of writing, halves of characters.
_CONTROL = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069\ud800-\udfff]")
LONGEST_NAME = 128
LONGEST_URI = 1024
LONGEST_VALUE = 1024
MOST_ATTRIBUTES = 64
PRIORITY_RANGE = (-1000, 1000)
LONGEST_REASON = 256
# ISO 8601 and ROS have no room for more [ns since the epoch].
_LATEST_NS = (2**31 - 1) * 1_000_000_000


def new_job_id(now_s: float | None = None) -> str:
    """Makes a job id that sorts by time, e.g. ``job-20240131-120000-1a2b3c``.

    Args:
        now_s: Seconds since the epoch; None = now.
    """
    stamp = time.strftime("%Y%m%d-%H%M%S", time.gmtime(now_s))
    return f"job-{stamp}-{secrets.token_hex(3)}"


def check_job(job: Job) -> Job:
    """Returns the job, or says what can't be accepted about it.

    Raises:
        JobTextError: A text is too long or has control characters.
        JobInvalidError: A field is missing or out of range.
    """
    if not ID_PATTERN.fullmatch(job.job_id) or job.job_id.strip(".") == "":
        raise JobInvalidError(
            f"job_id: 1 to 64 of [A-Za-z0-9_.-] are accepted, found {_shown(job.job_id)}"
        )
    for name in ("order_id", "serial_number", "operator_name", "part_id", "recipe_version"):
        _check_text(name, getattr(job, name), LONGEST_NAME)
    _check_uri(job.part_uri)
    if job.mesh_sha256 and not _HASH_PATTERN.fullmatch(job.mesh_sha256):
        raise JobInvalidError(
            "mesh_sha256: empty or 64 lower-case hex digits are accepted, found "
            f"{_shown(job.mesh_sha256)}"
        )
    low, high = PRIORITY_RANGE
    if not low <= job.priority <= high:
        raise JobInvalidError(f"priority: {low} to {high} is accepted, found {job.priority}")
    if not 0 <= job.earliest_start_ns <= _LATEST_NS:
        raise JobInvalidError(
            f"earliest_start: 0 to {_LATEST_NS // 1_000_000_000} s since 1970 is accepted, found "
            f"{job.earliest_start_ns / 1e9:.0f} s"
        )
    _check_attributes(job.attributes)
    return job


def check_command(operator_name: str, reason: str) -> None:
    """Lets texts of a command through that can be kept and shown.

    Raises:
        JobTextError: One is too long or has control characters.
    """
    _check_text("operator_name", operator_name, LONGEST_NAME)
    _check_text("reason", reason, LONGEST_REASON)


def _check_uri(uri: str) -> None:
    _check_text("part_uri", uri, LONGEST_URI)
    path = urlsplit(uri).path if uri.startswith("file://") else uri
    if not PurePosixPath(path).is_absolute():
        raise JobInvalidError(
            f"part_uri: an absolute path or a file:// URI is accepted, found {_shown(uri)}"
        )


def _check_attributes(attributes: tuple[tuple[str, str], ...]) -> None:
    if len(attributes) > MOST_ATTRIBUTES:
        raise JobInvalidError(
            f"attributes: up to {MOST_ATTRIBUTES} are accepted, found {len(attributes)}"
        )
    seen: set[str] = set()
    for key, value in attributes:
        _check_text("attribute key", key, LONGEST_NAME)
        _check_text(f"attribute {_shown(key)}", value, LONGEST_VALUE)
        if not key or key in seen:
            raise JobInvalidError(
                f"attributes: keys that are not empty and unique are accepted, found {_shown(key)}"
            )
        seen.add(key)


def _check_text(name: str, text: str, longest: int) -> None:
    if len(text) > longest:
        raise JobTextError(f"{name}: up to {longest} characters are accepted, found {len(text)}")
    if _CONTROL.search(text):
        raise JobTextError(
            f"{name}: text without control characters is accepted, found {_shown(text)}"
        )


def _shown(text: str) -> str:
    return ascii(text if len(text) <= 80 else text[:80] + "...")
