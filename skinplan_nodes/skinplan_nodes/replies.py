"""Every answer ends with a Status: one table from errors to codes, one decorator for handlers."""

import functools
import traceback
from collections.abc import Callable, Mapping
from typing import Any, overload

from skinplan_msgs.msg import Status

from skinplan import errors
from skinplan.recording.disk import is_full
from skinplan_nodes.offload import in_thread

Handler = Callable[[Any, Any, Any], Status | None]
Answering = Callable[[Any, Any, Any], Any]

#: The most special class of an error that stands here counts.
CODES: dict[type[Exception], int] = {
    errors.PartNotFoundError: Status.PART_NOT_FOUND,
    errors.PartInvalidError: Status.PART_INVALID,
    errors.PartIdError: Status.PART_ID_MISMATCH,
    errors.CellInvalidError: Status.CELL_INVALID,
    errors.CalibrationInvalidError: Status.CALIBRATION_MISSING,
    errors.CalibrationMissingError: Status.CALIBRATION_MISSING,
    errors.CalibrationDueError: Status.CALIBRATION_DUE,
    errors.StrategyUnknownError: Status.STRATEGY_UNKNOWN,
    errors.NothingMissingError: Status.NOTHING_MISSING,
    errors.InspectionPointsError: Status.INSPECTION_POINTS_INVALID,
    errors.MeshNotFoundError: Status.MESH_NOT_FOUND,
    errors.MeshUnreadableError: Status.MESH_UNREADABLE,
    errors.MeshEmptyError: Status.MESH_EMPTY,
    errors.MeshNotFiniteError: Status.MESH_NOT_FINITE,
    errors.MeshUnitError: Status.MESH_UNIT_IMPLAUSIBLE,
    errors.MeshHashError: Status.MESH_HASH_MISMATCH,
    errors.MeshError: Status.MESH_REFUSED,
    errors.ScanPathInvalidError: Status.SCAN_PATH_INVALID,
    errors.RobotModelError: Status.ROBOT_MODEL_INVALID,
    errors.JointsInvalidError: Status.JOINTS_INVALID,
    errors.ImageInvalidError: Status.IMAGE_INVALID,
    errors.JobInvalidError: Status.JOB_INVALID,
    errors.JobTextError: Status.JOB_TEXT_REFUSED,
    errors.JobOperatorError: Status.JOB_OPERATOR_REFUSED,
    errors.JobQueueFullError: Status.JOB_QUEUE_FULL,
    errors.JobStoreError: Status.JOB_STORE_FAILED,
    errors.JobUnknownError: Status.JOB_UNKNOWN,
    errors.JobConflictError: Status.JOB_CONFLICT,
    errors.JobCommandError: Status.JOB_COMMAND_REFUSED,
    errors.BagNotFoundError: Status.BAG_NOT_FOUND,
    errors.BagInvalidError: Status.BAG_INVALID,
    errors.BagNotWritableError: Status.BAG_NOT_WRITABLE,
    errors.DiskFullError: Status.DISK_FULL,
    errors.NoMarkerError: Status.NO_MARKER,
    errors.WrongMarkerError: Status.WRONG_MARKER,
    errors.AmbiguousPoseError: Status.AMBIGUOUS_POSE,
    errors.NoImageError: Status.NO_IMAGE,
    errors.StaleImageError: Status.STALE_IMAGE,
    errors.QualityNotReachedError: Status.QUALITY_NOT_REACHED,
    errors.SafeDistanceError: Status.SAFE_DISTANCE_REACHED,
    errors.BaseRefusedError: Status.BASE_REFUSED,
    errors.BaseBlockedError: Status.BASE_BLOCKED,
    errors.PartMovedError: Status.PART_MOVED,
    errors.LocalizationCancelledError: Status.LOCALIZATION_CANCELLED,
    errors.FrameMissingError: Status.NO_TRANSFORM,
    # Each failure that a user can meet has a class of its own.
    errors.LocalizationError: Status.INTERNAL,
    errors.NoCandidatesError: Status.NO_CANDIDATES,
    errors.NothingReachedError: Status.NOTHING_REACHED,
    errors.NoTrackerStationError: Status.NO_TRACKER_STATION,
    errors.StartStateError: Status.START_STATE_INVALID,
    errors.NoTrajectoryError: Status.NO_TRAJECTORY,
    errors.NoCloudError: Status.NO_CLOUD,
    errors.CloudInvalidError: Status.NO_CLOUD,
    errors.ResumeRefusedError: Status.RESUME_REFUSED,
    errors.FaultUnknownError: Status.FAULT_UNKNOWN,
    errors.DeviceRefusedError: Status.DEVICE_REFUSED,
    errors.AlignmentError: Status.ALIGNMENT_FAILED,
    errors.UnknownPartError: Status.UNKNOWN_PART,
    errors.CancelledError: Status.PLANNING_CANCELLED,
    # Of the command; no node shows anything.
    errors.ViewerMissingError: Status.INTERNAL,
    errors.PortBusyError: Status.REQUEST_INVALID,
}


