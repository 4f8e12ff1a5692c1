"""The Python package: its data comes along, its commands exist."""

import ast
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[2] / "skinplan_nodes"


def node_names() -> list[str]:
    """The table of nodes in setup.py."""
    for statement in ast.parse((PACKAGE / "setup.py").read_text()).body:
        if isinstance(statement, ast.Assign) and statement.targets[0].id == "NODES":
            return list(ast.literal_eval(statement.value))
    raise AssertionError("setup.py has no table of nodes")


@pytest.fixture(scope="module")
def wheel_files(tmp_path_factory):
    """Names of the files in a wheel of the package, built from a copy."""
    source = tmp_path_factory.mktemp("build") / "skinplan_nodes"
    shutil.copytree(PACKAGE, source, ignore=shutil.ignore_patterns("__pycache__", ".*", "*.egg*"))
    command = [sys.executable, "setup.py", "-q", "bdist_wheel", "--dist-dir", "dist"]
    subprocess.run(command, cwd=source, check=True, capture_output=True)
    (wheel,) = (source / "dist").glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        return set(archive.namelist())


@pytest.mark.parametrize("name", ["skinplan", "skinplan_nodes"])
def test_every_file_of_the_packages_is_installed(wheel_files, name):
    files = (f for f in (PACKAGE / name).rglob("*") if f.is_file())
    ours = {
        str(f.relative_to(PACKAGE)) for f in files if "cache" not in str(f.relative_to(PACKAGE))
    }
    assert ours
    assert ours - wheel_files == set()


@pytest.mark.parametrize("node", node_names())
def test_node_has_a_module_with_a_main_function(node):
    module = PACKAGE / "skinplan_nodes" / f"{node}.py"
    assert module.is_file()
    functions = {
        s.name for s in ast.parse(module.read_text()).body if isinstance(s, ast.FunctionDef)
    }
    assert "main" in functions
