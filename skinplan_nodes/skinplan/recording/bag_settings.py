"""How a bag is written."""

from dataclasses import dataclass


@dataclass(frozen=True)
class BagSettings:
    """How a bag is written.

    Attributes:
        compression: ``zstd``, ``lz4`` or ``none``.
        chunk_bytes: A chunk is closed when it is larger than this [B].
        flush_s: A chunk is closed and brought to the disk when it is older than this, wall time
            [s].
        ros_distro: Name of the ROS distribution whose types are recorded.
        split_bytes: The next file begins when one holds more than this behind its descriptions [B];
            0 = never.
        split_s: The next file begins when one holds more than this, log time [s]; 0 = never.
        least_free_bytes: So much stays free on the disk [B].
    """

    compression: str = "zstd"
    chunk_bytes: int = 2**20
    flush_s: float = 0.5
    ros_distro: str = "jazzy"
    split_bytes: int = 0
    split_s: float = 0.0
    least_free_bytes: int = 0
