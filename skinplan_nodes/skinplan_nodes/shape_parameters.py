"""Parameters of ``part_recognizer`` for its action ``locate_part_by_shape``."""

from types import SimpleNamespace

from skinplan.recognition.shape_fit import ShapeSettings
from skinplan.recognition.shape_gate import GateSettings
from skinplan.recognition.view import ViewSettings
from skinplan_nodes.parameters import Parameter

_SHAPE, _GATE = ShapeSettings(), GateSettings()
#: Of the action.
SHAPE_PARAMETERS = (
    Parameter(
        "reach_m",
        _SHAPE.reach_m,
        "By shape: the part stands within this of its nominal place, or of where it was located "
        "last, the base's own error included [m].",
        0.0,
        0.5,
    ),
    Parameter("reach_rad", _SHAPE.reach_rad, "... and is turned by no more [rad].", 0.0, 0.2),
    Parameter(
        "patch_error_m",
        _SHAPE.patch_error_m,
        "By shape: standard deviation of the mean depth of a patch of 40 mm, however many images "
        "are taken [m].",
        0.0,
        0.1,
    ),
    Parameter(
        "position_max_m",
        _GATE.position_max_m,
        "By shape: largest error of the part's place that is accepted [m] ...",
        1e-5,
        0.1,
    ),
    Parameter("angle_max_rad", _GATE.angle_max_rad, "... and of its turn [rad].", 1e-6, 0.1),
    Parameter("sigmas", _GATE.sigmas, "So many standard deviations are the error [1].", 1.0, 10.0),
    Parameter("max_attempts", 4, "By shape: estimates at most [1].", 1, 100),
    Parameter("settle_s", 0.5, "Rest of the base before an image counts [s].", 0.0, 60.0),
    Parameter("drive_timeout_s", 300.0, "Longest drive on wall time [s].", 1.0, 3600.0),
    Parameter("tf_rate_hz", 2.0, "Rate of map to workpiece on tf [Hz].", 0.1, 50.0),
)


def view_settings(values: SimpleNamespace) -> ViewSettings:
    """The shares of a scan are judged by other bounds than those of a view."""
    return ViewSettings(
        noise_at_1m_m=values.noise_at_1m_m,
        tolerance_m=values.tolerance_m,
        seen_ratio_min=values.seen_ratio_min,
    )
