"""Looks at the images while the base drives: nearer than d_min, the drive ends."""

from collections.abc import Callable

from skinplan.errors import SafeDistanceError, SkinplanError
from skinplan.localization.loop_cell import Cell
from skinplan.localization.pose import locate
from skinplan.localization.tracking import MarkerTracker
from skinplan.part.model import Fixture
from skinplan.robot.cell import CellConfig

# So many images in a row have to say it: one alone may show anything.
_ENOUGH_IMAGES = 2


class DriveWatch:
    """Watches one motion of the base.

    Args:
        cell: Gives the images.
        config: d_min of eq (3), how corners are found.
        fixture: The markers.
        is_cancelled: Asked with every look.
    """

    def __init__(
        self,
        cell: Cell,
        config: CellConfig,
        fixture: Fixture,
        is_cancelled: Callable[[], bool],
    ) -> None:
        self._cell = cell
        self._quality = config.quality
        self._fixture = fixture
        self._is_cancelled = is_cancelled
        self._tracker = MarkerTracker(fixture, config.quality, config.camera.corners)
        self._near = 0
        self._distance_m = float("inf")

    def must_stop(self) -> bool:
        """Tells whether the base has to stop: cancelled, or too near to the markers."""
        if self._is_cancelled():
            return True
        try:
            view = self._cell.glance()
            if view is None:
                return self._near >= _ENOUGH_IMAGES
            seen = self._tracker.observe(view.image, view.camera)
            pose = locate(seen, view.camera, self._fixture, self._quality)
        except SkinplanError:
            # From a base that drives markers look blurred, or are not seen; the next stand tells.
            return self._near >= _ENOUGH_IMAGES
        self._distance_m = pose.distance_m
        too_near = pose.distance_m < self._quality.distance_min_m
        self._near = self._near + 1 if too_near else 0
        return self._near >= _ENOUGH_IMAGES

    def explain(self) -> None:
        """Says why the base had to stop, where it came too near.

        Raises:
            SafeDistanceError: It did.
        """
        if self._near >= _ENOUGH_IMAGES:
            raise SafeDistanceError(
                f"a drive that keeps {self._quality.distance_min_m:.2f} m was asked for, but the "
                f"camera came to {self._distance_m:.2f} m before the marker; the base was stopped"
            )
