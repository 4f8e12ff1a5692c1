"""How well and how fast the part is located: rendered images, truth known.

    python benchmarks/localization.py [--poses 200] [--grid 12] [--draws 1000] [--seed 11]
                                      [--photo IMAGE] [--plot docs/localization.png]

Prints Markdown tables: a grid of distances and view angles, of blur, noise, light and cover, the
honesty of the covariance where E is good enough, and the times. The error is that
of the workpiece's origin in the arm base, and of its rotation.
"""

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from skinplan.errors import LocalizationError
from skinplan.localization.camera import camera_model, project
from skinplan.localization.chain import LocatedPart
from skinplan.localization.detect import MarkerDetector
from skinplan.localization.model import WorkpiecePose
from skinplan.localization.observe import observe
from skinplan.localization.pose import locate
from skinplan.localization.square import square_corners
from skinplan.localization.tracking import MarkerTracker
from skinplan.mock.camera import MockCamera
from skinplan.part.defaults import default_fixture, default_placement
from skinplan.robot.cell import CellConfig
from skinplan.transforms import Array, apply, difference, inverse, planar

CELL = CellConfig()
CAMERA = camera_model(CELL.camera)
T_OPTICAL = CELL.camera.T_base_link_optical
T_ARM_BASE_CAMERA = inverse(CELL.T_base_link_arm_base) @ T_OPTICAL
# A panel of the size of the paper's fuselage section.
BOUNDS = np.array([[-1.45, -0.4, -0.1], [1.45, 0.4, 0.1]])
FIXTURE = default_fixture(BOUNDS)
T_MAP_WORKPIECE = default_placement(BOUNDS)
DISTANCES_M = (0.7, 1.0, 1.4, 1.8, 2.2, 2.6, 3.0)
ANGLES_DEG = (0, 20, 40, 55, 70)
# Blur [px], noise [grey levels], light.
CONDITIONS = {
    "usual": (0.7, 2.0, 1.0),
    "sharp": (0.4, 2.0, 1.0),
    "blurred": (1.2, 2.0, 1.0),
    "noisy": (0.7, 6.0, 1.0),
    "dark": (0.7, 2.0, 0.4),
}


# Share of a marker that is covered, and of every so many of them.
COVERS = ((0.0, 1), (0.03, 2), (0.1, 2), (0.3, 2), (0.5, 2), (0.1, 1), (0.3, 1))


@dataclass
class Tally:
    """Figures of many images."""

    tried: int = 0
    visible: int = 0
    found: int = 0
    quality: list[float] = field(default_factory=list)
    position_mm: list[float] = field(default_factory=list)
    angle_deg: list[float] = field(default_factory=list)
    squares: list[float] = field(default_factory=list)

    def add(
        self,
        camera: MockCamera,
        T_map_base_link: Array,
        covered: float = 0.0,
        least_e: float = 0.0,
        every: int = 1,
    ) -> WorkpiecePose | None:
        """Renders one image, every so many markers covered, locates the part and compares."""
        truth = inverse(T_map_base_link @ T_OPTICAL) @ T_MAP_WORKPIECE
        markers = _visible(truth)
        covers = [_cover(corners, covered) for corners in markers[::every]] if covered else []
        seen = observe(camera.render(truth, covers), CAMERA, FIXTURE, CELL.quality)
        self.tried += 1
        self.visible += len(markers)
        self.found += len(seen.markers)
        try:
            pose = locate(seen, CAMERA, FIXTURE, CELL.quality)
        except LocalizationError:
            return None
        if pose.quality >= least_e:
            self._compare(pose, truth)
        return pose

    def _compare(self, pose: WorkpiecePose, truth: Array) -> None:
        located = LocatedPart.from_camera(pose, T_ARM_BASE_CAMERA, 0.0)
        wanted, found = T_ARM_BASE_CAMERA @ truth, located.T_arm_base_workpiece
        distance, angle = difference(wanted, found)
        turn = Rotation.from_matrix(found[:3, :3] @ wanted[:3, :3].T).as_rotvec()
        error = np.concatenate([found[:3, 3] - wanted[:3, 3], turn])
        self.quality.append(pose.quality)
        self.position_mm.append(1e3 * distance)
        self.angle_deg.append(float(np.degrees(angle)))
        self.squares.append(float(error @ np.linalg.solve(located.covariance, error)))

    def row(self, *names: str) -> str:
        """Returns one row of the table."""
        rate = f"{100.0 * self.found / max(self.visible, 1):.0f} % of {self.visible}"
        cells = [rate, f"{len(self.squares)}/{self.tried}"]
        if self.squares:
            cells += [
                f"{np.mean(self.quality):.2f}",
                *(f"{np.percentile(self.position_mm, share):.2f}" for share in (50, 95)),
                *(f"{np.percentile(self.angle_deg, share):.3f}" for share in (50, 95)),
                f"{np.mean(self.squares):.1f}",
            ]
        else:
            cells += ["-"] * 6
        return "| " + " | ".join([*names, *cells]) + " |"


