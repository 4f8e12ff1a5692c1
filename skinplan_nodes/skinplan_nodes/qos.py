"""Quality of service by name: published and subscribed with the same one."""

from rclpy.qos import QoSDurabilityPolicy, QoSHistoryPolicy, QoSProfile, QoSReliabilityPolicy


def _profile(depth: int, *, reliable: bool = True, latched: bool = False) -> QoSProfile:
    return QoSProfile(
        history=QoSHistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=(
            QoSReliabilityPolicy.RELIABLE if reliable else QoSReliabilityPolicy.BEST_EFFORT
        ),
        durability=(
            QoSDurabilityPolicy.TRANSIENT_LOCAL if latched else QoSDurabilityPolicy.VOLATILE
        ),
    )


#: Small streams: only the newest counts. Hears reliable publishers, too.
SENSOR = _profile(10, reliable=False)
#: Images: larger than the shared memory that DDS hands them over in; best effort loses 4 of 5.
IMAGE = _profile(5)
#: What must not get lost on the way: joint states, moving frames, scan frames, heartbeats.
STATE = _profile(500)
#: What holds until something new is published; a late subscriber gets the last one.
LATCHED = _profile(1, latched=True)
#: ``tf_static``: latched, of several publishers.
STATIC_TF = _profile(100, latched=True)

#: Services that many clients call at once: with the default of 10, the eleventh request or answer
#: that waits takes the place of the first, which is then never answered.
CALLS = _profile(500)

#: Every profile of topics by its name.
PROFILES = {
    "SENSOR": SENSOR,
    "IMAGE": IMAGE,
    "STATE": STATE,
    "LATCHED": LATCHED,
    "STATIC_TF": STATIC_TF,
}
