"""A cloud is collected, measured and recognised; and what is refused."""

import subprocess
import sys
import threading
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import JointState, PointCloud2
from skinplan_msgs.msg import CoverageState, Heartbeat, PartPose, Status
from skinplan_msgs.srv import IdentifyPart, InspectionFinish, InspectionStart
from std_msgs.msg import Bool
from tf2_msgs.msg import TFMessage

from nodes.bench import Bench
from nodes.small_part import reference, write_small_part
from skinplan.inspection.cloud import read_ply
from skinplan.mesh.load import load_mesh
from skinplan.part.model import Part
from skinplan.part.samples import write_sample
from skinplan.robot.arm import ArmModel
from skinplan.robot.cell import CellConfig
from skinplan.scanner.samples import sample_surface
from skinplan.transforms import Array, apply, difference, inverse, transform
from skinplan_nodes.coarse_pose import CoarsePose
from skinplan_nodes.conversions import (
    LocatedPart,
    ScanFrame,
    inspection_from_msg,
    joint_state_to_msg,
    part_pose_to_msg,
    pose_from_msg,
    pose_stamped_to_msg,
    scan_frame_to_msg,
    stamp_from_msg,
    transform_stamped_to_msg,
)
from skinplan_nodes.part_recognizer import PartRecognizer
from skinplan_nodes.qos import LATCHED, STATE
from skinplan_nodes.scan_inspector import ScanInspector

# The tracker looks along +x at the part, whose outside looks back.
T_TRACKER_WORKPIECE = transform((3.0, 0.2, -0.1), [[0, 0, -1], [1, 0, 0], [0, -1, 0]])
Q = np.array([0.1, -1.2, 1.5, -0.4, 1.3, 0.2])


@pytest.fixture(scope="module")
def part(tmp_path_factory: pytest.TempPathFactory) -> Part:
    return write_small_part(tmp_path_factory.mktemp("part"))


class Scan:
    """Publishes what the devices publish while a part is scanned."""

    def __init__(self, bench: Bench, part: Part, noise_m: float = 3e-5) -> None:
        self._bench = bench
        create = bench.tester.create_publisher
        self._points = create(PointCloud2, "scanner/points", STATE)
        self._pose = create(PoseStamped, "tracker/scanner_pose", STATE)
        self._joints = create(JointState, "joint_states", STATE)
        self._located = create(PartPose, "part_pose", LATCHED)
        self.visible = create(Bool, "tracker/visible", STATE)
        mesh = load_mesh(part.mesh_path, part.unit)
        random = np.random.default_rng(5)
        samples = sample_surface(mesh, 0.002)
        self.points = samples.points + samples.normals * random.normal(
            0.0, noise_m, (len(samples.points), 1)
        )
        self._random = random
        self._tf = create(TFMessage, "tf", STATE)
        self.joint_error_rad = self.base_error_m = 0.0

    def frame(self, points: Array, stamp_s: float, frame: str = "tracker") -> ScanFrame:
        """Makes a scan frame of points of the part."""
        values = {"intensity": np.ones(len(points)), "incidence": np.full(len(points), 0.1)}
        return ScanFrame(np.array(apply(T_TRACKER_WORKPIECE, points)), values, frame, stamp_s)

    def wait_for(self, *topics: str) -> None:
        """Waits until somebody listens."""
        for topic in topics:
            self._bench.wait(lambda t=topic: self._bench.tester.count_subscribers(t) > 0)

    def publish_cloud(self, cloud: PointCloud2) -> None:
        """Publishes a frame as it is, with the scanner's pose at its time."""
        self._points.publish(cloud)
        self.publish_pose(stamp_from_msg(cloud.header.stamp))

    def locate(self, error: Array) -> None:
        """Publishes where the part is in the arm base, with an error of the localisation."""
        T_tracker_scanner = self._scanner()
        T_arm_base_scanner = ArmModel.load(CellConfig()).forward_scanner(Q[None])[0]
        T_arm_base_workpiece = T_arm_base_scanner @ inverse(T_tracker_scanner) @ T_TRACKER_WORKPIECE
        located = LocatedPart(
            T_arm_base_workpiece @ error, np.zeros((6, 6)), 0.9, 0.1, np.array([1]), 1.0
        )
        self._located.publish(part_pose_to_msg(located))

    def publish(self, points: Array, stamp_s: float, frame: str = "tracker") -> None:
        """Publishes one scan frame with joints and scanner pose at its time."""
        self._joints.publish(joint_state_to_msg(Q + self.joint_error_rad, None, stamp_s))
        base = transform((self.base_error_m, -self.base_error_m, 0.0))
        edge = transform_stamped_to_msg("odom", "base_link", base, 0.5)
        self._tf.publish(TFMessage(transforms=[edge]))
        T = self._scanner()
        self._points.publish(scan_frame_to_msg(self.frame(points, stamp_s, frame)))
        self._pose.publish(pose_stamped_to_msg(T, "tracker", stamp_s))

    def publish_joints(self, stamps: list[float]) -> None:
        """Publishes joint states at these times."""
        for stamp_s in stamps:
            self._joints.publish(joint_state_to_msg(Q, None, stamp_s))

    def publish_pose(self, stamp_s: float) -> None:
        """Publishes the scanner's pose alone: nothing is scanned."""
        self._pose.publish(pose_stamped_to_msg(self._scanner(), "tracker", stamp_s))

    def publish_all(self, frames: int = 20) -> None:
        """Publishes the whole part."""
        order = self._random.permutation(len(self.points))
        for number, chosen in enumerate(np.array_split(order, frames)):
            self.publish(self.points[chosen], 2.0 + 0.1 * number)

    @staticmethod
    def _scanner() -> Array:
        # 0.3 m in front of the part, looking at it: scanner x = tracker x.
        return transform((2.7, 0.2, -0.1))


