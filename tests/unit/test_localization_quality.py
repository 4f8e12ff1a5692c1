"""Eq (3) against its closed forms."""

from dataclasses import replace

import numpy as np
import pytest

from skinplan.errors import InputError
from skinplan.localization.quality import angle_and_distance, marker_quality
from skinplan.robot.cell import QualitySettings
from skinplan.transforms import planar, transform

SETTINGS = QualitySettings(alpha=0.3, distance_min_m=0.5, distance_max_m=2.5)


def test_one_exactly_when_frontal_at_d_min():
    assert marker_quality(np.pi / 2, 0.5, SETTINGS) == 1.0
    assert marker_quality(np.pi / 2 - 0.01, 0.5, SETTINGS) < 1.0
    assert marker_quality(np.pi / 2, 0.51, SETTINGS) < 1.0


@pytest.mark.parametrize(
    ("angle", "distance", "expected"),
    [(np.pi / 6, 1.5, 0.3 * 0.5 + 0.7 * 0.5), (np.pi / 2, 2.5, 0.3), (0.0, 0.5, 0.7)],
)
def test_values(angle, distance, expected):
    assert marker_quality(angle, distance, SETTINGS) == pytest.approx(expected, abs=1e-12)


def test_beyond_the_range_it_stays_in_bounds():
    assert marker_quality(np.pi / 2, 50.0, SETTINGS) == pytest.approx(0.3)
    assert marker_quality(np.pi / 2, 0.1, SETTINGS) == 1.0


@pytest.mark.parametrize(
    ("angle", "distance"), [(np.nan, 1.0), (1.0, np.nan), (-0.1, 1.0), (1.6, 1.0), (1.0, np.inf)]
)
def test_impossible_views_are_refused(angle, distance):
    with pytest.raises(InputError, match="theta"):
        marker_quality(angle, distance, SETTINGS)


@pytest.mark.parametrize("change", [{"alpha": 1.5}, {"distance_max_m": 0.4}, {"distance_min_m": 0}])
def test_impossible_settings_are_refused(change):
    with pytest.raises(InputError, match="d_min"):
        marker_quality(1.0, 1.0, replace(SETTINGS, **change))


def test_distance_is_to_the_plane_not_to_the_marker():
    """Turning the camera on the spot changes theta, not d; a marker aside has the same d."""
    facing = transform((0.4, 0.2, 1.3), [[1, 0, 0], [0, -1, 0], [0, 0, -1]])
    angle, distance = angle_and_distance(facing)
    assert angle == pytest.approx(np.pi / 2)
    assert distance == pytest.approx(1.3)
    about_y = planar(0, 0, 0.4)[[1, 2, 0, 3]][:, [1, 2, 0, 3]]
    angle, distance = angle_and_distance(about_y @ facing)
    assert angle == pytest.approx(np.pi / 2 - 0.4)
    assert distance == pytest.approx(1.3)
