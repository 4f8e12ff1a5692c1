"""Grubbs' test: the critical value of the tables, planted outliers, clean sets."""

import numpy as np
import pytest

from skinplan.errors import InputError
from skinplan.recognition.grubbs import (
    grubbs_bound,
    grubbs_critical,
    grubbs_outliers,
    grubbs_statistic,
)


@pytest.mark.parametrize(
    ("count", "value"),
    # Published tables, one side, 95 %.
    [(3, 1.153), (10, 2.176), (20, 2.557), (50, 2.956), (100, 3.207)],
)
def test_the_critical_value_is_that_of_the_tables(count: int, value: float) -> None:
    assert grubbs_critical(count) == pytest.approx(value, abs=6e-4)


def test_the_closed_form_is_a_near_upper_bound() -> None:
    for count in (5, 20, 100):
        exact = grubbs_critical(count)
        assert exact - 1e-4 < grubbs_bound(count) < exact + 0.006
    # Small samples can't have two such deviations at once: the bound is exact.
    assert grubbs_bound(5) == pytest.approx(grubbs_critical(5), abs=1e-5)


def test_the_critical_value_is_what_samples_show() -> None:
    samples = np.random.default_rng(0).normal(size=(40_000, 30))
    statistic = (samples.max(axis=1) - samples.mean(axis=1)) / samples.std(axis=1, ddof=1)
    for confidence in (0.5, 0.95, 0.99):
        share = np.mean(statistic <= grubbs_critical(30, confidence))
        assert share == pytest.approx(confidence, abs=0.008)


def test_the_statistic_is_the_largest_deviation_in_sigmas() -> None:
    values = np.array([1.0, 2.0, 3.0, 10.0])
    assert grubbs_statistic(values) == pytest.approx((10.0 - 4.0) / np.std(values, ddof=1))
    assert grubbs_statistic(np.ones(5)) == 0.0


@pytest.mark.parametrize("seed", range(5))
def test_eighteen_planted_outliers_of_a_hundred_are_found(seed: int) -> None:
    rng = np.random.default_rng(seed)
    # Even quantiles: a clean set by construction.
    values = 0.6 + 0.1 * clean(82)
    planted = rng.choice([-1.0, 1.0], 18) * rng.uniform(1.0, 3.0, 18) + 0.6
    everything = np.concatenate([values, planted])
    order = rng.permutation(100)
    found = grubbs_outliers(everything[order])
    np.testing.assert_array_equal(found, order >= 82)


def test_outliers_that_hide_each_other_are_found() -> None:
    everything = np.concatenate([clean(82), np.full(18, 8.0)])
    # Against all values at once none of them would fail.
    assert grubbs_statistic(everything) < grubbs_critical(100)
    assert np.flatnonzero(grubbs_outliers(everything)).tolist() == list(range(82, 100))


def test_a_clean_set_has_none() -> None:
    assert not grubbs_outliers(clean(100)).any()
    assert not grubbs_outliers(np.full(10, 2.5)).any()
    rng = np.random.default_rng(0)
    hits = sum(grubbs_outliers(rng.normal(size=100)).any() for _ in range(200))
    # The table's value holds for one side; both together err twice as often.
    assert 0.04 < hits / 200 < 0.15


def test_what_can_not_be_tested_is_refused() -> None:
    with pytest.raises(InputError, match="finite values"):
        grubbs_outliers(np.array([1.0, np.nan, 2.0]))
    with pytest.raises(InputError, match="at least 3"):
        grubbs_outliers(np.array([1.0, 2.0]))
    with pytest.raises(InputError, match="confidence"):
        grubbs_critical(10, 1.5)


def clean(count: int) -> np.ndarray:
    """Quantiles of the normal distribution."""
    from scipy.stats import norm

    return norm.ppf((np.arange(count) + 0.5) / count)
