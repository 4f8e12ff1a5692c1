"""The service ``plan_trajectories``: one station or all, cancelled, and what it refuses."""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from skinplan_msgs import msg as messages
from skinplan_msgs.msg import Status
from skinplan_msgs.srv import PlanTrajectories
from std_srvs.srv import Trigger

from nodes.bench import Bench
from nodes.small_part import reference, write_small_part
from skinplan.errors import CancelledError, NoTrajectoryError
from skinplan.mesh.prepare import PreparedMesh, prepare_mesh
from skinplan.part.model import Part
from skinplan.plan_record import trajectory_hash
from skinplan.robot.cell import CellConfig
from skinplan.scan_path.model import ScanPath
from skinplan.scan_path.plan import plan_scan_path
from skinplan.stations.model import Station, StationPlan
from skinplan.stations.plan import plan_stations
from skinplan.trajectory.cycle import cycle_time
from skinplan.trajectory.plan import plan_station_trajectory, plan_trajectories
from skinplan.transforms import inverse, planar
from skinplan_nodes.conversions import (
    joint_state_to_msg,
    pose_from_msg,
    pose_stamped_to_msg,
    scan_path_to_msg,
    station_plan_from_msg,
    station_plan_to_msg,
    station_trajectory_from_msg,
    trajectory_plan_from_msg,
)
from skinplan_nodes.current_work import CurrentWork
from skinplan_nodes.qos import LATCHED, STATE
from skinplan_nodes.trajectory_planner import TrajectoryPlanner

NAN = float("nan")
CANCEL_S = 3.0  # the machine may be busy; the library asks several times a second
FAR = planar(60.0, 0.0, 0.0)


@dataclass(frozen=True)
class Planned:
    """A small part planned by the library up to the stations."""

    part: Part
    prepared: PreparedMesh
    path: ScanPath
    plan: StationPlan

    def one(self, **fields: Any) -> PlanTrajectories.Request:
        """A request for the first station."""
        station = self.plan.stations[0]
        T_map_arm_base = station.T_map_base_link @ CellConfig().T_base_link_arm_base
        T_arm_base_workpiece = inverse(T_map_arm_base) @ self.part.T_map_workpiece
        values = {
            "part": reference(self.part),
            "path": scan_path_to_msg(self.path),
            "station_id": station.id,
            "pose": pose_stamped_to_msg(T_arm_base_workpiece, "arm_base"),
            "points": station.points.tolist(),
        }
        return PlanTrajectories.Request(**{**values, **fields})

    def all(self, plan: StationPlan | None = None, **fields: Any) -> PlanTrajectories.Request:
        """A request for all stations."""
        values = {
            "part": reference(self.part),
            "path": scan_path_to_msg(self.path),
            "pose": pose_stamped_to_msg(self.part.T_map_workpiece, "map"),
            "stations": station_plan_to_msg(plan or self.plan),
        }
        return PlanTrajectories.Request(**{**values, **fields})

    def halves(self) -> StationPlan:
        """The points of the first station at two stations, and a third that reaches nothing."""
        (station,) = self.plan.stations[:1]
        middle = len(station.points) // 2
        parts = station.points[: middle - 3], station.points[middle:]
        lost = station.points[middle - 3 : middle]
        stations = [replace(station, id=i, points=points) for i, points in enumerate(parts)]
        return replace(
            self.plan, stations=(stations[0], Station(7, FAR, lost), replace(stations[1], id=9))
        )


@pytest.fixture(scope="module")
def planned(tmp_path_factory: pytest.TempPathFactory) -> Planned:
    part = write_small_part(tmp_path_factory.mktemp("part"))
    prepared = prepare_mesh(part)
    path = plan_scan_path(prepared.mesh, prepared.segmentation, part.scan)
    plan = plan_stations(path, part.T_map_workpiece, prepared.mesh, part.scan, CellConfig())
    return Planned(part, prepared, path, plan)


@pytest.fixture(scope="module")
def bench() -> Iterator[Bench]:
    found = Bench()
    found.start(TrajectoryPlanner, simulated=False)
    yield found
    found.close()
    assert not found.failures


