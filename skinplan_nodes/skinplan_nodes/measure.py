"""Hands in one job and follows it: the client of ``skinplan run``.

Prints one event per change of the job; the last one is the result. An interrupt aborts the job. In
a simulated cell it knows the truth, and adds to ``summary.json`` how far the localisations were
from it.
"""

import argparse
import json
import logging
import math
import signal
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from skinplan_msgs.msg import Status
from skinplan_msgs.srv import JobCommand, JobGet, JobSubmit

from skinplan.errors import SkinplanError
from skinplan.inspection.report import write_report
from skinplan.jobs.model import Job, JobRecord, JobState
from skinplan.jobs.states import is_over
from skinplan.json_file import write_json
from skinplan.robot.cell_file import load_cell
from skinplan_nodes.conversions import job_to_msg
from skinplan_nodes.dds_profiles import use_profiles
from skinplan_nodes.measure_client import MeasureClient
from skinplan_nodes.truth import TruthLog

_SUBMIT_S = 90.0
# An order or its answer may get lost while the nodes find each other: it is sent again, which is
# the same job.
_ANSWER_S, _AGAIN_S = 10.0, 2.0
_ASK_PERIOD_S = 2.0
_ABORT_S = 1.0
_log = logging.getLogger(__name__)


class Measurement:
    """One job from its submission to its end.

    Args:
        job: The order.
        truth: Takes the true poses.
        on_change: Called with every change of the job.
        reason: File that says why the client is interrupted; it need not exist.
        namespace: Namespace of the cell.
    """

    def __init__(
        self,
        job: Job,
        truth: TruthLog,
        on_change: Callable[[JobRecord], None],
        reason: Path,
        namespace: str = "",
    ) -> None:
        self._job = job
        self._reason = reason
        self._node = MeasureClient(truth, on_change, namespace)
        self._node.job_id = job.job_id
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._asked_to_end = False
        self.interrupted = False
        self._asked: Any = None
        self._asked_s = 0.0

    def interrupt(self) -> None:
        """Asks for the end of the job; called by the signal handler."""
        self._asked_to_end = True

    def run(self) -> tuple[JobRecord | None, str]:
        """Submits the job and waits for its end.

        Returns:
            The last state of the job, None when it was never taken; and one sentence when it did
            not end well.
        """
        error = self._submit()
        if error:
            return None, error
        while not self._over():
            self._executor.spin_once(timeout_sec=0.1)
            if self._asked_to_end:
                self._abort()
                self.interrupted = True
                break
            if self._node.absence.asking:
                self._ask()
            problem = self._node.absence.problem(time.monotonic(), self._state())
            if problem:
                return self._node.record, problem
        record = self._node.record
        error = record.error if record is not None else ""
        return record, error or (self._why() if self.interrupted else "")

    def close(self) -> None:
        """Leaves the graph."""
        rclpy.try_shutdown()
        self._node.destroy_node()

    def _submit(self) -> str:
        if not self._spin_until(self._node.submit.service_is_ready, _SUBMIT_S):
            if self._asked_to_end:
                return self._why()
            return f"nobody serves jobs/submit after {_SUBMIT_S:g} s"
        deadline = time.monotonic() + _ANSWER_S
        while True:
            answer = self._node.submit.call_async(JobSubmit.Request(job=job_to_msg(self._job)))
            if self._spin_until(answer.done, _AGAIN_S):
                break
            self._node.submit.remove_pending_request(answer)
            if self._asked_to_end:
                # It may have been taken all the same.
                self._abort()
                return self._why()
            if time.monotonic() > deadline:
                return f"no answer of jobs/submit within {_ANSWER_S:g} s"
        self._node.absence.expect(time.monotonic())
        status = answer.result().status
        return "" if status.code == Status.OK else str(status.message)

    def _ask(self) -> None:
        """Asks a supervisor that was started again how the job is."""
        now_s, client = time.monotonic(), self._node.get
        if self._asked is not None and self._asked.done():
            answer, self._asked = self._asked.result(), None
            if answer is not None and answer.status.code == Status.OK:
                self._node.take(answer.job_status)
                record = self._node.record
                if record is not None and record.state is JobState.RUNNING:
                    self._node.absence.goes_on()
        elif now_s - self._asked_s > _ASK_PERIOD_S and client.service_is_ready():
            self._asked_s = now_s
            if self._asked is not None:
                client.remove_pending_request(self._asked)
            self._asked = client.call_async(JobGet.Request(job_id=self._job.job_id))

    def _state(self) -> str:
        record = self._node.record
        return "not known" if record is None else record.state.title

    def _abort(self) -> None:
        request = JobCommand.Request(
            job_id=self._job.job_id,
            command=JobCommand.Request.ABORT,
            operator_name=self._job.operator_name,
            reason=self._why(),
        )
        self._node.command.call_async(request)
        self._asked_to_end = False
        self._spin_until(self._over, _ABORT_S)

    def _why(self) -> str:
        if self._reason.is_file():
            return self._reason.read_text(encoding="utf-8").strip()
        return "interrupted"

    def _over(self) -> bool:
        return self._node.record is not None and is_over(self._node.record.state)

    def _spin_until(self, done: Callable[[], bool], timeout_s: float) -> bool:
        deadline = time.monotonic() + timeout_s
        while not done():
            self._executor.spin_once(timeout_sec=0.05)
            if time.monotonic() > deadline or self._asked_to_end:
                return done()
        return True


