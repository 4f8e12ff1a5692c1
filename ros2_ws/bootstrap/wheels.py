"""Repairs the CMake files of the ROS wheels, which name folders of the machine that built them."""

from __future__ import annotations

import os
import re
from pathlib import Path

_PYTHON_INCLUDE = re.compile(r"/opt/python/cp3\d+-cp3\d+/include/python3\.\d+")
_NUMPY_INCLUDE = re.compile(
    r"/opt/python/cp3\d+-cp3\d+/lib/python3\.\d+/site-packages/numpy/_?core/include"
)


def repair_text(text: str, python_include: Path, numpy_include: Path) -> str:
    """Replace the build machine's header folders by this machine's.

    Args:
        text: Content of a CMake file.
        python_include: Folder of the Python headers here.
        numpy_include: Folder of the NumPy headers here.

    Returns:
        The repaired content; repairing twice changes nothing more.
    """
    text = _PYTHON_INCLUDE.sub(lambda _: str(python_include), text)
    return _NUMPY_INCLUDE.sub(lambda _: str(numpy_include), text)


def repair_cmake_files(share: Path, python_include: Path, numpy_include: Path) -> int:
    """Repair all CMake files below a folder, each whole or not at all.

    Args:
        share: The folder ``share`` of the virtual environment.
        python_include: Folder of the Python headers here.
        numpy_include: Folder of the NumPy headers here.

    Returns:
        Number of files changed.
    """
    changed = 0
    for file in sorted(share.glob("*/cmake/*.cmake")):
        text = file.read_text(encoding="utf-8", errors="surrogateescape")
        repaired = repair_text(text, python_include, numpy_include)
        if repaired != text:
            new = file.with_name(file.name + ".new")
            new.write_text(repaired, encoding="utf-8", errors="surrogateescape")
            os.replace(new, file)
            changed += 1
    return changed
