"""The node of the job client: what it hears of the cell."""

import time
from collections.abc import Callable

from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from skinplan_msgs.msg import Heartbeat, JobStatus
from skinplan_msgs.srv import JobCommand, JobGet, JobSubmit

from skinplan.jobs.model import JobRecord
from skinplan_nodes.absence import Absence
from skinplan_nodes.conversions import (
    job_status_from_msg,
    pose_stamped_from_msg,
    stamp_from_msg,
)
from skinplan_nodes.qos import LATCHED, STATE
from skinplan_nodes.truth import TruthLog


class MeasureClient(Node):
    """Submits a job and follows its state.

    Args:
        truth: Takes the true poses of a simulated cell.
        on_change: Called with every change of the job.
        arguments: Node arguments of ROS.
    """

    def __init__(
        self, truth: TruthLog, on_change: Callable[[JobRecord], None], namespace: str = ""
    ) -> None:
        super().__init__("measure", namespace=namespace)
        self._truth = truth
        self._on_change = on_change
        self.job_id = ""
        self.record: JobRecord | None = None
        self.absence = Absence()
        self.submit = self.create_client(JobSubmit, "jobs/submit")
        self.command = self.create_client(JobCommand, "jobs/command")
        self.get = self.create_client(JobGet, "jobs/get")
        self.create_subscription(JobStatus, "job_status", self.take, LATCHED)
        self.create_subscription(Heartbeat, "heartbeat", self._on_heartbeat, STATE)
        self.create_subscription(PoseStamped, "truth/base_pose", self._on_base_pose, STATE)
        self.create_subscription(
            PoseStamped, "truth/workpiece_pose", self._on_workpiece_pose, LATCHED
        )

    def take(self, message: JobStatus) -> None:
        """Takes a state of the job."""
        if message.job_id == self.job_id:
            self.record = job_status_from_msg(message)
            self._on_change(self.record)

    def _on_heartbeat(self, message: Heartbeat) -> None:
        if message.node.rsplit("/", 1)[-1] == "cell_supervisor":
            self.absence.heard(message.pid, time.monotonic())

    def _on_base_pose(self, message: PoseStamped) -> None:
        pose = pose_stamped_from_msg(message, "map", "true pose of the base")
        self._truth.base_stood(stamp_from_msg(message.header.stamp), pose)

    def _on_workpiece_pose(self, message: PoseStamped) -> None:
        self._truth.T_map_workpiece = pose_stamped_from_msg(message, "map", "true pose of the part")
