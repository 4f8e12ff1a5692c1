"""What the approach-retry loop needs of the cell, and what it tells it."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from skinplan.localization.model import CameraModel, Sighting, WorkpiecePose
from skinplan.transforms import Array

_NO_POSE = float("nan")


@dataclass(frozen=True, eq=False)
class View:
    """One image with the camera that took it.

    Attributes:
        image: shape (h, w) grey or (h, w, 3) BGR.
        camera: The camera.
        frame: Its optical frame.
        stamp_s: Time of the image [s].
        age_s: How old it was when it was taken over [s].
    """

    image: NDArray[np.uint8]
    camera: CameraModel
    frame: str
    stamp_s: float
    age_s: float


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

    def glance(self) -> View | None:
        """Returns the newest image, also of a base that moves; None = there is no new one."""

    def seen(self, sighting: Sighting, view: View) -> None:
        """Is told what was seen in an image."""

    def told(self, estimate: Estimate) -> None:
        """Is told each estimate."""
