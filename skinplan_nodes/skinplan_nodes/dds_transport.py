"""Shared memory of Fast DDS for messages of megabytes. Needs no ROS."""

import os
from collections.abc import MutableMapping
from pathlib import Path

# Fast DDS 2 reads the first, 3 the second.
_VARIABLES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
_PROFILES = Path(__file__).with_name("fastdds.xml")


def use_large_shared_memory(environment: MutableMapping[str, str] = os.environ) -> None:
    """Gives the participants that this process will make 32 MiB of shared memory each.

    Fast DDS has 512 KiB: a message of 1 MB does not fit in, its pieces are dropped and sent again
    on request, which takes four times as long. Profiles that the user has chosen stay.

    Args:
        environment: Environment variables, which Fast DDS reads when its first participant is made.
    """
    if not any(environment.get(name) for name in _VARIABLES):
        for name in _VARIABLES:
            environment[name] = str(_PROFILES)
