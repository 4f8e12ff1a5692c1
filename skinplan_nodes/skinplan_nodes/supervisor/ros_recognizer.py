"""The recognizer on ROS: which part the camera sees, and where one without markers is."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from skinplan_msgs.action import LocalizePart
from skinplan_msgs.msg import PartReference, Status
from skinplan_msgs.srv import IdentifyPart

from skinplan.errors import SkinplanError
from skinplan.jobs.model import Job
from skinplan.part.files import load_part
from skinplan_nodes.action_client import ThreadedActionClient
from skinplan_nodes.conversions import LocatedPart, part_pose_to_msg
from skinplan_nodes.part_cache import part_path
from skinplan_nodes.replies import status_of
from skinplan_nodes.supervisor.calls import Calls, part_reference
from skinplan_nodes.supervisor.cell import Located
from skinplan_nodes.supervisor.control import StepError
from skinplan_nodes.supervisor.identification import RECOGNIZER, Identified


class RosRecognizer:
    """Implements `skinplan_nodes.supervisor.identification.Recognizer`.

    Args:
        node: The supervisor.
        calls: Calls the service.
        values: The supervisor's parameters, of them ``planning_timeout_s``.
        group: Callback group of the client.

    Attributes:
        by_shape: Client of ``locate_part_by_shape``.
    """

    def __init__(
        self, node: Node, calls: Calls, values: SimpleNamespace, group: CallbackGroup
    ) -> None:
        self._calls, self._values = calls, values
        self._client = node.create_client(IdentifyPart, "identify_part", callback_group=group)
        self.by_shape = ThreadedActionClient(
            node, LocalizePart, "locate_part_by_shape", callback_group=group
        )

    def is_asked_where(self, job: Job) -> bool:
        """Whether the recognizer locates the part: its fixture has no markers.

        Raises:
            StepError: The part file can't be read any more.
        """
        try:
            return not load_part(part_path(job.part_uri)).fixture.markers
        except SkinplanError as error:
            raise StepError(status_of(error).code, str(error), "cell_supervisor") from error

    def identify(self, job: Job, others: tuple[Path, ...], located: Located) -> Identified:
        """Asks what the camera sees where the part was located."""
        candidates = [part_reference(job), *(PartReference(uri=str(path)) for path in others)]
        names = tuple(load_part(part_path(each.uri)).id for each in candidates)
        request = IdentifyPart.Request(
            candidates=candidates,
            source=IdentifyPart.Request.CAMERA,
            part_pose=part_pose_to_msg(_located(located)),
        )
        answer = self._calls.service(
            self._client,
            request,
            self._values.planning_timeout_s,
            RECOGNIZER,
            (Status.OK, Status.UNKNOWN_PART),
        )
        return Identified(
            tuple(answer.fits), names, float(answer.seen_ratios[0]), answer.status.message
        )


def _located(located: Located) -> LocatedPart:
    none = np.zeros(0, dtype=np.int64)
    return LocatedPart(
        located.T_arm_base_workpiece, np.zeros((6, 6)), located.quality, 0.0, none, located.stamp_s
    )
