"""Every name of the package of conversions is there, and a pose costs no planner."""

import ast
import subprocess
import sys
from pathlib import Path

from skinplan_nodes import conversions


def test_every_name_is_handed_out() -> None:
    for name in conversions.__all__:
        assert getattr(conversions, name).__module__.startswith("skinplan"), name
    assert sorted(conversions._HOME) == sorted(conversions.__all__)


def test_what_type_checkers_see_is_what_is_handed_out() -> None:
    tree = ast.parse(Path(conversions.__file__).read_text(encoding="utf-8"))
    seen = {
        alias.name: str(node.module).rsplit(".", 1)[1]
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and str(node.module).startswith("skinplan_nodes.")
        for alias in node.names
    }
    assert seen == conversions._HOME


def test_a_small_node_loads_no_planner() -> None:
    heavy = ("toppra", "matplotlib", "scipy.optimize", "eaik", "pinocchio")
    nodes = "skinplan_nodes.run_recorder, skinplan_nodes.mock_mir100, skinplan_nodes.measure"
    code = f"import sys, {nodes}; print([name for name in {heavy!r} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
