"""Runs floods of calls beside a job, and says what came of it."""

import json
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import psutil
from skinplan_msgs.msg import Status

_SCRIPT = Path(__file__).with_name("mes_flood.py")
_MIB = 1024 * 1024


class Floods:
    """Processes that flood the cell.

    Args:
        processes: How many.
        calls: Of each.
        job_id: The job on the cell.
        part_uri: A part that exists.
    """

    def __init__(self, processes: int, calls: int, job_id: str, part_uri: str) -> None:
        common = ["--calls", str(calls), "--job-id", job_id, "--part-uri", part_uri]
        self._processes = [
            subprocess.Popen(
                [sys.executable, str(_SCRIPT), *common, "--seed", str(seed)],
                stdout=subprocess.PIPE,
                text=True,
            )
            for seed in range(processes)
        ]

    def run(self) -> bool:
        """Whether one of them still calls."""
        return any(process.poll() is None for process in self._processes)

    def reports(self) -> list[dict[str, Any]]:
        """Waits for their ends."""
        found = [process.communicate(timeout=900.0)[0] for process in self._processes]
        return [json.loads(text.strip().splitlines()[-1]) for text in found]

    def close(self) -> None:
        """Ends those that are left."""
        for process in self._processes:
            if process.poll() is None:
                process.kill()
            process.wait(10)


def memory_mib(process: psutil.Process) -> float:
    """Returns what a process has in memory [MiB]."""
    return float(process.memory_info().rss) / _MIB


def check_answers(reports: list[dict[str, Any]], calls: int) -> Counter[int]:
    """Every call was answered, with many different refusals; returns the codes."""
    codes: Counter[int] = Counter()
    for report in reports:
        codes.update({int(code): count for code, count in report["codes"].items()})
    assert [call for report in reports for call in report["unanswered"]] == []
    assert sum(codes.values()) == calls
    assert Status.UNSET not in codes and Status.INTERNAL not in codes, codes
    for code in (
        Status.OK,
        Status.JOB_OPERATOR_REFUSED,
        Status.JOB_TEXT_REFUSED,
        Status.JOB_UNKNOWN,
        Status.JOB_INVALID,
    ):
        assert codes[code] > 0, code
    return codes
