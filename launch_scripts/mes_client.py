"""A reference client for bridges to an MES: submits jobs, follows them, fetches and acknowledges.

Needs rclpy and skinplan_msgs, nothing else of this repository; docs/mes.md explains each step.

``python launch_scripts/mes_client.py --orders orders.json --out results`` works orders off::

    [{"job_id": "A-1", "part_uri": "/parts/a/part.yaml", "serial_number": "SN-1", "priority": 5}]

Each is a JSON object with the fields of skinplan_msgs/Job (``part_uri`` and ``mesh_sha256`` are
those of its part; ``attributes`` is an object). It prints one JSON line per event and ends with 0
when every order is over and fetched, 1 when one was refused, 3 when the cell did not answer.
"""

import argparse
import json
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import rclpy
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import KeyValue
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from skinplan_msgs.msg import Job, JobStatus, PartReference, Status
from skinplan_msgs.srv import JobCommand, JobGet, JobSubmit

# A call that was not answered by then is made again: all four services may be asked twice.
ANSWER_S = 3.0
# How often a job is asked for although nothing was heard of it: topics may lose a message.
LOOK_S = 2.0
# What may be tried again later; every other refusal is for good.
LATER = (Status.DEVICE_NOT_READY, Status.JOB_QUEUE_FULL, Status.JOB_STORE_FAILED)
OVER = (JobStatus.ENDED, JobStatus.ABORTED)
# Every client of a service gets the answers to all others, too: with the default depth of 10 they
# may push ours out before it is taken.
CALLS = QoSProfile(depth=500)
NAMES = {
    JobStatus.NOT_ALLOWED_TO_START: "NotAllowedToStart",
    JobStatus.ALLOWED_TO_START: "AllowedToStart",
    JobStatus.RUNNING: "Running",
    JobStatus.INTERRUPTED: "Interrupted",
    JobStatus.ENDED: "Ended",
    JobStatus.ABORTED: "Aborted",
}


class CellAbsentError(Exception):
    """The cell did not answer in time."""


class MesClient:
    """Talks to one cell.

    Args:
        operator_name: Who asks; goes into every order and command.
        patience_s: A cell that does not answer for so long is absent: a supervisor that was started
            anew needs some seconds [s].
        on_status: Called with every new state of a job.
        namespace: Namespace of the cell.
    """

    def __init__(
        self,
        operator_name: str = "",
        patience_s: float = 90.0,
        on_status: Callable[[JobStatus], None] = lambda _: None,
        namespace: str = "",
    ) -> None:
        self.operator_name = operator_name
        self._patience_s = patience_s
        self._on_status = on_status
        self.node = Node("mes_client", namespace=namespace)
        self._submit = self.node.create_client(JobSubmit, "jobs/submit", qos_profile=CALLS)
        self._get = self.node.create_client(JobGet, "jobs/get", qos_profile=CALLS)
        self._command = self.node.create_client(JobCommand, "jobs/command", qos_profile=CALLS)
        self.states: dict[str, JobStatus] = {}
        latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.node.create_subscription(JobStatus, "job_status", self._take, latched)

    def submit(self, order: dict[str, Any]) -> JobSubmit.Response:
        """Hands an order in; with an id of its own it is the same job when handed in again."""
        return self._call(self._submit, JobSubmit.Request(job=job_of(order, self.operator_name)))

    def command(self, job_id: str, command: int, reason: str = "") -> JobCommand.Response:
        """Commands a job; what comes of it is seen in its state."""
        request = JobCommand.Request(job_id=job_id, command=command, reason=reason)
        request.operator_name = self.operator_name
        return self._call(self._command, request)

    def look(self, job_id: str) -> JobStatus:
        """Asks how a job is."""
        found = self._call(self._get, JobGet.Request(job_id=job_id))
        if found.status.code == Status.OK:
            self._take(found.job_status)
        return found.job_status

    def fetch(self, job_id: str) -> JobGet.Response:
        """Gets a job with its history and its result."""
        request = JobGet.Request(job_id=job_id, with_history=True, with_result=True)
        return self._call(self._get, request)

    def acknowledge(self, job_id: str) -> JobCommand.Response:
        """Says that the result is safe here: the cell lists the job no more."""
        return self.command(job_id, JobCommand.Request.CLEAR, "result fetched")

    def follow(self, job_id: str, timeout_s: float) -> JobStatus:
        """Waits until a job is over, also over a restart of the cell's supervisor.

        A cell that was switched on anew sends waiting jobs back to NotAllowedToStart: this client
        says START again, because its orders are to be worked off unattended.
        """
        deadline, looked_s = time.monotonic() + timeout_s, 0.0
        while time.monotonic() < deadline:
            self.spin(0.1)
            if time.monotonic() - looked_s > LOOK_S:
                self.look(job_id)
                looked_s = time.monotonic()
                if self.states[job_id].state == JobStatus.NOT_ALLOWED_TO_START:
                    self.command(job_id, JobCommand.Request.START, "the orders are unattended")
            state = self.states.get(job_id)
            if state is not None and state.state in OVER:
                return state
        raise CellAbsentError(f"job {job_id} was not over after {timeout_s:g} s")

    def spin(self, for_s: float) -> None:
        """Takes what comes in."""
        end = time.monotonic() + for_s
        while (left := end - time.monotonic()) > 0.0:
            rclpy.spin_once(self.node, timeout_sec=left)

    def _take(self, status: JobStatus) -> None:
        known = self.states.get(status.job_id)
        # Latched and asked-for states may arrive out of order: the stamp says which is newer.
        if known is not None and _stamp(status) < _stamp(known):
            return
        self.states[status.job_id] = status
        if known is None or (known.state, known.step) != (status.state, status.step):
            self._on_status(status)

    def _call(self, client: Any, request: Any) -> Any:
        """Asks, and asks again until there is an answer."""
        deadline = time.monotonic() + self._patience_s
        while time.monotonic() < deadline:
            if client.wait_for_service(timeout_sec=1.0):
                answer = client.call_async(request)
                rclpy.spin_until_future_complete(self.node, answer, timeout_sec=ANSWER_S)
                if answer.done():
                    return answer.result()
                client.remove_pending_request(answer)
        raise CellAbsentError(f"{client.srv_name}: no answer within {self._patience_s:g} s")


