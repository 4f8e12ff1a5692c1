"""The error tree of the library.

Every error says in one sentence what was asked, what was found and what would be accepted. The
nodes map the classes to the codes of ``skinplan_msgs/Status`` in one table; the command line maps
`InputError` to exit code 2 and the rest to 1.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from skinplan.mesh.model import Finding


class SkinplanError(Exception):
    """Base of everything that the library raises on purpose."""


class InputError(SkinplanError):
    """What was given can't be used: the caller has to change it."""


class PartNotFoundError(InputError):
    """No sample, part file or mesh of that name."""


class PartInvalidError(InputError):
    """A part file with an unknown key, a missing value or a value out of range."""


class PartIdError(InputError):
    """The part file is one of another part than the caller means."""


class CellInvalidError(InputError):
    """A cell file with an unknown key, a missing value or a value out of range."""


class CalibrationInvalidError(InputError):
    """A file of calibration facts with an unknown key, or a value that can't be used."""


class CalibrationMissingError(InputError):
    """The cell is not calibrated, or its calibration is not the one that was noted."""


class CalibrationDueError(InputError):
    """A calibration of the cell is out of date."""


class StrategyUnknownError(InputError):
    """A strategy name that does not exist; the message lists those that do."""


class MeshError(InputError):
    """Base of everything that is wrong with a mesh.

    Attributes:
        findings: What the mesh doctor found up to then, the reason of the refusal last; empty when
            the file could not be read at all.
    """

    def __init__(self, message: str, findings: "tuple[Finding, ...]" = ()) -> None:
        super().__init__(message)
        self.findings = findings


class MeshNotFoundError(MeshError):
    """The mesh file does not exist."""


class MeshUnreadableError(MeshError):
    """The file exists, but is no mesh of a known format."""


class MeshEmptyError(MeshError):
    """The mesh has no vertices or no faces."""


class MeshNotFiniteError(MeshError):
    """The mesh has vertices that are NaN or infinite."""


class MeshUnitError(MeshError):
    """The size of the mesh in the stated unit is no size of an aircraft skin."""


class MeshHashError(MeshError):
    """The mesh is another one than the caller means."""


class MeshRefusedError(MeshError):
    """The mesh is readable but can't be planned on."""


class MeshExtraMissingError(MeshUnreadableError):
    """The file's format needs an optional package that is not installed."""


class ScanPathInvalidError(InputError):
    """A scan path that is empty, not finite or not in the frame asked for."""


class RobotModelError(InputError):
    """A robot description that can't be used."""


class JointsInvalidError(InputError):
    """Joint names or positions that do not fit the arm."""


class ImageInvalidError(InputError):
    """An image or a camera model that can't be used."""


class JobInvalidError(InputError):
    """A job with a field that can't be used."""


class JobTextError(JobInvalidError):
    """A text of a job that is too long or has control characters."""


class JobOperatorError(InputError):
    """The operator is not one of the configured ones."""


class JobQueueFullError(InputError):
    """No further job can wait."""


class JobStoreError(SkinplanError):
    """The job store can't be read or written now."""


class JobUnknownError(InputError):
    """No job of that id."""


class JobConflictError(InputError):
    """The job id exists with other content."""


class JobCommandError(InputError):
    """The command is not allowed in the job's state."""


class BagNotFoundError(InputError):
    """No bag at that place."""


class BagInvalidError(InputError):
    """A file that is no readable bag."""


class BagNotWritableError(InputError):
    """A bag can't be created or written there."""


class DiskFullError(BagNotWritableError):
    """The disk is full, or would have less left than has to stay free."""


class LocalizationError(SkinplanError):
    """Base of everything that keeps the part from being located."""


class NoMarkerError(LocalizationError):
    """No marker of the fixture in the image."""


class WrongMarkerError(LocalizationError):
    """There are markers, but none of the fixture's."""


class FixtureMismatchError(WrongMarkerError):
    """The fixture's markers are seen, but not where its description says."""


class AmbiguousPoseError(LocalizationError):
    """Two poses explain the image about equally well."""


class NoImageError(LocalizationError):
    """No image or no camera model came in time."""


class StaleImageError(LocalizationError):
    """The camera's images are old, or it repeats one."""


class QualityNotReachedError(LocalizationError):
    """The view is not good enough after all attempts."""


class SafeDistanceError(LocalizationError):
    """The view is not good enough, and the camera may come no nearer."""


class BaseRefusedError(LocalizationError):
    """The base did not take a goal."""


class BaseBlockedError(LocalizationError):
    """The base did not arrive where it was sent."""


class PartMovedError(LocalizationError):
    """The part is not where it was."""


class FrameMissingError(LocalizationError):
    """A transform between two frames is not known."""


class LocalizationCancelledError(LocalizationError):
    """The caller asked to stop the localisation."""


class NoCandidatesError(SkinplanError):
    """No place where the base could stand."""


class MarkersUnseenError(NoCandidatesError):
    """From no place for the base the camera sees the part's markers well enough."""


class NothingReachedError(SkinplanError):
    """The arm reaches none of the points."""


class StartStateError(InputError):
    """The arm's start state is out of limits or in collision."""


class NoTrajectoryError(SkinplanError):
    """No point of the request can be scanned."""


class NoCloudError(SkinplanError):
    """There are no scan points to work on."""


class CloudInvalidError(InputError):
    """A cloud file that can't be read or written."""


class ResumeRefusedError(InputError):
    """What was kept of a scan belongs to another job or part."""


class FaultUnknownError(InputError):
    """A mock device does not know the fault."""


class DeviceRefusedError(SkinplanError):
    """A device does not take an order in its present state."""


class AlignmentError(SkinplanError):
    """The cloud can't be aligned with the part."""


class UnknownPartError(SkinplanError):
    """The part on the fixture is none of the candidates."""


class CancelledError(SkinplanError):
    """The caller asked to stop."""


class StageError(SkinplanError):
    """A planning stage failed.

    Attributes:
        stage: Name of the stage.
        index: Its number in the pipeline, from 0.
        cause: The error that the stage raised.
    """

    def __init__(self, stage: str, index: int, cause: SkinplanError) -> None:
        super().__init__(f"stage {index} ({stage}): {cause}")
        self.stage = stage
        self.index = index
        self.cause = cause


class InspectionPointsError(InputError):
    """Measuring points or normals that are missing, not finite, or not in metres."""


class NoTrackerStationError(SkinplanError):
    """No place from which the tracker sees the target at all poses."""


class ViewerMissingError(SkinplanError):
    """The package that shows scenes in the browser is not installed."""


class PortBusyError(InputError):
    """No network port that was asked for is free."""


class NothingMissingError(SkinplanError):
    """A re-scan was asked for, and nothing that could be scanned is missing."""


class TrackerBlindError(NothingReachedError):
    """The tracker does not see the scanner anywhere where the arm could bring it."""


class LimitsExcludeError(NothingReachedError):
    """Every solution of the inverse kinematics is outside the joint limits."""
