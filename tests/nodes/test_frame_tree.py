"""The frame tree of ``tf``: what is new, what only still holds, what comes too late."""

import numpy as np
import pytest
from tf2_msgs.msg import TFMessage

from skinplan.transforms import transform
from skinplan_nodes.conversions import transform_stamped_to_msg
from skinplan_nodes.frame_tree import Frames


def message(child: str, x_m: float, stamp_s: float) -> TFMessage:
    edge = transform_stamped_to_msg("odom", child, transform((x_m, 0.0, 0.0)), stamp_s)
    return TFMessage(transforms=[edge])


def place(frames: Frames) -> float:
    return float(frames.lookup("odom", "base_link")[0, 3])


def test_a_base_that_stands_is_known_anew_and_has_not_moved() -> None:
    frames, told = Frames(), []
    frames.on_base(lambda: told.append(frames.known_s))
    for stamp_s in (1.0, 2.0, 3.0):
        assert frames.take(message("base_link", 0.5, stamp_s)) == []
    assert (frames.known_s, frames.moved_s) == (3.0, 1.0)
    assert told == [1.0, 2.0, 3.0]
    frames.take(message("base_link", 0.6, 4.0))
    assert (frames.known_s, frames.moved_s, place(frames)) == (4.0, 4.0, 0.6)


@pytest.mark.parametrize(
    ("told", "x_m"),
    [
        pytest.param([(0.5, 2.0), (0.1, 1.0)], 0.5, id="an old place that comes late"),
        pytest.param([(0.5, 2.0), (0.1, 1.0), (0.1, 3.0)], 0.1, id="and is told again as new"),
        pytest.param([(0.5, 1.0), (0.5, 3.0), (0.1, 2.0)], 0.5, id="one older than the renewed"),
        pytest.param([(0.5, 1.0), (0.7, 2.0), (0.5, 3.0)], 0.5, id="there and back"),
    ],
)
@pytest.mark.parametrize("names", [("base_link",), ("/base_link", "base_link")])
def test_the_newest_place_counts(
    told: list[tuple[float, float]], x_m: float, names: tuple[str, ...]
) -> None:
    """A slash before the name makes no other frame."""
    frames = Frames()
    for n, (at_m, stamp_s) in enumerate(told):
        frames.take(message(names[n % len(names)], at_m, stamp_s))
    assert place(frames) == x_m


@pytest.mark.parametrize("x_m", [np.nan, np.inf])
def test_what_was_refused_is_refused_again(x_m: float) -> None:
    frames = Frames()
    bad = message("base_link", 0.0, 1.0)
    bad.transforms[0].transform.translation.x = x_m
    for _ in range(2):
        assert len(frames.take(bad)) == 1


def test_another_parent_is_another_edge() -> None:
    frames = Frames()
    frames.take(message("base_link", 0.5, 1.0))
    other = message("base_link", 0.5, 2.0)
    other.transforms[0].header.frame_id = "map"
    frames.take(other)
    assert float(frames.lookup("map", "base_link")[0, 3]) == 0.5
