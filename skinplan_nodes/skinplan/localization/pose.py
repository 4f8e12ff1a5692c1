"""From the markers of a sighting to the pose of the workpiece (M1.1, M1.2)."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from skinplan.errors import (
    AmbiguousPoseError,
    FixtureMismatchError,
    NoMarkerError,
    WrongMarkerError,
)
from skinplan.localization.bundle import Bundle, bundle_of, strain
from skinplan.localization.camera import require_camera
from skinplan.localization.edge_lines import narrowest_px
from skinplan.localization.edges import narrowest
from skinplan.localization.judge import SAME_POSE_RAD, ambiguity
from skinplan.localization.model import CameraModel, Observation, Sighting, WorkpiecePose
from skinplan.localization.quality import angle_and_distance, marker_quality
from skinplan.localization.solve import (
    Solutions,
    largest_by_chance,
    marker_errors,
    refine,
    turned_by,
)
from skinplan.localization.stand import clearly_seen, inside, marker_corners
from skinplan.part.model import Fixture
from skinplan.robot.cell import QualitySettings
from skinplan.transforms import Array, inverse

# Pose, reprojection error [px] and covariance.
_Solution = tuple[Array, float, Array]

# A pose is a guess when a second one explains the image with an error that is hardly larger.
AMBIGUITY_MAX = 0.6
# Starts that are tried for a second pose.
_SECOND_TRIES = 2
# The edges of narrower markers can't be told from their cells; they count only without better ones.
CLEAR_SIDE_PX = 20.0
_ENOUGH_CLEAR = 2
# So many markers tell which one of them is wrong.
_LEAST_TO_CONTRADICT = 3
# Corners farther off than this do not belong to the fixture as it is described.
REPROJECTION_MAX_PX = 3.0
# The pose of one marker, carried to another, is that far off at most: share of the other's side.
_AGREES_SHARE = 0.5
# A hidden marker is expected only well inside the image.
_HIDDEN_RIM_PX = 12.0


def locate(
    seen: Sighting,
    camera: CameraModel,
    fixture: Fixture,
    quality: QualitySettings,
    ambiguity_max: float = AMBIGUITY_MAX,
) -> WorkpiecePose:
    """Solves for the pose of the workpiece over all corners of the fixture's markers.

    Markers that the others contradict are left out, as long as more than half agree.

    Args:
        seen: What one image shows, or several of one stand.
        camera: The camera.
        fixture: Where the markers are.
        quality: Figures of eq (3).
        ambiguity_max: Largest ratio of the best to the second reprojection error at which a pose is
            no guess.

    Returns:
        The pose; its E is that of the best marker, by the pose found.

    Raises:
        NoMarkerError: No marker is seen.
        WrongMarkerError: Markers are seen, but none that can be used: of another fixture, twice,
            or mirrored.
        FixtureMismatchError: The markers are not where the fixture says.
        AmbiguousPoseError: A second pose explains the image about equally well.
    """
    camera = require_camera(camera)
    bundle = bundle_of(_usable(seen, fixture), fixture)
    if len(bundle.markers) == 1:
        kept, (best, second) = bundle, _alone(bundle, fixture)
    else:
        kept, best, second = _together(bundle, fixture, camera)
    pose, error, covariance = best
    ratio = 0.0 if second is None else ambiguity(pose, second[0], error, second[1])
    if second is not None and ratio > ambiguity_max:
        raise _ambiguous(kept, pose, second, error, ambiguity_max)
    reached, angle, distance = max(_view(pose, item, fixture, quality) for item in kept.markers)
    return WorkpiecePose(
        T_camera_workpiece=pose,
        covariance=covariance,
        reprojection_error_px=error,
        quality=reached,
        distance_m=distance,
        angle_rad=angle,
        marker_ids=np.array(kept.ids, dtype=np.int64),
        ambiguity_ratio=ratio,
        rejected_ids=np.array(sorted(set(bundle.ids) - set(kept.ids)), dtype=np.int64),
        hidden_ids=hidden_ids(pose, seen, camera, fixture),
    )


def _usable(seen: Sighting, fixture: Fixture) -> tuple[Observation, ...]:
    """Returns the markers to solve with, or says why there are none."""
    known = {marker.id for marker in fixture.markers}
    used = [item for item in seen.markers if item.id in known]
    if not used:
        foreign = sorted({*seen.unknown, *(item.id for item in seen.markers)})
        reasons = [
            text
            for ids, text in (
                (foreign, f"markers {foreign} were seen, which are of another fixture"),
                (seen.duplicates, f"markers {list(seen.duplicates)} are there several times"),
                (seen.mirrored, f"markers {list(seen.mirrored)} are there mirrored"),
            )
            if ids
        ]
        if not reasons:
            partly = f"; markers {list(seen.covered)} are partly hidden" if seen.covered else ""
            raise NoMarkerError(
                f"a marker of the fixture ({_names(fixture)}) was looked for, none was seen{partly}"
            )
        raise WrongMarkerError(
            f"{'; '.join(reasons)}; those of the fixture ({_names(fixture)}) are accepted, "
            "each once and not mirrored"
        )
    clear = [item for item in used if narrowest_px(item.corners) >= CLEAR_SIDE_PX]
    return tuple(clear if len(clear) >= _ENOUGH_CLEAR else used)


def _alone(bundle: Bundle, fixture: Fixture) -> tuple[_Solution, _Solution | None]:
    """Carries the two solutions of the only marker to the workpiece."""
    item = bundle.markers[0]
    if item.reprojection_error_px > REPROJECTION_MAX_PX:
        raise _mismatch(bundle, item.reprojection_error_px)
    T_marker_workpiece = inverse(fixture.T_workpiece_marker(item.id))
    # A turn of the marker moves the workpiece's origin by the lever between the two.
    x, y, z = item.T_camera_marker[:3, :3] @ T_marker_workpiece[:3, 3]
    carried = np.eye(6)
    carried[:3, 3:] = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]
    covariance = carried @ item.covariance @ carried.T
    best = (item.T_camera_marker @ T_marker_workpiece, item.reprojection_error_px, covariance)
    if item.ambiguity_ratio == 0.0:
        return best, None
    return best, (item.T_camera_second @ T_marker_workpiece, item.second_error_px, covariance)


def _together(
    bundle: Bundle, fixture: Fixture, camera: CameraModel
) -> tuple[Bundle, _Solution, _Solution | None]:
    """Solves for the pose of several markers; the markers that agree, the best, the second."""
    starts = np.array(
        [
            T_camera_marker @ inverse(fixture.T_workpiece_marker(item.id))
            for item in bundle.markers
            for T_camera_marker in (item.T_camera_marker, item.T_camera_second)
        ]
    )
    kept, found = _agreed(bundle, starts, camera)
    order = np.argsort(found.error_px, kind="stable")
    away = turned_by(found.poses[order[0]], found.poses[order]) > SAME_POSE_RAD
    second = _solution(found, int(order[away][0])) if away.any() else None
    return kept, _solution(found, int(order[0])), second


def _agreed(bundle: Bundle, starts: Array, camera: CameraModel) -> tuple[Bundle, Solutions]:
    """Finds the largest set of markers that one pose explains.

    Returns:
        The markers, and what the best start and a few that are turned against it lead to.
    """
    errors = marker_errors(starts, bundle.points, bundle.pixels, camera)
    sides = narrowest(bundle.pixels)
    allowed = REPROJECTION_MAX_PX + _AGREES_SHARE * sides
    agrees = errors < allowed
    cost = np.minimum(errors / allowed, 1.0).sum(axis=1)
    first = int(np.argmin(cost))
    kept = bundle.only(agrees[first])
    order = np.argsort(np.minimum(errors, allowed)[:, agrees[first]].sum(axis=1), kind="stable")
    away = turned_by(starts[order[0]], starts[order]) > SAME_POSE_RAD
    tried = starts[[order[0], *order[away][:_SECOND_TRIES]]]
    while len(kept.markers) > 0:
        found = refine(tried, kept.points, kept.pixels, kept.whiten, camera)
        errors_px = found.marker_error_px[int(np.argmin(found.error_px))]
        worst = float(errors_px.max())
        if worst <= REPROJECTION_MAX_PX:
            break
        if len(kept.markers) == 1:
            raise _mismatch(bundle, worst)
        kept = kept.only(errors_px < worst)
    if 2 * len(kept.markers) <= len(bundle.markers):
        raise _mismatch(bundle, float(errors[first].max()))
    return _unstrained(kept, found, tried, camera, len(bundle.markers))


def _unstrained(
    kept: Bundle, found: Solutions, tried: Array, camera: CameraModel, count: int
) -> tuple[Bundle, Solutions]:
    """Leaves markers out that the others contradict beyond chance: a thin cover over an edge.

    Where no more than half had to go and the rest is still in contradiction, nothing is left out:
    then it is the fixture, or the camera, and the covariance grows with the residuals.
    """
    fewer, solved = kept, found
    while True:
        by_marker = strain(solved.poses[int(np.argmin(solved.error_px))], fewer, camera)
        if by_marker.sum() <= largest_by_chance(8 * len(by_marker) - 6):
            return fewer, solved
        if len(by_marker) < _LEAST_TO_CONTRADICT or 2 * (len(by_marker) - 1) <= count:
            return kept, found
        fewer = fewer.only(np.arange(len(by_marker)) != int(np.argmax(by_marker)))
        solved = refine(tried, fewer.points, fewer.pixels, fewer.whiten, camera)


def _solution(found: Solutions, number: int) -> _Solution:
    return found.poses[number], float(found.error_px[number]), found.covariance[number]


def _view(
    pose: Array, item: Observation, fixture: Fixture, quality: QualitySettings
) -> tuple[float, float, float]:
    """Returns E, theta and d of a marker by the pose of the workpiece."""
    angle, distance = angle_and_distance(pose @ fixture.T_workpiece_marker(item.id))
    return marker_quality(angle, distance, quality), angle, distance


def hidden_ids(
    pose: Array, seen: Sighting, camera: CameraModel, fixture: Fixture
) -> NDArray[np.int64]:
    """Returns the markers that should be seen by a pose, and are not, or in part only."""
    found = {*(item.id for item in seen.markers), *seen.duplicates, *seen.mirrored}
    found -= set(seen.partly)
    missing = [marker for marker in fixture.markers if marker.id not in found]
    if not missing:
        return np.zeros(0, dtype=np.int64)
    frames = np.array([pose @ fixture.T_workpiece_marker(marker.id) for marker in missing])
    sizes = np.array([marker.size_m for marker in missing])
    expected = clearly_seen(frames, sizes, camera)
    expected &= inside(marker_corners(frames, sizes), camera, _HIDDEN_RIM_PX)
    return np.array([marker.id for marker in missing], dtype=np.int64)[expected]


def _mismatch(bundle: Bundle, error_px: float) -> FixtureMismatchError:
    return FixtureMismatchError(
        f"the best pose leaves {error_px:.1f} px at markers {bundle.ids}; at most "
        f"{REPROJECTION_MAX_PX} px at more than half of them is accepted: the markers are not "
        f"where the fixture says"
    )


def _ambiguous(
    kept: Bundle, pose: Array, second: _Solution, error_px: float, accepted: float
) -> AmbiguousPoseError:
    apart = np.degrees(turned_by(pose, second[0]))
    return AmbiguousPoseError(
        f"markers {kept.ids} fit two poses {apart:.1f} deg apart with errors of "
        f"{error_px:.3f} and {second[1]:.3f} px; a ratio up to {accepted} is accepted: come "
        f"closer, look from aside, or show more markers"
    )


def _names(fixture: Fixture) -> str:
    ids: Sequence[int] = [marker.id for marker in fixture.markers]
    return f"{fixture.dictionary} ids {list(ids)}"
