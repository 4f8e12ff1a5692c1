"""For the trajectory checker: does the scanner look where a scan segment says, and how?

Tolerances: a listed point is looked at when it is within 3 mm of its depth and of the view axis,
and the view within the allowed tilt plus one degree. Between the points the view axis is followed
to the part by Embree, at every place that is 4 mm or half a degree from the one before: where it
hits, the depth is inside the scanner's range and the incidence below the limit, within 3 mm and one
degree. A pass that goes straight over a steep wall hits it at an angle that no trajectory can
help (other views are for that wall): between two points a trajectory may have what the straight
way between them has, or one 5 mm beside it, plus the same tolerance.
"""

import numpy as np
import trimesh

from skinplan.transforms import inverse

NEAR_M = 0.003
TURN_RAD = np.radians(1.0)
RAY_M = 0.004
DENSER = 8
RANGE_SPARE_M = 0.003
BESIDE_M = 0.005  # trajectories may be 2 mm beside the straight way, and turned by half a degree
INCIDENCE_SPARE_RAD = np.radians(1.0)


def scan_faults(arm, segment, path, T_arm_base_workpiece, mesh, settings, deviation_m):
    """What is wrong with a scan segment's views."""
    T_part_arm = inverse(T_arm_base_workpiece)
    when = segment.point_s
    there = T_part_arm @ arm.scanner(_at(segment, when))
    yield from _look_faults(segment, path, settings, there)
    times = _fine_times(arm, segment)
    views = T_part_arm @ arm.scanner(_at(segment, times))
    owner = np.clip(np.searchsorted(when, times, side="right") - 1, 0, max(len(when) - 2, 0))
    if len(when) > 1:
        yield from _deviation_faults(segment, there, times, views, owner, deviation_m)
    yield from _ray_faults(mesh, settings, segment, times, views, there, owner)


def _look_faults(segment, path, settings, there):
    points = segment.points
    gap = path.targets[points] - there[:, :3, 3]
    depth = np.einsum("ni,ni->n", gap, there[:, :3, 0])
    beside = np.linalg.norm(gap - depth[:, None] * there[:, :3, 0], axis=1)
    wanted = np.linalg.norm(path.targets[points] - path.positions[points], axis=1)
    cosine = np.einsum("ni,ni->n", there[:, :3, 0], path.directions[points])
    lean = np.arccos(np.clip(cosine, -1.0, 1.0))
    for number, point in enumerate(points):
        off = abs(depth[number] - wanted[number])
        if off > NEAR_M or beside[number] > NEAR_M:
            yield (
                f"point {point} is not looked at at its time: {1e3 * off:.1f} mm in depth, "
                f"{1e3 * beside[number]:.1f} mm beside"
            )
        elif lean[number] > settings.tilt_max_rad + TURN_RAD:
            yield f"point {point} is looked at under {np.degrees(lean[number]):.1f} degrees"


def _deviation_faults(segment, there, times, views, owner, deviation_m):
    start, end = there[owner, :3, 3], there[owner + 1, :3, 3]
    way = end - start
    length = np.maximum(np.einsum("ni,ni->n", way, way), 1e-18)
    gap = views[:, :3, 3] - start
    share = np.clip(np.einsum("ni,ni->n", gap, way) / length, 0.0, 1.0)
    off = np.linalg.norm(gap - share[:, None] * way, axis=1)
    if off.max() > deviation_m:
        worst = int(np.argmax(off))
        pair = segment.points[owner[worst]], segment.points[owner[worst] + 1]
        yield (
            f"the scanner is {1e3 * off[worst]:.1f} mm beside the straight way from point "
            f"{pair[0]} to point {pair[1]}, {times[worst]:.3f} s after the start"
        )


def _ray_faults(mesh, settings, segment, times, views, there, owner):
    caster = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).ray
    driven = _excess(caster, mesh, settings, views[:, :3, 3], views[:, :3, 0])
    # The same for the straight way between the two points, densely (a wall that faces away is a
    # narrow strip), and the worst for each pair.
    following = np.minimum(owner + 1, len(there) - 1)
    pair = np.repeat(np.arange(owner.max() + 1), DENSER * np.bincount(owner))
    share = np.concatenate([np.linspace(0.0, 1.0, DENSER * n) for n in np.bincount(owner) if n])
    change = there[np.minimum(pair + 1, len(there) - 1)] - there[pair]
    straight = there[pair] + change * share[:, None, None]
    axes = straight[:, :3, 0] / np.linalg.norm(straight[:, :3, 0], axis=1, keepdims=True)
    worst = np.zeros((owner.max() + 1, 2))
    # A ray just beside the way may meet the wall of a hole that the way itself misses.
    for turn in (None, *np.arange(8) * np.pi / 4.0):
        aside = np.zeros(3)
        if turn is not None:
            aside = BESIDE_M * np.array([0.0, np.cos(turn), np.sin(turn)])
        origins = straight[:, :3, 3] + straight[:, :3, :3] @ aside
        np.maximum.at(worst, pair, _excess(caster, mesh, settings, origins, axes))
    limit = np.where(worst > 0.0, worst + [RANGE_SPARE_M, INCIDENCE_SPARE_RAD], 0.0)[owner]
    texts = ("stand-off {:.4f} m outside the range", "incidence {:.3f} rad beyond the limit")
    for kind, text in enumerate(texts):
        wrong = np.flatnonzero(driven[:, kind] > limit[:, kind])
        if len(wrong):
            most = wrong[np.argmax(driven[wrong, kind])]
            ends = segment.points[owner[most]], segment.points[following[most]]
            yield (
                f"{text.format(driven[most, kind])} from point {ends[0]} to point {ends[1]}, "
                f"{times[most]:.3f} s after the start"
            )


def _excess(caster, mesh, settings, origins, axes):
    """How far depth [m] and incidence [rad] are beyond the limits, 0 = not, shape (n, 2)."""
    face, ray, place = caster.intersects_id(
        origins, axes, multiple_hits=False, return_locations=True
    )
    depth = np.einsum("ni,ni->n", place - origins[ray], axes[ray])
    corner = mesh.vertices[mesh.faces[face]]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    incidence = np.arccos(np.clip(-np.einsum("ni,ni->n", normal, axes[ray]), -1.0, 1.0))
    result = np.zeros((len(origins), 2))
    low, high = settings.range_min_m - RANGE_SPARE_M, settings.range_max_m + RANGE_SPARE_M
    result[ray, 0] = np.maximum(np.maximum(low - depth, depth - high), 0.0)
    limit = settings.incidence_max_rad + INCIDENCE_SPARE_RAD
    result[ray, 1] = np.maximum(incidence - limit, 0.0)
    return result


def _fine_times(arm, segment):
    """Times at which the scanner has gone `RAY_M` or turned half a degree, and the samples'."""
    T = arm.scanner(segment.positions)
    way = np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1)
    cosine = np.einsum("ni,ni->n", T[1:, :3, 0], T[:-1, :3, 0])
    turn = np.arccos(np.clip(cosine, -1.0, 1.0))
    counts = np.ceil(np.maximum(way / RAY_M, turn / np.radians(0.5))).astype(int)
    counts = np.maximum(counts, 1)
    pieces = [
        np.linspace(a, b, count, endpoint=False)
        for a, b, count in zip(segment.times, segment.times[1:], counts, strict=False)
    ]
    return np.append(np.concatenate(pieces), segment.times[-1])


def _at(segment, times):
    columns = [np.interp(times, segment.times, joint) for joint in segment.positions.T]
    return np.stack(columns, axis=1).reshape(-1, 6)
