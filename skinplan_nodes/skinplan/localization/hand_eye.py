"""Hand-eye calibration: where the camera is in the arm base (``T_b_c`` of eq (1), M1.1).

The camera stands beside the arm and sees a marker that the flange carries. All methods are tried;
the one whose calibration explains pairs best that it has not seen is chosen.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from skinplan.errors import InputError
from skinplan.localization.hand_eye_methods import SOLVERS, Solver
from skinplan.transforms import Array, difference, inverse, transform

LEAST_PAIRS = 6
MOST_PAIRS = 5000
# Turns of the flange below this tell nothing, and their axes must not be parallel.
_LEAST_TURN_RAD = float(np.radians(10.0))
_LEAST_AXES = 0.05
_FOLDS = 5
# Pairs whose residual is so many times the median are mistakes.
_OUTLIER = 5.0
# Verdict by the residual of held-out pairs, root mean square.
GOOD_M, GOOD_RAD = 0.001, float(np.radians(0.1))
POOR_M, POOR_RAD = 0.005, float(np.radians(0.5))


@dataclass(frozen=True, eq=False)
class PosePair:
    """One stand of the arm.

    Attributes:
        T_arm_base_tool0: Flange in the arm base, shape (4, 4) [m].
        T_camera_marker: Marker in the camera's optical frame, shape (4, 4) [m].
    """

    T_arm_base_tool0: Array
    T_camera_marker: Array


@dataclass(frozen=True, eq=False)
class HandEye:
    """A calibration.

    Attributes:
        T_arm_base_camera: T_b_c, shape (4, 4) [m].
        T_tool0_marker: Where the marker is on the flange, shape (4, 4) [m].
        method: Name of the method.
        held_out_m: Residual of pairs that the method had not seen, root mean square [m].
        held_out_rad: The same of the rotation [rad].
        residual_m: Of each pair with the final calibration, shape (n,) [m]; NaN = left out.
        residual_rad: shape (n,) [rad].
        outliers: Numbers of the pairs that were left out.
        methods: Held-out residuals (m, rad) by method, NaN = it failed.
        verdict: good, doubtful or poor.
    """

    T_arm_base_camera: Array
    T_tool0_marker: Array
    method: str
    held_out_m: float
    held_out_rad: float
    residual_m: NDArray[np.float64]
    residual_rad: NDArray[np.float64]
    outliers: tuple[int, ...]
    methods: dict[str, tuple[float, float]]
    verdict: str


def calibrate(pairs: Sequence[PosePair]) -> HandEye:
    """Finds the camera in the arm base.

    Args:
        pairs: Stands of the arm, at least `LEAST_PAIRS`, turned about two axes or more.

    Raises:
        InputError: Too few or too many pairs, or they do not determine the calibration.
    """
    if not LEAST_PAIRS <= len(pairs) <= MOST_PAIRS:
        raise InputError(
            f"a hand-eye calibration of {len(pairs)} pairs was asked for; {LEAST_PAIRS} to "
            f"{MOST_PAIRS} are accepted"
        )
    _require_turns(pairs)
    kept = list(range(len(pairs)))
    first = _best(pairs)
    outliers = _outliers(pairs, first[1])
    if outliers and len(pairs) - len(outliers) >= LEAST_PAIRS:
        kept = [k for k in kept if k not in outliers]
        first = _best([pairs[k] for k in kept])
    else:
        outliers = ()
    method, T_arm_base_camera, methods = first
    used = [pairs[k] for k in kept]
    T_tool0_marker = _marker_on_tool(used, T_arm_base_camera)
    residuals = np.full((len(pairs), 2), np.nan)
    residuals[kept] = _residuals(used, T_arm_base_camera, T_tool0_marker)
    held_out = methods[method]
    return HandEye(
        T_arm_base_camera,
        T_tool0_marker,
        method,
        *held_out,
        residuals[:, 0],
        residuals[:, 1],
        outliers,
        methods,
        _verdict(*held_out),
    )


def _best(pairs: Sequence[PosePair]) -> tuple[str, Array, dict[str, tuple[float, float]]]:
    """Returns the best method by held-out pairs, its calibration, and all methods' residuals."""
    scores = {name: _held_out(pairs, solver) for name, solver in SOLVERS.items()}
    # A radian weighs like the metre at which the part stands.
    sums = {name: m + rad for name, (m, rad) in scores.items() if np.isfinite(m + rad)}
    if not sums:
        raise InputError(
            "none of the methods finds a calibration; pairs with turns of the flange about "
            "different axes are accepted"
        )
    name = min(sums, key=lambda key: sums[key])
    return name, _solved(SOLVERS[name], pairs), scores