HEAD = (
    "markers found | poses | E | position p50 | p95 (mm) | angle p50 | p95 (deg) | "
    "mean normalised square |"
)


def _visible(T_camera_workpiece: Array) -> list[Array]:
    """Returns the corners of the markers that are wholly in the image, shape (4, 2) each."""
    found = []
    for marker in FIXTURE.markers:
        pose = T_camera_workpiece @ FIXTURE.T_workpiece_marker(marker.id)
        corners = apply(pose, square_corners(marker.size_m))
        if corners[:, 2].min() <= 0.1 or pose[:3, 2] @ pose[:3, 3] >= 0:
            continue
        pixels = project(corners, CAMERA)
        if (pixels > 8.0).all() and (pixels < np.array([CAMERA.width, CAMERA.height]) - 9.0).all():
            found.append(pixels)
    return found


def _cover(corners: Array, share: float) -> Array:
    """Returns a strip over so much of a marker's left part, as a polygon."""
    over = 0.15
    rising = corners[3] - corners[0]
    right_top = corners[0] + share * (corners[1] - corners[0])
    right_low = corners[3] + share * (corners[2] - corners[3])
    out = -over * (corners[1] - corners[0])
    return np.array([corners[0] + out - over * rising, right_top - over * rising,
                     right_low + over * rising, corners[3] + out + over * rising])  # fmt: skip


def base_at(x: float, distance: float, angle: float, turn: float) -> Array:
    """Base whose camera looks at (x, 0) from a distance, `angle` beside the normal, `turn` off."""
    offset = (planar(0.0, 0.0, angle + turn) @ T_OPTICAL)[:3, 3]
    place = np.array([x + distance * np.sin(angle), -distance * np.cos(angle)]) - offset[:2]
    return planar(place[0], place[1], angle + turn)


def camera_of(condition: str, seed: int = 0) -> MockCamera:
    """Returns a camera under one of the conditions."""
    blur, noise, light = CONDITIONS[condition]
    return MockCamera(CELL.camera, FIXTURE, seed, blur, noise, light)


def grid(poses: int) -> dict[tuple[float, int], Tally]:
    """Distances and view angles under the usual conditions."""
    camera, random = camera_of("usual"), np.random.default_rng(2)
    tallies = {}
    print("| distance (m) | angle (deg) | " + HEAD + "\n|" + "---|" * 10)
    for distance in DISTANCES_M:
        for degrees in ANGLES_DEG:
            tally = tallies[distance, degrees] = Tally()
            for _ in range(poses):
                angle = np.radians(degrees) * random.choice([-1.0, 1.0])
                x, turn = random.uniform(-0.9, 0.9), random.uniform(-0.03, 0.03)
                tally.add(camera, base_at(x, distance / np.cos(angle), angle, turn))
            print(tally.row(f"{distance}", f"{degrees}"))
    return tallies


def conditions(poses: int) -> None:
    """Blur, noise, light and cover over the distances and angles of stations and approaches."""
    print("\n| condition | covered | " + HEAD + "\n|" + "---|" * 10)
    for name in CONDITIONS:
        camera = camera_of(name)
        for covered, every in COVERS if name == "usual" else COVERS[:1]:
            random, tally = np.random.default_rng(3), Tally()
            for _ in range(poses):
                place = random.uniform([-0.9, 0.7, -0.9, -0.03], [0.9, 2.2, 0.9, 0.03])
                tally.add(camera, base_at(*place), covered, every=every)
            text = f"{covered:.0%} of {'all' if every == 1 else 'every second'}"
            print(tally.row(name, text if covered else "-"))


def honesty(draws: int, seed: int) -> None:
    """Error and covariance where E is at least T_E, over all conditions."""
    random, total = np.random.default_rng(seed), Tally()
    names = list(CONDITIONS)
    cameras = [camera_of(name, seed) for name in names]
    tallies = [Tally() for _ in names]
    while sum(len(tally.squares) for tally in tallies) < draws:
        k = int(np.argmin([len(tally.squares) for tally in tallies]))
        place = random.uniform([-1.3, 0.7, -0.75, -0.03], [1.3, 1.4, 0.75, 0.03])
        tallies[k].add(cameras[k], base_at(*place), least_e=CELL.quality.threshold)
    for tally in tallies:
        total.squares += tally.squares
        total.position_mm += tally.position_mm
        total.angle_deg += tally.angle_deg
        total.quality += tally.quality
    print(f"\nE >= {CELL.quality.threshold}: {draws} draws\n")
    print(
        "| condition | position p95 (mm) | angle p95 (deg) | mean normalised square | in band | "
        "below the 95 % quantile |"
    )
    print("|" + "---|" * 6)
    low, high = chi2.ppf([0.025, 0.975], 6)
    for name, tally in zip([*names, "all"], [*tallies, total], strict=True):
        squares = np.array(tally.squares)
        inside = np.mean((squares > low) & (squares < high))
        below = np.mean(squares < chi2.ppf(0.95, 6))
        print(
            f"| {name} | {np.percentile(tally.position_mm, 95):.2f} | "
            f"{np.percentile(tally.angle_deg, 95):.3f} | {squares.mean():.2f} | {inside:.1%} | "
            f"{below:.1%} |"
        )
    bounds = chi2.ppf([0.025, 0.975], 6 * draws) / draws
    print(
        f"\n95 % band of the mean over {draws} draws: {bounds[0]:.2f} to {bounds[1]:.2f}; ", end=""
    )
    print(f"of one draw: {low:.2f} to {high:.2f} (95 % inside)")


