"""Tables of a bag's messages: trajectories, joints, poses, quality, coverage over time."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from skinplan.recording.cdr import CdrDecoder
from skinplan.recording.model import BagTopic
from skinplan.recording.reader import BagReader

Row = dict[str, Any]
_POSE_KINDS = (
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "nav_msgs/msg/Odometry",
    "skinplan_msgs/msg/PartPose",
    "tf2_msgs/msg/TFMessage",
)
_KINDS = ("transit", "scan")


@dataclass(frozen=True)
class Table:
    """One table.

    Attributes:
        name: Name of its file.
        columns: Names of the columns; the unit is the suffix.
        rows: Rows, produced as they are taken.
    """

    name: str
    columns: tuple[str, ...]
    rows: Iterator[Row]


def topics_of(reader: BagReader, *kinds: str) -> list[BagTopic]:
    """Returns the topics of some types that have messages."""
    return [t for t in reader.info.topics if t.type_name in kinds and t.messages]


def decoded(reader: BagReader, topics: list[BagTopic]) -> Iterator[tuple[float, str, Row]]:
    """Iterates over messages: log time [s], topic, message as a dict.

    Raises:
        BagInvalidError: A definition is missing, or a message is damaged.
    """
    decoders = {t.name: CdrDecoder(t.type_name, t.schema_text) for t in topics}
    if not decoders:
        return
    for message in reader.messages(decoders):
        data = decoders[message.topic].decode(message.data)
        yield message.log_time_ns * 1e-9, message.topic, data


def trajectories(reader: BagReader) -> Table:
    """Joint positions of every station as planned last, times from the segment's start."""
    topics = topics_of(reader, "skinplan_msgs/msg/TrajectoryPlan")
    joints: list[str] = []
    rows: list[Row] = []
    for topic in topics:
        decoder = CdrDecoder(topic.type_name, topic.schema_text)
        for last in reader.last(topic.name, reader.info.end_ns):
            for station in decoder.decode(last.data)["stations"]:
                joints = joints or _joint_names(station)
                rows += _station_rows(topic.name, station)
    cells = [f"{name}_{unit}" for unit in ("rad", "rad_s") for name in joints]
    columns = ("topic", "station", "segment", "kind", "time_s", *cells)
    return Table("trajectories", columns, iter(rows))


def joints(reader: BagReader) -> Table:
    """Joint states over time."""
    topics = topics_of(reader, "sensor_msgs/msg/JointState")
    names: list[str] = []
    for topic in topics:
        decoder = CdrDecoder(topic.type_name, topic.schema_text)
        for first in reader.last(topic.name, reader.info.end_ns):
            names += [name for name in decoder.decode(first.data)["name"] if name not in names]

    def rows() -> Iterator[Row]:
        for time_s, topic, message in decoded(reader, topics):
            values = zip(message["name"], message["position"], strict=False)
            yield {
                **_head(time_s, topic, message),
                **{f"{name}_rad": float(value) for name, value in values},
            }

    return Table("joints", (*_HEAD, *(f"{name}_rad" for name in names)), rows())


def poses(reader: BagReader) -> Table:
    """Poses and transforms over time."""

    def rows() -> Iterator[Row]:
        for time_s, topic, message in decoded(reader, topics_of(reader, *_POSE_KINDS)):
            for item in message.get("transforms", (message,)):
                yield {**_head(time_s, topic, item), **_pose_cells(item)}

    return Table("poses", (*_HEAD, *_POSE_COLUMNS), rows())


def quality(reader: BagReader) -> Table:
    """How well markers and part were located, image by image."""
    topics = topics_of(reader, "skinplan_msgs/msg/MarkerObservations", "skinplan_msgs/msg/PartPose")

    def rows() -> Iterator[Row]:
        for time_s, topic, message in decoded(reader, topics):
            for item in message.get("observations", (message,)):
                yield {
                    **_head(time_s, topic, message),
                    "marker": item.get("id", -1),
                    "quality": item["quality"],
                    "reprojection_error_px": item["reprojection_error"],
                    "distance_m": item.get("distance"),
                    "angle_rad": item.get("angle"),
                    "ambiguity_ratio": item.get("ambiguity_ratio"),
                }

    more = ("marker", "quality", "reprojection_error_px", "distance_m", "angle_rad")
    return Table("quality", (*_HEAD, *more, "ambiguity_ratio"), rows())


def coverage(reader: BagReader) -> Table:
    """What the scan has seen, over time."""
    counts = ("frames", "frames_hidden", "frames_out_of_range", "points")
    wanted = (*counts, "area_ratio", "feature_area_ratio")

    def rows() -> Iterator[Row]:
        topics = topics_of(reader, "skinplan_msgs/msg/CoverageState")
        for time_s, topic, message in decoded(reader, topics):
            yield {**_head(time_s, topic, message), **{n: message.get(n) for n in wanted}}

    return Table("coverage", (*_HEAD, *wanted), rows())


#: Tables by name.
TABLES = {
    "trajectories": trajectories,
    "joints": joints,
    "poses": poses,
    "quality": quality,
    "coverage": coverage,
}

_HEAD = ("time_s", "stamp_s", "topic")
_POSE_COLUMNS = ("parent", "child", "x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")


def _head(time_s: float, topic: str, message: Row) -> Row:
    stamp = message["header"]["stamp"]
    stamp_s = stamp["sec"] + stamp["nanosec"] * 1e-9
    return {"time_s": time_s, "stamp_s": stamp_s, "topic": topic}


def _pose_cells(item: Row) -> Row:
    pose = item.get("transform") or item["pose"]
    pose = pose.get("pose", pose)  # with covariance
    place = pose.get("translation") or pose["position"]
    turn = pose.get("rotation") or pose["orientation"]
    return {
        "parent": item["header"]["frame_id"],
        "child": item.get("child_frame_id", ""),
        **{f"{axis}_m": place[axis] for axis in "xyz"},
        **{f"q{axis}": turn[axis] for axis in "xyzw"},
    }


def _joint_names(station: Row) -> list[str]:
    return [str(n) for s in station["segments"][:1] for n in s["trajectory"]["joint_names"]]


def _station_rows(topic: str, station: Row) -> Iterator[Row]:
    for number, segment in enumerate(station["segments"]):
        trajectory = segment["trajectory"]
        names = trajectory["joint_names"]
        kind = _KINDS[segment["kind"]] if segment["kind"] < len(_KINDS) else str(segment["kind"])
        for point in trajectory["points"]:
            since = point["time_from_start"]
            yield {
                "topic": topic,
                "station": station["station_id"],
                "segment": number,
                "kind": kind,
                "time_s": since["sec"] + since["nanosec"] * 1e-9,
                **_cells(names, point["positions"], "rad"),
                **_cells(names, point["velocities"], "rad_s"),
            }


def _cells(names: list[str], values: Any, unit: str) -> Row:
    return {f"{n}_{unit}": float(v) for n, v in zip(names, values, strict=False)}
