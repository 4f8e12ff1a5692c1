"""A served graph with somebody beside it, who orders jobs, sees what moves, and does harm."""

import os
import shutil
import signal
import time
from collections import deque
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np
import yaml
from diagnostic_msgs.msg import KeyValue
from nav_msgs.msg import Odometry
from sensor_msgs.msg import JointState
from skinplan_msgs.msg import Job, JobStatus, Status
from skinplan_msgs.srv import InjectFault, JobCommand, JobSubmit
from std_srvs.srv import Trigger

from nodes.bench import Bench
from nodes.small_part import reference, write_small_part
from skinplan.part.model import Part
from skinplan_nodes.conversions import stamp_from_msg
from skinplan_nodes.draining import subscribe_draining
from skinplan_nodes.qos import LATCHED, STATE
from system.graph_run import TIMEOUT_S, GraphRun

OVER = (JobStatus.ENDED, JobStatus.ABORTED)
#: Sub-states in which a job stands still: nothing may move in them.
STANDS = ("waiting", "paused", "recovering")
_STILL_RAD, _STILL_M = 1e-3, 2e-3


class Change(NamedTuple):
    """A change of the job's state; `at_s` is the cell's time."""

    at_s: float
    job_id: str
    state: int
    sub_state: str


class Watch:
    """What somebody beside the cell sees: status, joints and odometry; and what he can do."""

    def __init__(self) -> None:
        self.bench = Bench()
        node = self.bench.tester
        self.status = JobStatus()
        self._changes: deque[Change] = deque(maxlen=1000)
        self._poses: deque[tuple[float, np.ndarray]] = deque(maxlen=400_000)
        self._place = np.zeros(2)
        node.create_subscription(JobStatus, "job_status", self._on_status, LATCHED)
        subscribe_draining(node, JointState, "joint_states", self._on_joints, STATE)
        node.create_subscription(Odometry, "odom", self._on_odometry, STATE)

    def forget(self) -> None:
        """Begins anew with what was seen."""
        self._changes.clear()
        self._poses.clear()

    def motion_while_standing(self) -> tuple[float, float]:
        """Returns the largest motion of joints [rad] and base [m] in a stretch of `STANDS`.

        Judged by the stamps: what this machine hears late happened before.
        """
        changes = list(self._changes)
        poses = list(self._poses)
        stamps = np.array([at_s for at_s, _ in poses])
        joints = base = 0.0
        for change, following in zip(changes, changes[1:], strict=False):
            if change.state != JobStatus.INTERRUPTED or change.sub_state not in STANDS:
                continue
            inside = (stamps >= change.at_s) & (stamps < following.at_s)
            if inside.any():
                spread = np.ptp([poses[i][1] for i in np.flatnonzero(inside)], axis=0)
                joints, base = max(joints, spread[:6].max()), max(base, spread[6:].max())
        return joints, base

    def motion(self) -> tuple[float, float]:
        """Returns the largest motion of joints [rad] and base [m] since `forget`."""
        poses = [pose for _, pose in list(self._poses)]
        spread = np.ptp(poses, axis=0) if poses else np.zeros(8)
        return float(spread[:6].max()), float(spread[6:].max())

    def moved_while_standing(self) -> bool:
        """Whether anything moved that has to stand."""
        joints, base = self.motion_while_standing()
        return joints > _STILL_RAD or base > _STILL_M

    def submit(self, job: Job) -> None:
        """Orders a job."""
        answer = self.bench.call(JobSubmit, "jobs/submit", JobSubmit.Request(job=job))
        assert answer.status.code == Status.OK, answer.status.message

    def inject(self, node: str, fault: str, values: dict[str, str]) -> None:
        """Begins a fault; an empty one ends all of the node."""
        pairs = [KeyValue(key=key, value=value) for key, value in values.items()]
        request = InjectFault.Request(fault=fault, values=pairs)
        answer = self.bench.call(InjectFault, f"{node}/inject_fault", request)
        assert answer.status.code == Status.OK, answer.status.message

    def command(self, job_id: str, command: int) -> bool:
        """Gives a command to a job; False = nobody answers: the supervisor is being started."""
        request = JobCommand.Request(job_id=job_id, command=command)
        try:
            self.bench.call(JobCommand, "jobs/command", request)
        except AssertionError:
            return False
        return True

    def reset_devices(self) -> None:
        """Acknowledges what stopped the devices, as somebody does before the next job."""
        for device in ("arm", "base", "camera", "tracker", "scanner"):
            try:
                self.bench.call(Trigger, f"{device}/reset", Trigger.Request())
            except AssertionError:
                # One that was killed just now seems to be there for a while and does not answer.
                self.bench.call(Trigger, f"{device}/reset", Trigger.Request())

    def is_over(self, job_id: str) -> bool:
        """Whether the job has come to its end."""
        return self.status.job_id == job_id and self.status.state in OVER

    def waits(self, job_id: str) -> bool:
        """Whether the job waits for somebody who looks and says RESUME."""
        status = self.status
        return bool(
            status.job_id == job_id
            and status.state == JobStatus.INTERRUPTED
            and status.sub_state == "waiting"
        )

    def _on_status(self, message: JobStatus) -> None:
        self.status = message
        at_s = stamp_from_msg(message.header.stamp)
        change = Change(at_s, message.job_id, message.state, message.sub_state)
        if not self._changes or self._changes[-1][1:] != change[1:]:
            self._changes.append(change)

    def _on_joints(self, message: JointState) -> None:
        pose = np.append(np.array(message.position), self._place)
        self._poses.append((stamp_from_msg(message.header.stamp), pose))

    def _on_odometry(self, message: Odometry) -> None:
        place = message.pose.pose.position
        self._place = np.array([place.x, place.y])


