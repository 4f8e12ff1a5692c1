"""Of the tests of nodes: a bench of its own for each test."""

from collections.abc import Iterator

import pytest

from nodes.bench import Bench


@pytest.fixture
def bench() -> Iterator[Bench]:
    """A private ROS context; no thread of it may have failed."""
    found = Bench()
    yield found
    found.close()
    assert not found.failures
