"""What a node's program tells Fast DDS before its first participant. Needs no ROS."""

import os
from collections.abc import MutableMapping
from pathlib import Path

# Fast DDS 2 reads the first, 3 the second.
_VARIABLES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
_FOLDER = Path(__file__).parent


def use_profiles(
    large_messages: bool = False, environment: MutableMapping[str, str] = os.environ
) -> None:
    """Chooses the Fast DDS profiles of this process, unless the user has chosen some.

    A lost message is sent again within 0.1 s; by default Fast DDS asks what has arrived every 3 s,
    and all that follows waits for it. A process with messages of megabytes gets 32 MiB of shared
    memory: into the 512 KiB of the default a message of 1 MB does not fit, its pieces are dropped
    and sent again. That is so where ROS is kept to this machine: else the transports are not ours.

    Args:
        large_messages: The process publishes or takes messages of megabytes.
        environment: Environment variables, which Fast DDS reads when its first participant is made.
    """
    if any(environment.get(name) for name in _VARIABLES):
        return
    local = environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper() == "LOCALHOST"
    name = "fastdds_large.xml" if large_messages and local else "fastdds.xml"
    for variable in _VARIABLES:
        environment[variable] = str(_FOLDER / name)
