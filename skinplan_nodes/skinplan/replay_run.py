"""Plays a bag into the graph: starts the node ``bag_player`` as a program of its own."""

import importlib.util
import json
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from skinplan.errors import InputError, SkinplanError

ParameterValue = str | float | bool | Sequence[str]


def require_nodes() -> None:
    """Refuses what needs the nodes where they are not installed.

    Raises:
        InputError: The nodes are not installed.
    """
    if importlib.util.find_spec("rclpy") is None:
        raise InputError(
            "a replay needs the Python module rclpy, which is not installed; "
            "`make setup` installs it"
        )


def replay_bag(
    bag: Path, parameters: Mapping[str, ParameterValue], remappings: Sequence[str] = ()
) -> bool:
    """Plays a bag to its end.

    Args:
        bag: Bag folder or storage file.
        parameters: Of the node ``bag_player``.
        remappings: Topics under other names, each ``old:=new``.

    Returns:
        True when it was played to its end, False when it was interrupted.

    Raises:
        InputError: The nodes are not installed, or a remapping is none.
        SkinplanError: The player failed; its log is on stderr.
    """
    require_nodes()
    command = [sys.executable, "-P", "-m", "skinplan_nodes.bag_player", "--ros-args"]
    for name, value in {**parameters, "bag": str(bag.absolute())}.items():
        command += ["-p", f"{name}:={_text(value)}"]
    for remapping in remappings:
        old, mark, new = remapping.partition(":=")
        if not (old and mark and new):
            raise InputError(f"the remapping {remapping!r} was asked for; old:=new is accepted")
        command += ["-r", remapping]
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


def _text(value: ParameterValue) -> str:
    """Returns a value as the YAML of a ROS argument; JSON is that, too."""
    return json.dumps(value if isinstance(value, str | bool | float | int) else list(value))
