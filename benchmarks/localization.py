"""How well and how fast the part is located: rendered images, truth known.

    python benchmarks/localization.py [--poses 200] [--grid 12] [--approaches 50]

Prints Markdown tables: the case of a station (camera about 1 m from the panel, base parallel to
it), a grid of distances and view angles, and whole approaches with rendered images. The error is
that of the workpiece's origin in the arm base, and of its rotation.
"""

import argparse
import time
from dataclasses import dataclass, field

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from skinplan.errors import LocalizationError
from skinplan.localization.approach import next_goal
from skinplan.localization.camera import camera_model
from skinplan.localization.model import WorkpiecePose
from skinplan.localization.observe import observe
from skinplan.localization.pose import locate
from skinplan.mock.base import BaseConfig, MockBase
from skinplan.mock.camera import MockCamera
from skinplan.part.defaults import default_fixture, default_placement
from skinplan.robot.cell import CellConfig
from skinplan.transforms import Array, difference, inverse, planar

CELL = CellConfig()
CAMERA = camera_model(CELL.camera)
T_OPTICAL = CELL.camera.T_base_link_optical
# A panel of the size of the paper's fuselage section.
BOUNDS = np.array([[-1.45, -0.4, -0.1], [1.45, 0.4, 0.1]])
FIXTURE = default_fixture(BOUNDS)
T_MAP_WORKPIECE = default_placement(BOUNDS)


@dataclass
class Tally:
    """Figures of many images."""

    tried: int = 0
    refused: dict[str, int] = field(default_factory=dict)
    markers: list[int] = field(default_factory=list)
    quality: list[float] = field(default_factory=list)
    position_mm: list[float] = field(default_factory=list)
    angle_deg: list[float] = field(default_factory=list)
    squares: list[float] = field(default_factory=list)
    milliseconds: list[tuple[float, float, float]] = field(default_factory=list)

    def add(self, camera: MockCamera, T_map_base_link: Array) -> WorkpiecePose | None:
        """Renders one image, locates the part in it and compares."""
        truth = inverse(T_map_base_link @ T_OPTICAL) @ T_MAP_WORKPIECE
        self.tried += 1
        times = [time.perf_counter()]
        image = camera.render(truth)
        times.append(time.perf_counter())
        try:
            seen = observe(image, CAMERA, FIXTURE, CELL.quality)
            times.append(time.perf_counter())
            pose = locate(seen, CAMERA, FIXTURE, CELL.quality)
        except LocalizationError as error:
            name = type(error).__name__
            self.refused[name] = self.refused.get(name, 0) + 1
            return None
        times.append(time.perf_counter())
        self.milliseconds.append(tuple(1e3 * np.diff(times)))
        self._compare(pose, truth)
        return pose

    def _compare(self, pose: WorkpiecePose, truth: Array) -> None:
        found = pose.T_camera_workpiece
        distance, angle = difference(truth, found)
        turn = Rotation.from_matrix(found[:3, :3] @ truth[:3, :3].T).as_rotvec()
        error = np.concatenate([found[:3, 3] - truth[:3, 3], turn])
        self.markers.append(len(pose.marker_ids))
        self.quality.append(pose.quality)
        self.position_mm.append(1e3 * distance)
        self.angle_deg.append(float(np.degrees(angle)))
        self.squares.append(float(error @ np.linalg.solve(pose.covariance, error)))

    def row(self, *names: str) -> str:
        """Returns one row of the table."""
        if not self.position_mm:
            return "| " + " | ".join([*names, f"0/{self.tried}", *["-"] * 8]) + " |"
        cells = [
            f"{len(self.position_mm)}/{self.tried}",
            f"{np.mean(self.markers):.1f}",
            f"{np.mean(self.quality):.3f}",
            *(f"{np.percentile(self.position_mm, share):.2f}" for share in (50, 95, 100)),
            *(f"{np.percentile(self.angle_deg, share):.3f}" for share in (50, 95)),
            f"{np.mean(self.squares):.1f}",
        ]
        return "| " + " | ".join([*names, *cells]) + " |"