def judge(run_folder: Path, truth: TruthLog) -> None:
    """Adds to a run's summary how far the localisations were from the truth, if that is known."""
    path = run_folder / "summary.json"
    if truth.T_map_workpiece is None or not path.is_file():
        return
    summary = json.loads(path.read_text(encoding="utf-8"))
    entries = summary.get("localization", [])
    summary["localization"] = [truth.judged(entry) for entry in entries]
    write_json(path, summary)


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of the program.

    Returns:
        Exit code: 0 when the job ended well, 1 otherwise.
    """
    logging.basicConfig(
        level=logging.INFO, stream=sys.stderr, format="%(levelname)s %(name)s: %(message)s"
    )
    given = _parser().parse_args(arguments)
    cell = load_cell(Path(given.cell_file) if given.cell_file else None)
    job = Job(
        given.job_id,
        given.part_uri,
        serial_number=given.serial_number,
        operator_name=given.operator,
    )
    truth = TruthLog(cell.T_base_link_arm_base)
    use_profiles()
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    reason = Path(given.runs_folder) / given.job_id / "log" / "died.txt"
    measurement = Measurement(
        job, truth, lambda record: _emit(_status_event(record)), reason, given.namespace
    )
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: measurement.interrupt())
    record, error = measurement.run()
    measurement.close()
    folder = Path(record.run_folder) if record is not None and record.run_folder else None
    if folder is not None:
        # Who interrupts a job does not want to wait for a report.
        _complete(folder, truth, with_report=not measurement.interrupted)
    _emit(_result_event(job, record, folder, error))
    return 0 if record is not None and record.state is JobState.ENDED else 1


def _complete(folder: Path, truth: TruthLog, with_report: bool) -> None:
    try:
        judge(folder, truth)
        if with_report:
            write_report(folder)
    except (SkinplanError, OSError, ValueError, KeyError) as error:
        _log.error("run %s: %s", folder, error)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m skinplan_nodes.measure", description=__doc__)
    parser.add_argument(
        "--part-uri", required=True, help="absolute path or file:// URI of the part file"
    )
    parser.add_argument("--runs-folder", default="runs", help="folder of the runs' log folders")
    parser.add_argument("--job-id", required=True, help="id of the job")
    parser.add_argument("--serial-number", default="", help="serial number of the individual part")
    parser.add_argument("--operator", default="", help="who asks, where the cell has a list")
    parser.add_argument("--cell-file", default="", help="cell file; empty = the default cell")
    parser.add_argument("--namespace", default="", help="namespace of the cell's nodes")
    parser.add_argument("--json-lines", action="store_true", help="events as JSON lines (always)")
    return parser


def _status_event(record: JobRecord) -> dict[str, Any]:
    return {
        "event": "status",
        "job_id": record.job.job_id,
        "state": record.state.title,
        "sub_state": record.sub_state,
        "station": record.station,
        "station_count": record.station_count,
        "progress": record.progress,
        "time_left_s": record.time_left_s if math.isfinite(record.time_left_s) else None,
    }


def _result_event(
    job: Job, record: JobRecord | None, folder: Path | None, error: str
) -> dict[str, Any]:
    return {
        "event": "result",
        "job_id": job.job_id,
        "state": record.state.title
        if record is not None and is_over(record.state)
        else JobState.ABORTED.title,
        "run_folder": str(folder) if folder is not None else "",
        "error": error,
    }


def _emit(event: dict[str, Any]) -> None:
    sys.stdout.write(json.dumps(event) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