def start(
    bench: Bench,
    part: Part,
    job_id: str = "a",
    folder: Path | str = "",
    resume: bool = False,
    **changes: str,
) -> Any:
    request = InspectionStart.Request(
        job_id=job_id, part=reference(part, **changes), folder=str(folder), resume=resume
    )
    return bench.call(InspectionStart, "inspection/start", request)


def finish(
    bench: Bench,
    job_id: str = "a",
    cloud: Path | str = "",
    scan: Scan | None = None,
    go_on: bool = False,
) -> Any:
    if scan is not None:
        scan.publish_pose(bench.now_s)
    request = InspectionFinish.Request(job_id=job_id, cloud_uri=str(cloud), go_on=go_on)
    return bench.call(InspectionFinish, "inspection/finish", request)


def start_scan(
    bench: Bench, part: Part, error: Array | None = None, folder: Path | str = ""
) -> tuple[Scan, list[CoverageState]]:
    """Starts a scan of a part that is located with an error; None = not located."""
    scan, coverage, _ = start_scan_of(bench, part, error, folder)
    return scan, coverage


def start_scan_of(
    bench: Bench, part: Part, error: Array | None, folder: Path | str = ""
) -> tuple[Scan, list[CoverageState], ScanInspector]:
    """As `start_scan`, with the node."""
    inspector = bench.start(ScanInspector, coverage_rate_hz=10.0)
    bench.wait(lambda: inspector.now_s() > 1.0, turning=True)
    scan = Scan(bench, part)
    coverage = bench.collect(CoverageState, "coverage", STATE)
    scan.wait_for("scanner/points", "tracker/scanner_pose", "joint_states", "part_pose")
    assert start(bench, part, folder=folder).status.code == Status.OK
    bench.wait(lambda: coverage, turning=True)
    assert np.isnan(coverage[-1].area_ratio), "the part is not located yet"
    if error is not None:
        scan.locate(error)
        bench.wait(lambda: inspector._tracks.located)
    return scan, coverage, inspector


