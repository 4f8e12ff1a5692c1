"""Locating a part by its shape until it is good enough: look, and come nearer when it is not.

The twin of `skinplan.localization.loop` for parts without markers. No image is watched while the
base drives: there is no marker in it that would say how near the part is.
"""

from dataclasses import dataclass, replace
from typing import Protocol

from skinplan.errors import (
    AlignmentError,
    AmbiguousPoseError,
    LocalizationCancelledError,
    QualityNotReachedError,
    SafeDistanceError,
    SkinplanError,
)
from skinplan.localization.chain import LocatedPart
from skinplan.localization.model import CameraModel
from skinplan.mesh.model import SurfaceMesh
from skinplan.recognition.shape_approach import nearer
from skinplan.recognition.shape_gate import ShapeVerdict, predicted_error_m
from skinplan.recognition.verdict import AMBIGUOUS, FAILED
from skinplan.robot.cell import CellConfig
from skinplan.transforms import Array


@dataclass(frozen=True, eq=False)
class ShapeEstimate:
    """What one look has found.

    Attributes:
        located: The pose in the arm base, with its covariance.
        T_camera_workpiece: The same in the optical frame, shape (4, 4) [m].
        camera: The camera.
        verdict: What it is worth.
        quality: Accepted over predicted error, 1 passes the gate [1].
        sigmas: So many standard deviations count as the error [1].
    """

    located: LocatedPart
    T_camera_workpiece: Array
    camera: CameraModel
    verdict: ShapeVerdict
    quality: float
    sigmas: float

    @property
    def reason(self) -> str:
        """What the verdict says."""
        return self.verdict.reason


class Cell(Protocol):
    """What the search asks of the cell; every method raises `SkinplanError`."""

    def estimate(self) -> ShapeEstimate:
        """Looks for the part from where the base stands."""

    def place(self) -> Array:
        """Returns ``T_map_base_link``, shape (4, 4) [m]."""

    def drive(self, T_map_base_link: Array) -> None:
        """Drives the base."""

    def told(self, phase: str, attempt: int, estimate: ShapeEstimate) -> None:
        """Is told an estimate."""


@dataclass(frozen=True)
class ShapeLoopSettings:
    """When the search ends.

    Attributes:
        threshold: Quality that is asked for [1].
        max_attempts: Estimates at most.
        may_move: Whether the base may be moved.
    """

    threshold: float
    max_attempts: int
    may_move: bool


class ShapeLoop:
    """One search.

    Args:
        cell: The cell.
        config: Its figures.
        mesh: The part.
        settings: When to end.

    Attributes:
        attempts: Estimates made.
        best_quality: Largest quality so far.
    """

    def __init__(
        self, cell: Cell, config: CellConfig, mesh: SurfaceMesh, settings: ShapeLoopSettings
    ) -> None:
        self._cell, self._config, self._mesh = cell, config, mesh
        self._settings = settings
        self._stops: list[Array] = []
        self.attempts = 0
        self.best_quality = 0.0

    def run(self) -> ShapeEstimate:
        """Runs the search; on failure the base goes back the way it came, after a cancel it stays.

        Raises:
            AlignmentError: What stands there is not the part, or not within the bounds.
            AmbiguousPoseError: Its shape leaves open where it is.
            QualityNotReachedError: It is not known well enough.
            SafeDistanceError: ... and the base may come no nearer.
            SkinplanError: No images, no way.
        """
        try:
            return self._search()
        except LocalizationCancelledError:
            raise
        except SkinplanError as error:
            try:
                for stop in reversed(self._stops):
                    self._cell.drive(stop)
            except LocalizationCancelledError:
                raise
            except SkinplanError as second:
                text = f"{error}; the base could not be brought back to its start: {second}"
                error.args = (text,)
            raise

    def _search(self) -> ShapeEstimate:
        phase = "detecting"
        while True:
            self.attempts += 1
            estimate = self._cell.estimate()
            self._cell.told(phase, self.attempts, estimate)
            self._require(estimate.verdict)
            self.best_quality = max(self.best_quality, estimate.quality)
            if estimate.quality >= self._settings.threshold:
                located = replace(estimate.located, quality=estimate.quality)
                return replace(estimate, located=located)
            phase = self._come_nearer(estimate)

    def _require(self, verdict: ShapeVerdict) -> None:
        if verdict.grade == FAILED:
            raise AlignmentError(
                f"the part was looked for by its shape, but it does not lie there: {verdict.reason}"
            )
        if verdict.grade == AMBIGUOUS:
            raise AmbiguousPoseError(
                f"the part was looked for by its shape, which does not tell where it is: "
                f"{verdict.reason}"
            )

    def _come_nearer(self, estimate: ShapeEstimate) -> str:
        settings = self._settings
        error_m = predicted_error_m(estimate.located, self._mesh, estimate.sigmas)
        reached = (
            f"the part's farthest point is known to {error_m * 1e3:.1f} mm ({estimate.sigmas:g} "
            f"sigma), up to {error_m * estimate.quality / settings.threshold * 1e3:.1f} mm"
        )
        if not settings.may_move:
            raise QualityNotReachedError(f"{reached} was asked for without moving the base")
        if self.attempts >= settings.max_attempts:
            raise QualityNotReachedError(
                f"{reached} was asked for within {settings.max_attempts} attempts"
            )
        here = self._cell.place()
        goal = nearer(here, estimate.T_camera_workpiece, self._mesh, estimate.camera, self._config)
        if goal is None:
            raise SafeDistanceError(f"{reached} was asked for, but the base may come no nearer")
        for stop in goal.stops:
            self._stops.append(self._cell.place())
            self._cell.drive(stop)
        return goal.phase
