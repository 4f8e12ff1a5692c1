"""The state that latched topics had at a place of a bag.

A late subscriber of a latched topic (durability transient local) gets its last messages at once. A
player that starts in the middle owes its subscribers the same.
"""

from collections.abc import Mapping

from skinplan.recording.model import BagMessage, BagTopic
from skinplan.recording.reader import BagReader

# Topics that are latched by convention, also in bags that keep no QoS.
_BY_CONVENTION = ("tf_static", "robot_description")
# tf_static adds up: whatever was said before still holds.
_ADDING_UP = ("tf_static",)
_MOST = 1000


def latched_depth(topic: BagTopic) -> int:
    """Returns how many of a topic's last messages a late subscriber gets; 0 = not latched.

    Args:
        topic: The topic. Each latched publisher adds its depth; recorders often know none, and
            then each counts once.
    """
    last_name = topic.name.rsplit("/", 1)[-1]
    depth = sum(max(1, profile.depth) for profile in topic.qos if profile.latched)
    if last_name in _ADDING_UP:
        return max(1, min(topic.messages, _MOST))
    if not topic.qos and last_name in _BY_CONVENTION:
        return 1
    return min(depth, _MOST)


def latched_state(
    reader: BagReader, depths: Mapping[str, int], before_ns: int
) -> dict[str, list[BagMessage]]:
    """Returns what late subscribers of latched topics would have got just before a log time.

    Args:
        reader: The bag.
        depths: Topic -> how many of its last messages.
        before_ns: The log time; messages of that time itself are left out [ns since the epoch].

    Returns:
        Topic -> its messages in order; empty = nothing was published before.

    Raises:
        BagInvalidError: The bag is damaged.
    """
    return {topic: reader.last(topic, before_ns - 1, count) for topic, count in depths.items()}
