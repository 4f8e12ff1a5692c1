"""Which points of a frame can be used, on planes whose distance and tilt are known."""

import numpy as np
import pytest

from skinplan.errors import InputError
from skinplan.inspection.frame_check import FrameCheck, incidence_of
from skinplan.scanner.model import ScannerModel
from skinplan.transforms import Array, apply, transform

SCANNER = ScannerModel(0.1, 0.2, 0.4, 0.3, np.deg2rad(60.0))
TURN = [[0, 0, 1], [1, 0, 0], [0, 1, 0]]
T_TRACKER_SCANNER = transform((1.0, -2.0, 0.5), TURN)


def plane(depth_m: float, tilt_deg: float, side_m: float = 0.04) -> Array:
    """A square whose normal stands at an angle to the view axis, in the tracker frame."""
    u, v = (axis.ravel() for axis in np.meshgrid(*2 * [np.linspace(-side_m, side_m, 15)]))
    tilt = np.deg2rad(tilt_deg)
    local = np.column_stack([depth_m + u * np.sin(tilt), u * np.cos(tilt), v])
    return np.asarray(apply(T_TRACKER_SCANNER, local))


@pytest.mark.parametrize("depth_m", [0.1, 0.19, 0.21, 0.3, 0.39, 0.41, 2.0, -0.3])
def test_range_is_along_the_view_axis(depth_m: float) -> None:
    usable = FrameCheck(SCANNER).usable(plane(depth_m, 0.0), T_TRACKER_SCANNER)
    assert np.all(usable == (0.2 <= depth_m <= 0.4))


@pytest.mark.parametrize("tilt_deg", [0.0, 30.0, 55.0, 65.0, 80.0])
def test_incidence_is_found_from_the_points(tilt_deg: float) -> None:
    points = plane(0.3, tilt_deg)
    assert np.all(FrameCheck(SCANNER).usable(points, T_TRACKER_SCANNER) == (tilt_deg <= 60.0))
    local = apply(np.linalg.inv(T_TRACKER_SCANNER), points)
    assert incidence_of(local) == pytest.approx(np.deg2rad(tilt_deg), abs=1e-6)


def test_incidence_that_the_scanner_tells_counts() -> None:
    points = plane(0.3, 0.0)
    told = np.where(np.arange(len(points)) < 10, np.deg2rad(70.0), 0.1)
    usable = FrameCheck(SCANNER).usable(points, T_TRACKER_SCANNER, told)
    assert np.array_equal(usable, np.arange(len(points)) >= 10)
    # Not told for some: those are found from the points.
    told[:10] = np.nan
    assert FrameCheck(SCANNER).usable(points, T_TRACKER_SCANNER, told).all()


def test_a_partly_oblique_frame_keeps_the_rest() -> None:
    points = np.vstack([plane(0.25, 0.0, 0.03), plane(0.5, 0.0, 0.03)])
    usable = FrameCheck(SCANNER).usable(points, T_TRACKER_SCANNER)
    assert np.array_equal(usable, np.arange(len(points)) < len(points) // 2)


@pytest.mark.parametrize("count", [0, 1, 2])
def test_few_points_are_judged_by_range_alone(count: int) -> None:
    points = plane(0.3, 85.0)[:count]
    assert FrameCheck(SCANNER).usable(points, T_TRACKER_SCANNER).tolist() == [True] * count


def test_other_numbers_of_incidences_are_refused() -> None:
    with pytest.raises(InputError, match="225 angles"):
        FrameCheck(SCANNER).usable(plane(0.3, 0.0), T_TRACKER_SCANNER, np.zeros(3))
