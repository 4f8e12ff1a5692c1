"""Program of ``skinplan replay --verify``: a run's inputs again, its results beside the new ones.

Progress goes to stderr, one JSON document to stdout.
"""

import argparse
import json
import logging
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import yaml
from rclpy.exceptions import ParameterException
from skinplan_msgs.msg import PartReference

from skinplan.errors import InputError, SkinplanError
from skinplan_nodes.aruco_localizer import ArucoLocalizer
from skinplan_nodes.run import die_with_parent
from skinplan_nodes.scan_path_planner import ScanPathPlanner
from skinplan_nodes.station_planner import StationPlanner
from skinplan_nodes.trajectory_planner import TrajectoryPlanner
from skinplan_nodes.verify.bench import VerifyBench
from skinplan_nodes.verify.compare import StageResult
from skinplan_nodes.verify.localizing import LocalizerFeed
from skinplan_nodes.verify.planning import (
    verify_scan_path,
    verify_stations,
    verify_trajectories,
)
from skinplan_nodes.verify.recorded import RecordedRun

Parameters = dict[str, dict[str, Any]]
_KINDS: dict[str, Callable[..., Any]] = {
    kind.NAME: kind for kind in (ArucoLocalizer, ScanPathPlanner, StationPlanner, TrajectoryPlanner)
}
# Nobody is in a hurry here, and the clock jumps from image to image.
_PATIENT = {"image_timeout_s": 600.0, "wall_timeout_s": 600.0}


def verify_bag(
    bag: Path,
    part_uri: str = "",
    cell_file: str = "",
    changes: Parameters | None = None,
    progress: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Verifies one run.

    Args:
        bag: Its bag.
        part_uri: Part file in the place of the recorded one; empty = that.
        cell_file: Cell file; empty = the default cell.
        changes: Node -> parameter -> value that differs from the default.
        progress: Is told what is being done.

    Returns:
        ``identical``, ``first_difference`` (a stage, or None) and ``stages``.

    Raises:
        SkinplanError: The bag is none of a run, or a node can't start.
    """
    run = RecordedRun(bag)
    bench = VerifyBench()
    try:
        part = PartReference(uri=part_uri or run.part_uri, mesh_sha256=run.mesh_sha256)
        for name, kind in _KINDS.items():
            bench.start(
                kind, _parameters(name, cell_file, changes or {}), name == "aruco_localizer"
            )
        results = _stages(bench, run, part, progress)
    finally:
        bench.close()
        run.close()
    differing = [result.name for result in results if result.differences]
    return {
        "bag": str(bag),
        "identical": not differing,
        "first_difference": differing[0] if differing else None,
        "stages": [result.document() for result in results],
    }


def _stages(
    bench: VerifyBench, run: RecordedRun, part: PartReference, progress: Callable[[str], None]
) -> list[StageResult]:
    results = [LocalizerFeed(bench, run, part).verify(progress)]
    progress("scan path")
    results.append(verify_scan_path(bench, run, part))
    progress("stations")
    results.append(verify_stations(bench, run, part))
    results.append(verify_trajectories(bench, run, part, progress))
    return results


def _parameters(name: str, cell_file: str, changes: Parameters) -> dict[str, Any]:
    found: dict[str, Any] = dict(_PATIENT) if name == "aruco_localizer" else {}
    if name != "scan_path_planner":
        found["cell_file"] = cell_file
    return {**found, **changes.get(name, {})}


def parsed_changes(given: Sequence[str]) -> Parameters:
    """Takes ``node.parameter=value`` apart.

    Raises:
        InputError: Another form, or a node that is none of those that are verified.
    """
    found: Parameters = {}
    for text in given:
        target, mark, value = text.partition("=")
        node, dot, parameter = target.partition(".")
        if not (mark and dot and parameter) or node not in _KINDS:
            raise InputError(
                f"the change {text!r} was asked for; node.parameter=value with one of the nodes "
                f"{', '.join(_KINDS)} is accepted"
            )
        try:
            found.setdefault(node, {})[parameter] = yaml.safe_load(value)
        except yaml.YAMLError as error:
            raise InputError(f"the value of {text!r} can't be read") from error
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of the program."""
    die_with_parent()
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("bag", type=Path)
    parser.add_argument("--part", default="")
    parser.add_argument("--cell", default="")
    parser.add_argument("--set", action="append", default=[], metavar="NODE.PARAMETER=VALUE")
    given = parser.parse_args(arguments)
    logging.basicConfig(level=logging.WARNING, stream=sys.stderr)
    try:
        document = verify_bag(given.bag, given.part, given.cell, parsed_changes(given.set), _tell)
    except (SkinplanError, ParameterException) as error:
        code = 2 if isinstance(error, InputError | ParameterException) else 1
        document = {"error": str(error), "code": code}
    sys.stdout.write(json.dumps(document) + "\n")
    return int(document.get("code", 0 if document.get("identical") else 1))


def _tell(text: str) -> None:
    sys.stderr.write(f"verify: {text}\n")


if __name__ == "__main__":
    sys.exit(main())
