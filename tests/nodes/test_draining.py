"""A burst of messages is taken in order, none twice, and nothing else has to wait for its end."""

import pytest
from rclpy.serialization import deserialize_message
from std_msgs.msg import UInt32

from nodes.bench import Bench
from skinplan_nodes.draining import subscribe_draining
from skinplan_nodes.qos import STATE


@pytest.mark.parametrize("raw", [False, True])
def test_a_burst_comes_in_order(bench: Bench, raw: bool) -> None:
    heard: list[int] = []

    def take(message: UInt32 | bytes) -> None:
        found = deserialize_message(message, UInt32) if raw else message
        heard.append(found.data)

    subscribe_draining(bench.tester, UInt32, "burst", take, STATE, raw=raw)
    publisher = bench.tester.create_publisher(UInt32, "burst", STATE)
    bench.wait(lambda: publisher.get_subscription_count() == 1)
    for number in range(400):
        publisher.publish(UInt32(data=number))
    bench.wait(lambda: len(heard) >= 400)
    assert heard == list(range(400))


def test_a_handler_may_end_its_subscription(bench: Bench) -> None:
    heard: list[int] = []

    def take(message: UInt32) -> None:
        heard.append(message.data)
        bench.tester.destroy_subscription(subscription)

    subscription = subscribe_draining(bench.tester, UInt32, "burst", take, STATE)
    publisher = bench.tester.create_publisher(UInt32, "burst", STATE)
    bench.wait(lambda: publisher.get_subscription_count() == 1)
    for number in range(20):
        publisher.publish(UInt32(data=number))
    bench.wait(lambda: heard and publisher.get_subscription_count() == 0)
    assert heard == [0]
