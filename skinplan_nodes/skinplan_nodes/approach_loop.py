"""The approach-retry loop of M1.2: look, judge, drive nearer, until the pose is good enough."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from skinplan_msgs.msg import Status

from skinplan.errors import AmbiguousPoseError, LocalizationError, NoMarkerError, SkinplanError
from skinplan.localization.approach import Approach, next_goal
from skinplan.localization.model import Observation, WorkpiecePose
from skinplan.localization.pose import locate, observe
from skinplan.part.model import Fixture
from skinplan.robot.cell import CellConfig
from skinplan.transforms import Array
from skinplan_nodes.camera_feed import View, cancelled
from skinplan_nodes.replies import RefusedError, status_of

_NO_POSE = float("nan")


@dataclass(frozen=True)
class ApproachSettings:
    """When the loop ends.

    Attributes:
        threshold: T_E of eq (3) [1].
        max_attempts: Estimates at most.
        max_misses: Estimates in a row without a pose, at most.
        may_move: Whether the base may be moved.
    """

    threshold: float
    max_attempts: int
    max_misses: int
    may_move: bool


@dataclass(frozen=True, eq=False)
class Estimate:
    """One estimate; the last one of a loop is its result.

    Attributes:
        phase: detecting, turning or advancing: what led to it.
        attempt: From 1.
        pose: The pose; None = none was found.
        stamp_s: Time of the image [s].
        frame: Optical frame of the camera.
    """

    phase: str
    attempt: int
    pose: WorkpiecePose | None
    stamp_s: float
    frame: str

    @property
    def quality(self) -> float:
        """E of eq (3); NaN = no pose."""
        return _NO_POSE if self.pose is None else self.pose.quality


class Cell(Protocol):
    """What the loop needs of the cell."""

    def look(self, after_s: float, is_cancelled: Callable[[], bool]) -> View:
        """Waits for an image that is newer than a time and than the last motion of the base."""

    def lookup(self, target: str, source: str) -> Array:
        """Returns ``T_target_source``."""

    def drive(self, T_map_base_link: Array, is_cancelled: Callable[[], bool]) -> bool:
        """Drives; False = cancelled."""

    def seen(self, observations: Sequence[Observation], view: View) -> None:
        """Is told what was seen in an image."""

    def told(self, estimate: Estimate) -> None:
        """Is told each estimate."""


class ApproachLoop:
    """One localisation.

    Args:
        cell: The cell.
        config: Its figures.
        fixture: The markers to look for.
        settings: When to end.
        is_cancelled: Asked often.
    """

    def __init__(
        self,
        cell: Cell,
        config: CellConfig,
        fixture: Fixture,
        settings: ApproachSettings,
        is_cancelled: Callable[[], bool],
    ) -> None:
        self._cell = cell
        self._config = config
        self._fixture = fixture
        self._settings = settings
        self._is_cancelled = is_cancelled
        self._moved = False
        self.attempts = 0
        self.best_quality = 0.0

    def run(self) -> Estimate:
        """Runs the loop.

        On final failure the base is brought back to where it started; after a cancel it stays.

        Returns:
            The estimate that was good enough.

        Raises:
            SkinplanError: Why there is none; `RefusedError` where only the cell can know.
        """
        start = self._cell.lookup("map", "base_link") if self._settings.may_move else None
        try:
            return self._approach()
        except SkinplanError as error:
            was_cancelled = (
                isinstance(error, RefusedError) and error.code == Status.LOCALIZATION_CANCELLED
            )
            if start is None or not self._moved or was_cancelled:
                raise
            raise self._returned(start, error) from error

    def _approach(self) -> Estimate:
        phase, misses, after_s = "detecting", 0, 0.0
        while True:
            if self._is_cancelled():
                raise cancelled()
            self.attempts += 1
            view = self._cell.look(after_s, self._is_cancelled)
            after_s = view.stamp_s
            pose, missed = self._estimate(view)
            estimate = Estimate(phase, self.attempts, pose, view.stamp_s, view.frame)
            self._cell.told(estimate)
            misses = 0 if missed is None else misses + 1
            if pose is not None:
                self.best_quality = max(self.best_quality, pose.quality)
                if pose.quality >= self._settings.threshold:
                    return estimate
            last = self.attempts >= self._settings.max_attempts
            if missed is not None:
                if last or misses >= self._settings.max_misses:
                    raise missed
                continue
            assert pose is not None
            phase = self._move_on(view, pose, last)

    def _estimate(self, view: View) -> tuple[WorkpiecePose | None, SkinplanError | None]:
        """Returns the pose, or why there is none that another look may find."""
        found: Sequence[Observation] = ()
        try:
            found = observe(view.image, view.camera, self._fixture, self._config.quality)
            pose = locate(found, view.camera, self._fixture, self._config.quality)
        except (NoMarkerError, AmbiguousPoseError) as error:
            return None, error
        except LocalizationError as error:
            # Other markers, or markers elsewhere than the fixture says: no look will change that.
            if type(error) is LocalizationError:
                raise RefusedError(Status.WRONG_MARKER, str(error)) from error
            raise
        finally:
            self._cell.seen(found, view)
        return pose, None

    def _move_on(self, view: View, pose: WorkpiecePose, last: bool) -> str:
        """Drives to where the view is better, and returns how."""
        settings = self._settings
        reached = f"E {self.best_quality:.3f} was reached, at least {settings.threshold:.3f}"
        if not settings.may_move:
            raise RefusedError(
                Status.QUALITY_NOT_REACHED, f"{reached} was asked for without moving the base"
            )
        if last:
            raise RefusedError(
                Status.QUALITY_NOT_REACHED,
                f"{reached} was asked for within {settings.max_attempts} attempts",
            )
        goal = self._goal(view, pose)
        if goal is None:
            raise RefusedError(
                Status.SAFE_DISTANCE_REACHED,
                f"{reached} was asked for, but the camera is {pose.distance_m:.2f} m before the "
                f"marker and may come no nearer",
            )
        self._moved = True
        if not self._cell.drive(goal.T_map_base_link, self._is_cancelled):
            raise cancelled()
        return goal.phase

    def _goal(self, view: View, pose: WorkpiecePose) -> Approach | None:
        mounted = self._cell.lookup("base_link", view.frame)
        if not np.allclose(mounted, self._config.camera.T_base_link_optical, atol=1e-4):
            raise RefusedError(
                Status.NO_TRANSFORM,
                f"the camera's place on the base by tf ({view.frame}) and by the cell file differ; "
                f"the same calibration in both is accepted",
            )
        return next_goal(
            self._cell.lookup("map", "base_link"), pose, self._fixture, view.camera, self._config
        )

    def _returned(self, start: Array, error: SkinplanError) -> SkinplanError:
        """Brings the base back, and returns the error with what became of that."""
        try:
            self._cell.drive(start, self._is_cancelled)
        except SkinplanError as second:
            return RefusedError(
                status_of(error).code,
                f"{error}; the base could not be brought back to its start: {second}",
            )
        return error
