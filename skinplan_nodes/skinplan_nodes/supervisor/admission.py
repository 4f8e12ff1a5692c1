"""Who may ask for jobs, and which jobs the cell takes. Needs no ROS but for part references."""

import logging
from collections.abc import Callable, Iterable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from skinplan.errors import (
    CalibrationDueError,
    CalibrationInvalidError,
    CalibrationMissingError,
    JobOperatorError,
    MeshHashError,
    PartIdError,
    SkinplanError,
)
from skinplan.jobs.model import Job
from skinplan.part.identity import PartIdentities
from skinplan.robot.calibration import (
    DUE,
    MISSING,
    NAMES,
    VALID,
    CalibrationFact,
    load_calibration,
)
from skinplan_nodes.part_cache import part_path

_log = logging.getLogger(__name__)


class CalibrationBook:
    """The calibration facts of a cell; files that have not changed are read once.

    Args:
        path: File of the facts; None = there is none.
        now: Returns the time.
    """

    def __init__(
        self, path: Path | None, now: Callable[[], datetime] = lambda: datetime.now(UTC)
    ) -> None:
        self._path = path
        self._now = now
        self._stamps: dict[str, Any] = {}
        self._facts: tuple[CalibrationFact, ...] = ()

    def facts(self) -> tuple[CalibrationFact, ...]:
        """Returns the facts as they are now; a file that can't be used = nothing is calibrated."""
        if not self._facts or self._stamps != self._look():
            try:
                self._facts = load_calibration(self._path, self._now())
            except CalibrationInvalidError as error:
                _log.error("%s", error)
                self._facts = tuple(CalibrationFact(name, reason=str(error)) for name in NAMES)
            self._stamps = self._look()
        return tuple(self._as_of_now(fact) for fact in self._facts)

    def documents(self) -> list[dict[str, Any]]:
        """Returns the block ``calibration`` of ``summary.json``."""
        return [fact.document() for fact in self.facts()]

    def _as_of_now(self, fact: CalibrationFact) -> CalibrationFact:
        if fact.state == MISSING or not fact.due:
            return fact
        is_due = self._now() > datetime.fromisoformat(fact.due)
        return replace(fact, state=DUE if is_due else VALID)

    def _look(self) -> dict[str, Any]:
        files = [str(self._path or ""), *(fact.file for fact in self._facts)]
        return {file: _stamp(file) for file in files if file}


class Admission:
    """What a job has to fulfil before it is taken.

    Args:
        calibration: Facts about the cell's calibration.
        operators: Names of those who may hand in and command jobs; empty = everybody.
        calibration_required: A job is refused where a calibration is missing.
        not_ready: Returns why no job could begin now; None = one could.
    """

    def __init__(
        self,
        calibration: CalibrationBook,
        operators: Iterable[str] = (),
        calibration_required: bool = True,
        not_ready: Callable[[], SkinplanError | None] = lambda: None,
    ) -> None:
        self.calibration = calibration
        self._operators = frozenset(operators)
        self._required = calibration_required
        self._not_ready = not_ready
        self._identities = PartIdentities()

    @property
    def restricted(self) -> bool:
        """Whether there is a list of operators."""
        return bool(self._operators)

    def check_operator(self, name: str) -> None:
        """Lets operators of the list through.

        Raises:
            JobOperatorError: It is another one.
        """
        if self._operators and name not in self._operators:
            raise JobOperatorError(
                f"operator {name[:80]!a} is not in the cell's list; an operator of the list is "
                "accepted"
            )

    def check_part(self, job: Job) -> None:
        """Lets parts through that exist and are those that are meant.

        Raises:
            PartNotFoundError, PartInvalidError, MeshNotFoundError: The part can't be used.
            PartIdError: The file is one of another part.
            MeshHashError: The mesh is another one.
        """
        found = self._identities.of(part_path(job.part_uri))
        if job.part_id and found.id and job.part_id != found.id:
            raise PartIdError(
                f"part {job.part_id[:80]!a} was asked for, {job.part_uri} is part {found.id}; that "
                "id or none is accepted"
            )
        if job.mesh_sha256 and found.mesh_sha256 and job.mesh_sha256 != found.mesh_sha256:
            raise MeshHashError(
                f"part {found.id}: the mesh with SHA-256 {job.mesh_sha256} was asked for, found "
                f"{found.mesh_sha256}; that hash or none is accepted"
            )

    def check_calibration(self, job: Job) -> None:
        """Lets jobs through for which the cell is calibrated well enough.

        Raises:
            CalibrationMissingError: A calibration is missing.
            CalibrationDueError: One is out of date.
        """
        if job.accept_due_calibration:
            return
        facts = self.calibration.facts()
        missing = [f"{fact.name} ({fact.reason})" for fact in facts if fact.state == MISSING]
        if missing and self._required:
            raise CalibrationMissingError(
                f"the cell is not calibrated: {', '.join(missing)}; calibrate it, or say "
                "accept_due_calibration"
            )
        due = [f"{fact.name} (since {fact.due})" for fact in facts if fact.state == DUE]
        if due:
            raise CalibrationDueError(
                f"the calibration is out of date: {', '.join(due)}; calibrate, or say "
                "accept_due_calibration"
            )

    def check_ready(self) -> None:
        """Lets a job through that can begin now.

        Raises:
            SkinplanError: A device or a node is not ready.
        """
        error = self._not_ready()
        if error is not None:
            raise error


def _stamp(file: str) -> tuple[int, int, int] | None:
    try:
        found = Path(file).stat()
    except (OSError, ValueError):
        return None
    return found.st_ino, found.st_mtime_ns, found.st_size
