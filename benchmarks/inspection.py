"""Inspection: speed and memory of each stage, and laying a cloud on a part beside other programs.

Run as ``python benchmarks/inspection.py [--points N] [--compare]``; prints tables. ``--compare``
needs the extra ``small-gicp`` (`make extras`).
"""

import argparse
import os
import resource
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from skinplan.errors import AlignmentError
from skinplan.inspection.closest import SurfaceIndex
from skinplan.inspection.coverage import CoverageSoFar
from skinplan.inspection.measure import coverage_so_far, inspect
from skinplan.inspection.merge import MergedCloud
from skinplan.inspection.registration import register
from skinplan.inspection.results import write_results
from skinplan.mesh.model import Segmentation, SurfaceMesh
from skinplan.mock.scanner import MockScanner
from skinplan.mock.tracker import MockTracker
from skinplan.part.model import ScanSettings
from skinplan.part.samples import sample_panel
from skinplan.recognition.align import align
from skinplan.scanner.model import ScannerModel
from skinplan.scanner.samples import sample_surface
from skinplan.transforms import apply, difference, transform

WIDTH_M, HEIGHT_M, STEP_M = 2.9, 0.8, 0.0068  # about 100,000 triangles
T_TRACKER_WORKPIECE = transform((3.1, 0.25, -0.08), [[0, 0, -1], [1, 0, 0], [0, -1, 0]])


def height_field(
    width: float, height: float, step: float, surface: Callable[..., np.ndarray]
) -> SurfaceMesh:
    """A surface z(x, y) over a rectangle."""
    x, y = np.meshgrid(
        np.linspace(-width / 2, width / 2, round(width / step) + 1),
        np.linspace(-height / 2, height / 2, round(height / step) + 1),
        indexing="ij",
    )
    number = np.arange(x.size).reshape(x.shape)
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    faces = np.concatenate(
        [np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)]
    )
    return SurfaceMesh(np.stack([x, y, surface(x, y)], axis=-1).reshape(-1, 3), faces)


