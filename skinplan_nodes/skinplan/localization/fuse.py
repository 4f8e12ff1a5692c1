"""Several images of one stand, made one: the noise of the corners averages out."""

from collections.abc import Sequence

import numpy as np

from skinplan.errors import InputError, NoMarkerError, StaleImageError
from skinplan.localization.judge import observations
from skinplan.localization.model import CameraModel, Detection, Observation, Sighting
from skinplan.part.model import Fixture
from skinplan.robot.cell import QualitySettings
from skinplan.transforms import Array

# A marker whose corners are farther than this from their median over the images is left out of
# that image: so many standard deviations, at least so many pixels.
_OUTLIER_SIGMA, _LEAST_BOUND_PX = 5.0, 0.15
# A camera that shakes moves the corners by less than this between two images [px].
_APART_PX = 5.0


def fuse(
    sightings: Sequence[Sighting],
    camera: CameraModel,
    fixture: Fixture,
    quality: QualitySettings,
) -> Sighting:
    """Joins the sightings of one stand: each marker's corners are averaged without outliers.

    Where the corners scatter more than their own covariance says (a camera that shakes), the
    scatter counts.

    Args:
        sightings: At least one; taken from the same place.
        camera: The camera that took them.
        fixture: The markers.
        quality: Figures of eq (3).

    Returns:
        What all of them show. A marker counts that is in at least half of the images that show any
        marker; one that is twice or mirrored in any image does not.

    Raises:
        InputError: There is no sighting.
    """
    if not sightings:
        raise InputError("0 sightings were to be fused; at least 1 is accepted")
    if len(sightings) == 1:
        return sightings[0]
    duplicates = {i for seen in sightings for i in seen.duplicates}
    mirrored = {i for seen in sightings for i in seen.mirrored}
    showing = [seen for seen in sightings if seen.markers]
    by_id: dict[int, list[Observation]] = {}
    for seen in showing:
        for item in seen.markers:
            by_id.setdefault(item.id, []).append(item)
    odd = duplicates | mirrored
    kept = [i for i in sorted(by_id) if i not in odd and 2 * len(by_id[i]) >= len(showing)]
    means = [_mean(by_id[i]) for i in kept]
    found = Detection(
        np.array(kept, dtype=np.int64),
        np.array([mean for mean, _ in means]).reshape(-1, 4, 2),
        np.array([covariance for _, covariance in means]).reshape(-1, 8, 8),
        np.array([max(item.corner_floor_px for item in by_id[i]) for i in kept]),
    )
    return Sighting(
        observations(found, camera, fixture, quality),
        unknown=tuple(sorted({i for seen in sightings for i in seen.unknown})),
        duplicates=tuple(sorted(duplicates)),
        mirrored=tuple(sorted(mirrored)),
        covered=tuple(sorted({i for seen in sightings for i in seen.covered} - set(kept))),
        partly=tuple(sorted({i for seen in sightings for i in seen.partly} & set(kept))),
        images=sum(seen.images for seen in sightings),
    )


def require_same_view(before: Sighting, now: Sighting) -> None:
    """Checks that two images were taken from one place, by the markers that both show.

    Two of three images that a camera repeats, or an old one that comes late, would outvote the only
    one that shows where the camera stands now.

    Raises:
        NoMarkerError: They have no marker in common.
        StaleImageError: Half of the corners are elsewhere.
    """
    places = {item.id: item.corners for item in before.markers}
    pairs = [(item.corners, places[item.id]) for item in now.markers if item.id in places]
    if not pairs:
        raise NoMarkerError(
            "several images of one place were looked at, and one shows other markers than the one "
            "before; a marker that all of them show is accepted"
        )
    apart = float(np.median([np.linalg.norm(a - b, axis=1) for a, b in pairs]))
    if apart > _APART_PX:
        raise StaleImageError(
            f"several images of one place were looked at, but the markers are {apart:.0f} px from "
            f"where the image before showed them; up to {_APART_PX:g} px, of a camera that runs "
            f"and stands still, are accepted"
        )


def _mean(items: Sequence[Observation]) -> tuple[Array, Array]:
    """Returns the mean corners of one marker, (4, 2) [px], and their covariance, (8, 8) [px^2]."""
    corners = np.array([item.corners.ravel() for item in items])
    covariance = np.mean([item.corner_covariance for item in items], axis=0)
    sigma = float(np.sqrt(np.trace(covariance) / 8.0))
    apart = np.abs(corners - np.median(corners, axis=0)).max(axis=1)
    kept = corners[apart <= max(_OUTLIER_SIGMA * sigma, _LEAST_BOUND_PX)]
    if len(kept) == 0:
        kept = corners
    mean = kept.mean(axis=0)
    if len(kept) > 1:
        expected = float(np.trace(covariance))
        scatter = float(((kept - mean) ** 2).sum() / (len(kept) - 1))
        covariance = covariance * max(1.0, scatter / max(expected, 1e-12))
    return mean.reshape(4, 2), covariance / len(kept)
