"""Markers that are partly hidden: where the others expect them, by the edges that are seen.

OpenCV reads a marker by all of its border; a strip over one side and it is not found. Markers that
are seen say where it is, to a fraction of a pixel. What of its edges lies there is fitted as of any
marker; of an edge that does not, its corners' covariance says that nothing is known.
"""

import logging
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from skinplan.errors import LocalizationError
from skinplan.localization.bundle import bundle_of, strain
from skinplan.localization.camera import project
from skinplan.localization.edge_lines import (
    bent,
    corner_covariance,
    fitted_lines,
    intersections,
    narrowest_px,
    straightened,
    without,
)
from skinplan.localization.edges import edge_points, looked_up, narrowest, profile_shape
from skinplan.localization.growth import drawn_in, edge_growth, lie_aside
from skinplan.localization.judge import observations
from skinplan.localization.model import (
    CameraModel,
    Detection,
    Observation,
    Sighting,
    WorkpiecePose,
)
from skinplan.localization.pose import hidden_ids, locate
from skinplan.localization.print_check import places_on, print_bits
from skinplan.localization.solve import largest_by_chance, refine
from skinplan.localization.square import square_corners
from skinplan.part.model import Fixture
from skinplan.robot.cell import QualitySettings
from skinplan.transforms import Array, apply, inverse

log = logging.getLogger(__name__)

# The others have to say where a corner is as well as this, one standard deviation [px].
_KNOWN_PX = 0.5
# An edge is where it is expected within so many of them and so many pixels; other edges are those
# of what covers it.
_SIGMAS, _NEAR_PX = 3.0, 0.3
# And its black and white are about as far apart as those of the clearest edge.
_LEAST_STEP_SHARE = 0.75
# Share of an edge's places that have to show it, and how many edges.
_LEAST_SHARE, _LEAST_EDGES = 0.3, 2
# Share of the places in the print that have to look as they should, the border left out: half of
# it covered by black or white leaves three quarters, another marker has about half.
_LEAST_PRINT = 0.7
_PLACES = np.array([0.3, 0.5, 0.7])
# An edge of a cover near that of a smaller marker can't be told from it [px].
_LEAST_SIDE_PX = 40.0
# How badly a hidden edge is known [px], and after how many rounds the others have settled.
_UNKNOWN_PX, _ROUNDS = 30.0, 4
# Images whose markers are known worse than this do not help to find others [px].
_WORST_FLOOR_PX = 0.1


def completed(
    seen: Sighting,
    found: Detection,
    grey: NDArray[np.uint8],
    book: cv2.aruco.Dictionary,
    camera: CameraModel,
    fixture: Fixture,
    quality: QualitySettings,
) -> Sighting:
    """Adds the fixture's markers that are partly hidden, where the others tell their place.

    Args:
        seen: The markers that were found.
        found: What the detector says of the image.
        grey: The image, shape (h, w).
        book: The dictionary.
        camera: The camera.
        fixture: Where the markers are.
        quality: Figures of eq (3).

    Returns:
        The sighting with `partly` and the markers it names; the same where none is added.
    """
    pose = _expected(seen, camera, fixture, quality)
    if pose is None:
        return seen
    light, parts = grey.astype(np.float32), []
    for marker_id in pose.hidden_ids.tolist():
        part = _in_part(light, marker_id, pose, book, camera, fixture)
        if part is not None:
            parts.append(part)
    if not parts:
        return seen
    ids, corners, covariance, floor = (np.array(item) for item in zip(*parts, strict=True))
    drawn = drawn_in(corners, found.growth_px) if found.growth_px else corners
    added = observations(Detection(ids, drawn, covariance, floor), camera, fixture, quality)
    added = _agreeing(seen, added, pose, camera, fixture)
    more = tuple(item.id for item in added)
    log.debug("markers %s are partly hidden", more)
    return replace(
        seen,
        markers=tuple(sorted([*seen.markers, *added], key=lambda item: item.id)),
        covered=tuple(i for i in seen.covered if i not in more),
        partly=more,
    )


def misses_any(seen: Sighting, camera: CameraModel, fixture: Fixture) -> bool:
    """Tells whether markers should be seen, by the largest one that is, and are not."""
    if not seen.markers:
        return False
    best = max(seen.markers, key=lambda item: narrowest_px(item.corners))
    rough = best.T_camera_marker @ inverse(fixture.T_workpiece_marker(best.id))
    return len(hidden_ids(rough, seen, camera, fixture)) > 0


def _agreeing(
    seen: Sighting,
    added: tuple[Observation, ...],
    pose: WorkpiecePose,
    camera: CameraModel,
    fixture: Fixture,
) -> tuple[Observation, ...]:
    """Leaves out again what contradicts the markers that are wholly seen."""
    known = tuple(item for item in seen.markers if item.id in pose.marker_ids)
    while added:
        bundle = bundle_of((*known, *added), fixture)
        start = pose.T_camera_workpiece[None]
        solved = refine(start, bundle.points, bundle.pixels, bundle.whiten, camera)
        by_marker = strain(solved.poses[0], bundle, camera)
        if by_marker.sum() <= largest_by_chance(8 * len(by_marker) - 6):
            break
        worst = int(np.argmax(by_marker[len(known) :]))
        added = (*added[:worst], *added[worst + 1 :])
    return added


