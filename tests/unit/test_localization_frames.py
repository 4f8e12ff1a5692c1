"""Lookups against products of the transforms that were set."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skinplan.errors import FrameMissingError, InputError
from skinplan.localization.frames import TransformTree
from skinplan.transforms import inverse, transform


def some(seed):
    random = np.random.default_rng(seed)
    return transform(random.normal(size=3), Rotation.random(rng=random).as_matrix())


def filled():
    tree = TransformTree()
    tree.set("map", "base", some(1), 1.0)
    tree.set("base", "arm", some(2), 1.0)
    tree.set("base", "camera", some(3), 1.0)
    tree.set("map", "tracker", some(4), 1.0)
    return tree


def test_lookup_along_across_and_back():
    tree = filled()
    np.testing.assert_allclose(tree.lookup("map", "arm"), some(1) @ some(2), atol=1e-12)
    np.testing.assert_allclose(tree.lookup("arm", "camera"), inverse(some(2)) @ some(3), atol=1e-12)
    expected = inverse(some(4)) @ some(1) @ some(3)
    np.testing.assert_allclose(tree.lookup("tracker", "camera"), expected, atol=1e-12)
    np.testing.assert_allclose(tree.lookup("arm", "arm"), np.eye(4), atol=1e-12)


def test_the_newest_counts():
    tree = filled()
    tree.set("map", "base", some(9), 0.5)
    np.testing.assert_array_equal(tree.lookup("map", "base"), some(1))
    tree.set("map", "base", some(9), 2.0)
    np.testing.assert_array_equal(tree.lookup("map", "base"), some(9))
    assert tree.stamp("base") == 2.0


def test_unknown_frame_is_named_with_those_known():
    with pytest.raises(FrameMissingError, match="'nowhere'.*arm, base, camera, map, tracker"):
        filled().lookup("map", "nowhere")
    with pytest.raises(FrameMissingError, match="none"):
        TransformTree().lookup("map", "base")
    with pytest.raises(FrameMissingError, match="known are"):
        filled().stamp("map")


def test_two_trees_do_not_connect():
    tree = filled()
    tree.set("world", "robot", np.eye(4), 0.0)
    with pytest.raises(FrameMissingError, match="connects"):
        tree.lookup("map", "robot")


@pytest.mark.parametrize(
    ("parent", "child", "pose"),
    [
        ("arm", "map", np.eye(4)),
        ("map", "map", np.eye(4)),
        ("", "base", np.eye(4)),
        ("map", "x", np.full((4, 4), np.nan)),
        ("map", "x", 2.0 * np.eye(4)),
    ],
)
def test_what_is_no_tree_or_transform_is_refused(parent, child, pose):
    tree = filled()
    with pytest.raises(InputError):
        tree.set(parent, child, pose, 5.0)
    assert tree.frames == ("arm", "base", "camera", "map", "tracker")


def test_a_renewed_transform_stays_and_is_as_old_as_its_newest_time() -> None:
    tree = TransformTree()
    tree.set("a", "b", transform((1.0, 0.0, 0.0)), 1.0)
    tree.renew("b", 3.0)
    assert tree.stamp("b") == 3.0
    tree.renew("b", 2.0)
    assert tree.stamp("b") == 3.0
    tree.set("a", "b", transform((9.0, 0.0, 0.0)), 2.0)
    assert tree.lookup("a", "b")[0, 3] == 1.0
