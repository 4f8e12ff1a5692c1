"""What every node of the graph offers and uses, read from the running nodes."""

import functools
import importlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rclpy.action import (
    get_action_client_names_and_types_by_node,
    get_action_server_names_and_types_by_node,
)
from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy

from nodes.bench import Bench
from skinplan.part.model import Part
from skinplan.recording.bag import BagWriter
from skinplan_nodes.graph import GraphSettings, describe
from skinplan_nodes.node import CellNodeMixin

# Of every node; the README says so once.
_COMMON = {
    "publishes": {"heartbeat", "diagnostics", "/rosout", "/parameter_events"},
    "subscribes": {"/clock"},
}
_LIFECYCLE = {"change_state", "get_state", "get_available_states", "get_available_transitions"}
_LIFECYCLE |= {"get_transition_graph", "transition_event"}
_PARAMETERS = {"describe_parameters", "get_parameter_types", "get_parameters", "list_parameters"}
_PARAMETERS |= {"set_parameters", "set_parameters_atomically", "get_type_description"}
NAMESPACE = "/cell"


@dataclass(frozen=True, order=True)
class Endpoint:
    """One thing that a node offers or uses.

    Attributes:
        role: publishes, subscribes, serves or calls.
        name: Relative name, or absolute where it begins with a slash.
        kind: ROS type.
        qos: reliable, latched or best effort; empty for services and actions.
    """

    role: str
    name: str
    kind: str
    qos: str = ""


@dataclass(frozen=True)
class NodeFacts:
    """One node.

    Attributes:
        name: Its name.
        kind: Its class.
        endpoints: What it offers and uses, sorted.
        profiles: QoS of each topic endpoint.
    """

    name: str
    kind: type[CellNodeMixin]
    endpoints: tuple[Endpoint, ...]
    profiles: tuple[tuple[Endpoint, QoSProfile], ...] = field(default=())


def node_class(name: str) -> Any:
    """Returns the class of a node by its name, e.g. ``sim_clock``."""
    module = importlib.import_module(f"skinplan_nodes.{name}")
    (found,) = (
        value
        for value in vars(module).values()
        if isinstance(value, type) and value.__dict__.get("NAME") == name
    )
    return found


def node_names() -> list[str]:
    """Returns the names of all nodes."""
    settings = GraphSettings(Path("/runs"), part_uri="/part.yaml")
    return [*(node.name for node in describe(settings)), "bag_player"]


def start_all(bench: Bench, part: Part, folder: Path) -> list[NodeFacts]:
    """Starts all nodes in the namespace ``/cell`` and reads what they offer."""
    with BagWriter(folder / "bag"):
        pass
    given = {
        "bag_player": {"bag": str(folder / "bag"), "exit_at_end": False},
        "cell_supervisor": {"runs_folder": str(folder / "runs"), "report": False},
    }
    found = []
    for name in node_names():
        kind = node_class(name)
        values: dict[str, Any] = dict(given.get(name, {}))
        if any(parameter.name == "part_uri" for parameter in kind.PARAMETERS):
            values["part_uri"] = str(part.source)
        node = bench.start(functools.partial(kind, namespace=NAMESPACE), simulated=False, **values)
        found.append(facts_of(node, kind))
    return found


def facts_of(node: Any, kind: Any) -> NodeFacts:
    """Reads what one node offers and uses."""
    topics = [
        (Endpoint(role, _relative(item.topic_name), _type(item.msg_type), _qos(item)), item)
        for role, items in (("publishes", node.publishers), ("subscribes", node.subscriptions))
        for item in items
    ]
    topics = [(end, item) for end, item in topics if not _is_common(end, node.get_name())]
    others = [
        Endpoint(role, _relative(item.srv_name), _type(item.srv_type))
        for role, items in (("serves", node.services), ("calls", node.clients))
        for item in items
    ]
    others += _actions(node, "serves", get_action_server_names_and_types_by_node)
    others += _actions(node, "calls", get_action_client_names_and_types_by_node)
    others = [end for end in others if not _is_common(end, node.get_name())]
    return NodeFacts(
        node.get_name(),
        kind,
        tuple(sorted({*(end for end, _ in topics), *others})),
        tuple((end, item.qos_profile) for end, item in topics),
    )


def _actions(node: Any, role: str, query: Any) -> list[Endpoint]:
    found = query(node, node.get_name(), node.get_namespace())
    return [Endpoint(role, _relative(name), kinds[0]) for name, kinds in found]


def _is_common(end: Endpoint, node: str) -> bool:
    if "/_action/" in end.name:  # parts of an action, which is listed as a whole
        return True
    last = end.name.rsplit("/", 1)[-1]
    own = end.name == f"{node}/{last}"
    return end.name in _COMMON.get(end.role, ()) or (own and last in _LIFECYCLE | _PARAMETERS)


def _relative(name: str) -> str:
    return name.removeprefix(f"{NAMESPACE}/")


def _type(kind: Any) -> str:
    package, section = kind.__module__.split(".")[:2]
    return f"{package}/{section}/{kind.__name__}"


def _qos(item: Any) -> str:
    profile = item.qos_profile
    if profile.durability == QoSDurabilityPolicy.TRANSIENT_LOCAL:
        return "latched"
    reliable = profile.reliability == QoSReliabilityPolicy.RELIABLE
    return "reliable" if reliable else "best effort"