def job_of(order: dict[str, Any], operator_name: str) -> Job:
    """Returns the message of an order."""
    fields = {key: value for key, value in order.items() if key not in _SPECIAL}
    job = Job(**fields)
    job.operator_name = order.get("operator_name", operator_name)
    job.part = PartReference(uri=order["part_uri"], mesh_sha256=order.get("mesh_sha256", ""))
    job.attributes = [KeyValue(key=k, value=v) for k, v in order.get("attributes", {}).items()]
    if "earliest_start_s" in order:
        job.earliest_start = Time(sec=int(order["earliest_start_s"]))
    return job


_SPECIAL = ("part_uri", "mesh_sha256", "attributes", "earliest_start_s", "operator_name")


def work_off(client: MesClient, orders: list[dict[str, Any]], out: Path, timeout_s: float) -> int:
    """Submits orders, follows them, fetches and acknowledges; returns the exit code."""
    taken, refused = [], 0
    for order in orders:
        answer = _submitted(client, order)
        if answer.status.code == Status.OK:
            taken.append(answer.job_id)
            emit("submitted", job_id=answer.job_id)
        else:
            refused += 1
            emit("refused", code=answer.status.code, reason=answer.status.message, **_named(order))
    for job_id in taken:
        client.follow(job_id, timeout_s)
        found = client.fetch(job_id)
        out.mkdir(parents=True, exist_ok=True)
        # First it is safe here, then the cell is told so.
        (out / f"{job_id}.json").write_text(json.dumps(document(found), indent=1), encoding="utf-8")
        acknowledged = client.acknowledge(job_id)
        emit("fetched", job_id=job_id, cleared=acknowledged.job_status.cleared)
    return 1 if refused else 0


def _submitted(client: MesClient, order: dict[str, Any]) -> JobSubmit.Response:
    deadline = time.monotonic() + 60.0
    while True:
        answer = client.submit(order)
        if answer.status.code not in LATER or time.monotonic() > deadline:
            return answer
        client.spin(LOOK_S)


def document(found: JobGet.Response) -> dict[str, Any]:
    """Returns what was fetched as a JSON document."""
    return {
        "job_id": found.job.job_id,
        "serial_number": found.job.serial_number,
        "state": NAMES[found.job_status.state],
        "error": {"code": found.job_status.status.code, "reason": found.job_status.status.message},
        "history": [
            {
                "time": entry.stamp.sec + 1e-9 * entry.stamp.nanosec,
                "state": NAMES[entry.state],
                "sub_state": entry.sub_state,
                "station": entry.station,
                "reason": entry.reason,
            }
            for entry in found.history
        ],
        "result": json.loads(found.result) if found.result else None,
        "summary": found.summary_uri,
        "report": found.report_uri,
    }


def emit(event: str, **fields: Any) -> None:
    """Prints one event."""
    sys.stdout.write(json.dumps({"event": event, **fields}) + "\n")
    sys.stdout.flush()


def _named(order: dict[str, Any]) -> dict[str, Any]:
    return {"job_id": order.get("job_id", "")}


def _stamp(status: JobStatus) -> tuple[int, int]:
    return status.header.stamp.sec, status.header.stamp.nanosec


def _print_status(status: JobStatus) -> None:
    left_s = status.time_left
    emit(
        "status",
        job_id=status.job_id,
        state=NAMES.get(status.state, "?"),
        sub_state=status.sub_state,
        step=[status.step, status.step_count],
        progress=round(status.progress, 3),
        time_left_s=None if left_s != left_s else round(left_s, 1),
        expected_end_s=status.expected_end.sec or None,
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--orders", type=Path, required=True, help="JSON list of orders")
    parser.add_argument("--out", type=Path, default=Path("results"), help="gets a file per job")
    parser.add_argument("--operator-name", default="", help="who asks")
    parser.add_argument("--namespace", default="", help="namespace of the cell")
    parser.add_argument("--timeout-s", type=float, default=3600.0, help="longest wait per job")
    given = parser.parse_args(arguments)
    orders = json.loads(given.orders.read_text(encoding="utf-8"))
    rclpy.init(args=[])
    client = MesClient(given.operator_name, on_status=_print_status, namespace=given.namespace)
    try:
        return work_off(client, orders, given.out, given.timeout_s)
    except CellAbsentError as error:
        emit("absent", reason=str(error))
        return 3
    finally:
        client.node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    sys.exit(main())