def milliseconds(work: Callable[[], object], count: int = 60) -> float:
    """Returns the median time of some work on the core it runs on [ms]."""
    times = []
    for _ in range(count):
        begin = time.thread_time()
        work()
        times.append(time.thread_time() - begin)
    return 1e3 * float(np.median(times))


def times(photo: Path | None) -> None:
    """Detection and pose on one core: the cell's images, and a photograph of 1280 x 960."""
    print("\n| image | OpenCV's detector alone (ms) | whole image, with pose (ms) | tracked (ms) |")
    print("|---|---|---|---|")
    truth = inverse(base_at(0.1, 1.0, 0.1, 0.0) @ T_OPTICAL) @ T_MAP_WORKPIECE
    _times("rendered 1280 x 720", camera_of("usual").render(truth), CAMERA, FIXTURE)
    if photo is not None:
        image = cv2.imread(str(photo), cv2.IMREAD_GRAYSCALE)
        K = np.array([[1006.1, 0.0, 655.9], [0.0, 1004.0, 490.6], [0.0, 0.0, 1.0]])
        camera = type(CAMERA)(image.shape[1], image.shape[0], K, np.zeros(5))
        ids = MarkerDetector("DICT_5X5_1000").find(image).ids
        fixture = type(FIXTURE)(
            "DICT_5X5_1000",
            np.eye(4),
            tuple(type(FIXTURE.markers[0])(int(i), 0.145, np.eye(4)) for i in ids[:1]),
        )
        _times(f"{photo.name} {image.shape[1]} x {image.shape[0]}", image, camera, fixture)


def _times(name: str, image: Array, camera: object, fixture: object) -> None:
    detector = MarkerDetector(fixture.dictionary)
    plain = cv2.aruco.ArucoDetector(detector.book)

    def whole() -> None:
        locate(observe(image, camera, fixture, CELL.quality), camera, fixture, CELL.quality)

    tracker, windowed = MarkerTracker(fixture, CELL.quality), []
    for _ in range(60):
        begin = time.thread_time()
        seen = tracker.observe(image, camera)
        locate(seen, camera, fixture, CELL.quality)
        if tracker.windowed:
            windowed.append(1e3 * (time.thread_time() - begin))
    alone = milliseconds(lambda: plain.detectMarkers(image))
    print(f"| {name} | {alone:.1f} | {milliseconds(whole):.1f} | {np.median(windowed):.1f} |")


def plot(tallies: dict[tuple[float, int], Tally], path: Path) -> None:
    """Draws detection rate, position and angle error over the distance."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.0, 3.8), layout="constrained")
    axes = figure.subplots(1, 3)
    for degrees in ANGLES_DEG:
        mine = [tallies[distance, degrees] for distance in DISTANCES_M]
        rate = [100.0 * t.found / max(t.visible, 1) for t in mine]
        axes[0].plot(DISTANCES_M, rate, marker="o", label=f"{degrees}°")
        for axis, name in ((axes[1], "position_mm"), (axes[2], "angle_deg")):
            values = [np.percentile(getattr(t, name), 95) if t.squares else np.nan for t in mine]
            axis.plot(DISTANCES_M, values, marker="o", label=f"{degrees}°")
    for axis, title in zip(
        axes, ("markers found (%)", "position error, 95 % (mm)", "angle error, 95 % (°)"),
        strict=True,
    ):  # fmt: skip
        axis.set(title=title, xlabel="distance d to the marker plane (m)", ylim=(0.0, None))
        axis.grid(alpha=0.3)
    axes[0].legend(title="angle to the normal")
    figure.savefig(path, dpi=110)


def main() -> None:
    """Runs all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--poses", type=int, default=200)
    parser.add_argument("--grid", type=int, default=12)
    parser.add_argument("--draws", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=11, help="of the draws")
    parser.add_argument("--photo", type=Path, default=None)
    parser.add_argument("--plot", type=Path, default=None)
    given = parser.parse_args()
    cv2.setNumThreads(1)
    tallies = grid(given.grid) if given.grid else {}
    if given.poses:
        conditions(given.poses)
    if given.draws:
        honesty(given.draws, given.seed)
    times(given.photo)
    if given.plot is not None and tallies:
        plot(tallies, given.plot)


if __name__ == "__main__":
    main()
