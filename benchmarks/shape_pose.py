"""How well depth images tell where a part without markers stands.

A panel of 0.5 m x 0.3 m with two bumps, 30 mm and 2 degrees beside its nominal place, before the
mock camera. `PYTHONPATH=tests python benchmarks/shape_pose.py [DRAWS]` prints a table.
"""

import sys
import time

import numpy as np
from scipy.spatial.transform import Rotation

import meshes
from shape_parts import LENGTH_M, WIDTH_M, two_bumps
from skinplan.localization.chain import LocatedPart
from skinplan.localization.model import WorkpiecePose
from skinplan.mock.depth_camera import DepthCamera
from skinplan.recognition.shape_gate import GateSettings, shape_quality
from skinplan.recognition.shape_pose import locate_shape
from skinplan.robot.cell import CameraConfig
from skinplan.transforms import Array, transform

PANEL = meshes.grid(LENGTH_M, WIDTH_M, 0.01, two_bumps)
IMAGES = 8


def draw(distance_m: float, seed: int) -> tuple[float, float, float, float, float]:
    """Locates it once: errors [mm], [deg], normalised square, gate quality, processor time [s]."""
    random = np.random.default_rng([seed, 17])
    shift, axis = (each / np.linalg.norm(each) for each in random.normal(size=(2, 3)))
    looked_for = transform((0.0, -0.15, distance_m), np.diag([1.0, -1.0, -1.0]))
    turn = Rotation.from_rotvec(np.radians(2.0) * axis).as_matrix()
    truth = transform(looked_for[:3, 3] + 0.03 * shift, turn @ looked_for[:3, :3])
    camera = DepthCamera(CameraConfig(), PANEL, seed)
    points = np.concatenate([camera.cloud(truth) for _ in range(IMAGES)])
    begin = time.thread_time()
    found = locate_shape(points, PANEL, looked_for)
    spent = time.thread_time() - begin
    turned = Rotation.from_matrix(found.T_camera_workpiece[:3, :3] @ truth[:3, :3].T).as_rotvec()
    off = np.concatenate([found.T_camera_workpiece[:3, 3] - truth[:3, 3], turned])
    return (
        float(np.linalg.norm(off[:3])) * 1e3,
        float(np.degrees(np.linalg.norm(off[3:]))),
        float(off @ np.linalg.solve(found.covariance, off)),
        shape_quality(_located(found.T_camera_workpiece, found.covariance), PANEL, GateSettings()),
        spent,
    )


def _located(pose: Array, covariance: Array) -> LocatedPart:
    none = np.zeros(0, dtype=np.int64)
    seen = WorkpiecePose(pose, covariance, 0.0, 0.0, 0.0, 0.0, none)
    return LocatedPart.from_camera(seen, np.eye(4), 0.0)


def main() -> None:
    """Prints the table."""
    draws = int(sys.argv[1]) if len(sys.argv) > 1 else 50
    print(
        "| distance (m) | position p50 | max (mm) | angle p50 | max (deg) | "
        "mean normalised square | accepted | time (s) |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for distance_m in (0.9, 1.2, 1.5, 1.8, 2.2, 2.6):
        rows = np.array([draw(distance_m, seed) for seed in range(draws)])
        middle, worst = np.median(rows, axis=0), rows.max(axis=0)
        print(
            f"| {distance_m} | {middle[0]:.2f} | {worst[0]:.2f} | {middle[1]:.3f} | "
            f"{worst[1]:.3f} | {rows[:, 2].mean():.1f} | {np.mean(rows[:, 3] >= 1.0):.0%} | "
            f"{middle[4]:.2f} |"
        )


if __name__ == "__main__":
    main()
