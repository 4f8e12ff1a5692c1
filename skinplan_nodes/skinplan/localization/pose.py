"""From an image to the pose of the workpiece (M1.1, M1.2)."""

import logging

import numpy as np
from numpy.typing import NDArray

from skinplan.errors import (
    AmbiguousPoseError,
    ImageInvalidError,
    LocalizationError,
    NoMarkerError,
    WrongMarkerError,
)
from skinplan.localization.camera import require_camera
from skinplan.localization.detect import detect_markers
from skinplan.localization.model import CameraModel, Observation, WorkpiecePose
from skinplan.localization.quality import angle_and_distance, marker_quality
from skinplan.localization.solve import (
    Solution,
    refine,
    reprojection_error,
    square_corners,
    square_solutions,
)
from skinplan.part.model import Fixture
from skinplan.robot.cell import QualitySettings
from skinplan.transforms import Array, apply, difference, inverse

log = logging.getLogger(__name__)

# A pose is a guess when a second one explains the image with an error that is hardly larger ...
AMBIGUITY_MAX = 0.6
# ... and lies elsewhere: farther turned than this.
SAME_POSE_RAD = float(np.radians(1.0))
# Starts that are tried for a second pose.
_SECOND_TRIES = 2
# The edges of narrower markers can't be told from their cells; they count only without better ones.
CLEAR_SIDE_PX = 20.0
_ENOUGH_CLEAR = 2
# Corners farther off than this do not belong to the fixture as it is described.
REPROJECTION_MAX_PX = 3.0


def observe(
    image: NDArray[np.uint8], camera: CameraModel, fixture: Fixture, quality: QualitySettings
) -> tuple[Observation, ...]:
    """Finds the fixture's markers in an image.

    Args:
        image: shape (h, w) grey or (h, w, 3) BGR, 8 bit, of the camera's size, not rectified.
        camera: The camera.
        fixture: The markers that count.
        quality: Figures of eq (3).

    Returns:
        One observation per marker, by rising id; empty where no marker of any kind is seen.

    Raises:
        ImageInvalidError: The image or the camera can't be used, or the sizes differ.
        WrongMarkerError: There are markers of the dictionary, but none is of this fixture.
    """
    camera = require_camera(camera)
    if np.shape(image)[:2] != (camera.height, camera.width):
        raise ImageInvalidError(
            f"an image of {camera.width} x {camera.height} px, as the camera model says, is "
            f"accepted, found shape {np.shape(image)}"
        )
    ids, corners = detect_markers(image, fixture.dictionary, camera)
    known = np.isin(ids, [marker.id for marker in fixture.markers])
    if len(ids) > 0 and not known.any():
        raise _wrong_markers(ids.tolist(), fixture)
    if not known.all():
        log.info("markers %s are not of the fixture", ids[~known].tolist())
    return observations(ids[known], corners[known], camera, fixture, quality)


def observations(
    ids: NDArray[np.int64],
    corners: Array,
    camera: CameraModel,
    fixture: Fixture,
    quality: QualitySettings,
) -> tuple[Observation, ...]:
    """Judges markers of the fixture whose corners are known.

    Args:
        ids: Each of the fixture, shape (m,).
        corners: shape (m, 4, 2) [px].
        camera: The camera.
        fixture: Sizes of the markers.
        quality: Figures of eq (3).

    Returns:
        One observation per marker; a marker with degenerate corners is left out.
    """
    sizes = {marker.id: marker.size_m for marker in fixture.markers}
    found = []
    for marker_id, pixels in zip(ids.tolist(), corners, strict=True):
        square = square_corners(sizes[marker_id])
        starts = square_solutions(pixels, sizes[marker_id], camera)
        solutions = sorted(
            (refine(start, square, pixels, camera) for start in starts), key=lambda s: s.error_px
        )
        if not solutions:
            log.warning("marker %d: no pose explains its corners", marker_id)
            continue
        pose = solutions[0].T_camera_object
        angle, distance = angle_and_distance(pose)
        found.append(
            Observation(
                id=marker_id,
                size_m=sizes[marker_id],
                corners=pixels,
                T_camera_marker=pose,
                reprojection_error_px=solutions[0].error_px,
                ambiguity_ratio=_ratio(solutions[0], solutions[-1]),
                distance_m=distance,
                angle_rad=angle,
                quality=marker_quality(angle, distance, quality),
            )
        )
    return tuple(found)