def _expected(
    seen: Sighting, camera: CameraModel, fixture: Fixture, quality: QualitySettings
) -> WorkpiecePose | None:
    """Returns the pose by the markers that were found; None where no other marker is missed."""
    known = [item for item in seen.markers if item.corner_floor_px <= _WORST_FLOOR_PX]
    if not known:
        return None
    # Mostly none is missed, and then nothing has to be solved.
    if not misses_any(seen, camera, fixture):
        return None
    try:
        pose = locate(replace(seen, markers=tuple(known)), camera, fixture, quality)
    except LocalizationError:
        return None
    used = bundle_of(tuple(item for item in known if item.id in pose.marker_ids), fixture)
    by_marker = strain(pose.T_camera_workpiece, used, camera)
    if by_marker.sum() > largest_by_chance(8 * len(by_marker) - 6):
        # They contradict each other: what is expected may be wrong.
        return None
    left_out = {item.id for item in seen.markers}
    return replace(pose, hidden_ids=np.array([i for i in pose.hidden_ids if i not in left_out]))


def _in_part(
    light: NDArray[np.float32],
    marker_id: int,
    pose: WorkpiecePose,
    book: cv2.aruco.Dictionary,
    camera: CameraModel,
    fixture: Fixture,
) -> tuple[int, Array, Array, float] | None:
    """Returns id, corners, their covariance and floor of a marker by its visible edges."""
    size_m = next(marker.size_m for marker in fixture.markers if marker.id == marker_id)
    points = apply(fixture.T_workpiece_marker(marker_id), square_corners(size_m))
    ahead = apply(pose.T_camera_workpiece, points)
    known_px = _known_px(ahead, pose, camera)
    expected = project(ahead, camera)[None]
    if known_px > _KNOWN_PX or narrowest_px(expected[0]) < _LEAST_SIDE_PX:
        return None
    corners, cells = expected, int(book.markerSize) + 2
    bound = _SIGMAS * known_px + _NEAR_PX
    good: NDArray[np.bool_] | None = None
    for _ in range(_ROUNDS):
        # What covers the marker has edges of its own: those of the rounds before are out.
        places, good, shape = edge_points(light, corners, cells, near=True, allowed=good)
        good &= np.abs(_beside(places, expected)) < bound
        good &= shape[1] > _LEAST_STEP_SHARE * np.median(shape[1], axis=2).max()
        shown = good.mean(axis=2) >= _LEAST_SHARE
        if shown.sum() < _LEAST_EDGES:
            return None
        good &= shown[..., None]
        lines = fitted_lines(straightened(places, camera), good, 2)
        lines = without(lines, ~shown, straightened(expected, camera), _UNKNOWN_PX)
        crossing = intersections(lines.lines)
        corners = bent(crossing, camera)
        if not np.isfinite(corners).all():
            return None
    assert good is not None
    covariance = corner_covariance(crossing, lines)[0]
    values, step, _, reach = shape
    if not _shows_print(light, corners, book, marker_id, _level(values, good)):
        return None
    ids = np.array([marker_id])
    _, _, aside = edge_growth(light, ids, corners, book)
    if lie_aside(light, ids, corners, aside, book, camera)[0]:
        return None
    floor, _ = profile_shape(values, step, good, reach, narrowest(corners) / cells)
    return marker_id, corners[0], covariance, float(floor[0])


def _known_px(ahead: Array, pose: WorkpiecePose, camera: CameraModel) -> float:
    """Returns how well a pose tells the pixels of points, (4, 3), at its worst: one sigma [px]."""
    arm = ahead - pose.T_camera_workpiece[:3, 3]
    by_pose = np.zeros((len(ahead), 3, 6))
    by_pose[:, :, :3] = np.eye(3)
    for axis in range(3):
        by_pose[:, :, 3 + axis] = np.cross(np.eye(3)[axis], arm)
    z = ahead[:, 2]
    by_point = np.zeros((len(ahead), 2, 3))
    by_point[:, 0, 0] = by_point[:, 1, 1] = 1.0 / z
    by_point[:, :, 2] = -ahead[:, :2] / z[:, None] ** 2
    slope = camera.K[:2, :2] @ by_point @ by_pose
    spread = slope @ pose.covariance @ slope.swapaxes(1, 2)
    return float(np.sqrt(np.linalg.eigvalsh(spread).max()))


def _beside(places: Array, corners: Array) -> Array:
    """Returns how far places are beside the expected edges, shape (1, 4, a) [px]."""
    along = corners[:, [1, 2, 3, 0]] - corners
    normal = np.stack([along[..., 1], -along[..., 0]], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    return np.asarray(np.einsum("meax,mex->mea", places - corners[:, :, None], normal))


def _level(values: NDArray[np.float32], good: NDArray[np.bool_]) -> float:
    """Returns the grey value between black and white, by the edges that are seen."""
    return float(values[good].mean())


def _shows_print(
    light: NDArray[np.float32],
    corners: Array,
    book: cv2.aruco.Dictionary,
    marker_id: int,
    level: float,
) -> bool:
    """Tells whether enough of the print, its border left out, is there."""
    cells = int(book.markerSize) + 2
    white = np.frombuffer(print_bits(book, marker_id), dtype=bool).reshape(cells, cells)
    inner = white[1:-1, 1:-1].repeat(len(_PLACES), axis=0).repeat(len(_PLACES), axis=1)
    at = ((np.arange(1, cells - 1)[:, None] + _PLACES) / cells).ravel()
    values = looked_up(light, places_on(corners, at[None, None, :], at[None, :, None]))[0]
    return bool(np.mean((values > level) == inner) >= _LEAST_PRINT)
