"""Grubbs' two-sided test for outliers, its critical value computed (R4.1, eq (4))."""

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from skinplan.errors import InputError
from skinplan.transforms import Array

_FEWEST = 3


def grubbs_critical(count: int, confidence: float = 0.95, sides: int = 1) -> float:
    """Critical value of Grubbs' statistic.

    The tables that the publication takes G_95(100) = 3.207 from give the confidence of one side:
    the level of the t quantile is ``(1 - confidence) / count``. With two sides it is half of that.

    Args:
        count: Number of values.
        confidence: In (0, 1).
        sides: 1 as in the tables, 2 = the confidence holds for both sides together.

    Returns:
        ``(n - 1) / sqrt(n) * sqrt(t^2 / (n - 2 + t^2))``.

    Raises:
        InputError: Fewer than 3 values, or a confidence or number of sides that can't be.
    """
    if count < _FEWEST or not 0.0 < confidence < 1.0 or sides not in (1, 2):
        raise InputError(
            f"Grubbs' critical value was asked for {count} values, confidence {confidence}, "
            f"{sides} sides; at least {_FEWEST} values, a confidence in (0, 1), 1 or 2 sides are "
            "accepted"
        )
    quantile = float(student.ppf(1.0 - (1.0 - confidence) / (sides * count), count - 2))
    share = quantile**2 / (count - 2 + quantile**2)
    return (count - 1) / float(np.sqrt(count)) * float(np.sqrt(share))


def grubbs_statistic(values: Array) -> float:
    """Largest distance from the mean over the standard deviation, eq (4); 0 if all are equal."""
    deviation = np.abs(values - np.mean(values))
    sigma = float(np.std(values, ddof=1))
    return float(deviation.max() / sigma) if sigma > 0.0 else 0.0


def grubbs_outliers(values: Array, confidence: float = 0.95, sides: int = 1) -> NDArray[np.bool_]:
    """Finds outliers on both sides.

    Groups of outliers hide each other from a test that begins with all values: 18 of 100 make the
    standard deviation so large that none of them fails. So the test begins with the half about the
    median and takes values in, the nearest first, as long as each passes eq (4) among those taken
    in with it, at the critical value of their number. The first that fails is an outlier, and so
    are all farther ones.

    Args:
        values: shape (n,).
        confidence: Of the test.
        sides: As in `grubbs_critical`.

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
    away = np.abs(numbers - np.median(numbers))
    order = np.argsort(away, kind="stable")
    for count in range(max(_FEWEST, (len(numbers) + 1) // 2 + 1), len(numbers) + 1):
        taken = numbers[order[:count]]
        sigma = float(np.std(taken, ddof=1))
        statistic = abs(taken[-1] - taken.mean()) / sigma if sigma > 0.0 else 0.0
        if statistic > grubbs_critical(count, confidence, sides):
            outlier = np.zeros(len(numbers), dtype=bool)
            outlier[order[count - 1 :]] = True
            return outlier
    return np.zeros(len(numbers), dtype=bool)
