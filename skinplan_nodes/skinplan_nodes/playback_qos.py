"""The QoS with which a recorded topic is published again."""

from collections.abc import Callable

from rclpy.duration import Duration
from rclpy.qos import (
    QoSDurabilityPolicy,
    QoSHistoryPolicy,
    QoSLivelinessPolicy,
    QoSProfile,
    QoSReliabilityPolicy,
)

from skinplan.recording.latched import latched_depth
from skinplan.recording.model import BagTopic
from skinplan.recording.qos import INFINITE_NS
from skinplan.recording.qos import QosProfile as RecordedQos

# A player that is faster than its subscribers must not lose what is on the way.
_DEPTH = 100
_LIVELINESS = {
    "automatic": QoSLivelinessPolicy.AUTOMATIC,
    "manual_by_topic": QoSLivelinessPolicy.MANUAL_BY_TOPIC,
}


def profile_to_play(
    topic: BagTopic, override: Callable[[RecordedQos], RecordedQos] | None = None
) -> RecordedQos:
    """Returns the profile to offer: one that satisfies whoever subscribed any recorded publisher.

    Args:
        topic: A recorded topic.
        override: What the person wants to be different.
    """
    depth = latched_depth(topic)
    recorded = topic.qos
    any_reliable = any(profile.reliability != "best_effort" for profile in recorded)
    made = RecordedQos(
        depth=depth or max([_DEPTH, *(profile.depth for profile in recorded)]),
        reliability="reliable" if any_reliable or not recorded else "best_effort",
        durability="transient_local" if depth else "volatile",
        # The slowest publisher's promises are what every subscriber was content with.
        deadline_ns=max((_limit(p.deadline_ns) for p in recorded), default=INFINITE_NS),
        lifespan_ns=max((_limit(p.lifespan_ns) for p in recorded), default=INFINITE_NS),
        liveliness=recorded[0].liveliness if recorded else "automatic",
        liveliness_lease_ns=max(
            (_limit(p.liveliness_lease_ns) for p in recorded), default=INFINITE_NS
        ),
    )
    return made if override is None else override(made)


def ros_profile(profile: RecordedQos) -> QoSProfile:
    """Converts a profile for a publisher."""
    return QoSProfile(
        history=(
            QoSHistoryPolicy.KEEP_ALL
            if profile.history == "keep_all"
            else QoSHistoryPolicy.KEEP_LAST
        ),
        depth=profile.depth or _DEPTH,
        reliability=(
            QoSReliabilityPolicy.BEST_EFFORT
            if profile.reliability == "best_effort"
            else QoSReliabilityPolicy.RELIABLE
        ),
        durability=(
            QoSDurabilityPolicy.TRANSIENT_LOCAL if profile.latched else QoSDurabilityPolicy.VOLATILE
        ),
        deadline=_duration(profile.deadline_ns),
        lifespan=_duration(profile.lifespan_ns),
        liveliness=_LIVELINESS.get(profile.liveliness, QoSLivelinessPolicy.AUTOMATIC),
        liveliness_lease_duration=_duration(profile.liveliness_lease_ns),
        avoid_ros_namespace_conventions=profile.avoid_ros_namespace_conventions,
    )


def _limit(nanoseconds: int) -> int:
    # Recorders write 0 where nothing was said.
    return nanoseconds or INFINITE_NS


def _duration(nanoseconds: int) -> Duration:
    return Duration(nanoseconds=0 if nanoseconds >= INFINITE_NS else nanoseconds)
