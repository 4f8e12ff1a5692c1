"""Where everything of the work tree is, and the environment that the tools of the set-up run in."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from bootstrap.process import MARK
from bootstrap.ros import WHEELS_GUARD, Ros

#: Variables that steer Python, pip or colcon and must not reach the tools.
_FOREIGN = frozenset(
    {
        WHEELS_GUARD,
        "COLCON_DEFAULTS_FILE",
        "COLCON_HOME",
        "COLCON_PREFIX_PATH",
        "PIP_CONSTRAINT",
        "PIP_PREFIX",
        "PIP_REQUIREMENT",
        "PIP_TARGET",
        "PIP_USER",
        "PYTHONHOME",
        "VIRTUAL_ENV",
    }
)


@dataclass(frozen=True)
class Paths:
    """Where everything is.

    Attributes:
        root: The work tree.
    """

    root: Path

    @property
    def venv(self) -> Path:
        """The virtual environment."""
        return self.root / ".venv"

    @property
    def old_venv(self) -> Path:
        """A virtual environment on its way out."""
        return self.root / ".venv-old"

    @property
    def state(self) -> Path:
        """What of the set-up is done; lies in the virtual environment and goes with it."""
        return self.venv / ".setup.json"

    @property
    def workspace(self) -> Path:
        """The colcon workspace."""
        return self.root / "ros2_ws"

    @property
    def log(self) -> Path:
        """Output of all tools of the last set-up that had something to do."""
        return self.workspace / "log/setup.log"

    @property
    def python(self) -> Path:
        """Python of the virtual environment."""
        return self.venv / "bin/python"

    @property
    def site_packages(self) -> Path:
        """Folder of the virtual environment's modules."""
        version = f"python{sys.version_info.major}.{sys.version_info.minor}"
        return self.venv / "lib" / version / "site-packages"

    @property
    def hook_settings(self) -> Path:
        """Settings of the start-up hook."""
        return self.site_packages / "_skinplan_environment.json"


def tool_environment(environ: Mapping[str, str], paths: Paths, ros: Ros) -> dict[str, str]:
    """Make the environment of the tools.

    Args:
        environ: Environment of this process.
        paths: Where everything is.
        ros: Where ROS 2 comes from.

    Returns:
        The environment without what other virtual environments and workspaces left in it.
    """
    clean = {name: value for name, value in environ.items() if name not in _FOREIGN}
    if WHEELS_GUARD in environ:
        clean.pop("LD_LIBRARY_PATH", None)
    if not ros.is_system:
        clean.pop("PYTHONPATH", None)
    prefixes = ":".join(str(path) for path in (paths.venv, *ros.prefixes))
    clean["AMENT_PREFIX_PATH"] = clean["CMAKE_PREFIX_PATH"] = prefixes
    clean["PATH"] = f"{paths.venv / 'bin'}:{environ.get('PATH', os.defpath)}"
    clean[MARK] = str(paths.root)
    return clean
