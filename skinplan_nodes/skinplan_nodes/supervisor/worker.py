"""Works one job off: makes its folder, runs its mission, and always leaves a summary."""

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from skinplan.errors import SkinplanError
from skinplan.inspection.report import write_report
from skinplan.jobs.model import Job, JobState
from skinplan.part.files import load_part
from skinplan.part.model import Part
from skinplan.robot.cell import CellConfig
from skinplan_nodes.part_cache import part_path
from skinplan_nodes.supervisor.cell import Cell
from skinplan_nodes.supervisor.control import AbortError, JobControl, StepError
from skinplan_nodes.supervisor.mission import Mission
from skinplan_nodes.supervisor.progress import Progress
from skinplan_nodes.supervisor.run_data import RunData
from skinplan_nodes.supervisor.run_folder import RunFolder

OK = 1
# What was scanned before a failure is merged, but nobody who ended the job waits long for that.
_SALVAGE_S = 30.0
_SALVAGE_ABORTED_S = 1.0
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Outcome:
    """How a job ended.

    Attributes:
        state: ENDED or ABORTED.
        code: Status code; 1 = all is well.
        error: Step, node and reason in one sentence; empty = all is well.
        folder: The run's folder; None = it could not be made.
        data: What was gathered.
    """

    state: JobState
    code: int
    error: str
    folder: RunFolder | None
    data: RunData


@dataclass(frozen=True)
class JobWorker:
    """Works jobs off, one at a time.

    Attributes:
        cell: The cell.
        config: The cell's figures.
        runs_folder: Gets the folders of the runs.
        code_of: Status code of an error of the library.
        with_report: Write ``report.html`` after a job, unless it was aborted from outside.
    """

    cell: Cell
    config: CellConfig
    runs_folder: Path
    code_of: Callable[[SkinplanError], int]
    with_report: bool = True

    def work(
        self, job: Job, control: JobControl, on_progress: Callable[[Progress, str], None]
    ) -> Outcome:
        """Works a job off, from its folder to its summary; never raises.

        Args:
            job: The order.
            control: Switches of the job.
            on_progress: Told the progress and the run's folder.
        """
        data = RunData()
        try:
            folder = RunFolder.create(self.runs_folder, job.job_id)
        except (SkinplanError, OSError) as error:
            return self._failed(self._step_error(error, "starting"), None, data)
        began = (time.monotonic(), self.cell.now_s())
        part, failure = self._run(job, folder, control, data, on_progress)
        data.timing_s = {"wall": time.monotonic() - began[0], "cell": self.cell.now_s() - began[1]}
        outcome = Outcome(JobState.ENDED, OK, "", folder, data)
        if failure is not None:
            outcome = self._failed(failure, folder, data)
        try:
            self._write(job, part, folder, outcome, failure)
        except Exception as error:  # the job must come to an end, whatever it is
            _log.exception("job %s: writing the summary", job.job_id)
            return self._failed(self._step_error(error, "closing"), folder, data)
        return outcome

    def _run(
        self,
        job: Job,
        folder: RunFolder,
        control: JobControl,
        data: RunData,
        on_progress: Callable[[Progress, str], None],
    ) -> tuple[Part | None, StepError | None]:
        part: Part | None = None
        mission: Mission | None = None
        failure: StepError | None = None

        def report(progress: Progress) -> None:
            on_progress(progress, str(folder.path))

        try:
            part = load_part(part_path(job.part_uri))
            mission = Mission(job, part, self.config, self.cell, folder, control, report, data)
            mission.run()
        except Exception as error:  # whatever it is, the job ends with a name and a reason
            failure = self._step_error(error, "starting")
            self._salvage(job, folder, data, failure)
        if mission is not None:
            mission.close()
        return part, failure

    def _salvage(self, job: Job, folder: RunFolder, data: RunData, failure: StepError) -> None:
        """Stops the devices and merges what was scanned up to the failure."""
        self.cell.halt()
        if not data.trajectories or data.measured:
            return
        timeout_s = _SALVAGE_ABORTED_S if isinstance(failure, AbortError) else _SALVAGE_S
        try:
            data.measured = self.cell.finish_inspection(job, folder.cloud, timeout_s)
        except SkinplanError as error:
            folder.note(f"what was scanned before the failure could not be merged: {error}")

    def _step_error(self, error: Exception, step: str) -> StepError:
        if isinstance(error, StepError):
            error.step = error.step or step
            return error
        if not isinstance(error, SkinplanError | OSError):
            _log.error("unexpected error", exc_info=error)
        code = (
            self.code_of(error)
            if isinstance(error, SkinplanError)
            else self.code_of(SkinplanError())
        )
        found = StepError(code, str(error) or type(error).__name__)
        found.step = step
        return found

    def _failed(self, error: StepError, folder: RunFolder | None, data: RunData) -> Outcome:
        return Outcome(JobState.ABORTED, error.code, sentence(error), folder, data)

    def _write(
        self,
        job: Job,
        part: Part | None,
        folder: RunFolder,
        outcome: Outcome,
        failure: StepError | None,
    ) -> None:
        folder.note(f"{outcome.state.title}{': ' + outcome.error if outcome.error else ''}")
        error: dict[str, Any] | None = None
        if failure is not None:
            error = {
                "code": failure.code,
                "step": failure.step,
                "node": failure.node,
                "message": str(failure),
            }
        summary = outcome.data.summary(
            _job_document(job, part, outcome),
            error,
            self.config,
            None if part is None else part.scan,
        )
        folder.finish(summary)
        # Who interrupts a job does not want to wait for a report.
        if self.with_report and not isinstance(failure, AbortError):
            self._report(folder)

    def _report(self, folder: RunFolder) -> None:
        """Writes the report; the measurement is good also without."""
        try:
            write_report(folder.path)
        except (SkinplanError, OSError) as error:
            folder.note(f"report: {error}")
            _log.error("run %s: report: %s", folder.path, error)


def sentence(error: StepError) -> str:
    """Returns step, node and reason in one sentence."""
    place = f"{error.step or 'job'} failed" + (f" at {error.node}" if error.node else "")
    return f"{place}: {error}"


def _job_document(job: Job, part: Part | None, outcome: Outcome) -> dict[str, Any]:
    return {
        "id": job.job_id,
        "state": outcome.state.title,
        "order_id": job.order_id,
        "serial_number": job.serial_number,
        "part": None if part is None else part.id,
        "part_uri": job.part_uri,
        "attributes": dict(job.attributes),
    }
