"""Of the tests of nodes: a bench and a ROS domain of its own for each test."""

from collections.abc import Iterator

import pytest

from nodes.bench import Bench
from ros_domains import own_domain


@pytest.fixture(scope="module", autouse=True)
def _domain_of_the_module() -> Iterator[None]:
    """Nodes that another module has killed are not seen."""
    with own_domain():
        yield


@pytest.fixture
def bench() -> Iterator[Bench]:
    """A private ROS context; no thread of it may have failed."""
    with own_domain():
        found = Bench()
        yield found
        found.close()
        assert not found.failures
