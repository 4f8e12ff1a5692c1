import numpy as np
import pytest

from meshes import grid, joined, moved
from skinplan.scan_path.clearance import Clearance, repair_by_tilt, tilt_toward
from skinplan.transforms import transform

UP = np.array([[0.0, 0.0, 1.0]])


def leaning(degrees):
    angle = np.radians(degrees)
    return np.array([[np.sin(angle), 0.0, np.cos(angle)]])


def test_tilt_stops_at_the_base():
    for asked, left in ((0.0, 40.0), (15.0, 25.0), (90.0, 0.0)):
        tilted = tilt_toward(leaning(40.0), UP, np.radians(asked))
        np.testing.assert_allclose(tilted, leaning(left), atol=1e-12)
    np.testing.assert_allclose(tilt_toward(UP, UP, 0.3), UP)


@pytest.mark.parametrize(("lean", "clearance", "left"), [(60, 0.15, 60), (70, 0.15, 60)])
def test_as_little_tilt_as_helps(lean, clearance, left):
    """Over a plane the scanner is standoff * cos(lean) high."""
    plane = Clearance(grid(2.0, 2.0, 0.02))
    target = np.zeros((1, 3))
    found = repair_by_tilt(plane, target, leaning(lean), UP, 0.3, clearance, np.radians(15.0))
    assert found.usable.all()
    assert found.tilted == (lean != left)
    np.testing.assert_allclose(found.normals, leaning(left), atol=1e-9)


def test_what_no_tilt_helps_is_marked():
    plane = Clearance(grid(2.0, 2.0, 0.02))
    found = repair_by_tilt(plane, np.zeros((1, 3)), leaning(85), UP, 0.3, 0.15, np.radians(15.0))
    assert not found.usable.any()
    np.testing.assert_array_equal(found.normals, leaning(85))


def test_a_hidden_target_is_not_usable():
    roof = moved(grid(0.3, 0.3, 0.02), transform((0.0, 0.0, 0.14)))
    clearance = Clearance(joined(grid(2.0, 2.0, 0.02), roof))
    targets = np.array([[0.0, 0.0, 0.0], [0.6, 0.0, 0.0]])
    usable = clearance.usable(targets, np.repeat(UP, 2, axis=0), 0.3, 0.1)
    np.testing.assert_array_equal(usable, [False, True])


def test_distance():
    clearance = Clearance(grid(1.0, 1.0, 0.1))
    found = clearance.distance(np.array([[0.03, 0.02, 0.15], [0.0, 0.0, -0.2], [0.7, 0.0, 0.0]]))
    np.testing.assert_allclose(found, [0.15, 0.2, 0.2], atol=5e-4)
