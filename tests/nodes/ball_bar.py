"""The accuracy experiment of the paper (Table 2): two spheres, scanned from two stations.

Tracker and scanner are the mock's node with its published noise; base and arm stand beside where
they should. What comes out of the frames is merged in the tracker frame and nothing else.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import JointState, PointCloud2
from std_srvs.srv import SetBool

from nodes.bench import Bench
from skinplan.inspection.fits import SphereFit, fit_sphere
from skinplan.inspection.merge import MergedCloud
from skinplan.mesh.load import load_mesh
from skinplan.mock.tracker import LineOfSight
from skinplan.mock.truth import Truth
from skinplan.part.model import Part
from skinplan.part.resolve import resolve_part
from skinplan.robot.arm import ArmModel
from skinplan.robot.cell import CellConfig
from skinplan.transforms import Array, inverse, planar, transform
from skinplan_nodes.conversions import (
    joint_state_to_msg,
    pose_stamped_to_msg,
    scan_frame_from_msg,
)
from skinplan_nodes.mock_ctrack import MockCtrack
from skinplan_nodes.qos import STATE

DIAMETER_M = 0.022225
APART_M = 1.847732
CELL = CellConfig()
RAYS = 20_000  # about 50 of them meet a sphere
_STAND_OFF_M = 0.3
_TILT_RAD = np.radians(35.0)
_SPREAD_M = 0.06
_STATION_M = 0.85


@dataclass(frozen=True)
class Errors:
    """How far base and arm are from where they believe to be, standard deviations.

    Attributes:
        base_m: Of the base after its localisation, along x and y [m].
        base_rad: ... and about the vertical [rad].
        arm_rad: Of every joint [rad].
    """

    base_m: float = 0.002
    base_rad: float = 0.0017
    arm_rad: float = 0.0003

    def times(self, factor: float) -> "Errors":
        """The same errors, larger."""
        return Errors(factor * self.base_m, factor * self.base_rad, factor * self.arm_rad)


@dataclass(frozen=True)
class Measured:
    """One run: both spheres in the tracker frame."""

    spheres: tuple[SphereFit, SphereFit]

    @property
    def diameters(self) -> Array:
        """Of both spheres, shape (2,) [m]."""
        return np.array([sphere.diameter for sphere in self.spheres])

    @property
    def distance(self) -> float:
        """Between the centres [m]."""
        return float(np.linalg.norm(self.spheres[1].centre - self.spheres[0].centre))


def write_ball_bar(folder: Path) -> Part:
    """Writes mesh and part file: two spheres along x."""
    ball = trimesh.creation.icosphere(subdivisions=6, radius=0.5 * DIAMETER_M)
    # Vertices on the sphere make a body that is too small: faces lie as far inside as outside now.
    inside = np.linalg.norm(ball.triangles_center, axis=1).mean()
    ball.apply_scale(2.0 * 0.5 * DIAMETER_M / (inside + 0.5 * DIAMETER_M))
    balls = [ball.copy().apply_translation([x, 0.0, 0.0]) for x in (-APART_M / 2, APART_M / 2)]
    path = folder / "ball_bar.stl"
    trimesh.util.concatenate(balls).export(path)
    return resolve_part(str(path), "m", folder)


class BallBar:
    """Scans the ball bar with a `MockCtrack` in a bench."""

    def __init__(self, bench: Bench, part: Part, seed: int, frames: int = 150) -> None:
        self._bench = bench
        self._frames = frames
        self._random = np.random.default_rng([seed, 0xBA77])
        self._arm = ArmModel.load(CELL)
        self.T_map_workpiece = Truth(part, CELL, seed).T_map_workpiece
        mesh = load_mesh(part.mesh_path, part.unit)
        self._sight = LineOfSight(CELL, self._arm, mesh, self.T_map_workpiece)
        bench.start(MockCtrack, part_uri=str(part.source), seed=seed, rays=RAYS)
        create = bench.tester.create_publisher
        self._joints = create(JointState, "joint_states", STATE)
        self._base = create(PoseStamped, "truth/base_pose", STATE)
        self.frames: list[PointCloud2] = bench.collect(PointCloud2, "scanner/points", STATE)
        bench.wait(lambda: bench.tester.count_subscribers("joint_states") > 0)
        bench.turn_clock()
        assert bench.call(SetBool, "scanner/enable", SetBool.Request(data=True)).success

    def measure(self, errors: Errors) -> Measured:
        """Scans both spheres, each from a station of its own."""
        spheres = [self._sphere(x, errors) for x in (-APART_M / 2, APART_M / 2)]
        return Measured((spheres[0], spheres[1]))

    def _sphere(self, x: float, errors: Errors) -> SphereFit:
        place = planar(x, -_STATION_M, 0.0)
        believed = place @ inverse(planar(*CELL.T_base_link_arm_base[:2, 3], 0.0))
        random = self._random
        aside = random.normal(0.0, [errors.base_m, errors.base_m, errors.base_rad])
        true = believed @ planar(*aside)
        cloud = MergedCloud(voxel_m=1e-4)
        number = 0
        while number < self._frames:
            q = self._view(np.array([x, 0.0, 0.0]), believed)
            if q is None:
                continue
            true_q = q + random.normal(0.0, errors.arm_rad, 6)
            if self._sight.hindrance(true_q, true @ CELL.T_base_link_arm_base):
                continue
            number += 1
            self._frame(true_q, true, cloud)
        return fit_sphere(cloud.points()[0])

    def _frame(self, q: Array, T_map_base_link: Array, cloud: MergedCloud) -> None:
        bench, before = self._bench, len(self.frames)
        bench.turn_clock()
        self._base.publish(pose_stamped_to_msg(T_map_base_link, "map", bench.now_s))
        self._joints.publish(joint_state_to_msg(q, None, bench.now_s))
        bench.wait(lambda: len(self.frames) > before)
        frame = scan_frame_from_msg(self.frames[-1])
        assert frame.frame == "tracker" and abs(frame.stamp_s - bench.now_s) < 1e-6
        cloud.add(frame.points)

    def _view(self, centre: Array, T_map_base_link: Array) -> Array | None:
        """Joints for a random view at a sphere; None = out of reach."""
        random = self._random
        tilt, turn = _TILT_RAD * np.sqrt(random.uniform()), random.uniform(-np.pi, np.pi)
        out = [np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)]
        view = -np.array(out)
        side = np.cross([0.0, 1.0, 0.0], view)
        side /= np.linalg.norm(side)
        rotation = np.column_stack([view, side, np.cross(view, side)])
        aside = rotation[:, 1:] @ random.uniform(-_SPREAD_M, _SPREAD_M, 2)
        T_workpiece_scanner = transform(centre - _STAND_OFF_M * view + aside, rotation)
        T_map_scanner = self.T_map_workpiece @ T_workpiece_scanner
        T_arm_base_scanner = inverse(T_map_base_link @ CELL.T_base_link_arm_base) @ T_map_scanner
        tool = T_arm_base_scanner @ inverse(CELL.T_tool0_scanner)
        q, valid = self._arm.inverse(tool[None])
        found: Any = q[0][valid[0]]
        return found[random.integers(len(found))] if len(found) else None
