"""The two starters read one description of the graph."""

import importlib
import importlib.util
import os
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import yaml

from skinplan_nodes.graph import GraphSettings, NodeSpec, describe
from skinplan_nodes.runner import graph_environment, parse_arguments, write_parameters

ROOT = Path(__file__).resolve().parents[2]
MOCK = GraphSettings(Path("/runs"), "/part.yaml", "/cell.yaml", 5.0, 7)
REAL = GraphSettings(Path("/runs"))


def nodes(settings: GraphSettings) -> dict[str, NodeSpec]:
    return {node.name: node for node in describe(settings)}


def node_class(spec: NodeSpec) -> Any:
    module = importlib.import_module(spec.module)
    kinds = [k for k in vars(module).values() if isinstance(k, type) and "NAME" in vars(k)]
    return next(kind for kind in kinds if kind.NAME == spec.name)


def test_every_node_is_a_program_with_these_parameters() -> None:
    for spec in describe(MOCK):
        known = {parameter.name: parameter for parameter in node_class(spec).PARAMETERS}
        for name, value in spec.parameters.items():
            if name != "use_sim_time":
                assert type(value) is type(known[name].default), f"{spec.name}: {name}"


def test_graph_without_a_part_has_no_mocks_and_no_simulated_time() -> None:
    mocked, real = nodes(MOCK), nodes(REAL)
    assert set(mocked) - set(real) == {name for name, node in mocked.items() if node.simulated}
    assert not any(node.parameters.get("use_sim_time") for node in real.values())
    assert all(
        node.parameters["use_sim_time"] for name, node in mocked.items() if name != "sim_clock"
    )


def test_supervisor_watches_what_is_required() -> None:
    for settings in (MOCK, REAL):
        found = nodes(settings)
        required = {name for name, node in found.items() if node.required}
        watched = set(found["cell_supervisor"].parameters["required_nodes"])
        assert watched == required - {"cell_supervisor"}


def test_parameter_files_say_what_the_description_says(tmp_path: Path) -> None:
    for spec in describe(MOCK):
        written = yaml.safe_load(write_parameters(spec, tmp_path).read_text())
        assert written == {"/**": {"ros__parameters": dict(spec.parameters)}}


def test_environment_keeps_what_is_set_and_bounds_threads() -> None:
    found = graph_environment({"ROS_DOMAIN_ID": "17", "OMP_NUM_THREADS": "3", "PATH": "/bin"})
    assert found["ROS_DOMAIN_ID"] == "17"
    assert found["OMP_NUM_THREADS"] == "3"
    assert found["OPENBLAS_NUM_THREADS"] == "1"
    assert found["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "--part is needed"),
        (["--part", "none.yaml"], "there is no such file"),
        (["--part", __file__, "--time-factor", "0"], "0.1 to 50 is accepted"),
        (["--part", __file__, "--time-factor", "nan"], "0.1 to 50 is accepted"),
        (["--part", __file__, "--job-id", "a/b"], "of [A-Za-z0-9_.-]"),
        (["--part", __file__, "--job-id", "used"], "exists already"),
        (["--serve"], "--part is needed"),
    ],
)
def test_bad_arguments_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], words: str
) -> None:
    (tmp_path / "used").mkdir()
    (tmp_path / "used" / "summary.json").write_text("{}")
    with pytest.raises(SystemExit) as ended:
        parse_arguments([*arguments, "--runs-folder", str(tmp_path)])
    assert ended.value.code == 2
    assert words in capsys.readouterr().err


def test_run_graph_script_is_the_runner() -> None:
    script = ROOT / "launch_scripts" / "run_graph.py"
    assert os.access(script, os.X_OK)
    assert _module(script).main is importlib.import_module("skinplan_nodes.runner").main


def test_launch_file_compiles() -> None:
    path = ROOT / "launch_scripts" / "skinplan.launch.py"
    compile(path.read_text(), str(path), "exec")


def test_launch_file_starts_what_is_described(tmp_path: Path) -> None:
    pytest.importorskip("launch", reason="ros2 launch is not part of the wheels")
    pytest.importorskip("launch_ros", reason="ros2 launch is not part of the wheels")
    from launch import LaunchContext
    from launch_ros.actions import Node

    module = _module(ROOT / "launch_scripts" / "skinplan.launch.py")
    context = LaunchContext()
    context.launch_configurations.update({k: v[0] for k, v in module.ARGUMENTS.items()})
    context.launch_configurations["part"] = "/part.yaml"
    started = []
    for entity in module.generate_launch_description().entities:
        if hasattr(entity, "_OpaqueFunction__function"):
            started = [a for a in entity.execute(context) or [] if isinstance(a, Node)]
    assert {node.node_executable for node in started} == set(nodes(MOCK))


def _module(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(path.stem.replace(".", "_"), path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
