"""The timed motion in a viser scene: the scanner's way by time, and a clock that moves the arm."""

import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skinplan.trajectory.model import SCAN
from skinplan.transforms import Array, quaternion
from skinplan.view import palette
from skinplan.view.motion import StationMotion, station_motions
from skinplan.view.scene_arm import ArmView
from skinplan.view.subject import Subject

SCAN_M, TRANSIT_M = 0.008, 0.003
_WAY_STEP_S = 0.1
_CLOCK_STEP_S = 0.05
_TICK_S = 0.05
_FASTER = ("1", "2", "5", "10")
_TRANSIT: palette.Colour = (0.40, 0.42, 0.45)
# The viewer brightens lines: darker ones look on the screen as the legend says.
_LIGHT = 1.8
_BAR_STOPS = 7

Show = Callable[[StationMotion, float], None]


def way_lines(motions: Sequence[StationMotion], kind: int) -> tuple[Array, NDArray[np.uint8]]:
    """Returns the scanner's ways as lines with the colours of their times.

    Args:
        motions: Of the stations.
        kind: SCAN or TRANSIT.

    Returns:
        Ends, shape (m, 2, 3) [m], workpiece frame, and red, green, blue of each, shape (m, 2, 3), 0
        to 255; transits are grey.
    """
    longest = max((motion.duration_s for motion in motions), default=0.0)
    lines, shares = [np.zeros((0, 2, 3))], [np.zeros((0, 2))]
    for motion in motions:
        for segment in np.flatnonzero(motion.kinds == kind):
            times, places = motion.way(int(segment), _WAY_STEP_S)
            lines.append(np.stack([places[:-1], places[1:]], axis=1))
            shares.append(np.stack([times[:-1], times[1:]], axis=1) / max(longest, 1e-9))
    share = np.concatenate(shares)
    colours = palette.time_colours(share.reshape(-1)).reshape(*share.shape, 3)
    if kind != SCAN:
        colours = np.broadcast_to(_TRANSIT, colours.shape)
    return np.concatenate(lines), np.rint(255.0 * colours).astype(np.uint8)


def add_ways(scene: Any, motions: Sequence[StationMotion]) -> dict[str, list[Any]]:
    """Adds the scanner's ways; returns the handles of each layer by its name.

    Args:
        scene: Of a ``viser.ViserServer``; ``/part`` is the workpiece.
        motions: Of the stations.
    """
    layers: dict[str, list[Any]] = {}
    for name, kind, width in (
        ("way while scanning, by time", SCAN, SCAN_M),
        ("way of the transits", 1 - SCAN, TRANSIT_M),
    ):
        lines, colours = way_lines(motions, kind)
        if len(lines):
            node = f"/part/way/{'scan' if kind == SCAN else 'transit'}"
            lit = np.rint(255.0 * (colours / 255.0) ** _LIGHT).astype(np.uint8)
            handle = scene.add_line_segments(node, lines.astype(np.float32), lit, thickness=width)
            layers[name] = [handle]
    return layers