def ask(bench: Bench, request: PlanTrajectories.Request) -> Any:
    return bench.call(PlanTrajectories, "plan_trajectories", request)


def cancel(bench: Bench) -> Any:
    return bench.call(Trigger, "plan_trajectories/cancel", Trigger.Request())


@pytest.mark.parametrize("strategy", ["tour", "published"])
def test_one_station_is_the_library_s(bench: Bench, planned: Planned, strategy: str) -> None:
    request = planned.one(strategy=strategy)
    answer = ask(bench, request)
    assert (answer.status.code, answer.status.message) == (Status.OK, "")
    T_arm_base_workpiece = pose_from_msg(request.pose.pose)
    wanted = plan_station_trajectory(
        planned.path,
        planned.plan.stations[0].points,
        T_arm_base_workpiece,
        planned.prepared.mesh,
        replace(planned.part.scan, order_strategy=strategy),
        CellConfig(),
        T_arm_base_map=T_arm_base_workpiece @ inverse(planned.part.T_map_workpiece),
    )
    assert answer.plan.plan_hash == trajectory_hash([wanted])
    assert answer.plan.plan_hash == trajectory_hash(trajectory_plan_from_msg(answer.plan))
    # NaN is not equal to itself, its name is.
    assert str(answer.trajectory) == str(answer.plan.stations[0])
    assert np.isnan(answer.plan.base_duration)
    found = station_trajectory_from_msg(answer.trajectory)
    assert (found.order, found.breaks) == (strategy, wanted.breaks)
    np.testing.assert_equal(found.order_cost, wanted.order_cost)
    np.testing.assert_equal(found.order_bound, wanted.order_bound)
    for segment, other in zip(found.segments, wanted.segments, strict=True):
        np.testing.assert_array_equal(segment.points, other.points)
        np.testing.assert_array_equal(segment.point_s, other.point_s)
        np.testing.assert_allclose(segment.times, other.times, atol=1e-9)
        np.testing.assert_array_equal(segment.positions, other.positions)


@pytest.mark.parametrize("strategy", ["tour", "published"])
def test_all_stations_are_the_library_s(bench: Bench, planned: Planned, strategy: str) -> None:
    latched = bench.collect(messages.TrajectoryPlan, "trajectory_plan", LATCHED)
    request = planned.all(planned.halves(), strategy=strategy)
    answer = ask(bench, request)
    assert (answer.status.code, answer.status.message) == (Status.OK, "")
    plan = station_plan_from_msg(request.stations)
    settings = replace(planned.part.scan, order_strategy=strategy)
    wanted = plan_trajectories(
        planned.path,
        plan,
        pose_from_msg(request.pose.pose),
        planned.prepared.mesh,
        settings,
        CellConfig(),
    )
    assert answer.plan.plan_hash == trajectory_hash(wanted)
    assert answer.plan.plan_hash == trajectory_hash(trajectory_plan_from_msg(answer.plan))
    assert not answer.trajectory.segments, "that is for one station"
    cycle = cycle_time(plan, wanted, CellConfig(), settings, planned.path)
    assert answer.plan.base_duration == cycle.base_s
    assert answer.plan.lower_bound == cycle.lower_bound_s
    assert answer.plan.scan_duration == pytest.approx(cycle.scan_s)
    found = trajectory_plan_from_msg(answer.plan)
    assert [t.station_id for t in found] == [0, 7, 9]
    assert [bool(t.segments) for t in found] == [True, False, True]
    lost = plan.stations[1].points.tolist()
    assert [s.point for s in found[1].skipped] == lost
    assert all("none of the 3 points can be scanned" in s.reason for s in found[1].skipped)
    bench.wait(lambda: latched and latched[-1].plan_hash == answer.plan.plan_hash)


