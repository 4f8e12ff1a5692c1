"""Parameters of the supervisor that say how a job goes on after an interruption."""

from pathlib import Path
from types import SimpleNamespace

from skinplan.robot.calibration import calibration_path
from skinplan_nodes.parameters import Parameter
from skinplan_nodes.supervisor.admission import CalibrationBook
from skinplan_nodes.supervisor.limits import Limits
from skinplan_nodes.supervisor.mission import ResumeSettings
from skinplan_nodes.supervisor.steps import RescanSettings
from skinplan_nodes.supervisor.worker import WorkSettings

RESUMING = (
    Parameter(
        "segment_timeout_s", 3600.0, "Longest motion of the arm, cell time [s].", 1.0, 86400.0
    ),
    Parameter(
        "stop_timeout_s",
        5.0,
        "Arm and base stand still so long after a stop, wall time [s].",
        0.5,
        60.0,
    ),
    Parameter(
        "recovery_timeout_s",
        60.0,
        "Longest wait for a node or a device that recovers by itself, wall time [s].",
        1.0,
        3600.0,
    ),
    Parameter(
        "operator_timeout_s",
        900.0,
        "Longest wait for the command RESUME, wall time [s].",
        1.0,
        604800.0,
    ),
    Parameter(
        "resume_after_fault",
        True,
        "Failures that endanger nobody recover by themselves; false = each waits for RESUME.",
    ),
    Parameter(
        "resume_attempts_max",
        3,
        "So often a job goes on by itself after the same failure at the same node; then it waits "
        "for RESUME [1].",
        0,
        100,
    ),
    Parameter(
        "resume_at_start",
        True,
        "The job of a supervisor process that was killed goes on by itself; false = at RESUME.",
    ),
    Parameter(
        "resume_age_max_s",
        120.0,
        "After a longer time without supervisor it waits for RESUME, wall time [s].",
        0.0,
        86400.0,
    ),
    Parameter(
        "without_recorder",
        "go_on",
        "What a job does whose recorder is lost: go_on, or interrupt until it is back.",
    ),
    Parameter(
        "certify_motion", True, "Certify for the summary what the motion of the arm should see."
    ),
    Parameter("max_rescans", 2, "So often what is missing is scanned again [1].", 0, 20),
    Parameter(
        "rescan_area_ratio",
        0.002,
        "It is when the measured share of the area is so much lower than the certified one [1].",
        0.0,
        1.0,
    ),
)


JOBS = (
    Parameter(
        "operators",
        [""],
        "Names of those who may hand in and command jobs; empty = everybody.",
    ),
    Parameter(
        "calibration_file",
        "",
        "Facts about the cell's calibration; empty = cell.calibration.yaml beside cell.yaml.",
    ),
    Parameter(
        "calibration_required",
        True,
        "Jobs are refused where a calibration is missing; one that is out of date always counts.",
    ),
    Parameter("queue_max", 200, "So many jobs may wait [1].", 1, 100000),
    Parameter("jobs_kept", 10000, "So many jobs that are over are kept [1].", 1, 1000000),
    Parameter("days_kept", 365.0, "Jobs that are over are kept so long [d].", 0.01, 36500.0),
)


def calibration_book(values: SimpleNamespace) -> CalibrationBook:
    """Returns the facts about the cell's calibration, from the supervisor's parameters."""
    path = calibration_path(values.cell_file)
    if values.calibration_file:
        path = Path(values.calibration_file).absolute()
    return CalibrationBook(path)


def work_settings(values: SimpleNamespace) -> WorkSettings:
    """Returns how jobs are worked off, from the supervisor's parameters."""
    return WorkSettings(
        Limits.of(values),
        ResumeSettings(
            values.resume_after_fault, values.resume_attempts_max, values.resume_at_start
        ),
        RescanSettings(values.max_rescans, values.rescan_area_ratio),
        needs_recorder=values.without_recorder == "interrupt",
        resume_age_max_s=values.resume_age_max_s,
        with_report=values.report,
        with_certificate=values.certify_motion,
    )