def test_a_scan_is_measured(bench: Bench, part: Part, tmp_path: Path) -> None:
    # The localisation is 4 mm off: good enough to begin with, and gone after the alignment.
    scan, coverage = start_scan(bench, part, transform((0.002, -0.003, 0.002)))
    scan.publish_all()
    bench.wait(lambda: coverage[-1].frames == 20, turning=True)
    bench.wait(lambda: coverage[-1].area_ratio > 0.95, turning=True)
    assert coverage[-1].points > 0.9 * len(scan.points)
    answer = finish(bench, cloud=tmp_path / "cloud.ply", scan=scan)
    assert (answer.status.code, answer.status.message) == (Status.OK, "")
    found = inspection_from_msg(answer.result)
    distance, angle = difference(found.alignment.T_tracker_workpiece, T_TRACKER_WORKPIECE)
    assert distance < 1e-4 and angle < 5e-4
    assert found.area_ratio > 0.99
    assert found.deviation_rms_m == pytest.approx(3e-5, rel=0.3)
    cloud = read_ply(tmp_path / "cloud.ply")
    assert cloud.frame == "workpiece"
    assert len(cloud.points) == found.points
    assert {"deviation", "intensity", "incidence"} <= set(cloud.values)
    measured = read_ply(tmp_path / "coverage.ply").values["measured"]
    assert measured.mean() > 0.98


def test_half_a_scan_covers_half(bench: Bench, part: Part) -> None:
    scan, coverage = start_scan(bench, part, np.eye(4))
    left = scan.points[scan.points[:, 0] < 0.0]
    for number, points in enumerate(np.array_split(left, 10)):
        scan.publish(points, 2.0 + 0.1 * number)
    bench.wait(lambda: coverage[-1].frames == 10, turning=True)
    assert finish(bench, scan=scan).result.area_ratio == pytest.approx(0.5, abs=0.06)


def test_hidden_frames_are_counted(bench: Bench, part: Part) -> None:
    scan, coverage = start_scan(bench, part)
    scan.wait_for("tracker/visible")
    for seen in (True, False, False):
        scan.visible.publish(Bool(data=seen))
    bench.wait(lambda: coverage[-1].frames_hidden == 2, turning=True)
    assert max(state.frames_hidden for state in coverage) == 2 and coverage[-1].frames == 0


def test_frames_of_another_frame_are_left_out(bench: Bench, part: Part) -> None:
    scan, coverage = start_scan(bench, part)
    scan.publish(scan.points[:100], 2.0, frame="map")
    for stamp_s in (2.1, 2.2):
        scan.publish(scan.points[:100], stamp_s)
    # Messages of a topic come in order: the first was seen when both others are counted.
    bench.wait(lambda: coverage[-1].frames >= 2, turning=True)
    finish(bench, scan=scan)
    assert max(state.frames for state in coverage) == 2


def test_the_cloud_does_not_pass_through_base_or_arm(part: Part) -> None:
    """Ten times the error of base and arm: the same points, bit by bit, and the same result."""
    clouds, results = [], []
    for times in (1.0, 10.0):
        with closing(Bench()) as bench:
            error = transform((0.002, -0.003, 0.002))
            scan, coverage, inspector = start_scan_of(bench, part, error)
            scan.joint_error_rad = times * 5e-5
            scan.base_error_m = times * 0.05
            scan.publish_all()
            bench.wait(lambda c=coverage: c[-1].frames == 20, turning=True)
            intake = inspector._intake
            assert intake is not None
            clouds.append(intake.session.merged())
            results.append(finish(bench, scan=scan))
        assert not bench.failures
    assert len(clouds[0]) > 1000
    assert np.array_equal(clouds[0], clouds[1]), "in the tracker frame, bit by bit"
    first, second = (inspection_from_msg(answer.result) for answer in results)
    moved = difference(first.alignment.T_tracker_workpiece, second.alignment.T_tracker_workpiece)
    assert moved[0] < 2e-6 and moved[1] < 1e-5
    assert second.deviation_rms_m == pytest.approx(first.deviation_rms_m, rel=1e-3)
    assert second.area_ratio == pytest.approx(first.area_ratio, abs=1e-3)


