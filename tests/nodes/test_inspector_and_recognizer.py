"""A cloud is collected, measured and recognised; and what is refused."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import JointState, PointCloud2
from skinplan_msgs.msg import CoverageState, PartPose, Status
from skinplan_msgs.srv import IdentifyPart, InspectionFinish, InspectionStart
from std_msgs.msg import Bool

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
from skinplan_nodes.conversions import (
    LocatedPart,
    ScanFrame,
    inspection_from_msg,
    joint_state_to_msg,
    part_pose_to_msg,
    pose_from_msg,
    pose_stamped_to_msg,
    scan_frame_to_msg,
)
from skinplan_nodes.part_recognizer import PartRecognizer
from skinplan_nodes.qos import LATCHED, STATE
from skinplan_nodes.scan_inspector import ScanInspector
from skinplan_nodes.scan_session import CoarsePose

# The tracker looks along +x at the part, whose outside looks back.
T_TRACKER_WORKPIECE = transform((3.0, 0.2, -0.1), [[0, 0, -1], [1, 0, 0], [0, -1, 0]])
Q = np.array([0.1, -1.2, 1.5, -0.4, 1.3, 0.2])


@pytest.fixture(scope="module")
def part(tmp_path_factory: pytest.TempPathFactory) -> Part:
    return write_small_part(tmp_path_factory.mktemp("part"))


@pytest.fixture
def bench() -> Iterator[Bench]:
    found = Bench()
    yield found
    found.close()
    assert not found.failures


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

    def wait_for(self, *topics: str) -> None:
        """Waits until somebody listens."""
        for topic in topics:
            self._bench.wait(lambda t=topic: self._bench.tester.count_subscribers(t) > 0)

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
        self._joints.publish(joint_state_to_msg(Q, None, stamp_s))
        T = self._scanner()
        values = {"intensity": np.ones(len(points)), "incidence": np.full(len(points), 0.1)}
        cloud = ScanFrame(apply(T_TRACKER_WORKPIECE, points), values, frame, stamp_s)
        self._points.publish(scan_frame_to_msg(cloud))
        self._pose.publish(pose_stamped_to_msg(T, "tracker", stamp_s))

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


def start(bench: Bench, part: Part, job_id: str = "a", **changes: str) -> Any:
    request = InspectionStart.Request(job_id=job_id, part=reference(part, **changes))
    return bench.call(InspectionStart, "inspection/start", request)


def finish(
    bench: Bench, job_id: str = "a", cloud: Path | str = "", scan: Scan | None = None
) -> Any:
    if scan is not None:
        scan.publish_pose(bench.now_s)
    request = InspectionFinish.Request(job_id=job_id, cloud_uri=str(cloud))
    return bench.call(InspectionFinish, "inspection/finish", request)


def start_scan(
    bench: Bench, part: Part, error: Array | None = None
) -> tuple[Scan, list[CoverageState]]:
    """Starts a scan of a part that is located with an error; None = not located."""
    inspector = bench.start(ScanInspector, coverage_rate_hz=10.0)
    bench.wait(lambda: inspector.now_s() > 1.0, turning=True)
    scan = Scan(bench, part)
    coverage = bench.collect(CoverageState, "coverage", STATE)
    scan.wait_for("scanner/points", "tracker/scanner_pose", "joint_states", "part_pose")
    assert start(bench, part).status.code == Status.OK
    bench.wait(lambda: coverage, turning=True)
    assert np.isnan(coverage[-1].area_ratio), "the part is not located yet"
    if error is not None:
        scan.locate(error)
        bench.wait(lambda: inspector._tracks.located)
    return scan, coverage


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


def test_frames_of_another_frame_are_left_out(bench: Bench, part: Part) -> None:
    scan, coverage = start_scan(bench, part)
    scan.publish(scan.points[:100], 2.0, frame="map")
    for stamp_s in (2.1, 2.2):
        scan.publish(scan.points[:100], stamp_s)
    # Messages of a topic come in order: the first was seen when both others are counted.
    bench.wait(lambda: coverage[-1].frames >= 2, turning=True)
    finish(bench, scan=scan)
    assert max(state.frames for state in coverage) == 2


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
