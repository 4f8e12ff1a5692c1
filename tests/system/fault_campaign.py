"""Faults in the middle of runs of the whole graph: what becomes of job, motion and bag.

``PYTHONPATH=tests .venv/bin/python -m system.fault_campaign --out table.md`` runs every fault at
every state with three seeds, which takes hours; ``--faults``, ``--states`` and ``--seeds`` choose.
"""

import argparse
import json
import os
import random
import signal
import tempfile
import time
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from diagnostic_msgs.msg import KeyValue
from nav_msgs.msg import Odometry
from rosbags.highlevel import AnyReader
from sensor_msgs.msg import JointState
from skinplan_msgs.msg import JobStatus, Status
from skinplan_msgs.srv import InjectFault, JobCommand

from nodes.bench import Bench
from nodes.small_part import write_small_part
from skinplan_nodes.conversions import stamp_from_msg
from skinplan_nodes.draining import subscribe_draining
from skinplan_nodes.graph import GraphSettings, describe
from skinplan_nodes.qos import LATCHED, STATE
from system.graph_run import GraphRun

STATES = (
    "starting",
    "driving",
    "localizing",
    "planning",
    "moving",
    "scanning",
    "inspecting",
    "closing",
)
#: Node and fault, with the values of the fault.
INJECTED: dict[str, tuple[str, dict[str, str]]] = {
    "protective_stop": ("mock_ur5", {}),
    "emergency_stop": ("mock_ur5", {}),
    "stops_following": ("mock_ur5", {}),
    "blocked": ("mock_mir100", {}),
    "base.lost": ("mock_mir100", {}),
    "never_answers": ("mock_mir100", {}),
    "jump": ("mock_mir100", {"jump": "0.08"}),
    "frozen": ("mock_camera", {}),
    "dark": ("mock_camera", {}),
    "stale_stamps": ("mock_camera", {}),
    "no_images": ("mock_camera", {}),
    "hidden": ("mock_ctrack", {}),
    "tracker.lost": ("mock_ctrack", {}),
    "drops_frames": ("mock_ctrack", {"share": "0.5"}),
    "clock_jump": ("sim_clock", {"jump": "5.0"}),
}
KILLED = tuple(f"kill {node.name}" for node in describe(GraphSettings(Path("/runs"), "/part.yaml")))
FAULTS = (*INJECTED, *KILLED)
#: How long a fault lasts [s of wall time]; those of the operator last until somebody looks.
LASTS_S = 3.0
#: A run that is not over by then hangs.
BOUND_S = 240.0
_FACTOR = "8"
_STILL_RAD, _STILL_M = 1e-3, 2e-3
_PATIENCE = {"operator_timeout_s": 60.0, "recovery_timeout_s": 40.0}


@dataclass(frozen=True)
class Row:
    """What became of one run."""

    fault: str
    state: str
    seed: int
    ended: str
    code: str
    area_ratio: float
    interruptions: int
    moved_while_stopped: bool
    bag_messages: int
    wall_s: float
    note: str

    @property
    def is_good(self) -> bool:
        """Finished, or ended as failed with a code; nothing moved, nothing was lost."""
        named = self.ended == "Ended" or (self.ended == "Aborted" and self.code != "")
        return named and not self.moved_while_stopped and self.bag_messages > 0

    def cells(self) -> str:
        """As a line of a table."""
        area = "" if np.isnan(self.area_ratio) else f"{self.area_ratio:.4f}"
        moved = "**yes**" if self.moved_while_stopped else "no"
        what = f"{self.fault} | {self.state} | {self.seed} | {self.ended} {self.code}"
        figures = (
            f"{self.interruptions} | {area} | {moved} | {self.bag_messages} | {self.wall_s:.0f}"
        )
        return f"| {what} | {figures} |"


HEAD = (
    "| fault | state | seed | end | interruptions | area | moved while stopped | bag messages | "
    "wall [s] |\n|---|---|---|---|---|---|---|---|---|"
)


class Watch:
    """What somebody beside the cell sees: status, joints and odometry; and what he can do."""

    def __init__(self) -> None:
        self.bench = Bench()
        node = self.bench.tester
        self.status = JobStatus()
        self._poses: deque[tuple[float, np.ndarray]] = deque(maxlen=4000)
        self._joints, self._place = np.zeros(6), np.zeros(2)
        node.create_subscription(JobStatus, "job_status", self._on_status, LATCHED)
        subscribe_draining(node, JointState, "joint_states", self._on_joints, STATE)
        node.create_subscription(Odometry, "odom", self._on_odometry, STATE)

    def stands(self, for_s: float) -> bool:
        """Whether arm and base do not move from the present status on, seconds of wall time.

        Judged by the stamps: what this machine hears late happened before.
        """
        begin_s = stamp_from_msg(self.status.header.stamp)
        time.sleep(for_s)
        seen = np.array([pose for at_s, pose in list(self._poses) if at_s >= begin_s])
        if not len(seen):
            return True
        spread = np.ptp(seen, axis=0)
        return bool(spread[:6].max() < _STILL_RAD and spread[6:].max() < _STILL_M)

    def inject(self, node: str, fault: str, values: dict[str, str]) -> None:
        """Begins a fault; an empty one ends all of the node."""
        pairs = [KeyValue(key=key, value=value) for key, value in values.items()]
        request = InjectFault.Request(fault=fault, values=pairs)
        answer = self.bench.call(InjectFault, f"{node}/inject_fault", request)
        assert answer.status.code == Status.OK, answer.status.message

    def resume(self, job_id: str) -> None:
        """Says RESUME."""
        request = JobCommand.Request(job_id=job_id, command=JobCommand.Request.RESUME)
        self.bench.call(JobCommand, "jobs/command", request)

    def _on_status(self, message: JobStatus) -> None:
        self.status = message

    def _on_joints(self, message: JointState) -> None:
        self._joints = np.array(message.position)
        stamp_s = stamp_from_msg(message.header.stamp)
        self._poses.append((stamp_s, np.append(self._joints, self._place)))

    def _on_odometry(self, message: Odometry) -> None:
        place = message.pose.pose.position
        self._place = np.array([place.x, place.y])


