"""Plays a bag into the graph: starts the node ``bag_player`` as a program of its own."""

import importlib.util
import signal
import subprocess
import sys
from pathlib import Path

from skinplan.errors import InputError, SkinplanError


def replay_bag(bag: Path, rate: float, start_s: float) -> bool:
    """Plays a bag to its end.

    Args:
        bag: Bag folder or MCAP file.
        rate: Times faster than recorded.
        start_s: Offset of the begin [s].

    Returns:
        True when it was played to its end, False when it was interrupted.

    Raises:
        InputError: The nodes are not installed.
        SkinplanError: The player failed; its log is on stderr.
    """
    if importlib.util.find_spec("rclpy") is None:
        raise InputError(
            "a replay needs the Python module rclpy, which is not installed; "
            "`make setup` installs it"
        )
    parameters = {
        "bag": bag.absolute(),
        "rate": float(rate),
        "start_offset_s": float(start_s),
        "exit_at_end": "true",
    }
    command = [sys.executable, "-P", "-m", "skinplan_nodes.bag_player", "--ros-args"]
    for name, value in parameters.items():
        command += ["-p", f"{name}:={value}"]
    player = subprocess.Popen(command, stdout=sys.stderr)
    try:
        code = player.wait()
    except KeyboardInterrupt:
        player.send_signal(signal.SIGINT)
        player.wait()
        return False
    if code != 0:
        raise SkinplanError(f"the bag player ended with code {code}; its log above says why")
    return True