class RefusedError(errors.SkinplanError):
    """Something that only a node can know: no image, no answer of a device, busy.

    Attributes:
        code: Code of the Status.
    """

    def __init__(self, code: int, message: str) -> None:
        super().__init__(message)
        self.code = code


def ok() -> Status:
    """Returns the Status of a success."""
    return Status(code=Status.OK)


def status_of(error: BaseException, invalid: int = Status.INTERNAL) -> Status:
    """Returns the Status of an error.

    Args:
        error: What was raised; of a `StageError` the cause decides the code. A full disk has its
            code, whatever could not be written.
        invalid: Code of an `InputError` that has none of its own: a malformed request.
    """
    if is_full(error):
        return Status(code=Status.DISK_FULL, message=str(error))
    if isinstance(error, errors.SkinplanError):
        return Status(code=_code(error, invalid), message=str(error))
    return Status(
        code=Status.INTERNAL,
        message=f"internal error: {type(error).__name__}: {error}; the node's log has the details",
    )


@overload
def replies(handler: Handler) -> Answering: ...
@overload
def replies(
    *, invalid: int, blank: Mapping[str, Any] | None = None
) -> Callable[[Handler], Answering]: ...
def replies(
    handler: Handler | None = None,
    *,
    invalid: int = Status.INTERNAL,
    blank: Mapping[str, Any] | None = None,
) -> Answering | Callable[[Handler], Answering]:
    """Wraps a service handler so that an answer always goes out, with its Status.

    A handler that raises would end the spin loop, and its client would wait forever. The handler
    gets ``(self, request, response)``, fills the response and returns nothing, or a Status of its
    own; an error leaves nothing half-filled in the answer.

    Args:
        handler: The handler.
        invalid: Code of a malformed request, where the error itself has none.
        blank: Fields of an answer after an error whose 0 would mean something.
    """
    if handler is None:
        return functools.partial(_wrapped, invalid=invalid, blank=blank or {})
    return _wrapped(handler, invalid, blank or {})


def replies_in_thread(
    *, invalid: int, blank: Mapping[str, Any] | None = None
) -> Callable[[Handler], Answering]:
    """Like `replies`, for a handler that takes long: it works in a thread of its own.

    The heartbeat and everything else of the node go on meanwhile; the next request waits where the
    service's callback group is mutually exclusive.

    Args:
        invalid: Code of a malformed request, where the error itself has none.
        blank: Fields of an answer after an error whose 0 would mean something.
    """

    def decorate(handler: Handler) -> Answering:
        answering = _wrapped(handler, invalid, blank or {})

        @functools.wraps(handler)
        async def awaiting(self: Any, request: Any, response: Any) -> Any:
            return await in_thread(self, lambda: answering(self, request, response))

        return awaiting

    return decorate


def log_error(logger: Any, where: str, error: BaseException) -> None:
    """Logs an error that is answered: one sentence, or the traceback when it is not on purpose."""
    if isinstance(error, errors.SkinplanError):
        logger.warning(f"{where}: {error}")
    else:
        logger.error(f"{where}: {''.join(traceback.format_exception(error))}")


def _wrapped(handler: Handler, invalid: int, blank: Mapping[str, Any]) -> Answering:
    @functools.wraps(handler)
    def answering(self: Any, request: Any, response: Any) -> Any:
        try:
            status = handler(self, request, response)
        except Exception as error:
            log_error(self.get_logger(), handler.__name__.removeprefix("_on_"), error)
            response = type(response)(**blank)
            _set_status(response, status_of(error, invalid))
        else:
            _set_status(response, ok() if status is None else status)
        return response

    return answering


def _code(error: errors.SkinplanError, invalid: int) -> int:
    if isinstance(error, RefusedError):
        return error.code
    if isinstance(error, errors.StageError):
        return _code(error.cause, invalid)
    for kind in type(error).__mro__:
        if kind in CODES:
            return CODES[kind]
    return invalid if isinstance(error, errors.InputError) else int(Status.INTERNAL)


def _set_status(response: Any, status: Status) -> None:
    """Sets the Status; the standard services have success and message instead."""
    if hasattr(response, "status"):
        response.status = status
        return
    response.success = status.code == Status.OK
    if not response.success:
        response.message = status.message