def test_a_scan_goes_on_after_it_was_measured(bench: Bench, part: Part, tmp_path: Path) -> None:
    scan, coverage = start_scan(bench, part, np.eye(4))
    left = scan.points[:, 0] < 0.0
    for number, points in enumerate(np.array_split(scan.points[left], 10)):
        scan.publish(points, 2.0 + 0.1 * number)
    bench.wait(lambda: coverage[-1].frames == 10, turning=True)
    half = finish(bench, cloud=tmp_path / "half.ply", scan=scan, go_on=True)
    assert half.status.code == Status.OK
    assert half.result.area_ratio == pytest.approx(0.5, abs=0.06)
    for number, points in enumerate(np.array_split(scan.points[~left], 10)):
        scan.publish(points, 3.5 + 0.1 * number)
    bench.wait(lambda: coverage[-1].frames == 20, turning=True)
    whole = finish(bench, cloud=tmp_path / "whole.ply", scan=scan)
    assert whole.result.area_ratio > 0.99
    assert whole.result.points > 1.8 * half.result.points
    sizes = [len(read_ply(tmp_path / f"{name}.ply").points) for name in ("half", "whole")]
    assert sizes == [half.result.points, whole.result.points]
    assert finish(bench).status.code == Status.NOT_INSPECTING


def test_a_scan_is_resumed_by_the_same_process(bench: Bench, part: Part, tmp_path: Path) -> None:
    scan, coverage = start_scan(bench, part)
    for stamp_s in (2.0, 2.1, 2.2):
        scan.publish(scan.points[:100], stamp_s)
    bench.wait(lambda: coverage[-1].frames == 3, turning=True)
    answer = start(bench, part, resume=True)
    assert (answer.status.code, answer.frames) == (Status.OK, 3)
    other = start(bench, write_small_part(tmp_path, height_m=0.05), resume=True)
    assert other.status.code == Status.RESUME_REFUSED
    assert "it is running with part" in other.status.message
    anew = start(bench, part)
    assert (anew.status.code, anew.frames) == (Status.OK, 0)


def test_a_scan_is_resumed_by_the_next_process(part: Part, tmp_path: Path) -> None:
    for number in range(2):
        with closing(Bench()) as bench:
            inspector = bench.start(ScanInspector, coverage_rate_hz=10.0)
            bench.wait(lambda n=inspector: n.now_s() > 1.0, turning=True)
            scan = Scan(bench, part)
            coverage = bench.collect(CoverageState, "coverage", STATE)
            scan.wait_for("scanner/points", "tracker/scanner_pose", "joint_states", "part_pose")
            answer = start(bench, part, folder=tmp_path, resume=True)
            assert (answer.status.code, answer.frames) == (Status.OK, 10 * number)
            if number == 0:
                scan.locate(np.eye(4))
                bench.wait(lambda n=inspector: n._tracks.located)
                half = scan.points[scan.points[:, 0] < 0.0]
                for place, points in enumerate(np.array_split(half, 10)):
                    scan.publish(points, 2.0 + 0.1 * place)
                scan.visible.publish(Bool(data=False))
            # Where the part stands was kept, too: the next process has not located it.
            bench.wait(
                lambda c=coverage: c and c[-1].area_ratio > 0.45 and c[-1].frames_hidden == 1,
                turning=True,
            )
            assert coverage[-1].frames == 10
            if number == 1:
                refused_elsewhere(bench, part, tmp_path)
                assert finish(bench).result.area_ratio == pytest.approx(0.5, abs=0.06)
        assert not bench.failures


