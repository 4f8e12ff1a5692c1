"""From corners to the fixture's markers, each judged (M1.2)."""

import logging
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from skinplan.localization.model import CameraModel, Detection, Observation, Sighting
from skinplan.localization.quality import angle_and_distance, marker_quality
from skinplan.localization.solve import (
    Solutions,
    refine,
    turned_by,
    whitening,
)
from skinplan.localization.square import square_corners, square_solutions
from skinplan.part.model import Fixture
from skinplan.robot.cell import QualitySettings
from skinplan.transforms import Array

log = logging.getLogger(__name__)

# Poses less turned than this against each other are one pose.
SAME_POSE_RAD = float(np.radians(1.0))


def judged(
    found: Detection, camera: CameraModel, fixture: Fixture, quality: QualitySettings
) -> Sighting:
    """Judges the markers of a detection and sorts out those that are not the fixture's."""
    own = [marker.id for marker in fixture.markers]
    known = np.isin(found.ids, own)
    kept = replace(
        found,
        ids=found.ids[known],
        corners=found.corners[known],
        covariance=found.covariance[known],
        floor_px=found.floor_px[known],
    )
    return Sighting(
        observations(kept, camera, fixture, quality),
        unknown=tuple(sorted({*found.ids[~known].tolist(), *found.foreign})),
        duplicates=tuple(i for i in found.duplicates if i in own),
        mirrored=tuple(i for i in found.mirrored if i in own),
        covered=tuple(i for i in found.covered if i in own),
    )


def observations(
    found: Detection, camera: CameraModel, fixture: Fixture, quality: QualitySettings
) -> tuple[Observation, ...]:
    """Judges markers that are all of the fixture.

    Args:
        found: The markers.
        camera: The camera.
        fixture: Sizes of the markers.
        quality: Figures of eq (3).

    Returns:
        One observation per marker; a marker with degenerate corners is left out.
    """
    sizes = {marker.id: marker.size_m for marker in fixture.markers}
    of_found = np.array([sizes[marker_id] for marker_id in found.ids.tolist()])
    both = square_solutions(found.corners, of_found, camera)
    owner, which = np.nonzero(np.isfinite(both[..., 0, 0]))
    for number in sorted(set(range(len(found.ids))) - set(owner.tolist())):
        log.warning("marker %d: no pose explains its corners", found.ids[number])
    if len(owner) == 0:
        return ()
    squares = np.array([square_corners(size) for size in of_found])
    whiten = whitening(found.covariance, found.floor_px)
    solved = refine(
        both[owner, which],
        squares[owner][:, None],
        found.corners[owner][:, None],
        whiten[owner][:, None],
        camera,
    )
    return tuple(
        _observation(
            found,
            number,
            float(of_found[number]),
            solved,
            np.flatnonzero(owner == number).tolist(),
            quality,
        )
        for number in sorted(set(owner.tolist()))
    )


def exact_detection(ids: NDArray[np.int64], corners: Array, noise_px: float) -> Detection:
    """Returns corners of which it is known how far they are off, all alike and independent.

    Args:
        ids: shape (m,).
        corners: shape (m, 4, 2) [px].
        noise_px: Standard deviation of each coordinate [px].
    """
    covariance = np.tile(np.eye(8) * noise_px**2, (len(ids), 1, 1))
    return Detection(ids, corners, covariance, np.zeros(len(ids)))


def ambiguity(best: Array, second: Array, best_px: float, second_px: float) -> float:
    """Returns best over second error; 0 where both are one pose, 1 where neither has any error."""
    if turned_by(best, second) <= SAME_POSE_RAD:
        return 0.0
    return best_px / second_px if second_px > 1e-9 else 1.0


def _observation(
    found: Detection,
    number: int,
    size_m: float,
    solved: Solutions,
    own: list[int],
    quality: QualitySettings,
) -> Observation:
    best, *others = sorted(own, key=lambda k: float(solved.error_px[k]))
    second = others[-1] if others else best
    pose, other = solved.poses[best], solved.poses[second]
    errors = float(solved.error_px[best]), float(solved.error_px[second])
    angle, distance = angle_and_distance(pose)
    return Observation(
        id=int(found.ids[number]),
        size_m=size_m,
        corners=found.corners[number],
        corner_covariance=found.covariance[number],
        corner_floor_px=float(found.floor_px[number]),
        T_camera_marker=pose,
        covariance=solved.covariance[best],
        reprojection_error_px=errors[0],
        T_camera_second=other,
        second_error_px=errors[1],
        ambiguity_ratio=ambiguity(pose, other, *errors),
        distance_m=distance,
        angle_rad=angle,
        quality=marker_quality(angle, distance, quality),
    )
