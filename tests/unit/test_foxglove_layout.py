"""The layout for Foxglove hangs together and names topics and fields that the graph has."""

import json
import re
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
LAYOUT = json.loads((ROOT / "docs" / "foxglove_layout.json").read_text(encoding="utf-8"))
README = (ROOT / "skinplan_nodes" / "README.md").read_text(encoding="utf-8")
# Of every node; the README says so once.
_COMMON = {"diagnostics": "diagnostic_msgs/msg/DiagnosticArray", "rosout": "rcl_interfaces/msg/Log"}


def published() -> dict[str, str]:
    rows = re.findall(r"^\| publishes \| `/?([\w/]+)` \| `([\w/]+)`", README, re.MULTILINE)
    return {**dict(rows), **_COMMON}


def panels(node: Any) -> list[str]:
    return [node] if isinstance(node, str) else panels(node["first"]) + panels(node["second"])


def test_every_panel_has_its_place_and_its_settings() -> None:
    assert sorted(panels(LAYOUT["layout"])) == sorted(LAYOUT["configById"])
    kinds = {name.split("!")[0] for name in LAYOUT["configById"]}
    assert kinds <= {
        "3D", "Image", "Plot", "StateTransitions", "DiagnosticSummary", "RosOut"
    }  # fmt: skip
    assert {"configById", "globalVariables", "userNodes", "playbackConfig", "layout"} == set(LAYOUT)


def test_topics_of_the_panels_are_published() -> None:
    topics = published()
    config = LAYOUT["configById"]
    named = set(config["3D!cell"]["topics"]) | {config["3D!cell"]["layers"]["robot"]["topic"]}
    named |= {
        config["Image!camera"]["imageMode"][key] for key in ("imageTopic", "calibrationTopic")
    }
    named |= {config["DiagnosticSummary!health"]["topicToRender"]}
    named |= {config["RosOut!log"]["topicToRender"]}
    assert {name.lstrip("/") for name in named} <= set(topics)
    views = {name for name in topics if name.startswith("view/")}
    assert {f"/{name}" for name in views} <= set(config["3D!cell"]["topics"])


def test_fields_of_the_plots_exist() -> None:
    topics = published()
    paths = [
        path["value"] for panel in LAYOUT["configById"].values() for path in panel.get("paths", ())
    ]
    assert len(paths) > 8
    for path in paths:
        topic, field = re.fullmatch(r"/([\w/]+)\.(\w+).*", path).groups()  # type: ignore[union-attr]
        package, _, kind = topics[topic].split("/")
        if package == "skinplan_msgs":
            text = (ROOT / "skinplan_msgs" / "msg" / f"{kind}.msg").read_text(encoding="utf-8")
            assert re.search(rf"^\S+ {field}\b", text, re.MULTILINE), path
