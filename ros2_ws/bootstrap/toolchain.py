"""Looks for what the set-up needs and names the package that brings what is missing."""

from __future__ import annotations

import importlib.util
import shutil
import sys
import sysconfig
from pathlib import Path

from bootstrap.process import SetupError

#: Program on PATH -> Debian/Ubuntu package that brings it.
PROGRAMS = {"gcc": "gcc", "g++": "g++", "cmake": "cmake", "make": "make"}


def missing_tools(
    path: str | None, include: Path, modules: tuple[str, ...] = ("venv", "ensurepip")
) -> dict[str, str]:
    """List what is missing.

    Args:
        path: Search path for programs; None = that of this process.
        include: Folder of the Python headers.
        modules: Modules of the standard library that Debian ships in a package of their own.

    Returns:
        What is missing -> Debian/Ubuntu package that brings it, in a stable order; empty = nothing.
    """
    version = f"{sys.version_info.major}.{sys.version_info.minor}"
    missing = {
        f"the program {name}": package
        for name, package in PROGRAMS.items()
        if not shutil.which(name, path=path)
    }
    if not (include / "Python.h").is_file():
        missing[f"the header {include / 'Python.h'}"] = f"python{version}-dev"
    for module in modules:
        if importlib.util.find_spec(module) is None:
            missing[f"the Python module {module}"] = f"python{version}-venv"
    return missing


def require_tools() -> None:
    """Check that everything is there.

    Raises:
        SetupError: Something is missing; the message names the packages.
    """
    missing = missing_tools(None, Path(sysconfig.get_paths()["include"]))
    if missing:
        packages = " ".join(dict.fromkeys(missing.values()))
        raise SetupError(
            f"missing on this machine: {', '.join(missing)}; "
            f"on Debian or Ubuntu: sudo apt install {packages}"
        )
