"""Subscriptions of topics with many small messages: all that wait are taken at one wake.

The executor looks at every subscription, timer and service of a node for each message: 0.2 to 0.3
ms. In fast time messages come in bursts, one per tick of the clock; taking the whole burst costs a
tenth of that.
"""

from collections.abc import Callable
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.exceptions import InvalidHandle
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription

# Then everything else has its turn.
_MOST_AT_ONCE = 100


def subscribe_draining(
    node: Node,
    kind: Any,
    topic: str,
    handler: Callable[[Any], None],
    qos: QoSProfile,
    group: CallbackGroup | None = None,
    *,
    raw: bool = False,
) -> "Subscription[Any]":
    """Subscribes a topic; the handler gets each message, in order.

    Args:
        node: The node.
        kind: Type of the messages.
        topic: The topic.
        handler: Called with each message.
        qos: Quality of service.
        group: Callback group; None = the node's own.
        raw: The handler gets serialised messages.
    """

    def on_first(message: Any) -> None:
        handler(message)
        for _ in range(_MOST_AT_ONCE):
            try:
                with subscription.handle:
                    taken = subscription.handle.take_message(kind, raw)
            except InvalidHandle:
                # The handler ended the subscription.
                return
            if taken is None:
                return
            handler(taken[0])

    subscription: Subscription[Any] = node.create_subscription(
        kind, topic, on_first, qos, callback_group=group, raw=raw
    )
    return subscription
