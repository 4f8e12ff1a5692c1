"""Works one job off: makes its folder, runs its mission, and always leaves a summary."""

import json
import logging
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from skinplan.errors import SkinplanError
from skinplan.inspection.complete import complete_run
from skinplan.inspection.report import write_report
from skinplan.jobs.model import Job, JobState
from skinplan.part.files import load_part
from skinplan.part.model import Part
from skinplan.recording.disk import is_full
from skinplan.robot.cell import CellConfig
from skinplan_nodes.part_cache import part_path
from skinplan_nodes.supervisor.bag_parts import BagParts
from skinplan_nodes.supervisor.cell import Cell
from skinplan_nodes.supervisor.certificate import certified_motion
from skinplan_nodes.supervisor.control import AbortError, JobControl, StepError
from skinplan_nodes.supervisor.faults import DISK_FULL, NODE_LOST
from skinplan_nodes.supervisor.journal import JournalError, read_journal
from skinplan_nodes.supervisor.limits import Limits
from skinplan_nodes.supervisor.machine import State, job_state
from skinplan_nodes.supervisor.mission import Mission, ResumeSettings
from skinplan_nodes.supervisor.place import Place
from skinplan_nodes.supervisor.progress import Progress
from skinplan_nodes.supervisor.record import RunRecord
from skinplan_nodes.supervisor.restore import (
    Restored,
    ResumeError,
    file_sha256,
    restore,
)
from skinplan_nodes.supervisor.run_data import RunData
from skinplan_nodes.supervisor.run_folder import RunFolder
from skinplan_nodes.supervisor.steps import RescanSettings, Steps
from skinplan_nodes.supervisor.timeline import timeline

OK = 1
_RESUME_REFUSED = 805
# A summary that finds no space on the disk is tried again after this [s].
_AGAIN_S = 2.0
_log = logging.getLogger(__name__)

OnProgress = Callable[[State, Progress, str, StepError | None], None]


@dataclass(frozen=True)
class Outcome:
    """How a job ended.

    Attributes:
        state: ENDED or ABORTED.
        code: Status code; 1 = all is well.
        error: Step, node and reason in one sentence; empty = all is well.
        folder: The run's folder; None = it could not be made.
        data: What was gathered.
        summary: What was written as ``summary.json``; None = it could not be written.
    """

    state: JobState
    code: int
    error: str
    folder: RunFolder | None
    data: RunData
    summary: dict[str, Any] | None = None


@dataclass(frozen=True)
class WorkSettings:
    """How jobs are worked off.

    Attributes:
        limits: How long each state may last.
        resume: How a job goes on after an interruption.
        rescans: When what is missing is scanned again.
        needs_recorder: A job waits for a recorder that is lost; otherwise it goes on without.
        resume_age_max_s: A job that stood still for longer before the supervisor was started waits
            for RESUME, wall time [s].
        with_report: Write ``report.html`` after a job, unless it was aborted from outside.
        with_certificate: Certify for the summary what the motion should see.
    """

    limits: Limits
    resume: ResumeSettings = ResumeSettings()
    rescans: RescanSettings = RescanSettings()
    needs_recorder: bool = False
    resume_age_max_s: float = 120.0
    with_report: bool = True
    with_certificate: bool = True


