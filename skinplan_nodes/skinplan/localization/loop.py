"""The approach-retry loop of M1.2: look, judge, drive nearer, until the pose is good enough.

Every drive follows a pose from an image that was taken where the base stands now, so the base never
drives blind; every turn of the loop uses up one attempt, so it ends.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skinplan.errors import (
    AmbiguousPoseError,
    BaseBlockedError,
    FrameMissingError,
    LocalizationCancelledError,
    NoMarkerError,
    PartMovedError,
    QualityNotReachedError,
    SafeDistanceError,
    SkinplanError,
    StaleImageError,
)
from skinplan.localization.approach import Approach, next_goal, stop_miss_m
from skinplan.localization.drive_watch import DriveWatch
from skinplan.localization.fuse import fuse, require_same_view
from skinplan.localization.loop_cell import Cell, Estimate, View
from skinplan.localization.model import Sighting, WorkpiecePose
from skinplan.localization.pose import locate
from skinplan.localization.tracking import MarkerTracker
from skinplan.part.model import Fixture
from skinplan.robot.cell import CellConfig
from skinplan.transforms import Array, difference, inverse

# A camera with noise never gives the same image twice; so many repetitions are no chance.
_REPEATS = 2
# A drive that moves the camera by less than this share of its way has not taken place ...
_DRIVEN_SHARE = 0.25
# ... and so many of them in a row are no slip of the wheels.
_STALLS = 2
# Drives below twice the stopping error can't be told from standing still.
_TELLING = 2.0


@dataclass(frozen=True)
class ApproachSettings:
    """When the loop ends.

    Attributes:
        threshold: T_E of eq (3) [1].
        max_attempts: Estimates at most.
        max_misses: Estimates in a row without a pose, at most.
        may_move: Whether the base may be moved.
        images: Images per estimate; one that shows nothing ends it early.
    """

    threshold: float
    max_attempts: int
    max_misses: int
    may_move: bool
    images: int = 1


class ApproachLoop:
    """One localisation.

    Args:
        cell: The cell.
        config: Its figures.
        fixture: The markers to look for.
        settings: When to end.
        is_cancelled: Asked often.
        last_image: The newest image that an earlier localisation looked at; None = there was none.

    Attributes:
        attempts: Estimates made.
        best_quality: Largest E so far.
        last_image: The newest image that was looked at.
    """

    def __init__(
        self,
        cell: Cell,
        config: CellConfig,
        fixture: Fixture,
        settings: ApproachSettings,
        is_cancelled: Callable[[], bool],
        last_image: NDArray[np.uint8] | None = None,
    ) -> None:
        self._cell = cell
        self._config = config
        self._fixture = fixture
        self._settings = settings
        self._is_cancelled = is_cancelled
        self._tracker = MarkerTracker(fixture, config.quality, config.camera.corners)
        self._moved = False
        self._after_s = 0.0
        self.last_image = last_image
        self._repeats = 0
        # The camera before the last drive, in the workpiece; how far that drive was to bring it,
        # and how far at most if the wheels slip on a part.
        self._before: tuple[Array, float, float] | None = None
        self._stops: list[Array] = []
        self._stalls = 0
        self.attempts = 0
        self.best_quality = 0.0

    def run(self) -> Estimate:
        """Runs the loop.

        On final failure the base is brought back to where it started; after a cancel it stays.

        Returns:
            The estimate that was good enough.

        Raises:
            SkinplanError: Why there is none.
        """
        start = self._cell.lookup("map", "base_link") if self._settings.may_move else None
        try:
            return self._approach()
        except LocalizationCancelledError:
            raise
        except SkinplanError as error:
            if start is None or not self._moved:
                raise
            raise self._returned(start, error) from error

    def _approach(self) -> Estimate:
        phase, misses = "detecting", 0
        while True:
            if self._is_cancelled():
                raise cancelled()
            self.attempts += 1
            view, pose, missed = self._estimate()
            estimate = Estimate(phase, self.attempts, pose, view.stamp_s, view.frame)
            self._cell.told(estimate)
            last = self.attempts >= self._settings.max_attempts
            if pose is None:
                assert missed is not None
                misses += 1
                if last or misses >= self._settings.max_misses:
                    raise missed
                continue
            misses = 0
            self._check_drive(pose)
            self.best_quality = max(self.best_quality, pose.quality)
            if pose.quality >= self._settings.threshold:
                return estimate
            phase = self._move_on(view, pose, last)

    def _estimate(self) -> tuple[View, WorkpiecePose | None, SkinplanError | None]:
        """Returns the last image, the pose, or why there is none that another look may find."""
        quality = self._config.quality
        sightings: list[Sighting] = []
        while True:
            view = self._cell.look(self._after_s, self._is_cancelled)
            self._after_s = view.stamp_s
            if self._is_repeated(view.image):
                continue
            sighting = self._tracker.observe(view.image, view.camera)
            self._cell.seen(sighting, view)
            try:
                if sightings and sighting.markers:
                    require_same_view(sightings[-1], sighting)
                # An image without markers takes back what the images before have shown.
                sightings = [*sightings, sighting] if sighting.markers else [sighting]
                if sighting.markers and len(sightings) < self._settings.images:
                    continue
                fused = fuse(sightings, view.camera, self._fixture, quality)
                return view, locate(fused, view.camera, self._fixture, quality), None
            except (NoMarkerError, AmbiguousPoseError) as error:
                return view, None, error

    def _is_repeated(self, image: NDArray[np.uint8]) -> bool:
        """Notices a camera that repeats one image under new stamps; such an image tells nothing."""
        last = self.last_image
        same = last is not None and np.ptp(image) > 0 and np.array_equal(last, image)
        self._repeats = self._repeats + 1 if same else 0
        self.last_image = image
        if self._repeats >= _REPEATS or (same and self._before is not None):
            raise StaleImageError(
                "a new image was waited for, the camera repeats the same one pixel by pixel "
                "under new stamps; a camera that runs is accepted"
            )
        return bool(same)

    def _check_drive(self, pose: WorkpiecePose) -> None:
        """Compares what the image says of the last drive with its length."""
        if self._before is None:
            return
        T_workpiece_before, length, reach = self._before
        self._before = None
        way = difference(T_workpiece_before, inverse(pose.T_camera_workpiece))[0]
        miss = stop_miss_m(self._config, length)
        if way > reach + stop_miss_m(self._config, reach):
            raise PartMovedError(
                f"the camera was driven {length:.2f} m, but the part is seen as if it were "
                f"{way:.2f} m; the markers of one part that stands still are accepted"
            )
        stalled = length > _TELLING * miss and way < _DRIVEN_SHARE * length
        self._stalls = self._stalls + 1 if stalled else 0
        if self._stalls >= _STALLS:
            raise BaseBlockedError(
                f"the base reported {_STALLS} drives as done, but the last one of {length:.2f} m "
                f"moved the camera by {way:.2f} m; a base that arrives is accepted"
            )

    def _move_on(self, view: View, pose: WorkpiecePose, last: bool) -> str:
        """Drives to where the view is better, and returns how."""
        settings = self._settings
        reached = f"E {self.best_quality:.3f} was reached, at least {settings.threshold:.3f}"
        if not settings.may_move:
            raise QualityNotReachedError(f"{reached} was asked for without moving the base")
        if last:
            raise QualityNotReachedError(
                f"{reached} was asked for within {settings.max_attempts} attempts"
            )
        goal, length, reach = self._goal(view, pose)
        if goal is None:
            raise SafeDistanceError(
                f"{reached} was asked for, but the camera is {pose.distance_m:.2f} m before the "
                f"marker and may come no nearer"
            )
        self._moved = True
        self._before = (inverse(pose.T_camera_workpiece), length, reach)
        watch = DriveWatch(self._cell, self._config, self._fixture, self._is_cancelled)
        for stop in goal.stops:
            self._stops.append(self._cell.lookup("map", "base_link"))
            if not self._cell.drive(stop, watch.must_stop):
                watch.explain()
                raise cancelled()
        return goal.phase

    def _goal(self, view: View, pose: WorkpiecePose) -> tuple[Approach | None, float, float]:
        """Returns the next goal, and how far the camera gets by it: without slips, at most [m]."""
        mounted = self._cell.lookup("base_link", view.frame)
        if not np.allclose(mounted, self._config.camera.T_base_link_optical, atol=1e-4):
            raise FrameMissingError(
                f"the camera's place on the base by tf ({view.frame}) and by the cell file differ; "
                f"the same calibration in both is accepted"
            )
        here = self._cell.lookup("map", "base_link")
        goal = next_goal(here, pose, self._fixture, view.camera, self._config)
        if goal is None:
            return None, 0.0, 0.0
        length = difference(here @ mounted, goal.T_map_base_link @ mounted)[0]
        # A slip on one of two slanted drives leaves the base farther aside than the goal is away.
        starts = (here, *goal.stops[:-1])
        drives = [difference(a, b)[0] for a, b in zip(starts, goal.stops, strict=True)]
        turned = (goal.T_map_base_link - here)[:3, :3]
        swing = float(np.linalg.norm(turned @ mounted[:3, 3]))
        return goal, length, max(length, max(drives) + swing)

    def _returned(self, start: Array, error: SkinplanError) -> SkinplanError:
        """Brings the base back, and returns the error with what became of that.

        It goes back the way it came: that way was clear.
        """
        try:
            for stop in [*reversed(self._stops[1:]), start]:
                if not self._cell.drive(stop, self._is_cancelled):
                    return cancelled()
        except SkinplanError as second:
            return type(error)(
                f"{error}; the base could not be brought back to its start: {second}"
            )
        return error


def cancelled() -> LocalizationCancelledError:
    """Returns the error of a localisation that was cancelled."""
    return LocalizationCancelledError("the localisation was cancelled")
