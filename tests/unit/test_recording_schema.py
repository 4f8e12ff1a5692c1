"""Schema texts and QoS as rosbag2 keeps them."""

import pytest

from skinplan.errors import BagInvalidError, BagNotWritableError
from skinplan.recording.qos import INFINITE_NS, QosProfile, qos_profiles, qos_text
from skinplan.recording.schema import SEPARATOR, schema_with_dependencies

DEFINITIONS = {
    "std_msgs/msg/String": "# a comment\nstring data\n",
    "std_msgs/msg/Header": "builtin_interfaces/Time stamp  # when\nstring frame_id\n",
    "builtin_interfaces/msg/Time": "int32 sec\nuint32 nanosec\n",
    "geometry_msgs/msg/Pose": "Point position\nQuaternion orientation\n",
    "geometry_msgs/msg/Point": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/msg/Quaternion": "float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1\n",
    "geometry_msgs/msg/PoseArray": "std_msgs/Header header\nPose[] poses\n",
    "geometry_msgs/msg/PoseStamped": "std_msgs/Header header\nPose pose\n",
    "unique_identifier_msgs/msg/UUID": "uint8[16] uuid\n",
    "service_msgs/msg/ServiceEventInfo": "uint8 event_type\nbuiltin_interfaces/Time stamp\n",
    "demo/action/Move": (
        "geometry_msgs/PoseStamped goal\n---\nbool "
        "reached\n---\ngeometry_msgs/Point at\nstring<=20[<=3] notes\n"
    ),
    "demo/srv/Ask": "string question\n---\nstd_msgs/Header header\n",
}


def load(name: str) -> str:
    return DEFINITIONS[name]


def parts(text: str) -> list[str]:
    return text.split(SEPARATOR + "\n")


def test_a_type_without_dependencies_is_its_own_text() -> None:
    assert (
        schema_with_dependencies("std_msgs/msg/String", load) == DEFINITIONS["std_msgs/msg/String"]
    )


def test_every_dependency_stands_once_with_its_name() -> None:
    pieces = parts(schema_with_dependencies("geometry_msgs/msg/PoseArray", load))
    assert pieces[0] == DEFINITIONS["geometry_msgs/msg/PoseArray"]
    names = [piece.splitlines()[0] for piece in pieces[1:]]
    assert names == [
        "MSG: std_msgs/Header",
        "MSG: geometry_msgs/Pose",
        "MSG: builtin_interfaces/Time",
        "MSG: geometry_msgs/Point",
        "MSG: geometry_msgs/Quaternion",
    ]
    assert SEPARATOR == 80 * "="


def test_a_feedback_message_is_composed_from_its_action() -> None:
    pieces = parts(schema_with_dependencies("demo/action/Move_FeedbackMessage", load))
    assert pieces[0] == "unique_identifier_msgs/UUID goal_id\ndemo/Move_Feedback feedback\n"
    assert pieces[2].startswith("MSG: demo/Move_Feedback\ngeometry_msgs/Point at\n")
    assert any(piece.startswith("MSG: geometry_msgs/Point") for piece in pieces)


@pytest.mark.parametrize(
    ("name", "first", "needs"),
    [
        ("demo/srv/Ask_Event", "service_msgs/ServiceEventInfo info\n", "demo/Ask_Response"),
        ("demo/srv/Ask_Response", "std_msgs/Header header\n", "std_msgs/Header"),
        (
            "demo/action/Move_SendGoal_Event",
            "service_msgs/ServiceEventInfo info\n",
            "demo/Move_Goal",
        ),
        ("demo/action/Move_GetResult_Response", "int8 status\n", "demo/Move_Result"),
    ],
)
def test_derived_types_of_services_and_actions(name: str, first: str, needs: str) -> None:
    text = schema_with_dependencies(name, load)
    assert text.startswith(first)
    assert f"MSG: {needs}\n" in text


def test_constants_and_defaults_are_no_dependencies() -> None:
    text = (
        "uint8 OK=1\nstring NAME='geometry_msgs/Pose x'\n# geometry_msgs/Pose pose\nfloat64[3] v\n"
    )
    assert schema_with_dependencies("demo/msg/Plain", lambda _: text) == text


def test_a_type_that_holds_itself_ends() -> None:
    texts = {"demo/msg/A": "B b\n", "demo/msg/B": "A[] a\n"}
    assert schema_with_dependencies("demo/msg/A", texts.__getitem__).count("MSG:") == 1


@pytest.mark.parametrize(
    "name",
    [
        "String",
        "std_msgs/String",
        "demo/msg/Missing",
        "demo/action/Move",
        "demo/action/No_Feedback",
        "a//b",
    ],
)
def test_what_has_no_definition_is_named(name: str) -> None:
    with pytest.raises(BagNotWritableError, match=name.split("/")[-1].split("_")[0] or "a"):
        schema_with_dependencies(name, load)


def test_a_missing_dependency_is_named() -> None:
    with pytest.raises(BagNotWritableError, match="other_msgs/msg/Thing"):
        schema_with_dependencies("demo/msg/X", {"demo/msg/X": "other_msgs/Thing t\n"}.__getitem__)


def test_qos_round_trip() -> None:
    profiles = (
        QosProfile(),
        QosProfile(
            "keep_all",
            0,
            "best_effort",
            "transient_local",
            1_500_000_000,
            7,
            "manual_by_topic",
            2,
            True,
        ),
    )
    assert qos_profiles(qos_text(profiles)) == profiles
    assert qos_profiles(qos_text(())) == ()
    assert qos_profiles("") == ()


def test_infinite_durations_are_those_of_rmw() -> None:
    assert "deadline:\n    sec: 9223372036\n    nsec: 854775807\n" in qos_text((QosProfile(),))


def test_numbers_of_older_versions_are_read() -> None:
    text = (
        "- history: 3\n  depth: 0\n  reliability: 1\n  durability: 1\n  deadline:\n    sec: "
        "2147483647\n"
        "    nsec: 4294967295\n  lifespan:\n    sec: 10\n    nsec: 5\n  liveliness: 1\n"
        "  liveliness_lease_duration:\n    sec: 0\n    nsec: 0\n  "
        "avoid_ros_namespace_conventions: false"
    )
    (profile,) = qos_profiles(text)
    assert profile == QosProfile(
        "unknown", 0, "reliable", "transient_local", INFINITE_NS, 10_000_000_005, "automatic", 0
    )
    assert profile.latched


@pytest.mark.parametrize(
    "text", ["a: 1", "- 5", "- history: 1", "[", "- {history: 1, depth: x}", "just words"]
)
def test_damaged_qos_is_named(text: str) -> None:
    with pytest.raises(BagInvalidError, match="offered_qos_profiles"):
        qos_profiles(text)