@dataclass(frozen=True)
class JobWorker:
    """Works jobs off, one at a time.

    Attributes:
        cell: The cell.
        config: The cell's figures.
        runs_folder: Gets the folders of the runs.
        code_of: Status code of an error of the library.
        settings: How jobs are worked off.
        calibration: Returns the facts about the cell's calibration, for the summary.
    """

    cell: Cell
    config: CellConfig
    runs_folder: Path
    code_of: Callable[[SkinplanError], int]
    settings: WorkSettings
    calibration: Callable[[], list[dict[str, Any]]] = list
    _left: list[Place] = field(default_factory=list)

    def work(
        self, job: Job, control: JobControl, on_progress: OnProgress, resume: bool = False
    ) -> Outcome:
        """Works a job off, from its folder to its summary; never raises.

        Args:
            job: The order.
            control: Switches of the job.
            on_progress: Told state, progress, the run's folder and why the job stands still.
            resume: The job was begun by a supervisor process that is gone.
        """
        data = RunData()
        try:
            folder = RunFolder(self.runs_folder / job.job_id)
            folder = folder if resume else RunFolder.create(self.runs_folder, job.job_id)
        except (SkinplanError, OSError) as error:
            return self._failed(self._step_error(error), None, data)
        began = (time.monotonic(), self.cell.now_s())
        made = self._run(job, folder, control, on_progress, resume)
        wall_s, cell_s = time.monotonic() - began[0], self.cell.now_s() - began[1]
        made.data.timing_s = {"wall": wall_s, "cell": cell_s}
        outcome = Outcome(JobState.ENDED, OK, "", folder, made.data)
        if made.failure is not None:
            outcome = self._failed(made.failure, folder, made.data)
        try:
            summary = self._written(
                lambda: self._write(job, made.part, folder, outcome, made.failure), control
            )
        except Exception as error:  # the job must come to an end, whatever it is
            _log.exception("job %s: writing the summary", job.job_id)
            return self._failed(self._step_error(error, "closing"), folder, made.data)
        return replace(outcome, summary=summary)

    def _run(
        self,
        job: Job,
        folder: RunFolder,
        control: JobControl,
        on_progress: OnProgress,
        resume: bool,
    ) -> "_Made":
        made = _Made(RunData())
        mission: Mission | None = None
        try:
            path = part_path(job.part_uri)
            made.part = part = load_part(path)
            found = Restored()
            if resume:
                found = restore(folder, job, part, path, self.cell)
            made.data = found.data
            mission = self._mission(job, part, path, folder, control, on_progress, found, resume)
            state = mission.run(*self._begin(found, resume))
            made.failure = mission.failure
            if made.failure is None and job_state(state) is JobState.ABORTED:
                made.failure = StepError(self.code_of(SkinplanError()), "aborted without a reason")
        except Exception as error:  # whatever it is, the job ends with a name and a reason
            made.failure = self._step_error(error)
            self._halt()
            if mission is not None:
                mission.close_bag()
        return made

    def _begin(self, found: Restored, resume: bool) -> tuple[State, StepError | None]:
        """Returns the first state, and why a job that is taken over stands still."""
        if not resume:
            return State.STARTING, None
        text = "the supervisor was ended and started anew"
        if found.age_s > self.settings.resume_age_max_s:
            text += f" after {found.age_s:.0f} s"
        return State.STOPPING, StepError(NODE_LOST, text, "cell_supervisor")

    def _mission(
        self,
        job: Job,
        part: Part,
        part_file: Path,
        folder: RunFolder,
        control: JobControl,
        on_progress: OnProgress,
        found: Restored,
        resume: bool,
    ) -> Mission:
        settings = self.settings
        record = RunRecord(folder, found.data, self.cell)
        if resume:
            record.taken_over()
        else:
            record.began(job, part, file_sha256(part_file))
        bag = BagParts(self.cell, record, _metadata(job, part), settings.needs_recorder)
        bag.restore(found.bag_part, found.recorder_pid, found.bag_open)
        steps = Steps(
            job,
            self.config,
            self.cell,
            record,
            bag,
            settings.rescans,
            part.recognition,
            found.place,
        )
        steps.left = self._left[-1] if self._left else None
        self._left[:] = [steps.place]
        if found.place.plan is not None:
            steps.progress = steps.progress.planned(
                found.place.plan, self.config, found.place.rescan
            )
        at_start = settings.resume.at_start and found.age_s <= settings.resume_age_max_s
        return Mission(
            steps,
            control,
            settings.limits,
            ResumeSettings(settings.resume.automatic, settings.resume.attempts, at_start),
            self.code_of,
            lambda state, progress, why: on_progress(state, progress, str(folder.path), why),
        )

    def _halt(self) -> None:
        try:
            self.cell.halt(stop_devices=True)
        except StepError as error:
            _log.error("halting the cell: %s", error)

    def _step_error(self, error: Exception, step: str = "starting") -> StepError:
        if isinstance(error, StepError):
            error.step = error.step or step
            return error
        if not isinstance(error, SkinplanError | OSError):
            _log.error("unexpected error", exc_info=error)
        known = error if isinstance(error, SkinplanError) else SkinplanError()
        code = _RESUME_REFUSED if isinstance(error, ResumeError) else self.code_of(known)
        code = DISK_FULL if is_full(error) else code
        found = StepError(code, str(error) or type(error).__name__)
        found.step = "resuming" if isinstance(error, ResumeError) else step
        return found

    def _failed(self, error: StepError, folder: RunFolder | None, data: RunData) -> Outcome:
        return Outcome(JobState.ABORTED, error.code, sentence(error), folder, data)

    def _written(self, write: Callable[[], dict[str, Any]], control: JobControl) -> dict[str, Any]:
        """Writes the summary; on a full disk as soon as there is space again, bounded."""
        deadline = time.monotonic() + self.settings.limits.operator_s
        while True:
            try:
                return write()
            except Exception as error:
                if not is_full(error) or control.aborted or time.monotonic() > deadline:
                    raise
                _log.error("the summary waits for space on the disk: %s", error)
                control.wait(_AGAIN_S)

    def _write(
        self,
        job: Job,
        part: Part | None,
        folder: RunFolder,
        outcome: Outcome,
        failure: StepError | None,
    ) -> dict[str, Any]:
        folder.note(f"{outcome.state.title}{': ' + outcome.error if outcome.error else ''}")
        error: dict[str, Any] | None = None
        if failure is not None:
            error = {
                "code": failure.code,
                "step": failure.step,
                "node": failure.node,
                "message": str(failure),
            }
        elif part is not None and self.settings.with_certificate:
            outcome.data.timed = certified_motion(outcome.data, part, self.config)
        summary = outcome.data.summary(
            _job_document(job, part, outcome),
            error,
            self.config,
            None if part is None else part.scan,
        )
        summary["calibration"] = self.calibration()
        summary["timeline"] = _timeline(folder)
        folder.finish(summary)
        # Who interrupts a job does not want to wait for a report.
        self._complete(folder, self.settings.with_report and not isinstance(failure, AbortError))
        # The report adds to it: the job store keeps what stands on disk.
        document: dict[str, Any] = json.loads(folder.summary.read_text(encoding="utf-8"))
        return document

    def _complete(self, folder: RunFolder, with_report: bool) -> None:
        """Completes the summary, by a report or alone; the measurement is good also without."""
        try:
            (write_report if with_report else complete_run)(folder.path)
        except (SkinplanError, OSError) as error:
            folder.note(f"report: {error}")
            _log.error("run %s: report: %s", folder.path, error)