HEAD = (
    "located | markers | E | position p50 | p95 | max (mm) | angle p50 | p95 (deg) | "
    "mean normalised square (6 = honest) |"
)


def base_at(x: float, distance: float, angle: float, turn: float) -> Array:
    """Base whose camera looks at (x, 0) from a distance, `angle` beside the normal, `turn` off."""
    offset = (planar(0.0, 0.0, angle + turn) @ T_OPTICAL)[:3, 3]
    place = np.array([x + distance * np.sin(angle), -distance * np.cos(angle)]) - offset[:2]
    return planar(place[0], place[1], angle + turn)


def station_case(camera: MockCamera, poses: int) -> None:
    """The base parallel to the panel, camera at 1 m, with the stopping error of the base."""
    random = np.random.default_rng(1)
    tally = Tally()
    for _ in range(poses):
        x, slip = random.uniform(-1.3, 1.3), random.uniform(-0.05, 0.05)
        tally.add(camera, base_at(x, 1.0 + slip, 0.0, random.uniform(-0.0175, 0.0175)))
    print("| case | " + HEAD + "\n|" + "---|" * 10)
    print(tally.row("station, 1.0 m"))
    render, observing, locating = np.median(tally.milliseconds, axis=0)
    print(f"\nmedian: render {render:.1f} ms, detect and judge {observing:.1f} ms, ", end="")
    print(f"locate {locating:.1f} ms\n")


def grid(camera: MockCamera, poses: int) -> None:
    """Distances and view angles."""
    random = np.random.default_rng(2)
    print("| distance (m) | angle (deg) | " + HEAD + "\n|" + "---|" * 11)
    for distance in (0.7, 1.0, 1.4, 1.8, 2.2, 2.5):
        for degrees in (0, 20, 40, 60):
            tally = Tally()
            for _ in range(poses):
                angle = np.radians(degrees) * random.choice([-1.0, 1.0])
                x, turn = random.uniform(-0.9, 0.9), random.uniform(-0.03, 0.03)
                tally.add(camera, base_at(x, distance, angle, turn))
            print(tally.row(f"{distance}", f"{degrees}"))


def approaches(camera: MockCamera, count: int) -> None:
    """Whole approaches from up to 3 m and 60 degrees aside."""
    attempts, failures, nearest = [], [], np.inf
    for seed in range(count):
        random = np.random.default_rng(seed)
        low, high = [-0.8, 0.9, -np.pi / 3, -0.15], [0.8, 3.0, np.pi / 3, 0.15]
        base = MockBase(BaseConfig(), CELL, seed, base_at(*random.uniform(low, high)))
        reached = False
        for attempt in range(1, CELL.quality.max_attempts + 1):
            pose = Tally().add(camera, base.true)
            reached = pose is not None and pose.quality >= CELL.quality.threshold
            goal = None
            if pose is not None and not reached:
                goal = next_goal(base.believed, pose, FIXTURE, CAMERA, CELL)
            if goal is None:
                break
            base.goal(goal.T_map_base_link)
            base.step(1e3 * (seed * 100 + attempt))
            nearest = min(nearest, -(base.true @ T_OPTICAL)[1, 3])
        if reached:
            attempts.append(attempt)
        else:
            failures.append(seed)
    print(
        f"\napproaches: {len(attempts)}/{count} reach E >= {CELL.quality.threshold}, estimates ",
        end="",
    )
    print(
        f"median {np.median(attempts):.0f}, most {max(attempts)}; nearest stop {nearest:.3f} m ",
        end="",
    )
    print(f"(d_min {CELL.quality.distance_min_m} m); failed seeds {failures}")


def main() -> None:
    """Runs all three."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--poses", type=int, default=200)
    parser.add_argument("--grid", type=int, default=12)
    parser.add_argument("--approaches", type=int, default=50)
    given = parser.parse_args()
    cv2.setNumThreads(1)
    camera = MockCamera(CELL.camera, FIXTURE, seed=0)
    station_case(camera, given.poses)
    grid(camera, given.grid)
    approaches(camera, given.approaches)


if __name__ == "__main__":
    main()
