"""Orders of an MES against a cell, with all that happens to orders, and what must come of it."""

import os
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import yaml
from skinplan_msgs.msg import JobStatus, Status
from skinplan_msgs.srv import JobCommand, JobGet

from nodes.small_part import write_small_part
from skinplan.jobs.model import JobState
from skinplan.jobs.states import TRANSITIONS

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "launch_scripts"))
from mes_client import OVER, MesClient

Ask = JobCommand.Request
#: What happens in the middle of a job, by its number.
EVENTS = {2: "kill", 4: "pause", 6: "abort", 8: "kill", 12: "kill"}

ATTRIBUTES = {"shift": "late", "note": "<b>Zoë & co</b>"}


def write_parts(folder: Path) -> list[Path]:
    """Writes three parts that fit the same cell: id, mesh and hash differ."""
    found = []
    for number, height_m in enumerate((0.03, 0.0305, 0.0295)):
        part = write_small_part(_made(folder / f"part{number}"), height_m)
        assert part.source is not None
        document = yaml.safe_load(part.source.read_text())
        document["id"] = f"panel{number}"
        part.source.write_text(yaml.safe_dump(document))
        found.append(part.source)
    return found


def orders_of(parts: list[Path], count: int) -> list[dict[str, Any]]:
    """Returns orders of mixed parts; their priorities make them run in this order."""
    return [
        {
            "job_id": f"order-{number:02d}",
            "order_id": f"A{number}",
            "serial_number": f"SN-{number}",
            "part_uri": str(parts[number % len(parts)]),
            "part_id": f"panel{number % len(parts)}",
            "recipe_version": "3",
            "priority": 100 - number,
            "attributes": ATTRIBUTES,
        }
        for number in range(1, count + 1)
    ]


def hand_in(client: MesClient, orders: list[dict[str, Any]]) -> None:
    """Hands all in, one twice, one with other content, and one of a part that is not there."""
    for order in orders:
        answer = client.submit(order)
        assert answer.status.code == Status.OK, answer.status.message
    assert client.submit(orders[-1]).status.code == Status.OK, "the same is no conflict"
    other = {**orders[-1], "serial_number": "another"}
    assert client.submit(other).status.code == Status.JOB_CONFLICT
    unknown = {**orders[-1], "job_id": "refused", "part_uri": "/nowhere/part.yaml"}
    assert client.submit(unknown).status.code == Status.PART_NOT_FOUND


def work_through(
    client: MesClient,
    orders: list[dict[str, Any]],
    events: dict[int, str],
    kill: Callable[[], None],
    timeout_s: float,
) -> dict[str, JobGet.Response]:
    """Follows all orders to their end, with what happens meanwhile; fetches and acknowledges."""
    fetched = {}
    for number, order in enumerate(orders, 1):
        job_id, event = order["job_id"], events.get(number, "")
        if event:
            _until(client, job_id, lambda s: s.state == JobStatus.RUNNING and s.station > 0)
            _happen(client, job_id, event, kill)
        client.follow(job_id, timeout_s)
        fetched[job_id] = client.fetch(job_id)
        assert client.acknowledge(job_id).job_status.cleared
        sys.stdout.write(f"{job_id} {event}: {_told(fetched[job_id])}\n")
    return fetched


def check(fetched: dict[str, JobGet.Response], events: dict[int, str]) -> None:
    """Every history is complete and consistent, and tells what happened."""
    for number, (job_id, found) in enumerate(sorted(fetched.items()), 1):
        event = events.get(number, "")
        states = [JobState(entry.state) for entry in found.history]
        assert states[0] is JobState.ALLOWED_TO_START, job_id
        # CLEAR came after it was fetched: the last entry is the end.
        wanted = JobState.ABORTED if event == "abort" else JobState.ENDED
        assert states[-1] is wanted, f"{job_id}: {found.job_status.status.message}"
        assert int(states[-1]) == found.job_status.state
        for before, after in zip(states, states[1:], strict=False):
            assert before is after or after in TRANSITIONS[before], f"{job_id}: {before} {after}"
        stamps = [(entry.stamp.sec, entry.stamp.nanosec) for entry in found.history]
        assert stamps == sorted(stamps), job_id
        reasons = " ".join(entry.reason for entry in found.history)
        subs = [entry.sub_state for entry in found.history]
        assert ("started anew" in reasons) == (event == "kill"), job_id
        assert (JobState.INTERRUPTED in states) == (event in ("kill", "pause")), job_id
        assert ("paused" in subs) == (event == "pause"), job_id
        assert ("PAUSE was given by Anna" in reasons) == (event == "pause"), job_id
        assert f'"{job_id}"' in found.result and '"calibration"' in found.result, job_id
        if wanted is JobState.ENDED:
            assert {"driving", "localizing", "planning", "scanning", "inspecting"} <= set(subs)
            assert '"area_ratio"' in found.result
        assert {item.key: item.value for item in found.job.attributes} == ATTRIBUTES, job_id


def kill_process(pid: int) -> None:
    """Ends a process as a power cut would."""
    os.kill(pid, signal.SIGKILL)


def _happen(client: MesClient, job_id: str, event: str, kill: Callable[[], None]) -> None:
    if event == "kill":
        kill()
    elif event == "abort":
        assert client.command(job_id, Ask.ABORT, "wrong part").status.code == Status.OK
    else:
        assert client.command(job_id, Ask.PAUSE, "lunch").status.code == Status.OK
        _until(client, job_id, lambda s: s.sub_state == "paused")
        assert client.command(job_id, Ask.PAUSE).status.code == Status.JOB_COMMAND_REFUSED
        assert client.command(job_id, Ask.RESUME, "back").status.code == Status.OK


def _until(client: MesClient, job_id: str, condition: Callable[[JobStatus], bool]) -> None:
    deadline = time.monotonic() + 300.0
    while not condition(client.look(job_id)):
        assert client.states[job_id].state not in OVER, client.states[job_id]
        assert time.monotonic() < deadline, client.states[job_id]
        client.spin(0.02)


def _told(found: JobGet.Response) -> str:
    states = " ".join(str(entry.state) for entry in found.history)
    return f"{len(found.history)} entries ({states}) {found.job_status.status.message}"


def _made(folder: Path) -> Path:
    folder.mkdir(parents=True)
    return folder
