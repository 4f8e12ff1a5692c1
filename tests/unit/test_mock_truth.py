"""The true places: bounded, standing on the floor, repeated with the seed."""

from pathlib import Path

import numpy as np
import pytest

from localization_scene import CELL, T_MAP_WORKPIECE, row_fixture
from skinplan.errors import InputError
from skinplan.mock.truth import PLACE_ERROR_M, PLACE_ERROR_RAD, Truth
from skinplan.part.model import Part
from skinplan.transforms import difference, inverse, planar


def part(place=T_MAP_WORKPIECE):
    return Part("panel", Path("panel.stl"), "m", "0" * 64, row_fixture(), place)


def test_the_part_is_moved_along_the_floor_within_bounds():
    errors = []
    for seed in range(200):
        place = Truth(part(), CELL, seed).T_map_workpiece
        errors.append(difference(T_MAP_WORKPIECE, place))
        assert place[2, 3] == T_MAP_WORKPIECE[2, 3]
        np.testing.assert_allclose(place[:3, 1], [0.0, 0.0, 1.0], atol=1e-12)
    errors = np.array(errors)
    assert errors[:, 0].max() <= PLACE_ERROR_M
    assert errors[:, 1].max() <= PLACE_ERROR_RAD + 1e-9
    assert errors[:, 0].max() > 0.9 * PLACE_ERROR_M
    assert errors[:, 1].max() > 0.9 * PLACE_ERROR_RAD


def test_seeds_repeat_and_differ():
    np.testing.assert_array_equal(
        Truth(part(), CELL, 5).T_map_workpiece, Truth(part(), CELL, 5).T_map_workpiece
    )
    assert not np.allclose(
        Truth(part(), CELL, 5).T_map_workpiece, Truth(part(), CELL, 6).T_map_workpiece
    )


def test_the_error_does_not_depend_on_where_the_map_begins():
    shift = planar(2.0, -1.0, 0.0)
    moved = Truth(part(shift @ T_MAP_WORKPIECE), CELL, 5).T_map_workpiece
    np.testing.assert_allclose(
        inverse(shift) @ moved, Truth(part(), CELL, 5).T_map_workpiece, atol=1e-12
    )


def test_the_base_starts_on_the_floor_away_from_the_work_position():
    start = Truth(part(), CELL, 1).T_map_base_start
    assert start[2, 3] == 0.0
    assert 1.0 < difference(start, CELL.T_map_work)[0] < 3.0


def test_a_part_without_a_place_is_refused():
    with pytest.raises(InputError, match="finite"):
        Truth(part(np.full((4, 4), np.nan)), CELL, 1)
