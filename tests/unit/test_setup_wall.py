"""The wall: the library never imports ROS or its own nodes, and the message says so if it does."""

import ast
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
LIBRARY = ROOT / "skinplan_nodes/skinplan"
FORBIDDEN = ("rclpy", "skinplan_nodes", "launch", "launch_ros", "builtin_interfaces", "std_srvs")


def imported(source: str) -> set[str]:
    """Top-level packages that a module imports, wherever in the module."""
    names = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            names.add(node.module.partition(".")[0])
    return names


def forbidden(names: set[str]) -> set[str]:
    return {n for n in names if n in FORBIDDEN or n.endswith(("_msgs", "_interfaces"))}


def test_imports_are_found_wherever_they_hide():
    source = "def f():\n    import geometry_msgs.msg as g\n    from rclpy.node import Node\n"
    assert forbidden(imported(source)) == {"geometry_msgs", "rclpy"}


def test_library_imports_no_ros():
    files = sorted(LIBRARY.rglob("*.py"))
    assert files
    found = {str(f.relative_to(ROOT)): forbidden(imported(f.read_text())) for f in files}
    assert {file: names for file, names in found.items() if names} == {}


@pytest.mark.parametrize(
    ("file", "refused"), [("mesh/x.py", True), ("../skinplan_nodes/x.py", False)]
)
def test_linter_refuses_ros_in_the_library_only(file, refused):
    command = [sys.executable, "-m", "ruff", "check", "--select", "TID251", "--no-cache"]
    result = subprocess.run(
        [*command, "--stdin-filename", str(LIBRARY / file), "-"],
        input="import rclpy\nfrom skinplan_msgs.msg import Status\n",
        cwd=ROOT,
        text=True,
        capture_output=True,
        check=False,
    )
    assert ("skinplan is the library without ROS" in result.stdout) == refused
    assert (result.returncode != 0) == refused


def test_linter_knows_every_package_that_the_nodes_use():
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())
    banned = settings["tool"]["ruff"]["lint"]["flake8-tidy-imports"]["banned-api"]
    files = sorted((ROOT / "skinplan_nodes/skinplan_nodes").rglob("*.py"))
    used = set().union(*(forbidden(imported(f.read_text())) for f in files))
    assert used <= banned.keys()