class ServedCell:
    """The whole graph on the mock cell, which takes one job after the other.

    Args:
        folder: Part, configuration and runs go there.
        seed: Seed of the mock cell.
        factor: How much faster than wall time.
        supervisor: Parameters of the supervisor that differ from the defaults.
        part: What stands in it; None = a very small panel.
        disk: Where the runs go; a file system of its own, where it is to run full.
    """

    def __init__(
        self,
        folder: Path,
        seed: int,
        factor: str,
        supervisor: dict[str, float],
        part: Part | None = None,
        disk: Path | None = None,
    ) -> None:
        self.part = part or write_small_part(folder, 0.02, (0.3, 0.2))
        assert self.part.source is not None
        config = folder / "config"
        config.mkdir()
        document = {"/**": {"ros__parameters": supervisor}}
        (config / "cell_supervisor.yaml").write_text(yaml.safe_dump(document))
        options = ["--serve", "--time-factor", factor, "--job-id", "cell", "--seed", str(seed)]
        options += ["--restarts", "20", "--config-folder", str(config)]
        self.runs = (disk or folder) / "runs"
        self.watch = Watch()
        self.run = GraphRun(self.runs, self.part.source, *options)
        self._wait_until_it_takes_jobs()

    def _wait_until_it_takes_jobs(self) -> None:
        client = self.watch.bench.tester.create_client(JobSubmit, "jobs/submit")
        try:
            assert client.wait_for_service(TIMEOUT_S), self.run.errors.read_text()
        except BaseException:
            self.end()
            raise
        self.watch.bench.tester.destroy_client(client)

    def order(self, job_id: str, part: Part | None = None) -> None:
        """Orders a job of the part that stands there, or as another part file describes it."""
        self.watch.forget()
        self.watch.submit(Job(job_id=job_id, part=reference(part or self.part)))

    def until(self, job_id: str, state: str, timeout_s: float) -> bool:
        """Waits for a job's sub-state; False = the job was over, or it took too long."""
        deadline = time.monotonic() + timeout_s
        while time.monotonic() < deadline and not self.watch.is_over(job_id):
            assert self.run.process.poll() is None, self.run.errors.read_text()
            status = self.watch.status
            if status.job_id == job_id and status.sub_state == state:
                return True
            time.sleep(0.01)
        return False

    def until_over(self, job_id: str, timeout_s: float) -> bool:
        """Waits for a job's end; False = it took too long."""
        deadline = time.monotonic() + timeout_s
        while time.monotonic() < deadline and not self.watch.is_over(job_id):
            assert self.run.process.poll() is None, self.run.errors.read_text()
            time.sleep(0.02)
        return self.watch.is_over(job_id)

    def kill(self, node: str) -> None:
        """Ends a node's process as it dies in the field: without a word."""
        self.run.node(node).send_signal(signal.SIGKILL)

    def fill_disk(self) -> None:
        """Leaves the runs nothing; refused where others write on the same disk."""
        disk = self.runs.parent
        assert disk.is_mount(), f"{disk} is no file system of its own"
        with (disk / "filler").open("wb", buffering=0) as file, suppress(OSError):
            os.posix_fallocate(file.fileno(), 0, shutil.disk_usage(disk).free - 2**24)
            file.seek(0, os.SEEK_END)
            while file.write(bytes(2**18)):
                pass

    def free_disk(self) -> None:
        """Takes back what `fill_disk` did."""
        (self.runs.parent / "filler").unlink(missing_ok=True)

    def end(self) -> None:
        """Ends the graph in order, whatever state it is in.

        The watch first: a process that has to be killed may leave DDS's shared memory locked, and
        who is still there then hangs.
        """
        try:
            self.watch.bench.close()
            if self.run.process.poll() is None:
                self.run.process.send_signal(signal.SIGINT)
                self.run.wait(90.0)
                self.run.wait_gone()
        finally:
            self.run.close()
