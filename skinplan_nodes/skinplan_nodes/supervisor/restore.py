"""Reads a run's journal: where in its plan the job was when its supervisor was killed. No ROS."""

import hashlib
import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from skinplan.errors import SkinplanError
from skinplan.jobs.model import Job
from skinplan.part.model import Part
from skinplan.plan_record import scan_path_hash, station_hash, trajectory_hash
from skinplan.transforms import Array
from skinplan_nodes.supervisor.cell import Cell, Located
from skinplan_nodes.supervisor.faults import Interruption
from skinplan_nodes.supervisor.identification import IDENTIFICATION_KEYS
from skinplan_nodes.supervisor.journal import Entry, JournalError, read_journal, read_stored
from skinplan_nodes.supervisor.machine import WORKING, State
from skinplan_nodes.supervisor.place import Place
from skinplan_nodes.supervisor.run_data import Localization, Round, RunData
from skinplan_nodes.supervisor.run_folder import RunFolder


class ResumeError(SkinplanError):
    """A job can't be taken over from the supervisor process before."""


@dataclass
class Restored:
    """What the journal says.

    Attributes:
        place: Where in its plan the job was.
        data: What was gathered.
        bag_part: Newest part of the bag; 0 = none.
        recorder_pid: Process that recorded it.
        bag_open: It was not closed.
        age_s: How long ago the last entry was written [s].
    """

    place: Place = field(default_factory=Place)
    data: RunData = field(default_factory=RunData)
    bag_part: int = 0
    recorder_pid: int = 0
    bag_open: bool = False
    age_s: float = 0.0