@pytest.mark.long
def test_a_scan_is_resumed_after_kill_9(bench: Bench, part: Part, tmp_path: Path) -> None:
    scan = Scan(bench, part)
    beats = bench.collect_before(Heartbeat, "heartbeat", STATE)
    coverage = bench.collect_before(CoverageState, "coverage", STATE)
    halves = np.array_split(np.random.default_rng(1).permutation(len(scan.points)), 2)
    for number, half in enumerate(halves):
        process = inspector_process(tmp_path)
        try:
            # DDS does not know yet that the one before is gone.
            bench.wait(lambda p=process: any(beat.pid == p.pid for beat in beats))
            bench.wait(lambda n=number: bench.tester.count_subscribers("part_pose") > n)
            bench.turn_clock(bench.now_s + 1.0)
            answer = start(bench, part, folder=tmp_path / "frames", resume=number > 0)
            assert (answer.status.code, answer.frames) == (Status.OK, 10 * number)
            scan.locate(np.eye(4))
            begin_s = bench.now_s
            for place, points in enumerate(np.array_split(half, 10)):
                scan.publish(scan.points[points], begin_s + 0.1 * place)
            bench.wait(lambda n=number: coverage and coverage[-1].frames == 10 * n + 10, True)
            bench.wait(lambda: coverage[-1].area_ratio > 0.3, turning=True)
            if number == 1:
                whole = finish(bench, cloud=tmp_path / "cloud.ply", scan=scan)
        finally:
            process.kill()
            process.wait(20.0)
    assert (whole.status.code, whole.status.message) == (Status.OK, "")
    assert whole.result.area_ratio > 0.99
    assert whole.result.points > 0.9 * len(scan.points)


def inspector_process(folder: Path) -> subprocess.Popen[bytes]:
    """Starts the inspector as a program."""
    command = [sys.executable, "-P", "-m", "skinplan_nodes.scan_inspector", "--ros-args"]
    command += ["-p", "use_sim_time:=true", "-p", "coverage_rate_hz:=10.0"]
    with (folder / "inspector.log").open("ab") as log:
        return subprocess.Popen(command, stdout=log, stderr=log)


def refused_elsewhere(bench: Bench, part: Part, folder: Path) -> None:
    """Another job does not get the frames of this one, whether it asks to resume or not."""
    for resume in (False, True):
        other = start(bench, part, "b", folder, resume)
        assert other.status.code == Status.RESUME_REFUSED
        assert "job a" in other.status.message


