"""The timed motion in the 3-D view: the coloured way, the clock, and the arm that it moves."""

import functools
import importlib.util
import threading

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import motion_scene as scene
from skinplan.trajectory.model import SCAN, TRANSIT
from skinplan.transforms import transform
from skinplan.view import palette
from skinplan.view.arm_shapes import arm_pose
from skinplan.view.browser import BrowserView
from skinplan.view.motion import station_motions
from skinplan.view.scene_data import SceneData
from skinplan.view.scene_motion import time_legend, way_lines

needs_viser = pytest.mark.skipif(
    importlib.util.find_spec("viser") is None, reason="viser is not installed"
)
WAYS = {"way while scanning, by time", "way of the transits"}


@functools.cache
def subject():
    return scene.subject_of((scene.first_station(), scene.second_station()))


@functools.cache
def motions():
    return station_motions(subject())


def wait_for(condition):
    waited = threading.Event()
    for _ in range(200):
        if condition():
            return
        waited.wait(0.05)
    raise AssertionError("not within 10 s")


def pose_of(handle):
    w, x, y, z = handle.wxyz
    return transform(handle.position, Rotation.from_quat([x, y, z, w]).as_matrix())


def scanner_of(arm):
    return pose_of(arm.base) @ pose_of(arm.joints[-1]) @ pose_of(arm.scanner)


def test_the_way_has_the_colour_of_its_time():
    lines, colours = way_lines(motions(), SCAN)
    assert lines.shape == colours.shape and len(lines) > 50
    first = motions()[0]
    for time in (2.0, 4.0, 11.0):
        place = first.scanner(first.joints(np.array([time])))[0, :3, 3]
        row, end = np.unravel_index(
            np.argmin(np.linalg.norm(lines - place, axis=2)), lines.shape[:2]
        )
        assert lines[row, end] == pytest.approx(place, abs=1e-9)
        wanted = 255.0 * palette.time_colours(np.array([time / 14.0]))[0]
        assert colours[row, end] == pytest.approx(wanted, abs=1.0)


def test_lines_go_on_within_a_segment_and_not_across():
    for kind in (SCAN, TRANSIT):
        lines, colours = way_lines(motions(), kind)
        jumps = np.linalg.norm(lines[1:, 0] - lines[:-1, 1], axis=1) > 1e-9
        assert jumps.sum() == sum((motion.kinds == kind).sum() for motion in motions()) - 1
        assert (len(np.unique(colours.reshape(-1, 3), axis=0)) == 1) == (kind == TRANSIT)
    nothing, colours = way_lines((), SCAN)
    assert nothing.shape == colours.shape == (0, 2, 3)


def test_the_legend_has_the_colours_of_begin_and_end():
    told = time_legend(51.2)
    for share in (0.0, 1.0):
        red, green, blue = np.rint(255 * palette.time_colours(np.array([share]))[0]).astype(int)
        assert f"rgb({red}, {green}, {blue})" in told
    assert ">0 s<" in told and ">51 s<" in told


@needs_viser
def test_the_time_slider_moves_the_arm_along_the_motion():
    with BrowserView(SceneData(subject()), 0) as view:
        shown, clock = view.scene, view.scene.clock
        assert set(shown.layers) >= WAYS
        assert clock.slider.max == 14.0
        for time in (3.0, 7.5, 14.0):
            clock.slider.value = time
            q = motions()[0].joints(np.array([time]))
            wanted = arm_pose(subject(), 0) @ scene.ARM.forward_scanner(q)[0]
            wait_for(lambda q=q: np.allclose(shown.arm.posture.q, q[0]))
            assert scanner_of(shown.arm) == pytest.approx(wanted, abs=1e-5)
            field = pose_of(shown.layers["field of view"][0])
            assert scene.HIGH @ field == pytest.approx(wanted, abs=1e-5)
        assert clock._told.content == ("Station 0, 14.0 of 14.0 s: transit, 9 of 9 points passed")
        clock.slider.value = 3.0
        assert "scan, 2 of 9 points passed" in clock._told.content


@needs_viser
def test_the_chosen_station_has_the_clock():
    with BrowserView(SceneData(subject()), 0) as view:
        shown, clock = view.scene, view.scene.clock
        clock.slider.value = 9.0
        shown.station_slider.value = 1
        wait_for(lambda: clock.motion is not None and clock.motion.number == 1)
        assert clock.slider.value == 0.0 and clock.slider.max == 7.0
        clock.slider.value = 2.0
        q = motions()[1].joints(np.array([2.0]))
        wanted = arm_pose(subject(), 1) @ scene.ARM.forward_scanner(q)[0]
        wait_for(lambda: np.allclose(scanner_of(shown.arm), wanted, atol=1e-5))
        # A point takes the arm off its way; the time does not move it back.
        shown.slider.value = 30
        wait_for(lambda: not np.allclose(shown.arm.posture.q, q[0]))


@needs_viser
def test_playing_moves_the_arm_to_the_end_and_stops():
    with BrowserView(SceneData(subject()), 0) as view:
        shown, clock = view.scene, view.scene.clock
        clock.faster.value = "10"
        seen = []
        clock.slider.on_update(lambda _: seen.append(clock.slider.value))
        clock.play()
        assert clock.playing and clock.button.label == "Stop"
        wait_for(lambda: not clock.playing)
        assert clock.button.label == "Play"
        assert len(seen) > 5 and seen == sorted(seen) and seen[-1] == 14.0
        assert shown.arm.posture.q == pytest.approx(scene.HOME)
        clock.play()  # from the start again
        wait_for(lambda: 0.0 < clock.slider.value < 13.0)
        shown.station_slider.value = 1
        wait_for(lambda: not clock.playing)
        assert clock.motion.number == 1 and clock.slider.value == 0.0


@needs_viser
def test_the_clock_stops_with_the_server():
    before = threading.active_count()
    with BrowserView(SceneData(subject()), 0) as view:
        view.scene.clock.play()
        clock = view.scene.clock
        assert clock.playing
    assert not clock.playing
    wait_for(lambda: threading.active_count() <= before + 1)


@needs_viser
def test_a_station_without_a_motion_has_no_clock():
    half = scene.subject_of((scene.first_station(), ()))
    with BrowserView(SceneData(half), 0) as view:
        clock = view.scene.clock
        view.scene.station_slider.value = 1
        wait_for(lambda: clock.motion is None)
        assert clock.slider.disabled and clock.button.disabled
        clock.play()
        assert not clock.playing
        view.scene.station_slider.value = 0
        wait_for(lambda: clock.motion is not None)
        assert not clock.slider.disabled
    with BrowserView(SceneData(scene.subject_of(((), ()))), 0) as view:
        assert view.scene.clock is None
        assert not WAYS & set(view.scene.layers)