def file_sha256(path: Path) -> str:
    """Returns the SHA-256 of a file, lower-case hex."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def journal_age_s(folder: RunFolder) -> float:
    """Returns how long ago the last entry was written; infinite = there is none [s]."""
    try:
        entries = read_journal(folder.journal)
    except JournalError:
        return float("inf")
    return time.time() - entries[-1].at_ns * 1e-9 if entries else float("inf")


def restore(folder: RunFolder, job: Job, part: Part, part_file: Path, cell: Cell) -> Restored:
    """Reads the journal and the files that it names, and checks that nothing has changed since.

    Args:
        folder: The run's folder.
        job: The order.
        part: The part as its file says now.
        part_file: That file.
        cell: Takes the plan in again.

    Raises:
        ResumeError: The journal or the part is not what it was; nothing was changed.
    """
    try:
        entries = read_journal(folder.journal)
        _require_same(entries, job, part, part_file)
        found = Restored(age_s=time.time() - entries[-1].at_ns * 1e-9)
        reader = _Reader(folder.state, cell, found)
        for entry in entries:
            reader.take(entry)
    except (JournalError, OSError) as error:
        raise ResumeError(f"job {job.job_id} can't be resumed: {error}") from error
    except (KeyError, TypeError, ValueError, IndexError, AssertionError) as error:
        raise ResumeError(
            f"job {job.job_id} can't be resumed: its journal {folder.journal} has an entry that "
            f"can't be understood ({type(error).__name__}: {error})"
        ) from error
    return found


def _require_same(entries: tuple[Entry, ...], job: Job, part: Part, part_file: Path) -> None:
    began = next((entry for entry in entries if entry.kind == "job"), None)
    if began is None:
        raise JournalError("its journal does not say what the job is about")
    if any(entry.kind == "over" for entry in entries):
        raise JournalError("its journal says that it is over")
    now = {
        "job_id": job.job_id,
        "part_uri": job.part_uri,
        "mesh_sha256": part.mesh_sha256,
        "part_sha256": file_sha256(part_file),
    }
    for name, value in now.items():
        if began.values[name] != value:
            raise JournalError(
                f"{name} was {began.values[name]!r} when the job began and is {value!r} now"
            )


class _Reader:
    """Plays a journal's entries into `Restored`."""

    def __init__(self, folder: Path, cell: Cell, found: Restored) -> None:
        self._folder = folder
        self._cell = cell
        self._found = found

    def take(self, entry: Entry) -> None:
        """Takes one entry in; kinds that say nothing about the place are left out."""
        handler = getattr(self, f"_{entry.kind}", None)
        if handler is not None:
            handler(entry.values)

    def _state(self, values: dict[str, Any]) -> None:
        place, state = self._found.place, State(values["state"])
        if values["rescan"] > place.rescan:
            place.replan()
            self._found.data.rounds.append(Round())
        if state in _GOES_ON:
            if values["station"] != place.station:
                place.leave()
            if state is State.DRIVING and place.trajectory is not None:
                place.executed += place.trajectory.segments[: place.segment]
                place.trajectory = None
            if state is State.DRIVING:
                place.located = None
            place.state, place.station = state, values["station"]
            place.segment = values["segment"]

    def _identified(self, values: dict[str, Any]) -> None:
        self._found.data.identification = {key: values[key] for key in IDENTIFICATION_KEYS}

    def _path(self, values: dict[str, Any]) -> None:
        planned = self._cell.planners.restore_path(read_stored(self._folder, values))
        _require_hash("scan path", scan_path_hash(planned.path), values)
        self._found.place.planned = self._found.data.round.planned = planned

    def _stations(self, values: dict[str, Any]) -> None:
        T_map_workpiece = _matrix(values["T_map_workpiece"])
        content = read_stored(self._folder, values)
        plan = self._cell.planners.restore_stations(content, T_map_workpiece)
        _require_hash("station plan", station_hash(plan), values)
        place = self._found.place
        place.plan = self._found.data.round.station_plan = plan
        place.T_map_workpiece, place.station = T_map_workpiece, 1

    def _located(self, values: dict[str, Any]) -> None:
        found = Located(
            _matrix(values["T_arm_base_workpiece"]),
            _matrix(values["T_map_workpiece"]),
            values["quality"],
            values["attempts"],
            values["stamp_s"],
        )
        place = self._found.place
        place.located = found
        if values["station"] == 0:
            place.T_map_workpiece = found.T_map_workpiece
        self._found.data.localizations.append(
            Localization(
                values["station"],
                found.quality,
                found.attempts,
                found.stamp_s,
                found.T_arm_base_workpiece,
            )
        )

    def _trajectory(self, values: dict[str, Any]) -> None:
        whole = self._cell.planners.restored_trajectory(read_stored(self._folder, values))
        _require_hash("trajectory", trajectory_hash([whole]), values)
        place = self._found.place
        place.executed = list(whole.segments[: values["done"]])
        place.trajectory = replace(whole, segments=whole.segments[values["done"] :])
        place.segment = 0
        self._found.data.round.put(whole)

    def _points(self, values: dict[str, Any]) -> None:
        now_s = time.monotonic()
        self._found.place.passed_s = {int(point): now_s for point in values["points"]}
        self._found.place.segment = max(self._found.place.segment, values["segment"])

    def _bag(self, values: dict[str, Any]) -> None:
        self._found.bag_part = values["part"]
        self._found.recorder_pid = values["recorder_pid"]
        self._found.bag_open = values["opened"]

    def _interrupted(self, values: dict[str, Any]) -> None:
        found = Interruption(float("nan"), values["state"], values["code"], values["reason"])
        kept = self._found.data.interruptions
        if not kept or kept[-1].resumed_after_s is not None:
            kept.append(found)

    def _resumed(self, values: dict[str, Any]) -> None:
        if self._found.data.interruptions:
            self._found.data.interruptions[-1].resumed_after_s = values["after_s"]


# In the other states a job stands still, or is nearly over: it goes on where it was before.
_GOES_ON = frozenset(WORKING) - {State.RESTORING}


def _require_hash(what: str, found: str, values: dict[str, Any]) -> None:
    if found != values["plan_hash"]:
        raise JournalError(
            f"its {what} has the hash {found}, the journal says {values['plan_hash']}"
        )


def _matrix(rows: Any) -> Array:
    matrix = np.array(rows, dtype=float)
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        raise ValueError(f"a 4 x 4 matrix is accepted, found {matrix.shape}")
    return matrix
