"""The supervisor's side of planning, against the real planners."""

import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from skinplan_msgs import msg as messages
from skinplan_msgs.msg import Status

from nodes.bench import TIMEOUT_S, Bench
from nodes.small_part import write_small_part
from skinplan.jobs.model import Job
from skinplan.mesh.prepare import prepare_mesh
from skinplan.part.files import save_part
from skinplan.part.model import Part
from skinplan.plan_record import trajectory_hash
from skinplan.robot.cell import CellConfig, load_cell
from skinplan.trajectory.plan import plan_station_trajectory
from skinplan.transforms import inverse, planar
from skinplan_nodes.conversions import pose_from_msg, pose_to_msg
from skinplan_nodes.qos import LATCHED, STATE
from skinplan_nodes.scan_path_planner import ScanPathPlanner
from skinplan_nodes.station_planner import StationPlanner
from skinplan_nodes.supervisor.control import AbortError, StepError
from skinplan_nodes.supervisor.ros_cell import RosCell
from skinplan_nodes.supervisor.watch import NodeWatch
from skinplan_nodes.trajectory_planner import TrajectoryPlanner

TIMEOUTS = SimpleNamespace(
    planning_timeout_s=60.0,
    drive_timeout_s=1.0,
    localize_timeout_s=1.0,
    start_timeout_s=1.0,
    stop_timeout_s=1.0,
)


@pytest.fixture(scope="module")
def part(tmp_path_factory: pytest.TempPathFactory) -> Part:
    return write_small_part(tmp_path_factory.mktemp("part"))


@pytest.fixture(scope="module")
def cell_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cell whose tracker stands so far off that it sees nothing."""
    path = tmp_path_factory.mktemp("cell") / "cell.yaml"
    path.write_text("T_map_tracker: {translation_m: [500, 500, 1]}\n", encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def bench(cell_file: Path) -> Iterator[Bench]:
    found = Bench()
    found.start(ScanPathPlanner, simulated=False)
    # Only the station plan says where the tracker really is.
    found.start(StationPlanner, simulated=False)
    found.start(TrajectoryPlanner, simulated=False, cell_file=str(cell_file))
    yield found
    found.close()
    assert not found.failures


def cell_of(bench: Bench) -> RosCell:
    return RosCell(bench.tester, TIMEOUTS, NodeWatch(()))


def through_msg(T_a_b: np.ndarray) -> np.ndarray:
    """A pose as the service gets it."""
    return pose_from_msg(pose_to_msg(T_a_b))


def test_the_tracker_and_the_part_s_place_reach_the_planner(
    bench: Bench, part: Part, cell_file: Path
) -> None:
    latched = bench.collect(messages.TrajectoryPlan, "trajectory_plan", LATCHED)
    config, cell, job = load_cell(cell_file), cell_of(bench), Job("j1", str(part.source))
    path = cell.planners.plan_path(job)[0].path
    T_map_workpiece = planar(0.3, -0.2, 0.1) @ part.T_map_workpiece
    plan = cell.planners.plan_stations(job, path, T_map_workpiece)
    assert plan.T_map_tracker is not None
    station = plan.stations[0]
    points = sorted(map(int, station.points))
    T_map_arm_base = station.T_map_base_link @ config.T_base_link_arm_base
    T_arm_base_workpiece = through_msg(inverse(T_map_arm_base) @ T_map_workpiece)
    made = cell.planners.plan_trajectory(job, path, station.id, T_arm_base_workpiece, points)
    assert made is not None
    wanted = plan_station_trajectory(
        path,
        np.array(points),
        T_arm_base_workpiece,
        prepare_mesh(part).mesh,
        part.scan,
        config,
        station.id,
        T_arm_base_map=T_arm_base_workpiece @ inverse(through_msg(T_map_workpiece)),
        T_map_tracker=through_msg(plan.T_map_tracker),
    )
    bench.wait(lambda: latched)
    assert latched[-1].plan_hash == trajectory_hash([wanted])
    assert made.order == part.scan.order_strategy
    for segment, other in zip(made.segments, wanted.segments, strict=True):
        np.testing.assert_array_equal(segment.point_s, other.point_s)


def test_a_job_that_is_aborted_leaves_no_planning_behind(
    bench: Bench, part: Part, tmp_path: Path
) -> None:
    # Effort enough that heartbeats tell of the planning.
    patient = replace(part, scan=replace(part.scan, tour_effort_s=4.0))
    patient = replace(patient, source=save_part(patient, tmp_path / "part.yaml"))
    cell, job = cell_of(bench), Job("j2", str(patient.source))
    path = cell.planners.plan_path(job)[0].path
    station = cell.planners.plan_stations(job, path, part.T_map_workpiece).stations[0]
    T_map_arm_base = station.T_map_base_link @ CellConfig().T_base_link_arm_base
    place = inverse(T_map_arm_base) @ part.T_map_workpiece
    said = bench.collect(DiagnosticArray, "diagnostics", STATE)

    def has_said(text: str) -> bool:
        return any(text in status.message for message in said for status in message.status)

    ended: list[StepError] = []

    def plan() -> None:
        try:
            cell.planners.plan_trajectory(job, path, station.id, place, station.points.tolist())
        except StepError as error:
            ended.append(error)

    job_thread = threading.Thread(target=plan)
    job_thread.start()
    bench.wait(lambda: has_said("joint branches"))
    cell.waiter.control.abort(Status.JOB_ABORTED, "enough")
    job_thread.join(TIMEOUT_S)
    assert [(type(error), str(error)) for error in ended] == [(AbortError, "enough")]
    bench.wait(lambda: has_said("planning station 0 was cancelled"))