def run_case(folder: Path, fault: str, state: str, seed: int) -> Row:
    """Runs one job with one fault."""
    part = write_small_part(folder)
    config = folder / "config"
    config.mkdir()
    document = {"/**": {"ros__parameters": _PATIENCE}}
    (config / "cell_supervisor.yaml").write_text(yaml.safe_dump(document))
    watch = Watch()
    options = ["--time-factor", _FACTOR, "--job-id", "job", "--seed", str(seed)]
    options += ["--restarts", "5", "--config-folder", str(config)]
    assert part.source is not None
    run = GraphRun(folder / "runs", part.source, *options)
    begin = time.monotonic()
    note, moved = "", False
    try:
        run.until_sub_state(state)
        time.sleep(random.Random(f"{fault} {state} {seed}").uniform(0.0, 0.6))
        try:
            begin_fault(run, watch, fault)
        except StopIteration:
            note = "the run was over before the fault"
        began = time.monotonic()
        moved = follow(run, watch, fault, began)
        if run.process.poll() is None:
            note = f"hangs in {watch.status.sub_state}"
            run.process.send_signal(signal.SIGINT)
        run.wait(60.0)
        run.wait_gone()
    finally:
        run.close()
        watch.bench.close()
    return row(folder / "runs" / "job", run, (fault, state, seed), moved, begin, note)


def begin_fault(run: GraphRun, watch: Watch, fault: str) -> None:
    """Kills a process or injects a fault."""
    if fault.startswith("kill "):
        run.node(fault.removeprefix("kill ")).send_signal(signal.SIGKILL)
        return
    node, values = INJECTED[fault]
    watch.inject(node, fault.rpartition(".")[2], values)


def follow(run: GraphRun, watch: Watch, fault: str, began: float) -> bool:
    """Follows a run to its end as an operator would; returns whether it moved while stopped."""
    moved, cleared = False, fault.startswith("kill ") or fault == "clock_jump"
    while run.process.poll() is None and time.monotonic() - began < BOUND_S:
        time.sleep(0.1)
        status = watch.status
        waits = status.state == JobStatus.INTERRUPTED and status.sub_state == "waiting"
        if waits:
            still = watch.stands(1.0)
            moved |= not still and watch.status.sub_state == "waiting"
        if not cleared and (waits or time.monotonic() - began > LASTS_S):
            cleared = end_fault(watch, fault)
        if waits and cleared and watch.status.sub_state == "waiting":
            watch.resume("job")
            time.sleep(0.5)
    return moved


def end_fault(watch: Watch, fault: str) -> bool:
    """Ends a fault; a node that does not answer any more has ended with its graph."""
    try:
        watch.inject(INJECTED[fault][0], "", {})
    except AssertionError:
        return False
    return True


def row(
    run_folder: Path,
    run: GraphRun,
    case: tuple[str, str, int],
    moved: bool,
    begin: float,
    note: str,
) -> Row:
    """Reads what a run left."""
    path = run_folder / "summary.json"
    summary: dict[str, Any] = json.loads(path.read_text()) if path.is_file() else {}
    results = [event for event in run.events if event.get("event") == "result"]
    ended = str(results[-1].get("state", "")) if results else "no result"
    error = summary.get("error", {})
    code = str(error.get("code", "")) if error else ""
    return Row(
        *case,
        ended,
        code,
        float(summary.get("measured", {}).get("area_ratio", np.nan)),
        len(summary.get("interruptions", [])),
        moved,
        messages_in(sorted(run_folder.glob("bag*"))),
        time.monotonic() - begin,
        note or str(error.get("message", "")),
    )


def messages_in(bags: Iterable[Path]) -> int:
    """Counts the messages of all parts of a bag, with a foreign reader; -1 = unreadable."""
    count = 0
    for bag in bags:
        try:
            with AnyReader([bag]) as reader:
                count += sum(1 for _ in reader.messages())
        except Exception:
            return -1
    return count


def main() -> None:
    """Runs the campaign and writes the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--faults", nargs="*", default=list(FAULTS))
    parser.add_argument("--states", nargs="*", default=list(STATES))
    parser.add_argument("--seeds", nargs="*", type=int, default=[1, 2, 3])
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    with given.out.open("a", encoding="utf-8") as table:
        table.write(HEAD + "\n")
        for fault in given.faults:
            for state in given.states:
                for seed in given.seeds:
                    with tempfile.TemporaryDirectory() as folder:
                        found = run_case(Path(folder), fault, state, seed)
                    good = "" if found.is_good else " **bad**"
                    table.write(f"{found.cells()} {found.note}{good}\n")
                    table.flush()


if __name__ == "__main__":
    main()
