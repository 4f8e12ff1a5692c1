"""Measured results."""

from dataclasses import dataclass

import numpy as np
from skinplan_msgs import msg as messages

from skinplan.inspection.model import Alignment, Inspection
from skinplan_nodes.conversions.geometry import (
    header_to_msg,
    pose_from_msg,
    pose_to_msg,
    require_frame,
)


@dataclass(frozen=True)
class CoverageProgress:
    """What the scan has seen so far.

    Attributes:
        job_id: Job that it belongs to.
        frames: Scan frames received.
        frames_hidden: Frames left out because the tracker did not see the scanner.
        frames_out_of_range: Frames of which points beyond range or incidence limit were left out.
        points: Points kept.
        area_ratio: Share of the part's area seen [1]; NaN while the part is not located.
        feature_area_ratio: Same, complex regions only; NaN without any.
    """

    job_id: str
    frames: int = 0
    frames_hidden: int = 0
    frames_out_of_range: int = 0
    points: int = 0
    area_ratio: float = float("nan")
    feature_area_ratio: float = float("nan")


def coverage_progress_to_msg(
    progress: CoverageProgress, stamp_s: float = 0.0
) -> messages.CoverageState:
    """Converts what the scan has seen so far."""
    return messages.CoverageState(
        header=header_to_msg("workpiece", stamp_s),
        job_id=progress.job_id,
        frames=progress.frames,
        frames_hidden=progress.frames_hidden,
        frames_out_of_range=progress.frames_out_of_range,
        points=progress.points,
        area_ratio=progress.area_ratio,
        feature_area_ratio=progress.feature_area_ratio,
    )


def coverage_progress_from_msg(msg: messages.CoverageState) -> CoverageProgress:
    """Returns what the scan has seen so far.

    Raises:
        InputError: Another frame than workpiece.
    """
    require_frame(msg.header, "workpiece", "coverage")
    return CoverageProgress(
        msg.job_id,
        msg.frames,
        msg.frames_hidden,
        msg.frames_out_of_range,
        msg.points,
        msg.area_ratio,
        msg.feature_area_ratio,
    )


def inspection_to_msg(
    inspection: Inspection, job_id: str, cloud_uri: str = ""
) -> messages.InspectionResult:
    """Converts what was measured; the deviations of the points are in the cloud's file."""
    return messages.InspectionResult(
        job_id=job_id,
        points=inspection.points,
        area_ratio=inspection.area_ratio,
        feature_area_ratio=inspection.feature_area_ratio,
        deviation_rms=inspection.deviation_rms_m,
        alignment_rms=inspection.alignment.rms_m,
        alignment=pose_to_msg(inspection.alignment.T_tracker_workpiece),
        cloud_uri=cloud_uri,
    )


def inspection_from_msg(msg: messages.InspectionResult) -> Inspection:
    """Returns what was measured, without the deviations of the points.

    Raises:
        InputError: The alignment is no pose.
    """
    alignment = Alignment(pose_from_msg(msg.alignment), msg.alignment_rms, 0, True)
    return Inspection(
        alignment,
        msg.points,
        np.zeros(0),
        msg.deviation_rms,
        msg.area_ratio,
        msg.feature_area_ratio,
    )