@dataclass
class _Made:
    data: RunData
    part: Part | None = None
    failure: StepError | None = None


def sentence(error: StepError) -> str:
    """Returns step, node and reason in one sentence."""
    place = f"{error.step or 'job'} failed" + (f" at {error.node}" if error.node else "")
    return f"{place}: {error}"


def _timeline(folder: RunFolder) -> list[dict[str, Any]]:
    try:
        return timeline(read_journal(folder.journal))
    except JournalError as error:
        folder.note(f"no timeline: {error}")
        return []


def _metadata(job: Job, part: Part) -> dict[str, str]:
    named = {"job_id": job.job_id, "order_id": job.order_id, "serial_number": job.serial_number}
    named |= {"operator_name": job.operator_name, "recipe_version": job.recipe_version}
    found = {"part": part.id, "part_uri": job.part_uri, "mesh_sha256": part.mesh_sha256}
    return {**named, **found, **dict(job.attributes)}


def _job_document(job: Job, part: Part | None, outcome: Outcome) -> dict[str, Any]:
    return {
        "id": job.job_id,
        "state": outcome.state.title,
        "order_id": job.order_id,
        "serial_number": job.serial_number,
        "part": None if part is None else part.id,
        "part_uri": job.part_uri,
        "recipe_version": job.recipe_version,
        "operator_name": job.operator_name,
        "accept_due_calibration": job.accept_due_calibration,
        "attributes": dict(job.attributes),
    }