def _solved(solver: Solver, pairs: Sequence[PosePair]) -> Array:
    flange = np.array([pair.T_arm_base_tool0 for pair in pairs])
    return solver(flange, np.array([pair.T_camera_marker for pair in pairs]))


def _held_out(pairs: Sequence[PosePair], solver: Solver) -> tuple[float, float]:
    """Root mean square residual of pairs in turn left out, distance [m] and angle [rad]."""
    order = np.random.default_rng(0).permutation(len(pairs))
    found = []
    for fold in np.array_split(order, min(_FOLDS, len(pairs))):
        training = [pairs[k] for k in range(len(pairs)) if k not in fold]
        try:
            T_arm_base_camera = _solved(solver, training)
            T_tool0_marker = _marker_on_tool(training, T_arm_base_camera)
        except (InputError, ValueError, np.linalg.LinAlgError):
            return float("nan"), float("nan")
        found.append(_residuals([pairs[k] for k in fold], T_arm_base_camera, T_tool0_marker))
    distance, angle = np.sqrt(np.mean(np.concatenate(found) ** 2, axis=0))
    return float(distance), float(angle)


def _residuals(pairs: Sequence[PosePair], T_arm_base_camera: Array, T_tool0_marker: Array) -> Array:
    """Returns how far the marker is from where the flange carries it, shape (n, 2) [m, rad]."""
    return np.array(
        [
            difference(
                pair.T_arm_base_tool0 @ T_tool0_marker, T_arm_base_camera @ pair.T_camera_marker
            )
            for pair in pairs
        ]
    )


def _marker_on_tool(pairs: Sequence[PosePair], T_arm_base_camera: Array) -> Array:
    poses = np.array(
        [inverse(p.T_arm_base_tool0) @ T_arm_base_camera @ p.T_camera_marker for p in pairs]
    )
    turn = Rotation.from_matrix(poses[:, :3, :3]).mean().as_matrix()
    return transform(np.median(poses[:, :3, 3], axis=0), turn)


def _outliers(pairs: Sequence[PosePair], T_arm_base_camera: Array) -> tuple[int, ...]:
    residuals = _residuals(pairs, T_arm_base_camera, _marker_on_tool(pairs, T_arm_base_camera))
    bound = _OUTLIER * np.maximum(np.median(residuals, axis=0), 1e-6)
    return tuple(int(k) for k in np.flatnonzero((residuals > bound).any(axis=1)))


def _require_turns(pairs: Sequence[PosePair]) -> None:
    """Refuses pairs that leave the calibration undetermined."""
    turns = [
        Rotation.from_matrix(
            pairs[0].T_arm_base_tool0[:3, :3].T @ pair.T_arm_base_tool0[:3, :3]
        ).as_rotvec()
        for pair in pairs[1:]
    ]
    large = np.array([turn for turn in turns if np.linalg.norm(turn) > _LEAST_TURN_RAD])
    axes = large / np.linalg.norm(large, axis=1, keepdims=True) if len(large) else large
    spread = np.linalg.svd(axes)[1] if len(axes) > 1 else np.zeros(2)
    if len(axes) < 2 or spread[1] ** 2 / len(axes) < _LEAST_AXES:
        raise InputError(
            f"a hand-eye calibration was asked for, but {len(large)} of {len(pairs) - 1} stands "
            f"are turned by more than {np.degrees(_LEAST_TURN_RAD):.0f} deg against the first, "
            f"about one axis only; turns about two axes or more are accepted"
        )


def _verdict(distance_m: float, angle_rad: float) -> str:
    if distance_m <= GOOD_M and angle_rad <= GOOD_RAD:
        return "good"
    return "doubtful" if distance_m <= POOR_M and angle_rad <= POOR_RAD else "poor"
