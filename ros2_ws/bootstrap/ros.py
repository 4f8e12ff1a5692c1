"""Decides where ROS 2 comes from: a full Jazzy that is sourced, or the wheels."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from bootstrap.process import SetupError

#: Set by the wheels' start-up hook once it has put their libraries on ``LD_LIBRARY_PATH``.
WHEELS_GUARD = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"

#: The ROS 2 release that the interfaces and nodes are written for.
DISTRIBUTION = "jazzy"


@dataclass(frozen=True)
class Ros:
    """Where ROS 2 comes from.

    Attributes:
        prefixes: Prefixes of the sourced installation, in the order of ``AMENT_PREFIX_PATH``;
            empty = the wheels.
        library_paths: Folders of its shared libraries (``LD_LIBRARY_PATH``).
        python_paths: Folders of its Python modules (``PYTHONPATH``).
    """

    prefixes: tuple[Path, ...] = ()
    library_paths: tuple[Path, ...] = ()
    python_paths: tuple[Path, ...] = ()

    @property
    def is_system(self) -> bool:
        """Whether a full installation is sourced."""
        return bool(self.prefixes)


def find_ros(environ: Mapping[str, str], venv: Path) -> Ros:
    """Find the sourced ROS 2 installation.

    A virtual environment is no such installation, even when its prefix is on ``AMENT_PREFIX_PATH``
    (the start-up hook of ours puts it there for the processes that it starts).

    Args:
        environ: The environment.
        venv: The virtual environment of the work tree.

    Returns:
        The installation; without prefixes when none that has rclpy is sourced.

    Raises:
        SetupError: The sourced installation is of another release.
    """
    prefixes = _paths(environ, "AMENT_PREFIX_PATH", venv)
    if not any(has_package(prefix, "rclpy") for prefix in prefixes):
        return Ros()
    distribution = environ.get("ROS_DISTRO", DISTRIBUTION)
    if distribution != DISTRIBUTION:
        raise SetupError(
            f"the sourced ROS 2 is {distribution} and skinplan needs {DISTRIBUTION}: source that, "
            "or run make setup in a shell where no ROS is sourced, then wheels are used"
        )
    modules = _paths(environ, "PYTHONPATH", venv)
    return Ros(
        prefixes=prefixes,
        library_paths=_paths(environ, "LD_LIBRARY_PATH", venv),
        python_paths=tuple(p for p in modules if any(p.is_relative_to(x) for x in prefixes)),
    )


def remembered_ros(settings: Path, venv: Path) -> Ros:
    """Find the installation that the virtual environment was set up with.

    Without this, ``make demo`` in a shell where nothing is sourced would set all up anew with
    the wheels.

    Args:
        settings: The settings file of the start-up hook.
        venv: The virtual environment of the work tree.

    Returns:
        The installation; without prefixes when there was none or it is gone.
    """
    try:
        found = json.loads(settings.read_text(encoding="utf-8"))
        names = ("prefixes", "library_paths", "python_paths")
        groups = [[Path(path) for path in found[name]] for name in names]
    except (OSError, ValueError, KeyError, TypeError):
        return Ros()
    ros = Ros(*(tuple(p for p in group if not p.is_relative_to(venv)) for group in groups))
    return ros if any(has_package(prefix, "rclpy") for prefix in ros.prefixes) else Ros()


def has_package(prefix: Path, package: str) -> bool:
    """Tell whether the ament index of a prefix lists a package."""
    return (prefix / "share/ament_index/resource_index/packages" / package).is_file()


def check_ros_python(ros: Ros) -> None:
    """Check that this Python can load the compiled modules of the installation.

    Args:
        ros: The sourced installation.

    Raises:
        SetupError: The installation's modules are for another Python version.
    """
    own = f"python{sys.version_info.major}.{sys.version_info.minor}"
    folders = (folder for prefix in ros.prefixes for folder in prefix.glob("lib/python3.*"))
    found = sorted({f.name for f in folders if (f / "site-packages/rclpy").is_dir()})
    if own not in found:
        python = f"/usr/bin/{found[0]}" if found else "/path/to/its/python3"
        raise SetupError(
            f"rclpy of the sourced ROS 2 is for {', '.join(found) or 'a Python that was not found'}"
            f" and this is {own}: make setup PYTHON={python}"
        )


def _paths(environ: Mapping[str, str], name: str, venv: Path) -> tuple[Path, ...]:
    """Split a search path, leaving out what belongs to a virtual environment."""
    paths = (Path(word) for word in environ.get(name, "").split(":") if word)
    return tuple(path for path in paths if not _is_in_virtual_environment(path, venv))


def _is_in_virtual_environment(path: Path, venv: Path) -> bool:
    folders = (path, *path.parents)
    return venv in folders or any((folder / "pyvenv.cfg").is_file() for folder in folders)
