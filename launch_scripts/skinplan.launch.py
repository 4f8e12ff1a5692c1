"""Starts the node graph with ``ros2 launch`` on a full ROS 2 installation.

``ros2 launch launch_scripts/skinplan.launch.py runs_folder:=/data/runs part:=/data/part.yaml``
starts the graph with the mock cell; without ``part`` the drivers of the real devices are started
elsewhere.
"""

from pathlib import Path

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, EmitEvent, OpaqueFunction, RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from skinplan_nodes.graph import PACKAGE, GraphSettings, NodeSpec, describe

ARGUMENTS = {
    "runs_folder": ("runs", "folder that gets the run folders"),
    "part": ("", "part file that stands in the mock cell; empty = real devices"),
    "cell_file": ("", "cell file; empty = the default cell"),
    "time_factor": ("1.0", "times faster than real time, mock cell only"),
    "seed": ("1", "seed of every random draw of the mock cell"),
    "namespace": ("", "namespace of all nodes"),
    "config_folder": ("", "folder of parameter files <node>.yaml; empty = the nodes' defaults"),
}


def generate_launch_description() -> LaunchDescription:
    """Returns the launch arguments and the function that makes the nodes from them."""
    arguments = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in ARGUMENTS.items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=_nodes)])


def _nodes(context: LaunchContext) -> list[Node | RegisterEventHandler]:
    given = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    settings = GraphSettings(
        runs_folder=Path(given["runs_folder"]).absolute(),
        part_uri=_absolute(given["part"]),
        cell_file=_absolute(given["cell_file"]),
        time_factor=float(given["time_factor"]),
        seed=int(given["seed"]),
    )
    actions: list[Node | RegisterEventHandler] = []
    for spec in describe(settings):
        node = _node(spec, given["namespace"], given["config_folder"])
        gone = EmitEvent(event=Shutdown(reason=f"node {spec.name} ended"))
        actions += [node, RegisterEventHandler(OnProcessExit(target_action=node, on_exit=[gone]))]
    return actions


def _node(spec: NodeSpec, namespace: str, config_folder: str) -> Node:
    config = Path(config_folder) / f"{spec.name}.yaml"
    files = [str(config)] if config_folder and config.is_file() else []
    return Node(
        package=PACKAGE,
        executable=spec.name,
        name=spec.name,
        namespace=namespace or None,
        parameters=[*files, dict(spec.parameters)],
        output="both",
    )


def _absolute(path: str) -> str:
    return str(Path(path).absolute()) if path else ""