class MotionClock:
    """The controls that move the arm along the motion of the chosen station.

    Attributes:
        slider: The time since the arm has left home [s].
        button: Starts and stops the clock.
        faster: How many times faster the clock runs.
        playing: Whether it runs.
    """

    def __init__(self, gui: Any, motions: Sequence[StationMotion], show: Show) -> None:
        """Adds the controls.

        Args:
            gui: Of a ``viser.ViserServer``.
            motions: Those that last, at least one.
            show: Called with the motion and the time when the arm is to be moved.
        """
        self._motions, self._show = motions, show
        self.motion: StationMotion | None = motions[0]
        self._lock = threading.Lock()
        self._playing = threading.Event()
        with gui.add_folder("Motion"):
            self.slider: Any = gui.add_slider(
                "Time [s]", 0.0, _last(motions[0]), _CLOCK_STEP_S, 0.0
            )
            self.button: Any = gui.add_button("Play")
            self.faster: Any = gui.add_dropdown("Times faster", _FASTER, initial_value="1")
            gui.add_html(time_legend(max(motion.duration_s for motion in motions)))
            self._told: Any = gui.add_markdown("")
        self._quiet = False
        self.slider.on_update(lambda _: self._moved())
        self.button.on_click(lambda _: self.stop() if self.playing else self.play())

    @property
    def playing(self) -> bool:
        """Whether the clock runs."""
        return self._playing.is_set()

    def choose(self, number: int) -> None:
        """Takes the motion of a station, from its start.

        Args:
            number: The station's place in the order of visit.
        """
        found = next((motion for motion in self._motions if motion.number == number), None)
        if found is self.motion:
            return
        self.stop()
        self.motion = found
        self.slider.disabled = self.button.disabled = found is None
        if found is None:
            self._told.content = "no motion at this station"
            return
        self._rewind()
        self.slider.max = _last(found)
        self._told.content = ""

    def play(self) -> None:
        """Starts the clock, at the end from the start again."""
        with self._lock:
            if self.playing or self.motion is None:
                return
            self._playing.set()
        self.button.label = "Stop"
        if self.slider.value >= self.motion.duration_s - _CLOCK_STEP_S:
            self._rewind()
        # A daemon: a page that nobody closes must not keep the process alive.
        threading.Thread(target=self._run, args=(self.motion,), daemon=True).start()

    def stop(self) -> None:
        """Stops the clock where it is; may be called twice."""
        self._playing.clear()
        self.button.label = "Play"

    def _rewind(self) -> None:
        """Sets the time to 0 without moving the arm."""
        self._quiet = True
        self.slider.value = 0.0
        self._quiet = False

    def _run(self, motion: StationMotion) -> None:
        now, before = float(self.slider.value), time.monotonic()
        while self.playing and self.motion is motion and now < motion.duration_s:
            time.sleep(_TICK_S)
            tick = time.monotonic()
            now = min(now + (tick - before) * float(self.faster.value), motion.duration_s)
            before = tick
            if self.playing and self.motion is motion:
                self.slider.value = min(now, float(self.slider.max))
        if self.motion is motion:
            self.stop()

    def _moved(self) -> None:
        motion = self.motion
        if motion is None or self._quiet:
            return
        now = min(float(self.slider.value), motion.duration_s)
        self._show(motion, now)
        doing = "scan" if motion.is_scanning(now) else "transit"
        passed = int(np.count_nonzero(motion.point_s <= now + 1e-9))
        self._told.content = (
            f"Station {motion.name}, {now:.1f} of {motion.duration_s:.1f} s: {doing}, "
            f"{passed} of {len(motion.points)} points passed"
        )


def add_motion(
    scene: Any, gui: Any, subject: Subject, arm: ArmView, field: Any, told: Any
) -> tuple[MotionClock | None, dict[str, list[Any]]]:
    """Adds the ways and the clock that moves arm and field of view.

    Args:
        scene: Of a ``viser.ViserServer``; ``/part`` is the workpiece.
        gui: Of the same.
        subject: Has a station plan.
        arm: The arm.
        field: Frame of the scanner's field of view below ``/part``.
        told: What is told of the arm at a point: not so while it moves.

    Returns:
        The clock, None when nothing moves, and the handles of each layer by its name.
    """
    motions = [motion for motion in station_motions(subject) if motion.duration_s > 0.0]
    if not motions:
        return None, {}

    def show(motion: StationMotion, time_s: float) -> None:
        q = motion.joints(np.array([time_s]))
        arm.move(motion.number, q[0])
        pose = motion.scanner(q)[0]
        # viser turns w, x, y, z; ours is x, y, z, w.
        field.position, field.wxyz = pose[:3, 3], np.roll(quaternion(pose), 1)
        told.content = ""

    return MotionClock(gui, motions, show), add_ways(scene, motions)


def time_legend(longest_s: float) -> str:
    """Returns the bar that says which colour of the way is which time, as HTML."""
    colours = palette.time_colours(np.linspace(0.0, 1.0, _BAR_STOPS))
    stops = ", ".join(
        f"rgb({red}, {green}, {blue})" for red, green, blue in np.rint(255 * colours).astype(int)
    )
    bar = f'<div style="height:.6em;background:linear-gradient(to right, {stops})"></div>'
    ends = (
        '<div style="display:flex;justify-content:space-between"><span>0 s</span>'
        f"<span>way while scanning</span><span>{longest_s:.0f} s</span></div>"
    )
    return f'<div style="margin:0 1em;font-size:.85em">{bar}{ends}</div>'


def _last(motion: StationMotion) -> float:
    """The end of the slider [s]: a whole number of its steps, not before the motion's end."""
    return float(np.ceil(motion.duration_s / _CLOCK_STEP_S - 1e-9) * _CLOCK_STEP_S)