def test_a_folder_that_takes_nothing_is_a_warning(bench: Bench, part: Part, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("none")
    inspector = bench.start(ScanInspector, simulated=False)
    answer = start(bench, part, folder=tmp_path / "file")
    assert answer.status.code == Status.OK
    level, text, _ = inspector._health
    assert level == DiagnosticStatus.WARN
    assert str(tmp_path / "file") in text and "in memory only" in text
    assert start(bench, part, folder="here").status.code == Status.REQUEST_INVALID


def test_bad_frames_are_counted_by_reason(bench: Bench, part: Part) -> None:
    scan, coverage, inspector = start_scan_of(bench, part, None)
    good = scan_frame_to_msg(scan.frame(scan.points[:500], 2.0))
    cut = scan_frame_to_msg(scan.frame(scan.points[:500], 2.1))
    cut.data = cut.data[:-4]
    huge = PointCloud2(header=good.header, height=1, width=2_000_000, point_step=0)
    holes = scan.frame(scan.points[:500], 2.2)
    holes.points[:7] = np.nan
    holes.points[7, 1] = np.inf
    for cloud in (
        good,
        good,
        cut,
        huge,
        scan_frame_to_msg(holes),
        scan_frame_to_msg(scan.frame(scan.points[:500], 0.5)),
        scan_frame_to_msg(scan.frame(scan.points[:500], 1e6)),
        scan_frame_to_msg(scan.frame(scan.points[:500] + 5000.0, 2.3)),
        scan_frame_to_msg(scan.frame(scan.points[:500], 2.4)),
        # Overtaken, but not by much.
        scan_frame_to_msg(scan.frame(scan.points[:500], 2.35)),
    ):
        scan.publish_cloud(cloud)
    bench.wait(lambda: coverage[-1].frames == 5, turning=True)
    counted = {
        "frames_duplicate": 1,
        "frames_stale": 1,
        "frames_ahead_of_time": 1,
        "frames_invalid": 2,
        "poses_refused": 1,
        "points_not_finite": 8,
    }
    assert inspector.health_values() == counted
    # Points 5 km away are beyond the scanner's range.
    assert coverage[-1].frames_out_of_range == 1
    assert coverage[-1].points == 4 * 500 - 8


def test_points_beyond_range_or_incidence_are_left_out(bench: Bench, part: Part) -> None:
    scan, coverage = start_scan(bench, part)
    far = scan.frame(scan.points[:300], 2.0)
    # Away from the scanner, along the tracker's x.
    far.points[:100, 0] += 0.5
    oblique = scan.frame(scan.points[:300], 2.1)
    oblique.values["incidence"][:50] = np.deg2rad(80.0)
    for frame in (far, oblique, scan.frame(scan.points[:300], 2.2)):
        scan.publish_cloud(scan_frame_to_msg(frame))
    bench.wait(lambda: coverage[-1].frames == 3, turning=True)
    assert coverage[-1].frames_out_of_range == 2
    assert coverage[-1].points == 200 + 250 + 300


def test_a_clock_that_is_set_back_is_named_and_costs_no_frame(bench: Bench, part: Part) -> None:
    scan, coverage, inspector = start_scan_of(bench, part, None)
    bench.turn_clock(8.0)
    for stamp_s in (7.0, 7.1):
        scan.publish(scan.points[:100], stamp_s)
    bench.wait(lambda: coverage[-1].frames == 2, turning=True)
    # A jump ahead: nothing happens.
    bench.turn_clock(step_s=100.0)
    scan.publish(scan.points[:100], bench.now_s)
    bench.wait(lambda: coverage[-1].frames == 3, turning=True)
    bench.now_s = 3.0
    bench.turn_clock()
    bench.wait(lambda: "set back" in inspector._health[1], turning=True)
    scan.publish(scan.points[:100], 3.0)
    bench.wait(lambda: inspector.health_values().get("frames_stale") == 1, turning=True)
    assert coverage[-1].frames == 3


def test_joint_states_that_come_late_are_waited_for(bench: Bench, part: Part) -> None:
    scan, coverage = start_scan(bench, part, np.eye(4))
    stamps = [2.0 + 0.1 * number for number in range(20)]
    pieces = np.array_split(np.arange(len(scan.points)), 20)
    for stamp_s, chosen in zip(stamps, pieces, strict=True):
        scan.publish_cloud(scan_frame_to_msg(scan.frame(scan.points[chosen], stamp_s)))
    bench.wait(lambda: coverage[-1].frames == 20, turning=True)
    late = threading.Timer(1.0, scan.publish_joints, [stamps])
    late.start()
    answer = finish(bench, scan=scan)
    late.join()
    assert (answer.status.code, answer.status.message) == (Status.OK, "")


def test_a_scan_without_localisation_keeps_its_cloud(
    bench: Bench, part: Part, tmp_path: Path
) -> None:
    scan, coverage = start_scan(bench, part)
    scan.publish_all()
    bench.wait(lambda: coverage[-1].frames == 20, turning=True)
    answer = finish(bench, cloud=tmp_path / "cloud.ply", scan=scan)
    assert answer.status.code == Status.ALIGNMENT_FAILED
    assert "localisation" in answer.status.message
    assert read_ply(tmp_path / "cloud.ply").frame == "tracker"


def test_inspector_refuses(bench: Bench, part: Part, tmp_path: Path) -> None:
    bench.start(ScanInspector, simulated=False)
    cases = (
        (start(bench, part, ""), Status.JOB_INVALID, "1 to 64"),
        (start(bench, part, "a/b"), Status.JOB_INVALID, "1 to 64"),
        (start(bench, part, uri="/no/part.yaml"), Status.PART_NOT_FOUND, "no such file"),
        (start(bench, part, mesh_sha256="0" * 64), Status.MESH_HASH_MISMATCH, "SHA-256"),
        (finish(bench), Status.NOT_INSPECTING, "that is none"),
    )
    for answer, code, words in cases:
        assert answer.status.code == code
        assert words in answer.status.message
    assert start(bench, part).status.code == Status.OK
    other = finish(bench, "b")
    assert other.status.code == Status.NOT_INSPECTING
    assert "that is a" in other.status.message
    relative = finish(bench, cloud="cloud.ply")
    assert relative.status.code == Status.NO_CLOUD
    empty = finish(bench, cloud=tmp_path / "cloud.ply")
    assert empty.status.code == Status.NO_CLOUD
    assert "no points" in empty.status.message
    assert not (tmp_path / "cloud.ply").exists()


def test_coarse_pose_is_not_moved_by_a_few_bad_estimates() -> None:
    random = np.random.default_rng(0)
    coarse = CoarsePose()
    assert coarse.estimate() is None
    for stand in (1.0, 2.0, 3.0):
        for _ in range(20):
            coarse.add(stand, T_TRACKER_WORKPIECE @ transform(random.normal(0.0, 1e-4, 3)))
        coarse.add(stand, T_TRACKER_WORKPIECE @ transform((9.0, 9.0, 9.0)))
    found = coarse.estimate()
    assert found is not None
    assert difference(found, T_TRACKER_WORKPIECE)[0] < 2e-4


def identify(bench: Bench, candidates: list[Any]) -> Any:
    return bench.call(IdentifyPart, "identify_part", IdentifyPart.Request(candidates=candidates))


def test_the_part_is_recognised(
    bench: Bench, part: Part, tmp_path_factory: pytest.TempPathFactory
) -> None:
    recognizer = bench.start(PartRecognizer, simulated=False)
    other = write_sample("scene2", tmp_path_factory.mktemp("other"))
    scan = Scan(bench, part)
    scan.wait_for("scanner/points")
    scan.publish_all()
    bench.wait(lambda: recognizer._stamp_s > 3.8)
    answer = identify(bench, [reference(other), reference(part)])
    assert (answer.status.code, answer.index) == (Status.OK, 1)
    assert answer.residuals[1] < 1e-4
    assert answer.pose.header.frame_id == "tracker"
    # The bump is round: turned by half a turn, the part looks the same.
    found = pose_from_msg(answer.pose.pose)
    turned = T_TRACKER_WORKPIECE @ transform((0, 0, 0), np.diag([-1.0, -1.0, 1.0]))
    assert min(difference(found, T)[0] for T in (T_TRACKER_WORKPIECE, turned)) < 1e-3
    stranger = identify(bench, [reference(other)])
    assert (stranger.status.code, stranger.index) == (Status.UNKNOWN_PART, -1)
    assert "unknown part" in stranger.status.message
    assert len(stranger.residuals) == 1


def test_recognizer_refuses(bench: Bench, part: Part) -> None:
    bench.start(PartRecognizer, simulated=False)
    none = identify(bench, [])
    assert (none.status.code, none.index) == (Status.PART_INVALID, -1)
    assert "0 candidates" in none.status.message
    empty = identify(bench, [reference(part)])
    assert (empty.status.code, empty.index) == (Status.NO_CLOUD, -1)
    scan = Scan(bench, part)
    scan.wait_for("scanner/points")
    scan.publish_all()
    bench.wait(lambda: identify(bench, [reference(part)]).status.code == Status.OK)
    wrong = identify(bench, [reference(part, mesh_sha256="0" * 64)])
    assert (wrong.status.code, wrong.index) == (Status.MESH_HASH_MISMATCH, -1)
