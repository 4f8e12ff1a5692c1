import dataclasses

import numpy as np
import pytest

from skinplan.errors import InputError
from skinplan.part.model import ScanSettings
from skinplan.scanner.model import ScannerModel

SCANNER = ScannerModel(0.2, 0.2, 0.4, 0.3, np.radians(60))


def test_the_settings_of_a_part_make_a_scanner():
    settings = ScanSettings(field_radius_m=0.1, field_of_view="cone", incidence_max_rad=0.9)
    scanner = ScannerModel.from_settings(settings)
    assert scanner == ScannerModel(0.1, 0.2, 0.4, 0.3, 0.9, "cone")
    assert ScannerModel.from_settings(ScanSettings()).field == "cylinder"


def test_the_cone_is_as_wide_as_the_cylinder_at_the_least_range():
    cone = dataclasses.replace(SCANNER, field="cone")
    depths = np.array([0.2, 0.3, 0.4])
    np.testing.assert_allclose(cone.field_radius(depths), [0.2, 0.3, 0.4])
    np.testing.assert_allclose(SCANNER.field_radius(depths), 0.2)


def test_a_scanner_narrowed_by_margins_is_inside_the_other():
    narrow = SCANNER.narrowed(0.005, 0.05)
    assert dataclasses.astuple(narrow)[:5] == pytest.approx(
        (0.195, 0.205, 0.395, 0.3, np.radians(60) - 0.05)
    )
    assert SCANNER.narrowed(0.0, 0.0) == SCANNER


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"field": "sphere"}, "cylinder or cone"),
        ({"field_radius_m": 0.0}, "radius"),
        ({"field_radius_m": -0.2}, "radius"),
        ({"field_radius_m": np.nan}, "radius"),
        ({"range_min_m": 0.4, "range_max_m": 0.2}, "d_min < d_max"),
        ({"range_min_m": 0.0}, "d_min"),
        ({"range_max_m": np.inf}, "d_max"),
        ({"range_max_m": np.nan}, "d_max"),
        ({"standoff_m": -0.3}, "stand-off"),
        ({"standoff_m": np.nan}, "stand-off"),
        ({"incidence_max_rad": 0.0}, "incidence"),
        ({"incidence_max_rad": 60.0}, "incidence"),
        ({"incidence_max_rad": np.nan}, "incidence"),
    ],
)
def test_a_scanner_that_can_not_be(changes, words):
    with pytest.raises(InputError, match=words):
        dataclasses.replace(SCANNER, **changes)
