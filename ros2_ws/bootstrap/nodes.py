"""Installs ``skinplan_nodes`` so that its commands run and its Python code stays where it is."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path

from bootstrap.paths import Paths
from bootstrap.process import SetupError

_LIST_COMMANDS = """
from importlib.metadata import distribution
entries = distribution("skinplan_nodes").entry_points
print(*(entry.name for entry in entries if entry.group == "console_scripts"))
"""


def install_nodes(paths: Paths, run: Callable[[Sequence[str | Path], str], str]) -> None:
    """Install the package editable: a change of the Python code needs no set-up.

    Not through colcon: its ``--symlink-install`` goes through a build folder, and tracebacks and
    ``__file__`` would name that folder instead of the source.

    Args:
        paths: Where everything is.
        run: Runs a tool; takes the command and what it is for.

    Raises:
        SetupError: The package cannot be installed.
    """
    package = paths.root / "skinplan_nodes"
    pip = [paths.python, "-m", "pip", "install", "--no-input", "--disable-pip-version-check"]
    # Without --use-pep517, older versions of pip put the commands where setup.cfg tells colcon to.
    options = ["--no-deps", "--no-build-isolation", "--no-index", "--use-pep517"]
    run([*pip, *options, "--editable", package], "installing skinplan_nodes")
    commands = run([paths.python, "-c", _LIST_COMMANDS], "listing the commands of skinplan_nodes")
    _register(paths, package, commands.split())


def _register(paths: Paths, package: Path, commands: Sequence[str]) -> None:
    """Put the package into the ament index: ``ros2 run`` and launch files find it there."""
    venv = paths.venv
    marker = venv / "share/ament_index/resource_index/packages/skinplan_nodes"
    marker.parent.mkdir(parents=True, exist_ok=True)
    marker.write_text("", encoding="utf-8")
    share = venv / "share/skinplan_nodes"
    replace_link(share / "package.xml", package / "package.xml")
    replace_link(share / "config", package / "config")
    replace_link(share / "launch", paths.root / "launch_scripts")
    for name in commands:
        if not (venv / "bin" / name).is_file():
            raise SetupError(f"installing skinplan_nodes did not make {venv / 'bin' / name}")
        replace_link(venv / "lib/skinplan_nodes" / name, venv / "bin" / name)


def replace_link(link: Path, target: Path) -> None:
    """Make a relative symbolic link, in the place of an older one if there is one.

    Args:
        link: The link.
        target: Where it points.
    """
    link.parent.mkdir(parents=True, exist_ok=True)
    new = link.with_name(link.name + ".new")
    new.unlink(missing_ok=True)
    new.symlink_to(os.path.relpath(target, link.parent))
    new.replace(link)