def test_no_station_that_can_scan_is_a_named_error(bench: Bench, planned: Planned) -> None:
    station = planned.plan.stations[0]
    plan = replace(planned.plan, stations=(replace(station, T_map_base_link=FAR),))
    answer = ask(bench, planned.all(plan))
    assert answer.status.code == Status.NO_TRAJECTORY
    assert not answer.plan.stations


def far_tracker() -> np.ndarray:
    """A place from where the tracker sees nothing: far out of its range."""
    T_map_tracker = np.eye(4)
    T_map_tracker[:3, 3] = [500.0, 500.0, 1.0]
    return T_map_tracker


def test_the_tracker_of_the_request_is_the_one_that_has_to_see_the_scanner(
    bench: Bench, planned: Planned
) -> None:
    place = pose_stamped_to_msg(far_tracker(), "map")
    answer = ask(bench, planned.one(tracker=place))
    assert answer.status.code == Status.NO_TRAJECTORY
    assert "tracker" in answer.status.message
    plan = replace(planned.plan, T_map_tracker=far_tracker())
    assert ask(bench, planned.all(plan)).status.code == Status.NO_TRAJECTORY


def test_the_workpiece_in_map_places_the_cell_s_tracker(bench: Bench, planned: Planned) -> None:
    far = planar(400.0, 0.0, 0.0) @ planned.part.T_map_workpiece
    answer = ask(bench, planned.one(map_pose=pose_stamped_to_msg(far, "map")))
    assert answer.status.code == Status.NO_TRAJECTORY
    assert "tracker" in answer.status.message


Change = Callable[[PlanTrajectories.Request], Any]


def nan_pose(pose: PoseStamped) -> None:
    pose.pose.position.z = NAN


def no_quaternion(pose: PoseStamped) -> None:
    pose.pose.orientation.w = 0.0


def in_map() -> PoseStamped:
    return pose_stamped_to_msg(np.eye(4), "map")


def in_odom() -> PoseStamped:
    return pose_stamped_to_msg(np.eye(4), "odom")


COLLIDING = joint_state_to_msg(np.array([0.0, -1.57, 3.1, 0.0, 0.0, 0.0]))
BEYOND = joint_state_to_msg(np.array([0.0, -99.0, 0.0, 0.0, 0.0, 0.0]))
UNKNOWN = joint_state_to_msg(np.zeros(6))
UNKNOWN.name = [f"joint_{number}" for number in range(6)]
ENDLESS = joint_state_to_msg(np.full(6, NAN))
ONE_CASES: list[tuple[str, Change, int, str]] = [
    ("frame", lambda r: setattr(r.pose.header, "frame_id", "map"), 1001, "frame 'arm_base' is acc"),
    ("no frame", lambda r: setattr(r.pose.header, "frame_id", ""), 1001, "found ''"),
    ("nan", lambda r: nan_pose(r.pose), 1001, "finite"),
    ("tracker frame", lambda r: setattr(r, "tracker", in_odom()), 1001, "tracker: frame 'map'"),
    ("map_pose frame", lambda r: setattr(r, "map_pose", in_odom()), 1001, "map_pose: frame 'map'"),
    ("strategy", lambda r: setattr(r, "strategy", "magic"), Status.STRATEGY_UNKNOWN, "magic"),
    ("empty", lambda r: setattr(r, "points", []), Status.SCAN_PATH_INVALID, "0 points"),
    ("twice", lambda r: setattr(r, "points", [1, 1]), Status.SCAN_PATH_INVALID, "each once"),
    ("range", lambda r: setattr(r, "points", [2**32 - 1]), Status.SCAN_PATH_INVALID, "4294967295"),
    (
        "huge",
        lambda r: setattr(r, "points", np.zeros(2_000_000, dtype=np.uint32)),
        Status.SCAN_PATH_INVALID,
        "found 2000000",
    ),
    ("joints", lambda r: setattr(r, "start", UNKNOWN), Status.JOINTS_INVALID, "missing"),
    ("nan start", lambda r: setattr(r, "start", ENDLESS), Status.JOINTS_INVALID, "finite"),
    ("limits", lambda r: setattr(r, "start", BEYOND), Status.START_STATE_INVALID, "limits"),
    (
        "collision",
        lambda r: setattr(r, "start", COLLIDING),
        Status.START_STATE_INVALID,
        "collision",
    ),
]


