"""The cloud of one part, cut out of the views that show it (R2.2)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skinplan.errors import NoCloudError
from skinplan.recognition.clusters import clusters, crowd, normals, spread
from skinplan.recognition.planes import Plane, between
from skinplan.recognition.vfh import vfh
from skinplan.transforms import Array

# Of the coarse scan: points with so few others in a cube of 3 cells of this side hang in mid-air.
_COARSE_CELL, _COARSE_FEW = 1.5, 5


@dataclass(frozen=True)
class CutSettings:
    """How parts are cut out of clouds.

    Attributes:
        low_m: Points lower over the tray belong to it [m].
        high_m: Points higher are something else [m].
        gap_m: Parts are farther apart than this, seen from above [m].
        fewest: Smaller clusters are debris.
        spacing_m: Clouds of parts are thinned to one point per cube of this side [m].
        size_m: Distances in descriptors are counted up to this [m].
        crowd: Points with fewer others in a cube of 1.5 spacings about them hang in mid-air.
    """

    low_m: float = 0.0006
    high_m: float = 0.2
    gap_m: float = 0.016
    fewest: int = 60
    spacing_m: float = 0.002
    size_m: float = 0.25
    crowd: int = 5


@dataclass(frozen=True, eq=False)
class PartCloud:
    """Points of one part, evenly spread.

    Attributes:
        points: Tray frame, shape (n, 3) [m].
        normals: Toward the camera, shape (n, 3).
        seen_from: Where each was seen from, shape (n, 3) [m].
        above: Where the camera stood that looked straight down, shape (3,) [m].
    """

    points: Array
    normals: Array
    seen_from: Array
    above: Array

    def descriptor(self, settings: CutSettings | None = None) -> Array:
        """Viewpoint feature histogram, shape (308,), as the models' in the database."""
        settings = settings or CutSettings()
        return vfh(self.points, self.normals, self.above, settings.size_m)


@dataclass(frozen=True, eq=False)
class Place:
    """Where something lies on the tray, by the coarse scan.

    Attributes:
        points: Of the coarse scan, shape (n, 3) [m].
        middle: Middle of its box, shape (3,) [m].
        radius_m: Half the diagonal of the box seen from above [m].
    """

    points: Array
    middle: Array
    radius_m: float

    @classmethod
    def of(cls, points: Array) -> "Place":
        """Box of points, shape (n, 3) [m]."""
        low, high = points.min(axis=0), points.max(axis=0)
        return cls(points, (low + high) / 2.0, float(np.hypot(*(high - low)[:2])) / 2.0)


def places(points: Array, plane: Plane, settings: CutSettings | None = None) -> list[Place]:
    """Finds what lies on the tray.

    Args:
        points: Coarse scan, shape (n, 3) [m].
        plane: The tray.
        settings: How.

    Returns:
        One for each cluster, the largest first; none = the tray is empty.
    """
    settings = settings or CutSettings()
    kept = points[between(plane.heights(points), settings.low_m, settings.high_m)]
    # Single points in mid-air would make bridges between neighbours.
    kept = kept[crowd(kept, np.arange(len(kept)), _COARSE_CELL * settings.spacing_m) > _COARSE_FEW]
    groups = clusters(kept, settings.gap_m, settings.fewest, height_weight=0.0)
    return [Place.of(kept[group]) for group in groups]


def part_cloud(
    clouds: Sequence[Array],
    cameras: Sequence[Array],
    plane: Plane,
    place: Place,
    settings: CutSettings | None = None,
) -> PartCloud:
    """Merges the views of one part and cuts it out.

    Args:
        clouds: Points of each view, tray frame, shapes (n, 3) [m]; the first looks straight down.
        cameras: Where the views were taken from, shapes (3,) [m].
        plane: The tray.
        place: Where the part lies.
        settings: How.

    Returns:
        The part.

    Raises:
        NoCloudError: Nothing is there.
    """
    settings = settings or CutSettings()
    points = np.concatenate(list(clouds))
    owner = np.repeat(np.arange(len(clouds)), [len(cloud) for cloud in clouds])
    reach = place.radius_m + settings.gap_m
    over = np.flatnonzero(between(plane.heights(points), settings.low_m, settings.high_m))
    chosen = over[np.hypot(*(points[over, :2] - place.middle[:2]).T) < reach]
    near = points[chosen]
    few = spread(near, settings.spacing_m)
    beside = crowd(near, few, settings.spacing_m / 2.0)
    chosen = chosen[few[beside > settings.crowd]]
    groups = clusters(points[chosen], settings.gap_m, settings.fewest, height_weight=0.0)
    if not groups:
        raise NoCloudError(
            f"the cloud of a part was asked for; at least {settings.fewest} points over the tray "
            f"are accepted, found {len(chosen)} at {place.middle[0]:.3f}, {place.middle[1]:.3f} m"
        )
    # The part is the cluster that lies where the coarse scan has it; others are its neighbours.
    middles = np.array([Place.of(points[chosen[group]]).middle for group in groups])
    best = int(np.argmin(np.hypot(*(middles[:, :2] - place.middle[:2]).T)))
    chosen = chosen[groups[best]]
    seen_from = np.asarray(cameras)[owner[chosen]]
    found = points[chosen]
    return PartCloud(found, normals(found, seen_from), seen_from, np.asarray(cameras[0]))
