"""From views (position, direction, roll) to scanner and flange poses (M1.1, M2.1).

The paper's roll = 0 by yaw and pitch is singular for vertical views. Here roll is counted from a
frame that is turned to the view direction the shortest way from a reference direction, so the
singular view is the one opposite to the reference.
"""

import numpy as np

from skinplan.transforms import Array, inverse


def scanner_frames(
    positions: Array, directions: Array, rolls: Array | float, reference: Array
) -> Array:
    """Builds scanner poses, +x along the view direction.

    Args:
        positions: Scanner origins, shape (n, 3) [m].
        directions: Unit view directions, shape (n, 3).
        rolls: Turn about the view direction, shape (n,) or one number [rad].
        reference: Unit direction that rolls are counted from, shape (3,): the mean view direction
            of a station, say.

    Returns:
        Transforms from the scanner frame to the frame of the positions, shape (n, 4, 4) [m].
    """
    base = _frame_of(reference)
    turned = _shortest_turns(reference, directions) @ base
    cosine, sine = np.cos(rolls), np.sin(rolls)
    result = np.zeros((len(positions), 4, 4))
    result[:, :3, 0] = turned[:, :, 0]
    result[:, :3, 1] = (
        turned[:, :, 1] * np.atleast_1d(cosine)[:, None]
        + turned[:, :, 2] * np.atleast_1d(sine)[:, None]
    )
    result[:, :3, 2] = (
        turned[:, :, 2] * np.atleast_1d(cosine)[:, None]
        - turned[:, :, 1] * np.atleast_1d(sine)[:, None]
    )
    result[:, :3, 3] = positions
    result[:, 3, 3] = 1.0
    return result


def tool_poses(
    positions: Array,
    directions: Array,
    rolls: Array | float,
    T_tool0_scanner: Array,
    reference: Array,
) -> Array:
    """Builds flange poses, (n, 4, 4) [m], that bring the scanner to views (`scanner_frames`)."""
    return np.asarray(
        scanner_frames(positions, directions, rolls, reference) @ inverse(T_tool0_scanner)
    )


def mean_direction(directions: Array) -> Array:
    """Returns the mean of unit directions, shape (3,); the first one when they cancel out."""
    total = directions.sum(axis=0)
    length = float(np.linalg.norm(total))
    return np.asarray(total / length if length > 1e-6 * len(directions) else directions[0])


def tilted(directions: Array, angle_rad: float, count: int = 16) -> Array:
    """Returns views tilted by one angle to ``count`` sides, shape (n, count, 3)."""
    frames = _shortest_turns(np.array([1.0, 0.0, 0.0]), directions)
    turns = 2.0 * np.pi * np.arange(count) / count
    sideways = (
        np.cos(turns)[:, None] * frames[:, None, :, 1]
        + np.sin(turns)[:, None] * frames[:, None, :, 2]
    )
    return np.asarray(np.cos(angle_rad) * directions[:, None, :] + np.sin(angle_rad) * sideways)


def interpolate_directions(first: Array, second: Array, share: Array) -> Array:
    """Returns directions on great arcs between pairs, (n, 3), at shares of the way, (n,)."""
    angle = np.arccos(np.clip(np.einsum("ni,ni->n", first, second), -1.0, 1.0))
    sine = np.sin(angle)
    straight = sine < 1e-9
    safe = np.where(straight, 1.0, sine)
    a = np.where(straight, 1.0 - share, np.sin((1.0 - share) * angle) / safe)
    b = np.where(straight, share, np.sin(share * angle) / safe)
    result = a[:, None] * first + b[:, None] * second
    return np.asarray(result / np.linalg.norm(result, axis=1, keepdims=True))


def _frame_of(x: Array) -> Array:
    """A rotation whose first column is x, shape (3, 3); z as near to up as can be."""
    up = np.array([0.0, 0.0, 1.0]) if abs(x[2]) < 0.9 else np.array([1.0, 0.0, 0.0])
    y = np.cross(up, x)
    y /= np.linalg.norm(y)
    return np.stack([x, y, np.cross(x, y)], axis=1)


def _shortest_turns(start: Array, ends: Array) -> Array:
    """The shortest rotations from one unit vector to others, shape (n, 3, 3)."""
    cosine = ends @ start
    axis = np.cross(np.broadcast_to(start, ends.shape), ends)
    cross = np.zeros((len(ends), 3, 3))
    cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = -axis[:, 2], axis[:, 1], -axis[:, 0]
    cross -= np.swapaxes(cross, 1, 2)
    opposite = cosine < -1.0 + 1e-9
    scale = 1.0 / np.where(opposite, 1.0, 1.0 + cosine)
    result = np.eye(3) + cross + cross @ cross * scale[:, None, None]
    # Opposite to the start every half turn is shortest: one about the y axis of the start's own
    # frame.
    side = _frame_of(start)[:, 1]
    result[opposite] = 2.0 * np.outer(side, side) - np.eye(3)
    return np.asarray(result)
