"""Completes a run's ``summary.json`` with what the inspector has left, and writes what needs both.

May be done again at any time: the same files give the same result.
"""

import hashlib
import json
import logging
import platform
from importlib import metadata
from pathlib import Path
from typing import Any

from skinplan.errors import InputError
from skinplan.inspection.qif import write_qif
from skinplan.inspection.record import NAME, VERSION
from skinplan.json_file import write_json

_log = logging.getLogger(__name__)
_FILES = ("cloud.ply", "cloud.laz", "coverage.ply", "deviation.csv", "inspection.json")
_LIBRARIES = ("numpy", "scipy", "embreex", "opencv-python-headless", "pin")
_LARGEST_JSON = 64 * 2**20


def complete_run(folder: Path) -> None:
    """Adds ``version``, ``inspection``, ``files`` and ``software`` to the summary; writes QIF.

    A run without a readable summary is left as it is: there is nothing to complete.

    Raises:
        InputError: A file can't be written.
    """
    summary = _read(folder / "summary.json")
    if not summary:
        return
    found = _read(folder / NAME)
    summary["version"] = VERSION
    try:
        if found:
            summary["inspection"] = found
            _write_qif(folder, summary)
        names = [*_FILES, "results.qif"] if found else _FILES
        summary["files"] = {
            name: _facts(folder / name) for name in names if (folder / name).is_file()
        }
        summary["software"] = software()
        write_json(folder / "summary.json", summary)
    except OSError as error:
        raise InputError(
            f"{folder}: the results can't be written ({error.strerror or error})"
        ) from error


def _write_qif(folder: Path, summary: dict[str, Any]) -> None:
    try:
        write_qif(folder, summary)
    except (KeyError, TypeError, ValueError) as error:
        # An inspection.json of another make; the report says what it can.
        _log.warning("%s: no QIF results of this inspection: %s", folder, error)


def software() -> dict[str, str]:
    """Returns what made the result, by name: this program, Python, the libraries that count."""
    found = {"python": platform.python_version(), "system": platform.platform()}
    for name in ("skinplan_nodes", *_LIBRARIES):
        try:
            found[name.removesuffix("_nodes")] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name.removesuffix("_nodes")] = "not installed as a package"
    return found


def _facts(path: Path) -> dict[str, Any]:
    with path.open("rb") as stream:
        digest = hashlib.file_digest(stream, "sha256").hexdigest()
    return {"bytes": path.stat().st_size, "sha256": digest}


def _read(path: Path) -> dict[str, Any]:
    try:
        if path.stat().st_size > _LARGEST_JSON:
            return {}
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}
