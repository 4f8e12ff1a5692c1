"""What a bag tells about a run: the inputs of each stage and what came out of it."""

from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from geometry_msgs.msg import TransformStamped
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import CameraInfo, Image, JointState
from skinplan_msgs import msg as messages
from tf2_msgs.msg import TFMessage

from skinplan.errors import BagInvalidError
from skinplan.recording.reader import BagReader

_TYPES: dict[str, Any] = {
    "scan_path": messages.ScanPath,
    "station_plan": messages.StationPlan,
    "trajectory_plan": messages.TrajectoryPlan,
    "part_pose": messages.PartPose,
    "markers/observations": messages.MarkerObservations,
    "tf": TFMessage,
    "tf_static": TFMessage,
    "camera/color/camera_info": CameraInfo,
}
_IMAGE, _JOINTS = "camera/color/image_raw", "joint_states"


@dataclass(frozen=True)
class Stamped:
    """One recorded message.

    Attributes:
        at_ns: Log time [ns].
        message: The message.
    """

    at_ns: int
    message: Any


@dataclass(frozen=True)
class Localization:
    """One localisation: the images that were evaluated, and what it ended with.

    Attributes:
        observations: One per image, in the order of evaluation.
        part_pose: The result; None = it failed.
    """

    observations: tuple[Stamped, ...]
    part_pose: Stamped | None


class RecordedRun:
    """One run, read from its bag.

    Args:
        path: Bag of a run, of one namespace.

    Attributes:
        part_uri: Part file that was measured.
        mesh_sha256: Hash of its mesh.

    Raises:
        BagNotFoundError: Nothing is there.
        BagInvalidError: No bag, or none of a run.
    """

    def __init__(self, path: Path) -> None:
        self._reader = BagReader(path)
        facts = self._reader.info.custom_data
        self.part_uri, self.mesh_sha256 = facts.get("part_uri", ""), facts.get("mesh_sha256", "")
        if not self.part_uri:
            raise BagInvalidError(
                f"{path}: the bag of a run is accepted, which says what part was measured; this "
                "one has no part_uri in its metadata"
            )
        self._names = {t.name.lstrip("/"): t.name for t in self._reader.info.topics}
        self._read: dict[str, list[Stamped]] = {}

    def close(self) -> None:
        """Closes the bag."""
        self._reader.close()

    def all(self, topic: str) -> list[Stamped]:
        """Returns all messages of a topic, e.g. ``scan_path``."""
        if topic not in self._read:
            self._read[topic] = [
                Stamped(m.log_time_ns, deserialize_message(m.data, _TYPES[topic]))
                for m in self._raw(topic)
            ]
        return self._read[topic]

    def last(self, topic: str, at_ns: int) -> Any:
        """Returns the last message of a topic up to a log time; None = none."""
        found = self.all(topic)
        number = bisect_right(found, at_ns, key=lambda item: item.at_ns)
        return found[number - 1].message if number else None

    def joint_state(self, at_ns: int) -> JointState:
        """Returns the last joint positions up to a log time; empty = none."""
        found = self._reader.last(self._names.get(_JOINTS, ""), at_ns)
        return deserialize_message(found[0].data, JointState) if found else JointState()

    def image(self, stamp: Any) -> Image | None:
        """Returns the image of a stamp; None = it was not recorded."""
        at_ns = stamp.sec * 10**9 + stamp.nanosec
        # Images are received after their stamp, on a busy machine much later.
        for message in self._raw(_IMAGE, at_ns):
            image: Image = deserialize_message(message.data, Image)
            if image.header.stamp == stamp:
                return image
            if image.header.stamp.sec > stamp.sec + 60:
                return None
        return None

    def transform(self, parent: str, child: str, at_ns: int) -> TransformStamped | None:
        """Returns the last transform between two frames up to a log time; None = none."""
        found = None
        for item in self.all("tf"):
            if item.at_ns > at_ns:
                break
            for edge in item.message.transforms:
                if (edge.header.frame_id, edge.child_frame_id) == (parent, child):
                    found = edge
        return found

    def localizations(self) -> list[Localization]:
        """Returns the localisations in the order in which they were made."""
        seen, found = list(self.all("markers/observations")), []
        for pose in self.all("part_pose"):
            stamp = _ns(pose.message.header.stamp)
            mine = [o for o in seen if _ns(o.message.header.stamp) <= stamp]
            seen = seen[len(mine) :]
            if mine:
                found.append(Localization(tuple(mine), pose))
        if seen:
            found.append(Localization(tuple(seen), None))
        return found

    def planned_stations(self) -> Iterator[tuple[int, Any]]:
        """Iterates over the trajectories as they were planned: log time and trajectory."""
        before: dict[int, Any] = {}
        for plan in self.all("trajectory_plan"):
            for trajectory in plan.message.stations:
                if before.get(trajectory.station_id) != trajectory:
                    before[trajectory.station_id] = trajectory
                    yield plan.at_ns, trajectory

    def _raw(self, topic: str, start_ns: int | None = None) -> Iterator[Any]:
        name = self._names.get(topic)
        return iter(()) if name is None else self._reader.messages([name], start_ns)


def _ns(stamp: Any) -> int:
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)
