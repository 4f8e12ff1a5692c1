"""Floods the job services of a cell with calls, malformed ones among them, from one process.

``python tests/mes_flood.py --calls 1250 --seed 1 --job-id J --part-uri P`` prints one JSON line:
the calls, the status codes that came back, how long the answers took. Nobody of the cell's list of
operators asks for anything that would change a job.
"""

import argparse
import json
import random
import sys
import time
from collections import Counter
from collections.abc import Callable
from typing import Any

import rclpy
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import KeyValue
from rclpy.node import Node
from rclpy.qos import QoSProfile
from skinplan_msgs.msg import Job, PartReference
from skinplan_msgs.srv import JobCommand, JobGet, JobList, JobSubmit

#: A call that was not answered by then counts as unanswered [s].
PATIENCE_S = 20.0
_LOOK_S = 0.002
_GREETING_S = 2.0
TEXTS = (
    "",
    "Eve",
    "../../etc",
    "a\x00b",
    "\x1b[2J",
    "x" * 500,
    "<script>",
    "\U0001f600" * 90,
    "%s%n",
)


class Flood:
    """Calls the four services one after the other.

    Args:
        job_id: The job on the cell.
        part_uri: A part that exists.
        seed: Of the choice of calls.
    """

    def __init__(self, job_id: str, part_uri: str, seed: int) -> None:
        self._job_id, self._part_uri = job_id, part_uri
        self._rng = random.Random(seed)
        self.node = Node(f"flood_{seed}")
        self._clients = {
            kind: self.node.create_client(kind, f"jobs/{name}", qos_profile=QoSProfile(depth=500))
            for kind, name in (
                (JobSubmit, "submit"),
                (JobGet, "get"),
                (JobList, "list"),
                (JobCommand, "command"),
            )
        }
        self.codes: Counter[int] = Counter()
        self.taken_s: list[float] = []
        self.greetings = 0
        self.unanswered: list[tuple[int, str]] = []

    def run(self, calls: int) -> None:
        """Makes so many calls."""
        for client in self._clients.values():
            assert client.wait_for_service(timeout_sec=60.0), client.srv_name
        for kind in self._clients:
            # DDS may lose the answer to a client that has just come up: the server does not know it
            # yet. A bridge asks again.
            while self._call(kind, kind.Request(), _GREETING_S) is None:
                self.greetings += 1
        makers: tuple[Callable[[], Any], ...] = (
            self._submit,
            self._get,
            self._list,
            self._command,
        )
        for number in range(calls):
            request = self._rng.choice(makers)()
            kind = next(k for k in self._clients if isinstance(request, k.Request))
            begin = time.monotonic()
            answer = self._call(kind, request, PATIENCE_S)
            self.taken_s.append(time.monotonic() - begin)
            if answer is None:
                self.unanswered.append((number, kind.__name__))
            else:
                self.codes[answer.status.code] += 1

    def _call(self, kind: Any, request: Any, patience_s: float) -> Any:
        """Asks past the executor.

        Every client of a service is woken by the answers to all others; with rclpy's executor eight
        floods take more of a machine of two cores than the whole cell.
        """
        handle = self._clients[kind].handle
        with handle:
            number = handle.send_request(request)
            deadline = time.monotonic() + patience_s
            while time.monotonic() < deadline:
                header, response = handle.take_response(kind.Response)
                if header is not None and header.request_id.sequence_number == number:
                    return response
                time.sleep(_LOOK_S)
        return None

    def _text(self) -> str:
        return self._rng.choice(TEXTS)

    def _submit(self) -> JobSubmit.Request:
        rng = self._rng
        job = Job(job_id=rng.choice(("", self._job_id, "new", self._text())))
        job.part = PartReference(
            uri=rng.choice((self._part_uri, "/dev/zero", "relative", "http://x/y", self._text())),
            mesh_sha256=rng.choice(("", "0" * 64, self._text())),
        )
        # Of the list only with something that can't be accepted.
        job.operator_name = rng.choice(("Eve", "Anna", self._text()))
        job.order_id = "y" * 200 if job.operator_name == "Anna" else self._text()
        job.priority = rng.choice((0, 2**31 - 1, -(2**31)))
        job.earliest_start = Time(sec=rng.choice((0, -5, 2**31 - 1)))
        many = rng.choice((0, 3, 500))
        job.attributes = [KeyValue(key=self._text(), value=self._text()) for _ in range(many)]
        return JobSubmit.Request(job=job)

    def _get(self) -> JobGet.Request:
        job_id = self._rng.choice(("", self._job_id, self._text(), "z" * 100_000))
        deep = self._rng.random() < 0.5
        return JobGet.Request(job_id=job_id, with_history=deep, with_result=deep)

    def _list(self) -> JobList.Request:
        rng = self._rng
        return JobList.Request(
            limit=rng.choice((0, 1, 2**32 - 1)),
            before_job_id=rng.choice(("", self._text())),
            states=rng.choice(([], [2], [255] * 1000)),
            include_cleared=rng.random() < 0.5,
        )

    def _command(self) -> JobCommand.Request:
        rng = self._rng
        return JobCommand.Request(
            job_id=rng.choice((self._job_id, "", self._text())),
            command=rng.randrange(256) if rng.random() < 0.3 else rng.randrange(1, 8),
            operator_name=rng.choice(("", "Eve", "anna", "Anna ", self._text())),
            reason=rng.choice(("", self._text(), "r" * 50_000)),
        )


def main() -> int:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--calls", type=int, required=True)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--job-id", required=True)
    parser.add_argument("--part-uri", required=True)
    given = parser.parse_args()
    rclpy.init(args=[])
    flood = Flood(given.job_id, given.part_uri, given.seed)
    begin = time.monotonic()
    flood.run(given.calls)
    taken = sorted(flood.taken_s)
    report = {
        "calls": len(taken),
        "unanswered": flood.unanswered,
        "first_calls_repeated": flood.greetings,
        "codes": dict(sorted(flood.codes.items())),
        "median_s": taken[len(taken) // 2],
        "p99_s": taken[int(0.99 * len(taken))],
        "slowest_s": taken[-1],
        "seconds": time.monotonic() - begin,
    }
    sys.stdout.write(json.dumps(report) + "\n")
    flood.node.destroy_node()
    rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
