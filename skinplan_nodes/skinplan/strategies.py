"""Strategies are chosen by name; a name that is none is answered with those that are."""

from collections.abc import Mapping
from typing import TypeVar

from skinplan.errors import StrategyUnknownError

Strategy = TypeVar("Strategy")


def chosen(kind: str, name: str, strategies: Mapping[str, Strategy]) -> Strategy:
    """Returns the strategy of a name.

    Args:
        kind: What it is a strategy for, as the message says it.
        name: The name asked for.
        strategies: All that there are.

    Raises:
        StrategyUnknownError: There is none of that name.
    """
    if name not in strategies:
        raise StrategyUnknownError(
            f"{kind} strategy {name!r} is not available; accepted are "
            f"{', '.join(sorted(strategies))}"
        )
    return strategies[name]
