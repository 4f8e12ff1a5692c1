"""Reads what a run left on disk.

Whatever is missing or damaged becomes a remark, so that a failed run can be reported too.
"""

import json
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from skinplan.errors import SkinplanError
from skinplan.inspection.cloud import Cloud, read_ply
from skinplan.recording.model import BagInfo
from skinplan.recording.reader import open_bag

_LARGEST_JSON = 512 * 2**20


@dataclass(frozen=True, eq=False)
class RunFiles:
    """The files of a run, as far as they are there.

    Attributes:
        folder: The run's folder.
        summary: ``summary.json``; empty = none.
        path: ``plan/scan_path.json``; empty = none.
        stations: ``plan/stations.json``; empty = none.
        trajectories: ``plan/trajectories.json``; empty = none.
        cloud: ``cloud.ply``; None = none.
        coverage: ``coverage.ply``, samples of the part with the value ``measured``; None = none.
        bag: ``bag/``; None = none.
        remarks: What is missing or could not be read, one sentence each.
    """

    folder: Path
    summary: dict[str, Any] = field(default_factory=dict)
    path: dict[str, Any] = field(default_factory=dict)
    stations: dict[str, Any] = field(default_factory=dict)
    trajectories: dict[str, Any] = field(default_factory=dict)
    cloud: Cloud | None = None
    coverage: Cloud | None = None
    bag: BagInfo | None = None
    remarks: tuple[str, ...] = ()


def read_run(folder: Path) -> RunFiles:
    """Reads a run folder; never fails for what is in it."""
    remarks: list[str] = []
    return RunFiles(
        folder=folder,
        summary=_document(folder, "summary.json", remarks),
        path=_document(folder, "plan/scan_path.json", remarks),
        stations=_document(folder, "plan/stations.json", remarks),
        trajectories=_document(folder, "plan/trajectories.json", remarks),
        cloud=_cloud(
            folder / "cloud.ply", remarks, "cloud.ply is missing: nothing measured can be shown."
        ),
        coverage=_cloud(folder / "coverage.ply", remarks, ""),
        bag=_bag(folder / "bag", remarks),
        remarks=tuple(remarks),
    )


def section(document: dict[str, Any], key: str) -> dict[str, Any]:
    """Returns a part of a document that should be a dict; empty when it is not."""
    found = document.get(key)
    return found if isinstance(found, dict) else {}


def items(document: dict[str, Any], key: str) -> list[dict[str, Any]]:
    """Returns the dicts of a part of a document that should be a list of them."""
    found = document.get(key)
    return [item for item in found if isinstance(item, dict)] if isinstance(found, list) else []


def number(value: object) -> float:
    """Returns a number as float; NaN when it is none."""
    return (
        float(value) if isinstance(value, int | float) and not isinstance(value, bool) else math.nan
    )


def _document(folder: Path, name: str, remarks: list[str]) -> dict[str, Any]:
    path = folder / name
    if not path.is_file():
        remarks.append(f"{name} is missing.")
        return {}
    try:
        if path.stat().st_size > _LARGEST_JSON:
            raise ValueError(f"{path.stat().st_size} bytes are too many")
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        remarks.append(f"{name} can't be read ({error}).")
        return {}
    if not isinstance(found, dict):
        remarks.append(f"{name} can't be read (an object is accepted).")
        return {}
    return found


def _cloud(path: Path, remarks: list[str], missing: str) -> Cloud | None:
    if not path.is_file():
        if missing:
            remarks.append(missing)
        return None
    try:
        return read_ply(path)
    except SkinplanError as error:
        remarks.append(f"{path.name} can't be read ({error}).")
        return None


def _bag(folder: Path, remarks: list[str]) -> BagInfo | None:
    if not folder.is_dir():
        remarks.append("bag/ is missing: the run was not recorded.")
        return None
    try:
        return open_bag(folder)
    except SkinplanError as error:
        remarks.append(f"bag/ can't be read ({error}).")
        return None
