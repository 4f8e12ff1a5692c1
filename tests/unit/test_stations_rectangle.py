import numpy as np
import pytest

from skinplan.errors import NoCandidatesError
from skinplan.robot.cell import CellConfig
from skinplan.robot.collision import CollisionWorld
from skinplan.robot.reach import Views, reach
from skinplan.stations.rectangle import BAND_M, longest_rectangle, workspace_rectangle

X = np.arange(-5, 6) * 0.1
Y = np.arange(8) * 0.1


def test_the_longest_of_the_depth_asked_for_is_found():
    mask = np.zeros((11, 8), dtype=bool)
    mask[2:9, 1:4] = True  # |x| <= 0.3, y 0.1..0.3
    mask[1:10, 5:7] = True  # |x| <= 0.4, y 0.5..0.6
    shallow = longest_rectangle(X, Y, mask, 0.1)
    assert np.allclose((shallow.length_m, shallow.depth_m, shallow.offset_m), (0.8, 0.1, 0.55))
    deep = longest_rectangle(X, Y, mask, 0.2)
    assert np.allclose((deep.length_m, deep.depth_m, deep.offset_m), (0.6, 0.2, 0.2))
    with pytest.raises(NoCandidatesError, match="0.3 m"):
        longest_rectangle(X, Y, mask, 0.3)


def test_holes_and_one_sided_reach_do_not_count():
    mask = np.ones((11, 8), dtype=bool)
    mask[5, :4] = False  # not reached in the middle
    mask[8, 4:] = False  # a hole to the right at 0.3
    found = longest_rectangle(X, Y, mask, 0.2)
    assert np.allclose((found.length_m, found.offset_m), (0.4, 0.5))


def test_an_arm_that_reaches_nothing_has_none():
    with pytest.raises(NoCandidatesError):
        longest_rectangle(X, Y, np.zeros((11, 8), dtype=bool), 0.1)


def test_the_derived_rectangle_is_reached_at_places_in_between_too():
    cell = CellConfig()
    found = workspace_rectangle(cell, 0.3)
    assert 1.0 <= found.length_m <= 1.3 and np.isclose(found.depth_m, 0.3)
    world = CollisionWorld(cell, None)
    rng = np.random.default_rng(0)
    half = 0.5 * np.array([found.length_m, found.depth_m, BAND_M])
    middle = np.array([0.0, found.offset_m, world.arm.first_axis[2]])
    places = middle + rng.uniform(-half, half, (200, 3))
    view = np.array([0.0, 1.0, 0.0])
    views = Views(places, np.tile(view, (200, 1)), places + 0.3 * view, view)
    assert len(np.unique(reach(world, views, 0.0, np.array(cell.home_rad)).view)) >= 198


def test_an_impossible_depth_is_refused():
    with pytest.raises(NoCandidatesError, match="2 m"):
        workspace_rectangle(CellConfig(), 2.0)