def panel() -> SurfaceMesh:
    """A curved panel with three bumps."""

    def surface(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        z = np.sqrt(4.0 - y**2) - 2.0
        for centre in (-0.9, 0.0, 0.9):
            z += 0.08 * np.exp(-((x - centre) ** 2 + y**2) / 0.1**2)
        return z

    return height_field(WIDTH_M, HEIGHT_M, STEP_M, surface)


def measured(mesh: SurfaceMesh, count: int, rng: np.random.Generator) -> np.ndarray:
    """Points on the panel with 0.03 mm of noise along the normal."""
    points = np.empty((count, 3))
    for begin in range(0, count, 500_000):
        part = min(500_000, count - begin)
        face = rng.integers(0, len(mesh.faces), part)
        found = np.einsum("nc,nci->ni", rng.dirichlet(np.ones(3), part), mesh.corners[face])
        found += rng.normal(size=(part, 1)) * 3e-5 * mesh.face_normals[face]
        points[begin : begin + part] = found
    return points


def stream(
    mesh: SurfaceMesh, rng: np.random.Generator, frames: int = 500, per_frame: int = 900
) -> float:
    """Returns the mean time of a frame of a scanner that sweeps the panel [s]."""
    coverage = CoverageSoFar(sample_surface(mesh))
    points = measured(mesh, 400_000, rng)
    spent = 0.0
    for k in range(frames):
        centre = np.array([-WIDTH_M / 2 + WIDTH_M * k / frames, 0.3 * np.sin(k / 10.0)])
        seen = points[np.hypot(*(points[:, :2] - centre).T) < 0.2]
        frame = seen[rng.choice(len(seen), min(per_frame, len(seen)), replace=False)]
        begin = time.perf_counter()
        coverage.add(frame, np.array([0.0, 0.0, -1.0]))
        spent += time.perf_counter() - begin
    return spent / frames


class Stages:
    """Wall time of stages and the memory that was ever in use after them."""

    def __init__(self) -> None:
        self.total = 0.0

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Times what is done inside and prints it."""
        begin = time.perf_counter()
        yield
        spent = time.perf_counter() - begin
        self.total += spent
        print(f"{name:34} {spent:8.2f} s {peak_gib():8.2f} GiB", flush=True)


def peak_gib() -> float:
    """Returns the most memory that this process has ever used [GiB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20


def whole(count: int) -> None:
    """Inspects a cloud and writes its files, stage by stage."""
    mesh, rng = panel(), np.random.default_rng(0)
    print(f"{len(mesh.faces):,} triangles, load before: {os.getloadavg()[0]:.1f}")
    print(f"coverage of a frame of 900 points {stream(mesh, rng) * 1e3:9.2f} ms")
    points = measured(mesh, count, rng)
    segmentation = Segmentation(np.zeros(len(mesh.faces), np.int64), mesh)
    stages = Stages()
    print(f"{'stage, ' + format(count, ',') + ' points':34} {'time':>10} {'peak memory':>12}")
    with stages.stage("samples and index"):
        samples = sample_surface(mesh)
        index = SurfaceIndex(mesh, samples)
    with stages.stage("alignment (register)"):
        alone = register(points, index, transform((0.003, 0.001, 0.002)))
    with stages.stage("closest points (one core)"):
        for begin in range(0, count, 100_000):
            index.closest(points[begin : begin + 100_000])
    coverage = coverage_so_far(samples, segmentation)
    begin = time.perf_counter()
    with stages.stage("inspection: all of it (two cores)"):
        found = inspect(
            points, mesh, segmentation, transform((0.003, 0.001, 0.002)), None, None, coverage
        )
    with stages.stage("files"), tempfile.TemporaryDirectory() as folder:
        write_results(Path(folder) / "cloud.ply", points, found, coverage)
    spent = time.perf_counter() - begin
    print(f"{'inspection and files':34} {spent:8.2f} s {peak_gib():8.2f} GiB")
    print(f"alignment residual {alone.rms_m * 1e6:.1f} um, condition {alone.condition:.0f}")


def scanned(mesh: SurfaceMesh, seed: int) -> np.ndarray:
    """The merged cloud of frames on rows, as the mock devices measure it, tracker frame."""
    scanner = MockScanner(mesh, ScannerModel.from_settings(ScanSettings()), seed)
    tracker = MockTracker(np.eye(4), seed, volumetric_m=0.0)
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    cloud = MergedCloud(0.001, 3_000_000)
    for y in np.arange(low[1], high[1] + 0.05, 0.1):
        for x in np.arange(low[0], high[0] + 0.01, 0.03):
            pose = transform((x, y, 0.3), [[0, 1, 0], [0, 0, -1], [-1, 0, 0]])
            points = scanner.frame(pose).points
            cloud.add(apply(tracker.measure(T_TRACKER_WORKPIECE @ pose), points))
    return cloud.points()[0]


def small_gicp_pose(points: np.ndarray, mesh: SurfaceMesh, initial: np.ndarray) -> np.ndarray:
    """Lays the points on dense samples of the mesh with small-gicp, coarse then fine."""
    import small_gicp

    target, _ = small_gicp.preprocess_points(
        sample_surface(mesh, 0.002).points, downsampling_resolution=0.002, num_threads=2
    )
    tree = small_gicp.KdTree(target, num_threads=2)
    source, _ = small_gicp.preprocess_points(
        points[:: max(1, len(points) // 100_000)], downsampling_resolution=0.001, num_threads=2
    )
    pose = initial
    for gate in (0.06, 0.01, 0.002):
        found = small_gicp.align(
            target,
            source,
            tree,
            init_T_target_source=np.linalg.inv(pose),
            registration_type="PLANE_ICP",
            max_correspondence_distance=gate,
            num_threads=2,
            max_iterations=100,
            rotation_epsilon=1e-7,
            translation_epsilon=1e-7,
        )
        pose = np.linalg.inv(found.T_target_source)
    return pose


def dented(mesh: SurfaceMesh) -> SurfaceMesh:
    """The mesh with a dent of 60 mm and a step of 120 mm diameter."""
    vertices, normals = mesh.vertices.copy(), mesh.vertex_normals
    for x, y, radius, height in ((-0.12, 0.10, 0.030, -5e-4), (0.15, -0.10, 0.060, 3e-4)):
        inside = np.hypot(vertices[:, 0] - x, vertices[:, 1] - y) < radius
        vertices[inside] += height * normals[inside]
    return SurfaceMesh(vertices, mesh.faces)


def compare() -> None:
    """Prints how far off each program lays dented, noisy clouds, from near and from far."""
    names = ("flat", "scene1", "scene2", "scene4")
    print(f"{'part':8} {'start':>13} {'program':>12} {'off by':>12} {'turned by':>12} {'time':>8}")
    for name in names:
        if name == "flat":
            mesh = height_field(1.0, 0.6, 0.005, lambda x, y: np.zeros_like(x))
        else:
            shape = sample_panel(name)
            mesh = height_field(*shape.size_m, 0.005, shape.height)
        cloud = scanned(dented(mesh), 1)
        index = SurfaceIndex(mesh, sample_surface(mesh))
        for far_m, angle_deg in ((0.003, 0.3), (0.040, 1.0)):
            turn = Rotation.from_rotvec(np.deg2rad(angle_deg) * np.array([0.5, 0.5, 0.7071]))
            start = T_TRACKER_WORKPIECE @ transform(
                far_m * np.array([0.8, 0.48, 0.36]), turn.as_matrix()
            )
            for program, laid in _PROGRAMS.items():
                begin = time.perf_counter()
                try:
                    distance, angle = difference(T_TRACKER_WORKPIECE, laid(cloud, index, start))
                    result = f"{distance * 1e3:9.4f} mm {np.rad2deg(angle):9.5f} deg"
                except AlignmentError:
                    result = "none found"
                spent = time.perf_counter() - begin
                where = f"{far_m * 1e3:.0f} mm {angle_deg:g} deg"
                print(f"{name:8} {where:>13} {program:>12} {result:>25} {spent:6.1f} s", flush=True)


_PROGRAMS = {
    "small-gicp": lambda cloud, index, start: small_gicp_pose(cloud, index.mesh, start),
    "align": lambda cloud, index, start: align(cloud, index, start).T_tracker_workpiece,
    "register": lambda cloud, index, start: register(cloud, index, start).T_tracker_workpiece,
}


def main() -> None:
    """Prints the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--points", type=int, default=1_000_000)
    parser.add_argument("--compare", action="store_true")
    given = parser.parse_args()
    if given.compare:
        compare()
    else:
        whole(given.points)


if __name__ == "__main__":
    main()
