"""Runs the node graph as a program of its own and follows a job in it.

The library knows no ROS: the graph is started as ``python -m skinplan_nodes.runner``, which tells
how it goes in JSON lines.
"""

import importlib.util
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from skinplan.errors import InputError, SkinplanError
from skinplan.part.files import load_part, save_part
from skinplan.part.model import Part
from skinplan.pipeline import Progress

# The runner ends its nodes within 5 s of an interrupt.
_STOP_TIMEOUT_S = 15.0


@dataclass(frozen=True)
class RunRequest:
    """What to measure, and how the mock cell runs.

    Attributes:
        part: What to measure.
        runs_folder: Absolute path of the folder that gets the run's folder.
        cell_file: Cell file; None = the default cell.
        time_factor: Times faster than real time.
        seed: Seed of every random draw of the mock cell.
    """

    part: Part
    runs_folder: Path
    cell_file: Path | None
    time_factor: float
    seed: int


@dataclass(frozen=True)
class RunOutcome:
    """How a run ended.

    Attributes:
        ended: The job reached state Ended.
        folder: The run's folder; None when the job never got one.
        error: One sentence; empty when the job ended.
        summary: Content of ``summary.json``; empty when there is none.
    """

    ended: bool
    folder: Path | None
    error: str
    summary: dict[str, Any]

    def document(self) -> dict[str, Any]:
        """Returns what ``skinplan run --json`` prints."""
        return {
            "job": {"id": None, "state": "Aborted"},
            **self.summary,
            "folder": None if self.folder is None else str(self.folder),
            "error": self.error or None,
        }


class CellRun:
    """One run of the graph on the mock cell with one job.

    Args:
        request: What to measure, and how.
    """

    def __init__(self, request: RunRequest) -> None:
        self._request = request

    def measure(self, progress: Progress) -> RunOutcome:
        """Starts the graph, follows the job, ends the graph.

        Args:
            progress: Told the share done and what is being done.

        Returns:
            How the job ended.

        Raises:
            InputError: The nodes are not installed.
        """
        _require_nodes()
        request = self._request
        request.runs_folder.mkdir(parents=True, exist_ok=True)
        last: dict[str, Any] = {}
        died: list[str] = []
        with _program(self._arguments(_part_file(request))) as lines:
            for event in lines:
                if event["event"] == "status":
                    progress(float(event["progress"] or 0.0), _status_text(event))
                elif event["event"] == "node_died" and not event.get("restarted"):
                    died.append(str(event["node"]))
                elif event["event"] == "result":
                    last = event
        return _outcome(last, died)

    def _arguments(self, part_file: Path) -> list[str]:
        request = self._request
        arguments = ["--part", str(part_file), "--runs-folder", str(request.runs_folder)]
        arguments += ["--time-factor", str(request.time_factor), "--seed", str(request.seed)]
        if request.cell_file is not None:
            arguments += ["--cell-file", str(request.cell_file.absolute())]
        return [*arguments, "--json-lines"]


@contextmanager
def _program(arguments: list[str]) -> Iterator[Iterator[dict[str, Any]]]:
    # -P: a folder of that name in the present one is not the package.
    command = [sys.executable, "-P", "-m", "skinplan_nodes.runner", *arguments]
    program = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, bufsize=1)
    assert program.stdout is not None
    try:
        yield _events(program.stdout)
        program.wait()
    finally:
        _end(program)


def _events(stream: Any) -> Iterator[dict[str, Any]]:
    for line in stream:
        try:
            event = json.loads(line)
        except json.JSONDecodeError:
            sys.stderr.write(line)
            continue
        if isinstance(event, dict) and "event" in event:
            yield event


def _end(program: subprocess.Popen[str]) -> None:
    if program.poll() is None:
        program.send_signal(signal.SIGINT)
        try:
            program.wait(_STOP_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            program.kill()
            program.wait()


def _part_file(request: RunRequest) -> Path:
    """Returns a part file that says exactly what was asked; writes one where the part has none."""
    part = request.part
    if part.source is not None and load_part(part.source).scan == part.scan:
        return part.source.absolute()
    path = request.runs_folder / "parts" / f"{part.id}-{os.getpid()}.yaml"
    path.parent.mkdir(parents=True, exist_ok=True)
    save_part(part, path)
    return path


def _require_nodes() -> None:
    for module in ("rclpy", "skinplan_msgs", "skinplan_nodes"):
        if importlib.util.find_spec(module) is None:
            raise InputError(
                f"a run needs the Python module {module}, which is not installed; "
                "`make setup` installs it"
            )


def _status_text(event: dict[str, Any]) -> str:
    text = str(event["sub_state"] or event["state"])
    if event.get("station"):
        text += f" (station {event['station']} of {event['station_count']})"
    return text


def _outcome(last: dict[str, Any], died: list[str]) -> RunOutcome:
    if not last:
        cause = f"node {died[0]} died" if died else "the graph ended before the job"
        return RunOutcome(False, None, f"{cause}; the log folder of the run says more", {})
    folder = Path(last["run_folder"]) if last.get("run_folder") else None
    summary: dict[str, Any] = {}
    if folder is not None and (folder / "summary.json").is_file():
        try:
            summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
        except json.JSONDecodeError as error:
            raise SkinplanError(
                f"summary {folder / 'summary.json'} can't be read: {error}"
            ) from error
    ended = last["state"] == "Ended"
    reason = "" if ended else str(last.get("error") or f"the job is {last['state']}")
    return RunOutcome(ended, folder, reason, summary)
