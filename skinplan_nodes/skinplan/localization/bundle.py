"""Several markers of one sighting as one body."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skinplan.localization.camera import project
from skinplan.localization.model import CameraModel, Observation
from skinplan.localization.solve import whitening
from skinplan.localization.square import square_corners
from skinplan.part.model import Fixture
from skinplan.transforms import Array, apply


@dataclass(frozen=True, eq=False)
class Bundle:
    """Markers of one sighting as one body.

    Attributes:
        markers: What is seen of each.
        points: Their corners in the workpiece, shape (m, 4, 3) [m].
        pixels: shape (m, 4, 2) [px].
        whiten: `whitening` of each, shape (m, 8, 8).
    """

    markers: tuple[Observation, ...]
    points: Array
    pixels: Array
    whiten: Array

    def only(self, keep: NDArray[np.bool_]) -> "Bundle":
        """Returns some of the markers, by shape (m,)."""
        markers = tuple(m for m, kept in zip(self.markers, keep, strict=True) if kept)
        return Bundle(markers, self.points[keep], self.pixels[keep], self.whiten[keep])

    @property
    def ids(self) -> list[int]:
        """The markers' ids."""
        return [marker.id for marker in self.markers]


def bundle_of(markers: tuple[Observation, ...], fixture: Fixture) -> Bundle:
    """Puts markers in their places on the fixture."""
    points = [
        apply(fixture.T_workpiece_marker(item.id), square_corners(item.size_m)) for item in markers
    ]
    covariance = np.array([item.corner_covariance for item in markers])
    floor = np.array([item.corner_floor_px for item in markers])
    pixels = np.array([item.corners for item in markers])
    return Bundle(markers, np.array(points), pixels, whitening(covariance, floor))


def strain(pose: Array, bundle: Bundle, camera: CameraModel) -> Array:
    """Returns the squared normalised residuals of each marker, shape (m,)."""
    apart = project(apply(pose, bundle.points.reshape(-1, 3)), camera) - bundle.pixels.reshape(
        -1, 2
    )
    white = np.einsum("mij,mj->mi", bundle.whiten, apart.reshape(-1, 8))
    return np.asarray(np.einsum("mi,mi->m", white, white))