def locate(
    seen: tuple[Observation, ...],
    camera: CameraModel,
    fixture: Fixture,
    quality: QualitySettings,
    ambiguity_max: float = AMBIGUITY_MAX,
) -> WorkpiecePose:
    """Solves for the pose of the workpiece over all corners of the fixture's markers.

    Args:
        seen: Observations of one image.
        camera: The camera.
        fixture: Where the markers are.
        quality: Figures of eq (3).
        ambiguity_max: Largest ratio of the best to the second reprojection error at which a pose is
            no guess.

    Returns:
        The pose; its E is that of the best marker, by the pose found.

    Raises:
        NoMarkerError: There is no observation.
        WrongMarkerError: None of the observations is of this fixture.
        AmbiguousPoseError: A second pose explains the image about equally well.
        LocalizationError: No pose explains the image: the markers are not where the fixture says.
    """
    camera = require_camera(camera)
    used = _of_fixture(seen, fixture)
    points = np.vstack([_in_workpiece(fixture, item) for item in used])
    pixels = np.vstack([item.corners for item in used])
    best, second = _two_best(used, points, pixels, camera, fixture)
    if best.error_px > REPROJECTION_MAX_PX:
        raise LocalizationError(
            f"the best pose leaves {best.error_px:.1f} px at markers {[item.id for item in used]}; "
            f"at most {REPROJECTION_MAX_PX} px is accepted: the markers are not where the fixture "
            f"says"
        )
    if second is not None and _ratio(best, second) > ambiguity_max:
        apart = np.degrees(difference(best.T_camera_object, second.T_camera_object)[1])
        raise AmbiguousPoseError(
            f"markers {[item.id for item in used]} fit two poses {apart:.1f} deg apart with errors "
            f"of {best.error_px:.3f} and {second.error_px:.3f} px; a ratio up to {ambiguity_max} "
            f"is accepted: come closer, look from aside, or show more markers"
        )
    angle, distance, reached = _best_view(best, used, fixture, quality)
    return WorkpiecePose(
        T_camera_workpiece=best.T_camera_object,
        covariance=best.covariance,
        reprojection_error_px=best.error_px,
        quality=reached,
        distance_m=distance,
        angle_rad=angle,
        marker_ids=np.array([item.id for item in used], dtype=np.int64),
    )


def _of_fixture(seen: tuple[Observation, ...], fixture: Fixture) -> list[Observation]:
    if not seen:
        raise NoMarkerError(
            f"a marker of the fixture ({_names(fixture)}) was looked for, none was seen"
        )
    known = {marker.id for marker in fixture.markers}
    used = [item for item in seen if item.id in known]
    if not used:
        raise _wrong_markers([item.id for item in seen], fixture)
    clear = [item for item in used if _narrowest_px(item.corners) >= CLEAR_SIDE_PX]
    return clear if len(clear) >= _ENOUGH_CLEAR else used


def _narrowest_px(corners: Array) -> float:
    return float(np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).min())


def _two_best(
    used: list[Observation], points: Array, pixels: Array, camera: CameraModel, fixture: Fixture
) -> tuple[Solution, Solution | None]:
    """Refines from the best of the markers' own poses, and from the best one elsewhere."""
    starts = []
    for item in used:
        T_marker_workpiece = inverse(fixture.T_workpiece_marker(item.id))
        for T_camera_marker in square_solutions(item.corners, item.size_m, camera):
            start = T_camera_marker @ T_marker_workpiece
            starts.append((reprojection_error(start, points, pixels, camera), start))
    if not starts:
        raise LocalizationError("no pose explains the corners of the markers seen")
    starts.sort(key=lambda pair: pair[0])
    best = refine(starts[0][1], points, pixels, camera)
    away = [
        start
        for _, start in starts[1:]
        if difference(best.T_camera_object, start)[1] > SAME_POSE_RAD
    ]
    for start in away[:_SECOND_TRIES]:
        other = refine(start, points, pixels, camera)
        if difference(best.T_camera_object, other.T_camera_object)[1] > SAME_POSE_RAD:
            return (best, other) if best.error_px <= other.error_px else (other, best)
    return best, None


def _best_view(
    best: Solution, used: list[Observation], fixture: Fixture, quality: QualitySettings
) -> tuple[float, float, float]:
    """Returns theta, d and E of the marker with the largest E."""
    views = []
    for item in used:
        pose = best.T_camera_object @ fixture.T_workpiece_marker(item.id)
        angle, distance = angle_and_distance(pose)
        views.append((marker_quality(angle, distance, quality), angle, distance))
    reached, angle, distance = max(views)
    return angle, distance, reached


def _in_workpiece(fixture: Fixture, item: Observation) -> Array:
    return apply(fixture.T_workpiece_marker(item.id), square_corners(item.size_m))


def _ratio(best: Solution, second: Solution) -> float:
    """Returns best over second error; 0 where both are one pose, 1 where neither has any error."""
    if difference(best.T_camera_object, second.T_camera_object)[1] <= SAME_POSE_RAD:
        return 0.0
    return best.error_px / second.error_px if second.error_px > 1e-9 else 1.0


def _wrong_markers(ids: list[int], fixture: Fixture) -> WrongMarkerError:
    return WrongMarkerError(
        f"markers {ids} were seen; those of the fixture ({_names(fixture)}) are accepted"
    )


def _names(fixture: Fixture) -> str:
    return f"{fixture.dictionary} ids {[marker.id for marker in fixture.markers]}"
