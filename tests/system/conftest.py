"""Of the tests of the whole graph: the reference MES client in this process."""

from collections.abc import Iterator

import pytest
import rclpy

from mes_orders import MesClient


@pytest.fixture
def client() -> Iterator[MesClient]:
    """Speaks for the operator Anna."""
    rclpy.init(args=[])
    found = MesClient("Anna", patience_s=120.0)
    yield found
    found.node.destroy_node()
    rclpy.try_shutdown()
