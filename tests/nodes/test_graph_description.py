"""The README's tables and the parameter files agree with the running nodes; QoS fits everywhere."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from rclpy.qos import QoSCompatibility, qos_check_compatible

from nodes.bench import Bench
from nodes.graph_facts import NodeFacts, node_class, node_names, start_all
from nodes.small_part import write_small_part
from skinplan_nodes.graph import GraphSettings, describe
from skinplan_nodes.supervisor.devices import DEVICES, MOVING

PACKAGE = Path(__file__).resolve().parents[2] / "skinplan_nodes"
README = PACKAGE / "README.md"
NAMES = node_names()
_UNIT_SUFFIXES = ("_s", "_m", "_rad", "_hz", "_bytes")


@pytest.fixture(scope="module")
def facts(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, NodeFacts]]:
    folder = tmp_path_factory.mktemp("graph")
    bench = Bench()
    found = start_all(bench, write_small_part(folder), folder)
    yield {node.name: node for node in found}
    bench.close()
    assert not bench.failures


def section(name: str) -> str:
    """The README's section of a node."""
    text = README.read_text(encoding="utf-8")
    (found,) = re.findall(rf"^### `{name}`$(.*?)(?=^##|\Z)", text, re.MULTILINE | re.DOTALL)
    return found


def rows(text: str, heading: str) -> list[list[str]]:
    """The rows of the table whose first column has a heading."""
    lines = text.splitlines()
    begins = [i for i, line in enumerate(lines) if line.startswith(f"| {heading} |")]
    if not begins:
        return []
    table = []
    for line in lines[begins[0] + 2 :]:
        if not line.startswith("|"):
            break
        table.append([cell.strip().strip("`") for cell in line.strip("|").split(" | ")])
    return table


def test_every_node_has_its_section() -> None:
    text = README.read_text(encoding="utf-8")
    assert re.findall(r"^### `(\w+)`$", text, re.MULTILINE) == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_readme_lists_what_the_node_offers_and_uses(facts: dict[str, Any], name: str) -> None:
    wanted = [[e.role, e.name, e.kind, e.qos] for e in facts[name].endpoints]
    assert [row[:4] for row in rows(section(name), "role")] == wanted


@pytest.mark.parametrize("name", NAMES)
def test_readme_lists_the_parameters(name: str) -> None:
    found = [row[0] for row in rows(section(name), "parameter")]
    assert found == [parameter.name for parameter in node_class(name).PARAMETERS]


@pytest.mark.parametrize("name", NAMES)
def test_parameter_file_has_every_parameter_with_its_default(name: str) -> None:
    path = PACKAGE / "config" / f"{name}.yaml"
    (content,) = yaml.safe_load(path.read_text(encoding="utf-8")).values()
    wanted = {parameter.name: parameter.default for parameter in node_class(name).PARAMETERS}
    found = content["ros__parameters"]
    assert found == wanted
    # ROS takes no 1 for 1.0.
    assert {key: type(value) for key, value in found.items()} == {
        key: type(value) for key, value in wanted.items()
    }


def test_there_is_no_parameter_file_of_a_node_that_is_none() -> None:
    assert sorted(path.stem for path in (PACKAGE / "config").iterdir()) == sorted(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_parameters_are_described_with_unit_and_range(name: str) -> None:
    for parameter in node_class(name).PARAMETERS:
        assert parameter.description.endswith("."), parameter.name
        if isinstance(parameter.default, bool | str | list):
            continue
        assert re.search(r"\[[^\]]+\]", parameter.description), f"{parameter.name}: no unit"
        assert parameter.minimum is not None, f"{parameter.name}: no range"
        assert parameter.maximum is not None, f"{parameter.name}: no range"
        assert parameter.minimum <= parameter.default <= parameter.maximum, parameter.name
        if parameter.name.endswith(_UNIT_SUFFIXES):
            assert "[1]" not in parameter.description, parameter.name


def test_every_subscription_fits_to_every_publisher(facts: dict[str, Any]) -> None:
    ends = [(name, *item) for name, node in facts.items() for item in node.profiles]
    published = [end for end in ends if end[1].role == "publishes"]
    subscribed = [end for end in ends if end[1].role == "subscribes"]
    pairs = 0
    for subscriber, sub, wanted in subscribed:
        for publisher, pub, offered in published:
            if pub.name != sub.name:
                continue
            pairs += 1
            assert pub.kind == sub.kind, f"{sub.name}: {publisher} and {subscriber}"
            fits, reason = qos_check_compatible(offered, wanted)
            assert fits != QoSCompatibility.ERROR, (
                f"{sub.name}: {publisher} and {subscriber}: {reason}"
            )
    assert pairs >= 12


def test_every_subscription_and_call_has_somebody_who_answers(facts: dict[str, Any]) -> None:
    ends = [end for node in facts.values() for end in node.endpoints]
    served = {(e.name, e.kind) for e in ends if e.role in ("publishes", "serves")}
    used = {(e.name, e.kind) for e in ends if e.role in ("subscribes", "calls")}
    every_node = {
        ("heartbeat", "skinplan_msgs/msg/Heartbeat"),
        ("diagnostics", "diagnostic_msgs/msg/DiagnosticArray"),
    }
    # Drivers need not have these: the cell works with their actions alone.
    optional = {(f"{device}/state", "skinplan_msgs/msg/DeviceState") for device in DEVICES}
    optional |= {(f"{device}/reset", "std_srvs/srv/Trigger") for device in DEVICES}
    optional |= {(f"{device}/stop", "std_srvs/srv/Trigger") for device in MOVING}
    assert used - served - every_node <= optional


MOCKS = {
    node.name for node in describe(GraphSettings(Path("/runs"), "/part.yaml")) if node.simulated
}


def test_only_mocks_know_the_truth_and_only_mocks_fail_on_demand(facts: dict[str, Any]) -> None:
    ends = [(name, end) for name, node in facts.items() for end in node.endpoints]
    knowing = {name for name, end in ends if "truth" in end.name.split("/")}
    assert knowing and knowing <= MOCKS
    failing = {(name, end.role) for name, end in ends if end.name.endswith("inject_fault")}
    assert failing == {(name, "serves") for name in MOCKS}
    subscribed = {end.name for _, end in ends if end.role == "subscribes"}
    published = {end.name for name, end in ends if end.role == "publishes" and name in MOCKS}
    assert {name for name in published & subscribed if name.startswith("truth/")}, "they are used"


def test_no_module_of_the_cell_refers_to_a_mock() -> None:
    """Neither by import nor by name of a topic or node; the job client judges simulated runs."""
    judges = {"measure_client.py", "truth.py", "measure.py"}
    found = []
    for path in sorted(PACKAGE.glob("skinplan*/**/*.py")):
        is_mock = path.name.startswith("mock_") or path.parent.name == "mock"
        if is_mock or path.name in {"graph.py", *judges}:
            continue
        text = path.read_text(encoding="utf-8")
        if re.search(r"skinplan\.mock|\bmock_\w+|[\"']truth/", text):
            found.append(str(path.relative_to(PACKAGE)))
    assert found == []
