"""Grubbs' test for outliers on both sides, its critical value computed (R4.1, eq (4)).

The publication takes G_95(100) = 3.207 from a table. The usual closed form with a quantile of the t
distribution is an upper bound, 3.2095 for 100 values; the table holds the exact quantile. It comes
from a recursion: that the largest of n values deviates by g, the others must not deviate more.
Their statistic does not depend on g, and a single deviation is distributed by t with n - 2 degrees
of freedom.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.stats import t as student

from skinplan.errors import InputError
from skinplan.transforms import Array

_FEWEST, _MOST = 3, 1000
# Points of a distribution, and the range that they are in: the least deviation of the largest of
# any number of values is 1 / sqrt(count), but for four and more none below the first is likely.
_GRID, _RANGE = 6000, (0.05, 7.0)


def grubbs_critical(count: int, confidence: float = 0.95) -> float:
    """Critical value of Grubbs' statistic, as in the tables: exact for one side.

    Args:
        count: Number of values, 3 to 1000.
        confidence: In (0, 1).

    Returns:
        The quantile of ``max(x_i - mean) / sigma`` of a normal sample.

    Raises:
        InputError: Another number of values or confidence.
    """
    _check(count, confidence)
    statistic, chance = _distribution(count)
    return float(np.interp(confidence, chance, statistic))


def grubbs_bound(count: int, confidence: float = 0.95) -> float:
    """Upper bound of the critical value, ``(n - 1) / sqrt(n) * sqrt(t^2 / (n - 2 + t^2))``.

    Args:
        count: Number of values n, 3 to 1000.
        confidence: In (0, 1); t is the quantile at ``1 - (1 - confidence) / n``.

    Raises:
        InputError: Another number of values or confidence.
    """
    _check(count, confidence)
    quantile = float(student.ppf(1.0 - (1.0 - confidence) / count, count - 2))
    share = quantile**2 / (count - 2 + quantile**2)
    return (count - 1) / float(np.sqrt(count)) * float(np.sqrt(share))


def grubbs_statistic(values: Array) -> float:
    """Largest distance from the mean over the standard deviation, eq (4); 0 if all are equal."""
    deviation = np.abs(values - np.mean(values))
    sigma = float(np.std(values, ddof=1))
    return float(deviation.max() / sigma) if sigma > 0.0 else 0.0


def grubbs_outliers(values: Array, confidence: float = 0.95) -> NDArray[np.bool_]:
    """Finds outliers on both sides.

    Groups of outliers hide each other from a test that begins with all values: 18 of 100 make the
    standard deviation so large that none of them fails. So the test begins with the half about the
    median and takes values in, the nearest first, as long as each passes eq (4) among those taken
    in with it, at the critical value of their number. The first that fails is an outlier, and so
    are all farther ones.

    Args:
        values: shape (n,).
        confidence: Of the test, as in `grubbs_critical`.

    Returns:
        Which are outliers, shape (n,).

    Raises:
        InputError: Fewer than 3 values, or some that are not finite.
    """
    numbers = np.asarray(values, dtype=float)
    if numbers.ndim != 1 or len(numbers) < _FEWEST or not np.isfinite(numbers).all():
        raise InputError(
            f"outliers were asked for; at least {_FEWEST} finite values are accepted, found shape "
            f"{numbers.shape} with {np.count_nonzero(~np.isfinite(numbers))} that are not finite"
        )
    order = np.argsort(np.abs(numbers - np.median(numbers)), kind="stable")
    for count in range(max(_FEWEST, len(numbers) // 2 + 1), len(numbers) + 1):
        taken = numbers[order[:count]]
        sigma = float(np.std(taken, ddof=1))
        statistic = abs(taken[-1] - taken.mean()) / sigma if sigma > 0.0 else 0.0
        if statistic > grubbs_critical(count, confidence):
            outlier = np.zeros(len(numbers), dtype=bool)
            outlier[order[count - 1 :]] = True
            return outlier
    return np.zeros(len(numbers), dtype=bool)


def _check(count: int, confidence: float) -> None:
    if not _FEWEST <= count <= _MOST or not 0.0 < confidence < 1.0:
        raise InputError(
            f"Grubbs' critical value was asked for {count} values and confidence {confidence}; "
            f"{_FEWEST} to {_MOST} values and a confidence in (0, 1) are accepted"
        )


@lru_cache(maxsize=_MOST)
def _distribution(count: int) -> tuple[Array, Array]:
    """Values of the statistic and the chance that it is not above, shapes (k,)."""
    # Of three values the largest deviates by 2 / sqrt(3) sin(angle), the angle even over 30 to 90
    # degrees.
    angle = np.linspace(np.pi / 6.0, np.pi / 2.0, _GRID)
    statistic, chance = 2.0 / np.sqrt(3.0) * np.sin(angle), 3.0 / np.pi * angle - 0.5
    for n in range(4, count + 1):
        statistic, chance = _one_more(n, statistic, chance)
    return statistic, chance


def _one_more(n: int, statistic: Array, chance: Array) -> tuple[Array, Array]:
    """The distribution for n values from that for n - 1."""
    # Over the angle the density is smooth even at the largest deviation possible.
    most = (n - 1) / np.sqrt(n)
    first, last = np.arcsin(np.clip(np.array(_RANGE) / most, 0.0, 1.0))
    angle = np.linspace(first, last, _GRID)
    deviation = most * np.sin(angle)
    # Squared sigma of the others, in units of that of all.
    rest = ((n - 1) - n * deviation**2 / (n - 1)) / (n - 2)
    with np.errstate(divide="ignore", invalid="ignore"):
        others = np.where(rest > 1e-12, deviation * n / (n - 1) / np.sqrt(rest), np.inf)
    below = np.interp(others, statistic, chance, left=0.0, right=1.0)
    # A single deviation: t = sqrt(n - 2) tan(angle), of which this is the density by the angle.
    scale = student.pdf(0.0, n - 2) * np.sqrt(n - 2)
    density = scale * np.cos(angle) ** (n - 3)
    found = cumulative_trapezoid(n * density * below, angle, initial=0.0)
    return deviation, found / found[-1]
