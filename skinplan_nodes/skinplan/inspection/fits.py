"""Spheres and planes through measured points: robust least squares of the distances (Tukey)."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skinplan.errors import InputError
from skinplan.inspection.points import SIGMA_OF_MAD, TUKEY, checked_points
from skinplan.transforms import Array

_LEAST_SIGMA_M = 1e-9
_ITERATIONS = 60
_DONE = 1e-12


@dataclass(frozen=True, eq=False)
class SphereFit:
    """A sphere through points.

    Attributes:
        centre: shape (3,) [m].
        diameter: [m].
        deviations: Signed distances of all points from the sphere, outside positive, shape (n,)
            [m].
        used: Which points count, the others are outliers, shape (n,).
        covariance: Of centre and diameter from the points' scatter, shape (4, 4) [m^2].
    """

    centre: Array
    diameter: float
    deviations: Array
    used: NDArray[np.bool_]
    covariance: Array

    @property
    def form_error(self) -> float:
        """Largest minus smallest deviation of the points that count [m]."""
        return float(np.ptp(self.deviations[self.used]))

    @property
    def rms(self) -> float:
        """Root mean square deviation of the points that count [m]."""
        return float(np.sqrt(np.mean(self.deviations[self.used] ** 2)))


@dataclass(frozen=True, eq=False)
class PlaneFit:
    """A plane through points.

    Attributes:
        point: Middle of the points that count, shape (3,) [m].
        normal: Unit normal, shape (3,); towards the origin of the points' frame, where the sensor
            is.
        deviations: Signed distances of all points, shape (n,) [m].
        used: Which points count, shape (n,).
    """

    point: Array
    normal: Array
    deviations: Array
    used: NDArray[np.bool_]

    @property
    def form_error(self) -> float:
        """Flatness: largest minus smallest deviation of the points that count [m]."""
        return float(np.ptp(self.deviations[self.used]))

    @property
    def rms(self) -> float:
        """Root mean square deviation of the points that count [m]."""
        return float(np.sqrt(np.mean(self.deviations[self.used] ** 2)))


def fit_sphere(points: Array) -> SphereFit:
    """Fits a sphere by the distances of the points from it.

    Args:
        points: shape (n >= 4, 3) [m].

    Raises:
        InputError: Fewer points, points that are not finite, or points that lie on a plane.
    """
    points = checked_points(points)
    _require(points, 4, "a sphere")
    middle = points.mean(axis=0)
    size = float(np.abs(points - middle).max())
    if size <= 0.0:
        raise InputError(f"a sphere through {len(points)} points: all of them are the same point")
    # In units of their extent about their middle: well conditioned wherever they are.
    scaled = (points - middle) / size
    start = _algebraic_sphere(scaled)

    def linearised(x: Array) -> tuple[Array, Array]:
        away = scaled - x[:3]
        distance = np.maximum(np.linalg.norm(away, axis=1), 1e-12)
        jacobian = np.column_stack([-away / distance[:, None], -np.ones(len(away))])
        return distance - x[3], jacobian

    x, weights = _robust(linearised, start, _LEAST_SIGMA_M / size)
    residuals, jacobian = linearised(x)
    to_diameter = size * np.diag([1.0, 1.0, 1.0, 2.0])
    covariance = to_diameter @ _covariance(residuals, jacobian, weights) @ to_diameter
    return SphereFit(
        middle + size * x[:3],
        float(2.0 * size * x[3]),
        residuals * size,
        weights > 0.0,
        covariance,
    )


def fit_plane(points: Array) -> PlaneFit:
    """Fits a plane by the distances of the points from it.

    Args:
        points: shape (n >= 3, 3) [m].

    Raises:
        InputError: Fewer points, points that are not finite, or points that lie on a line.
    """
    points = checked_points(points)
    _require(points, 3, "a plane")
    weights = np.ones(len(points))
    for _ in range(_ITERATIONS):
        middle = np.average(points, axis=0, weights=weights)
        away = points - middle
        spread, axes = np.linalg.eigh((weights[:, None] * away).T @ away)
        if spread[1] <= 1e-12 * spread[2]:
            raise InputError(f"a plane through {len(points)} points: they lie on one line")
        deviations = away @ axes[:, 0]
        before, weights = weights, _weights(deviations, _LEAST_SIGMA_M)
        if np.abs(weights - before).max() < 1e-9:
            break
    normal = axes[:, 0] if axes[:, 0] @ middle <= 0.0 else -axes[:, 0]
    return PlaneFit(middle, normal, away @ normal, weights > 0.0)


def _require(points: Array, least: int, what: str) -> None:
    if len(points) < least:
        raise InputError(
            f"{what} was asked; {least} points or more are accepted, found {len(points)}"
        )


def _algebraic_sphere(points: Array) -> Array:
    """Centre and radius by the linear equation ``|p|^2 = 2 c.p + (r^2 - |c|^2)``, shape (4,)."""
    matrix = np.column_stack([2.0 * points, np.ones(len(points))])
    found, _, rank, _ = np.linalg.lstsq(matrix, np.sum(points**2, axis=1), rcond=1e-10)
    if rank < 4:
        raise InputError(f"a sphere through {len(points)} points: they lie on one plane")
    return np.append(found[:3], np.sqrt(max(found[3] + found[:3] @ found[:3], 1e-12)))


def _robust(
    linearised: Callable[[Array], tuple[Array, Array]], start: Array, least_sigma: float
) -> tuple[Array, Array]:
    """Gauss-Newton with Tukey's weights; returns solution and weights.

    Raises:
        InputError: The points do not determine what is looked for.
    """
    x = start
    for _ in range(_ITERATIONS):
        residuals, jacobian = linearised(x)
        weights = _weights(residuals, least_sigma)
        matrix = (weights[:, None] * jacobian).T @ jacobian
        try:
            step = np.linalg.solve(matrix, -(weights[:, None] * jacobian).T @ residuals)
        except np.linalg.LinAlgError as error:
            raise InputError(
                f"a sphere through {len(residuals)} points: too few of them lie on one"
            ) from error
        x = x + step
        if np.abs(step).max() < _DONE:
            break
    return x, weights


def _covariance(residuals: Array, jacobian: Array, weights: Array) -> Array:
    """Covariance of an M-estimate: E[psi^2] / E[psi']^2 of the points that count."""
    used = weights > 0.0
    jacobian, residuals, root = jacobian[used], residuals[used], np.sqrt(weights[used])
    slope = root * (5.0 * root - 4.0)  # psi' = (1 - u^2) (1 - 5 u^2)
    free = max(len(residuals) - jacobian.shape[1], 1)
    scatter = float(np.sum((weights[used] * residuals) ** 2)) / free
    return np.asarray(scatter / np.mean(slope) ** 2 * np.linalg.inv(jacobian.T @ jacobian))


def _weights(residuals: Array, least_sigma: float) -> Array:
    sigma = max(SIGMA_OF_MAD * float(np.median(np.abs(residuals))), least_sigma)
    return np.asarray(np.clip(1.0 - (residuals / (TUKEY * sigma)) ** 2, 0.0, None) ** 2)
