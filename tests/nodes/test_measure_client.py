"""The job client beside a supervisor that is slow, or whose answers get lost."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from skinplan_msgs.msg import JobStatus, Status
from skinplan_msgs.srv import JobSubmit

from nodes.bench import TIMEOUT_S, Bench
from skinplan_nodes.qos import LATCHED


class SlowDesk:
    """Takes jobs; its first answer comes too late."""

    def __init__(self, bench: Bench, late_s: float) -> None:
        self.asked: list[str] = []
        self._late_s = late_s
        self._states = bench.tester.create_publisher(JobStatus, "job_status", LATCHED)
        bench.tester.create_service(JobSubmit, "jobs/submit", self._on_submit)

    def _on_submit(self, request: Any, response: Any) -> Any:
        self.asked.append(request.job.job_id)
        if len(self.asked) == 1:
            time.sleep(self._late_s)
        else:
            self._states.publish(JobStatus(job_id=request.job.job_id, state=JobStatus.ENDED))
        response.status = Status(code=Status.OK)
        return response


def test_an_order_without_answer_is_sent_again(bench: Bench, tmp_path: Path) -> None:
    desk = SlowDesk(bench, late_s=3.0)
    command = [sys.executable, "-P", "-m", "skinplan_nodes.measure", "--job-id", "job"]
    command += ["--part-uri", "/part.yaml", "--runs-folder", str(tmp_path)]
    found = subprocess.run(
        command, capture_output=True, text=True, timeout=2 * TIMEOUT_S, env=os.environ, check=False
    )
    assert found.returncode == 0, found.stderr
    assert desk.asked[:2] == ["job", "job"]
    result = json.loads(found.stdout.splitlines()[-1])
    assert (result["event"], result["state"], result["error"]) == ("result", "Ended", "")
