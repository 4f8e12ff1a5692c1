"""Begins a scan, anew or where an earlier process ended. Needs no ROS but the messages' codes."""

import re
from dataclasses import dataclass
from pathlib import Path

from skinplan_msgs.msg import Status
from skinplan_msgs.srv import InspectionStart

from skinplan.errors import ResumeRefusedError
from skinplan.inspection.spool import FrameSpool, SpoolOwner
from skinplan.mesh.prepare import PreparedMesh
from skinplan.part.model import Part
from skinplan_nodes.parameters import Parameter
from skinplan_nodes.replies import RefusedError
from skinplan_nodes.scan_session import ScanSession, SessionSettings

#: Parameters of the node.
SCAN = (
    Parameter("voxel_m", 0.001, "One point is kept per voxel of this side [m].", 1e-4, 0.1),
    Parameter("points_max", 3_000_000, "At most so many points [1].", 1000, 50_000_000),
    Parameter(
        "frame_points_max",
        1_000_000,
        "A scan frame of more points is left out [1].",
        1000,
        50_000_000,
    ),
    Parameter("coverage_spacing_m", 0.005, "Spacing of surface samples [m].", 0.001, 0.05),
    Parameter(
        "coverage_radius_m", 0.008, "A sample is measured by a point so near [m].", 0.001, 0.05
    ),
    Parameter("coverage_rate_hz", 1.0, "Rate of the topic coverage [Hz].", 0.1, 10.0),
)
_JOB_ID = re.compile(r"[A-Za-z0-9_.-]{1,64}")


@dataclass(frozen=True)
class Begun:
    """A session that has begun.

    Attributes:
        session: It.
        owner: Whose frames it takes.
        warning: Why nothing is kept on disk although it was asked for; empty = all is well.
    """

    session: ScanSession
    owner: SpoolOwner
    warning: str = ""


def check_request(request: InspectionStart.Request) -> None:
    """Checks job id and folder.

    Raises:
        RefusedError: One of them can't be used.
    """
    if not _JOB_ID.fullmatch(request.job_id):
        raise RefusedError(
            Status.JOB_INVALID,
            f"job id {request.job_id!r} was given; 1 to 64 of letters, digits, '_', '.', '-' "
            f"are accepted",
        )
    if request.folder and ("\0" in request.folder or not Path(request.folder).is_absolute()):
        raise RefusedError(
            Status.REQUEST_INVALID,
            f"frames were to be kept in {request.folder!r}; an absolute path, or none, is accepted",
        )


def require_same(running: SpoolOwner, asked: SpoolOwner) -> None:
    """Checks that what is to be resumed here is what is running here.

    Raises:
        ResumeRefusedError: The same job has another part.
    """
    if running != asked:
        raise ResumeRefusedError(
            f"job {asked.job_id} with part {asked.part_id} and mesh {asked.mesh_sha256[:12]} was "
            f"to be resumed; it is running with part {running.part_id} and mesh "
            f"{running.mesh_sha256[:12]}, which are accepted"
        )


def begin(
    request: InspectionStart.Request, part: Part, prepared: PreparedMesh, settings: SessionSettings
) -> Begun:
    """Begins a session as the request says.

    A folder that can't be used is no reason not to scan: the session is in memory then.

    Raises:
        ResumeRefusedError: The folder holds frames of another job or part.
    """
    owner = SpoolOwner(request.job_id, part.id, part.mesh_sha256)
    if not request.folder:
        return Begun(ScanSession(request.job_id, prepared, settings, None, part), owner)
    folder = Path(request.folder)
    try:
        if request.resume:
            spool, records = FrameSpool.resume(folder, owner)
            session = ScanSession(request.job_id, prepared, settings, spool, part)
            session.restore(records)
        else:
            spool = FrameSpool.create(folder, owner)
            session = ScanSession(request.job_id, prepared, settings, spool, part)
    except OSError as error:
        warning = (
            f"scan frames can't be kept in {folder} ({error.strerror or error}); they are in "
            f"memory only and can't be resumed by another process"
        )
        return Begun(ScanSession(request.job_id, prepared, settings, None, part), owner, warning)
    return Begun(session, owner)


def cloud_path(uri: str) -> Path | None:
    """Returns the path that a cloud is written to; None = it is not written.

    Raises:
        RefusedError: It can't be used.
    """
    if not uri:
        return None
    path = Path(uri.removeprefix("file://"))
    if not path.is_absolute() or path.suffix != ".ply" or not path.parent.is_dir():
        raise RefusedError(
            Status.NO_CLOUD,
            f"a cloud in {uri!r} was asked for; the absolute path of a .ply file in an existing "
            f"folder is accepted",
        )
    return path
