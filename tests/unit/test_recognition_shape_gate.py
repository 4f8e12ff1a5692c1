"""The gate for a pose by the shape, and the way nearer to the part."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest

import meshes
from shape_parts import LENGTH_M, WIDTH_M, flat, two_bumps
from skinplan.errors import (
    AlignmentError,
    AmbiguousPoseError,
    BaseBlockedError,
    QualityNotReachedError,
    SafeDistanceError,
)
from skinplan.localization.camera import camera_model
from skinplan.localization.chain import LocatedPart
from skinplan.localization.model import WorkpiecePose
from skinplan.mock.depth_camera import DepthCamera
from skinplan.recognition.shape_approach import nearer
from skinplan.recognition.shape_gate import (
    GateSettings,
    accepted_error_m,
    judge_shape,
    predicted_error_m,
    shape_quality,
)
from skinplan.recognition.shape_pose import locate_shape
from skinplan.recognition.shape_search import ShapeEstimate, ShapeLoop, ShapeLoopSettings
from skinplan.recognition.verdict import FAILED
from skinplan.recognition.view import ViewSettings
from skinplan.robot.cell import CellConfig
from skinplan.transforms import Array, inverse, planar, transform

CELL = CellConfig()
MODEL = camera_model(CELL.camera)
GATE = GateSettings()
PANEL = meshes.grid(LENGTH_M, WIDTH_M, 0.01, two_bumps)
PLATE = meshes.grid(LENGTH_M, WIDTH_M, 0.01, flat)
STANDS = transform((0.0, 0.0, 0.6), np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]))


def located(covariance: Array) -> LocatedPart:
    none = np.zeros(0, dtype=np.int64)
    return LocatedPart(transform((0.4, 1.0, 0.2)), covariance, 0.0, 0.0, none, 0.0)


def test_the_predicted_error_is_that_of_the_farthest_point() -> None:
    shift = np.diag([0.001**2, 0.0, 0.002**2, 0.0, 0.0, 0.0])
    assert predicted_error_m(located(shift), PLATE, 3.0) == pytest.approx(0.006)
    turn = np.diag([0.0, 0.0, 0.0, 0.0, 0.0, 0.001**2])
    corner = np.hypot(LENGTH_M / 2, WIDTH_M / 2)
    assert predicted_error_m(located(turn), PLATE, 2.0) == pytest.approx(0.002 * corner)
    # A turn that a shift of the origin undoes at the right end, and doubles at the left one.
    coupled = np.zeros((6, 6))
    row = np.array([0.0, -LENGTH_M / 2, 0.0, 0.0, 0.0, 1.0]) * 0.001
    coupled += np.outer(row, row)
    expected = 0.001 * np.hypot(LENGTH_M, WIDTH_M / 2)
    assert predicted_error_m(located(coupled), PLATE, 1.0) == pytest.approx(expected)


def test_the_gate_opens_at_the_bound_of_poses_by_markers() -> None:
    bound = 0.002 + np.radians(0.1) * np.hypot(LENGTH_M / 2, WIDTH_M / 2)
    assert accepted_error_m(PLATE, GATE) == pytest.approx(bound)
    assert bound < CELL.collision_margin_m
    for share, quality in ((0.5, 1.0), (0.999, 1.0), (2.0, 0.5)):
        sigma = share * bound / GATE.sigmas
        covariance = np.diag([sigma**2, 0.0, 0.0, 0.0, 0.0, 0.0])
        assert shape_quality(located(covariance), PLATE, GATE) == pytest.approx(quality)


@dataclass
class DepthCell:
    """A depth camera on a base that drives as it is told."""

    base: Array
    mesh: object = PANEL
    images: int = 8
    told_phases: list[str] = field(default_factory=list)
    drives: list[Array] = field(default_factory=list)
    blocked_after: int = 100
    verdict: str = ""

    def __post_init__(self) -> None:
        self._camera = DepthCamera(CELL.camera, self.mesh, 4)

    def estimate(self) -> ShapeEstimate:
        truth = inverse(self.base @ CELL.camera.T_base_link_optical) @ STANDS
        points = np.concatenate([self._camera.cloud(truth) for _ in range(self.images)])
        found = locate_shape(points, self.mesh, truth @ transform((0.02, 0.01, -0.01)))
        verdict = judge_shape(points, MODEL, self.mesh, found, ViewSettings())
        if self.verdict:
            verdict = replace(verdict, grade=self.verdict, reason="another part")
        pose = WorkpiecePose(
            found.T_camera_workpiece, found.covariance, 0, 0, 0, 0, np.zeros(0, dtype=np.int64)
        )
        T_arm_base_camera = inverse(CELL.T_base_link_arm_base) @ CELL.camera.T_base_link_optical
        place = LocatedPart.from_camera(pose, T_arm_base_camera, 0.0)
        quality = shape_quality(place, self.mesh, GATE)
        return ShapeEstimate(place, found.T_camera_workpiece, MODEL, verdict, quality, GATE.sigmas)

    def place(self) -> Array:
        return self.base

    def drive(self, T_map_base_link: Array) -> None:
        if len(self.drives) >= self.blocked_after:
            raise BaseBlockedError("blocked")
        self.drives.append(T_map_base_link)
        self.base = T_map_base_link

    def told(self, phase: str, attempt: int, estimate: ShapeEstimate) -> None:
        self.told_phases.append(phase)


FAR = planar(-0.3, -2.4, 0.0)


def run(cell: DepthCell, most: int = 4, may_move: bool = True, threshold: float = 1.0):
    return ShapeLoop(cell, CELL, cell.mesh, ShapeLoopSettings(threshold, most, may_move)).run()


def test_the_base_comes_nearer_until_the_gate_opens() -> None:
    cell = DepthCell(FAR)
    found = run(cell)
    assert found.quality == found.located.quality == 1.0
    assert cell.told_phases[0] == "detecting" and "advancing" in cell.told_phases
    truth = inverse(cell.base @ CELL.T_base_link_arm_base) @ STANDS
    off = np.abs(found.located.T_arm_base_workpiece - truth)[:3, 3]
    assert off.max() < 0.002
    for base in cell.drives:
        camera = (base @ CELL.camera.T_base_link_optical)[:3, 3]
        assert -0.04 - camera[1] >= CELL.quality.distance_min_m


def test_what_is_not_good_enough_is_named_and_the_base_goes_back() -> None:
    cell = DepthCell(FAR)
    with pytest.raises(QualityNotReachedError, match="without moving the base"):
        run(cell, may_move=False)
    assert not cell.drives
    assert run(cell, may_move=False, threshold=0.05).quality < 1.0
    # Few images are not enough from the first two stands.
    cell = DepthCell(FAR, images=1)
    with pytest.raises(QualityNotReachedError, match=r"\(3 sigma\), up to 2.5 mm was asked for wi"):
        run(cell, most=2)
    np.testing.assert_allclose(cell.base, FAR)
    cell = DepthCell(FAR, images=1, blocked_after=2)
    with pytest.raises(QualityNotReachedError, match="could not be brought back .*: blocked"):
        run(cell, most=2)


def test_a_plate_and_another_part_are_refused_without_a_drive() -> None:
    plate = DepthCell(FAR, PLATE)
    with pytest.raises(AmbiguousPoseError, match="does not tell where it is: the images leave"):
        run(plate)
    other = DepthCell(FAR, verdict=FAILED)
    with pytest.raises(AlignmentError, match="it does not lie there: another part"):
        run(other)
    assert not plate.drives and not other.drives


def test_a_part_so_near_is_not_approached() -> None:
    near = planar(-0.3, -0.65, 0.0)
    T_camera_workpiece = inverse(near @ CELL.camera.T_base_link_optical) @ STANDS
    assert nearer(near, T_camera_workpiece, PANEL, MODEL, CELL) is None
    cell = DepthCell(near, images=1)
    cell.estimate = lambda: replace(DepthCell(FAR).estimate(), quality=0.3)
    with pytest.raises(SafeDistanceError):
        cell.base = near
        far = cell.estimate()
        cell.estimate = lambda: replace(far, T_camera_workpiece=T_camera_workpiece)
        run(cell)


def test_a_part_that_lies_flat_is_not_faced() -> None:
    lying = inverse(FAR @ CELL.camera.T_base_link_optical) @ transform((0.0, 0.0, 0.3))
    with pytest.raises(QualityNotReachedError, match="the side of the part that is seen lies flat"):
        nearer(FAR, lying, PANEL, MODEL, CELL)