@pytest.mark.parametrize(
    ("change", "code", "words"), [c[1:] for c in ONE_CASES], ids=[c[0] for c in ONE_CASES]
)
def test_requests_for_one_station_that_are_none(
    bench: Bench, planned: Planned, change: Change, code: int, words: str
) -> None:
    request = planned.one()
    change(request)
    answer = ask(bench, request)
    assert answer.status.code == code, answer.status.message
    assert words in answer.status.message
    assert not answer.trajectory.segments
    assert not answer.plan.stations


def many_stations(request: PlanTrajectories.Request) -> None:
    request.stations.stations = [messages.Station(id=number) for number in range(2_000)]


def point_at_two(request: PlanTrajectories.Request) -> None:
    station = request.stations.stations[0]
    other = messages.Station(id=station.id + 1, pose=station.pose, points=station.points[:1])
    request.stations.stations = [station, other]


def one_id(request: PlanTrajectories.Request) -> None:
    station = request.stations.stations[0]
    request.stations.stations = [station, messages.Station(id=station.id)]


ALL_CASES: list[tuple[str, Change, int, str]] = [
    ("frame", lambda r: setattr(r.pose.header, "frame_id", "arm_base"), 1001, "frame 'map' is acc"),
    ("nan", lambda r: nan_pose(r.pose), 1001, "finite"),
    ("quaternion", lambda r: no_quaternion(r.pose), 1001, "length 1"),
    ("plan frame", lambda r: setattr(r.stations.header, "frame_id", ""), 1001, "frame 'map'"),
    (
        "nan station",
        lambda r: setattr(r.stations.stations[0].pose.position, "x", NAN),
        1001,
        "finite",
    ),
    ("strategy", lambda r: setattr(r, "strategy", "magic"), Status.STRATEGY_UNKNOWN, "magic"),
    ("points too", lambda r: setattr(r, "points", [0]), 1001, "found points"),
    ("id too", lambda r: setattr(r, "station_id", 3), 1001, "found station_id"),
    ("start too", lambda r: setattr(r, "start", UNKNOWN), 1001, "found start"),
    ("tracker too", lambda r: setattr(r, "tracker", in_map()), 1001, "found tracker"),
    ("map_pose too", lambda r: setattr(r, "map_pose", in_map()), 1001, "found map_pose"),
    (
        "range",
        lambda r: setattr(r.stations.stations[0], "points", [10**6]),
        Status.SCAN_PATH_INVALID,
        "station 0: indices",
    ),
    ("two", point_at_two, Status.SCAN_PATH_INVALID, "at 2 of them"),
    ("one id", one_id, 1001, "0 is the id of 2"),
    ("huge", many_stations, Status.NO_TRAJECTORY, "none of the 2000 stations"),
]


@pytest.mark.parametrize(
    ("change", "code", "words"), [c[1:] for c in ALL_CASES], ids=[c[0] for c in ALL_CASES]
)
def test_requests_for_all_stations_that_are_none(
    bench: Bench, planned: Planned, change: Change, code: int, words: str
) -> None:
    request = planned.all()
    change(request)
    answer = ask(bench, request)
    assert answer.status.code == code, answer.status.message
    assert words in answer.status.message
    assert not answer.plan.stations


def test_nothing_to_cancel(bench: Bench) -> None:
    answer = cancel(bench)
    assert (answer.success, answer.message) == (False, "nothing is being planned")


STATIONS = 100
AT_WORK = f"of {STATIONS}: "


