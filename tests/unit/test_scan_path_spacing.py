import numpy as np
import pytest

from skinplan.errors import InputError
from skinplan.scan_path.spacing import equivalent_spacing

UP = np.array([0.0, 0.0, 1.0])


def leaning(degrees):
    angle = np.radians(degrees)
    return np.stack([np.sin(angle), np.zeros_like(angle), np.cos(angle)], axis=-1)


@pytest.mark.parametrize("k", [1, 2, 3, 6])
def test_over_the_angle(k):
    """Fig. 9: falls from d_interval to 0 at a right angle, faster for larger k."""
    degrees = np.array([0.0, 30.0, 45.0, 60.0, 90.0, 120.0, 180.0])
    found = equivalent_spacing(UP, leaning(degrees), 0.08, k)
    wanted = 0.08 * np.array([1.0, np.sqrt(3) / 2, np.sqrt(0.5), 0.5, 0.0, 0.0, 0.0]) ** k
    np.testing.assert_allclose(found, wanted, atol=1e-12)
    np.testing.assert_allclose(equivalent_spacing(leaning(degrees), UP, 0.08, k), found)


@pytest.mark.parametrize("k", [1, 2, 3, 6])
def test_steepness_over_the_angle(k):
    """Fig. 9 between its points: the slope is -k d_interval cos^(k-1) sin, largest at 1/sqrt(k)."""
    angle = np.radians(np.linspace(0.5, 89.5, 179))
    step = 1e-6
    ahead, behind = (np.degrees(angle + side * step) for side in (1, -1))
    rise = equivalent_spacing(UP, leaning(ahead), 0.08, k)
    rise = rise - equivalent_spacing(UP, leaning(behind), 0.08, k)
    wanted = -k * 0.08 * np.cos(angle) ** (k - 1) * np.sin(angle)
    np.testing.assert_allclose(rise / (2 * step), wanted, atol=1e-8)
    steepest = np.degrees(angle[np.argmin(wanted)])
    assert steepest == pytest.approx(np.degrees(np.arctan(1 / np.sqrt(k - 1 + 1e-12))), abs=0.6)


def test_without_sensitivity_only_the_side_counts():
    found = equivalent_spacing(UP, leaning(np.array([0.0, 89.0, 91.0])), 0.08, 0.0)
    np.testing.assert_allclose(found, [0.08, 0.08, 0.0])


@pytest.mark.parametrize(
    ("normals", "interval", "k"),
    [
        (UP, 0.0, 2),
        (UP, -0.1, 2),
        (UP, np.nan, 2),
        (UP, 0.1, -1),
        (UP, 0.1, np.inf),
        (UP[:2], 0.1, 2),
    ],
)
def test_what_can_not_be_used(normals, interval, k):
    with pytest.raises(InputError, match="accepted"):
        equivalent_spacing(normals, UP, interval, k)
