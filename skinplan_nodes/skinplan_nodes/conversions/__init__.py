"""All translations between messages and the library's types.

Pure pairs ``x_to_msg`` / ``x_from_msg``; nothing else takes a message apart. Frames, finiteness and
the names of joints are checked here.

A module is loaded when the first of its names is used: who converts poses needs no planner in
memory.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from skinplan_nodes.conversions.cloud import (
        ScanFrame,
        scan_frame_from_msg,
        scan_frame_to_msg,
    )
    from skinplan_nodes.conversions.geometry import (
        duration_from_msg,
        duration_to_msg,
        header_to_msg,
        point_to_msg,
        pose_from_msg,
        pose_stamped_from_msg,
        pose_stamped_to_msg,
        pose_to_msg,
        raw_stamp_s,
        require_frame,
        stamp_from_msg,
        stamp_to_msg,
        transform_from_msg,
        transform_stamped_from_msg,
        transform_stamped_to_msg,
        transform_to_msg,
        vector_to_msg,
        xyz_from_msg,
    )
    from skinplan_nodes.conversions.inspection import (
        CoverageProgress,
        coverage_progress_from_msg,
        coverage_progress_to_msg,
        inspection_from_msg,
        inspection_to_msg,
    )
    from skinplan_nodes.conversions.jobs import (
        history_entry_to_msg,
        job_from_msg,
        job_status_from_msg,
        job_status_to_msg,
        job_to_msg,
        key_values_from_msg,
        key_values_to_msg,
    )
    from skinplan_nodes.conversions.joints import (
        joint_state_from_msg,
        joint_state_to_msg,
        joint_tolerances_from_msg,
        joint_trajectory_from_msg,
        joint_trajectory_to_msg,
        start_from_msg,
    )
    from skinplan_nodes.conversions.localization import (
        LocatedPart,
        camera_info_from_msg,
        camera_info_to_msg,
        compressed_image_from_msg,
        image_from_msg,
        image_to_msg,
        observations_from_msg,
        observations_to_msg,
        part_pose_from_msg,
        part_pose_to_msg,
    )
    from skinplan_nodes.conversions.path import (
        PathFacts,
        coverage_figures_from_msg,
        coverage_figures_to_msg,
        finding_from_msg,
        finding_to_msg,
        path_facts_from_msg,
        require_points,
        scan_path_from_msg,
        scan_path_to_msg,
    )
    from skinplan_nodes.conversions.plans import (
        PlanTimes,
        segment_from_msg,
        segment_to_msg,
        skipped_from_msg,
        skipped_to_msg,
        station_from_msg,
        station_plan_from_msg,
        station_plan_to_msg,
        station_to_msg,
        station_trajectory_from_msg,
        station_trajectory_to_msg,
        trajectory_plan_from_msg,
        trajectory_plan_to_msg,
    )

_MODULES = {
    "cloud": (
        "ScanFrame",
        "scan_frame_from_msg",
        "scan_frame_to_msg",
    ),
    "geometry": (
        "duration_from_msg",
        "duration_to_msg",
        "header_to_msg",
        "point_to_msg",
        "pose_from_msg",
        "pose_stamped_from_msg",
        "pose_stamped_to_msg",
        "pose_to_msg",
        "raw_stamp_s",
        "require_frame",
        "stamp_from_msg",
        "stamp_to_msg",
        "transform_from_msg",
        "transform_stamped_from_msg",
        "transform_stamped_to_msg",
        "transform_to_msg",
        "vector_to_msg",
        "xyz_from_msg",
    ),
    "inspection": (
        "CoverageProgress",
        "coverage_progress_from_msg",
        "coverage_progress_to_msg",
        "inspection_from_msg",
        "inspection_to_msg",
    ),
    "jobs": (
        "history_entry_to_msg",
        "job_from_msg",
        "job_status_from_msg",
        "job_status_to_msg",
        "job_to_msg",
        "key_values_from_msg",
        "key_values_to_msg",
    ),
    "joints": (
        "joint_state_from_msg",
        "joint_state_to_msg",
        "joint_tolerances_from_msg",
        "joint_trajectory_from_msg",
        "joint_trajectory_to_msg",
        "start_from_msg",
    ),
    "localization": (
        "LocatedPart",
        "camera_info_from_msg",
        "camera_info_to_msg",
        "compressed_image_from_msg",
        "image_from_msg",
        "image_to_msg",
        "observations_from_msg",
        "observations_to_msg",
        "part_pose_from_msg",
        "part_pose_to_msg",
    ),
    "path": (
        "PathFacts",
        "coverage_figures_from_msg",
        "coverage_figures_to_msg",
        "finding_from_msg",
        "finding_to_msg",
        "path_facts_from_msg",
        "require_points",
        "scan_path_from_msg",
        "scan_path_to_msg",
    ),
    "plans": (
        "PlanTimes",
        "segment_from_msg",
        "segment_to_msg",
        "skipped_from_msg",
        "skipped_to_msg",
        "station_from_msg",
        "station_plan_from_msg",
        "station_plan_to_msg",
        "station_to_msg",
        "station_trajectory_from_msg",
        "station_trajectory_to_msg",
        "trajectory_plan_from_msg",
        "trajectory_plan_to_msg",
    ),
}
_HOME = {name: module for module, names in _MODULES.items() for name in names}

__all__ = [
    "CoverageProgress",
    "LocatedPart",
    "PathFacts",
    "PlanTimes",
    "ScanFrame",
    "camera_info_from_msg",
    "camera_info_to_msg",
    "compressed_image_from_msg",
    "coverage_figures_from_msg",
    "coverage_figures_to_msg",
    "coverage_progress_from_msg",
    "coverage_progress_to_msg",
    "duration_from_msg",
    "duration_to_msg",
    "finding_from_msg",
    "finding_to_msg",
    "header_to_msg",
    "image_from_msg",
    "image_to_msg",
    "inspection_from_msg",
    "inspection_to_msg",
    "history_entry_to_msg",
    "job_from_msg",
    "job_status_from_msg",
    "job_status_to_msg",
    "job_to_msg",
    "joint_state_from_msg",
    "joint_state_to_msg",
    "joint_tolerances_from_msg",
    "joint_trajectory_from_msg",
    "joint_trajectory_to_msg",
    "key_values_from_msg",
    "key_values_to_msg",
    "observations_from_msg",
    "observations_to_msg",
    "part_pose_from_msg",
    "part_pose_to_msg",
    "path_facts_from_msg",
    "point_to_msg",
    "pose_from_msg",
    "pose_stamped_from_msg",
    "pose_stamped_to_msg",
    "pose_to_msg",
    "raw_stamp_s",
    "require_frame",
    "require_points",
    "scan_frame_from_msg",
    "scan_frame_to_msg",
    "scan_path_from_msg",
    "scan_path_to_msg",
    "segment_from_msg",
    "segment_to_msg",
    "skipped_from_msg",
    "skipped_to_msg",
    "stamp_from_msg",
    "stamp_to_msg",
    "start_from_msg",
    "station_from_msg",
    "station_plan_from_msg",
    "station_plan_to_msg",
    "station_to_msg",
    "station_trajectory_from_msg",
    "station_trajectory_to_msg",
    "trajectory_plan_from_msg",
    "trajectory_plan_to_msg",
    "transform_from_msg",
    "transform_stamped_from_msg",
    "transform_stamped_to_msg",
    "transform_to_msg",
    "vector_to_msg",
    "xyz_from_msg",
]


def __getattr__(name: str) -> Any:
    """Loads the module of a name and hands the name out."""
    home = _HOME.get(name)
    if home is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found = getattr(import_module(f"{__name__}.{home}"), name)
    # Asked once only.
    globals()[name] = found
    return found