def long_request(planned: Planned) -> PlanTrajectories.Request:
    """Long work: the same scan path again and again, its points at many stations."""
    path, station = planned.path, planned.plan.stations[0]
    again = [np.concatenate([array] * STATIONS) for array in (path.positions, path.directions)]
    targets, kinds = (np.concatenate([array] * STATIONS) for array in (path.targets, path.kinds))
    groups = np.concatenate([path.groups + 100 * number for number in range(STATIONS)])
    stations = tuple(
        replace(station, id=number, points=station.points + number * len(path))
        for number in range(STATIONS)
    )
    return planned.all(
        replace(planned.plan, stations=stations),
        path=scan_path_to_msg(ScanPath(*again, targets, kinds, groups, path.strategy, 1)),
    )


class Asked:
    """A request that is being worked on."""

    def __init__(self, bench: Bench, request: PlanTrajectories.Request) -> None:
        self._bench = bench
        self._client = bench.tester.create_client(PlanTrajectories, "plan_trajectories")
        bench.wait(self._client.service_is_ready)
        self.future = self._client.call_async(request)

    def answer(self) -> Any:
        """Waits for the answer."""
        found = self._bench.result(self.future)
        self._bench.tester.destroy_client(self._client)
        return found


def wait_for_work(bench: Bench, text: str) -> None:
    """Waits until the node says on diagnostics that it works on something."""
    said = bench.collect(DiagnosticArray, "diagnostics", STATE)
    bench.wait(lambda: any(text in status.message for m in said for status in m.status))


def test_cancel_ends_the_planning_and_the_node_stays_usable(bench: Bench, planned: Planned) -> None:
    asked = Asked(bench, long_request(planned))
    wait_for_work(bench, AT_WORK)
    begin = time.monotonic()
    answer = cancel(bench)
    assert (answer.success, answer.message) == (True, "planning 100 stations is being cancelled")
    found = asked.answer()
    assert time.monotonic() - begin < CANCEL_S
    assert found.status.code == Status.PLANNING_CANCELLED
    assert found.status.message == "planning 100 stations was cancelled"
    assert not found.plan.stations
    assert not cancel(bench).success
    assert ask(bench, planned.one(strategy="published")).status.code == Status.OK


def test_a_second_request_waits_and_cancel_ends_only_the_first(
    bench: Bench, planned: Planned
) -> None:
    first = Asked(bench, long_request(planned))
    wait_for_work(bench, AT_WORK)
    second = Asked(bench, planned.one(strategy="published"))
    assert cancel(bench).message == "planning 100 stations is being cancelled"
    assert first.answer().status.code == Status.PLANNING_CANCELLED
    found = second.answer()
    assert (found.status.code, found.status.message) == (Status.OK, "")
    assert found.trajectory.segments


def test_the_end_of_the_node_ends_the_planning(planned: Planned) -> None:
    own = Bench()
    try:
        node = own.start(TrajectoryPlanner, simulated=False)
        asked = Asked(own, long_request(planned))
        wait_for_work(own, AT_WORK)
        begin = time.monotonic()
        node.asked_to_end.set()
        assert asked.answer().status.code == Status.PLANNING_CANCELLED
        assert time.monotonic() - begin < CANCEL_S
    finally:
        own.close()
    assert not own.failures


def test_who_was_told_that_it_is_cancelled_gets_no_result() -> None:
    told: list[float] = []
    current = CurrentWork(lambda: False, lambda share, text: told.append(share))
    with current.doing("planning station 1") as work:
        work.progress(0.5, "half")
        assert not work.is_cancelled()
    with (
        pytest.raises(CancelledError, match="planning station 2 was cancelled"),
        current.doing("planning station 2") as work,
    ):
        assert current.cancel() == "planning station 2"
        assert work.is_cancelled()
    with (
        pytest.raises(CancelledError, match="planning station 3 was cancelled"),
        current.doing("planning station 3") as work,
    ):
        current.cancel()
        work.progress(1.0, "never told")
    with (
        pytest.raises(CancelledError, match="planning station 4 was cancelled"),
        current.doing("planning station 4"),
    ):
        current.cancel()
        raise NoTrajectoryError("no point can be scanned")
    with pytest.raises(NoTrajectoryError), current.doing("planning station 5"):
        raise NoTrajectoryError("no point can be scanned")
    assert current.cancel() == ""
    assert told == [0.5]
