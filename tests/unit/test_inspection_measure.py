"""Closest points, alignment, deviation and coverage against closed forms."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from skinplan.errors import AlignmentError, InputError, MeshEmptyError, NoCloudError
from skinplan.inspection.closest import SurfaceIndex, edge_neighbours
from skinplan.inspection.cloud import read_ply
from skinplan.inspection.coverage import CoverageSoFar
from skinplan.inspection.measure import InspectionSettings, coverage_so_far, deviations, inspect
from skinplan.inspection.merge import MergedCloud
from skinplan.inspection.results import write_results
from skinplan.mesh.model import Segmentation, SurfaceMesh
from skinplan.recognition.align import AlignSettings, align
from skinplan.scanner.samples import sample_surface
from skinplan.transforms import apply, difference, inverse, rotate, transform

SPACING = 0.005


def grid(
    width: float, height: float, step: float, surface=lambda x, y: np.zeros_like(x)
) -> SurfaceMesh:
    """A height field z(x, y) about the origin, normals about +z."""
    x, y = np.meshgrid(
        np.linspace(-width / 2, width / 2, round(width / step) + 1),
        np.linspace(-height / 2, height / 2, round(height / step) + 1),
        indexing="ij",
    )
    vertices = np.stack([x, y, surface(x, y)], axis=-1).reshape(-1, 3)
    number = np.arange(x.size).reshape(x.shape)
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    faces = np.concatenate(
        [np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)]
    )
    return SurfaceMesh(vertices, faces)


def bumps(x, y):
    return 0.04 * np.exp(-((x - 0.1) ** 2 + (y + 0.05) ** 2) / 0.08**2) + 0.03 * np.sin(
        6 * x
    ) * np.cos(5 * y)


def flat(mesh: SurfaceMesh) -> Segmentation:
    return Segmentation(np.zeros(len(mesh.faces), np.int64), mesh)


def index_of(mesh: SurfaceMesh) -> SurfaceIndex:
    return SurfaceIndex(mesh, sample_surface(mesh, SPACING))


def random_pose(rng: np.random.Generator, position: float, angle: float) -> np.ndarray:
    axis = rng.normal(size=3)
    shift = rng.normal(size=3)
    turn = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)).as_matrix()
    return transform(position * shift / np.linalg.norm(shift), turn)


def measured(
    mesh: SurfaceMesh, rng: np.random.Generator, count: int, noise: float = 0.0
) -> np.ndarray:
    """Points on the mesh with noise along the normal."""
    face = rng.choice(len(mesh.faces), count, p=mesh.face_areas / mesh.area)
    share = rng.dirichlet(np.ones(3), count)
    points = np.einsum("nc,nci->ni", share, mesh.corners[face])
    return points + rng.normal(size=(count, 1)) * noise * mesh.face_normals[face]


# --- closest point


def test_closest_points_equal_brute_force() -> None:
    mesh = grid(0.3, 0.2, 0.02, bumps)
    rng = np.random.default_rng(2)
    points = measured(mesh, rng, 300) + rng.normal(scale=0.004, size=(300, 3))
    found = index_of(mesh).closest(points)
    # Brute force: the finest possible sampling of every face can't come nearer than the closest
    # point.
    fine = np.linspace(0, 1, 41)
    u, v = (w[np.add.outer(fine, fine) <= 1] for w in np.meshgrid(fine, fine, indexing="ij"))
    shares = np.stack([1 - u - v, u, v], axis=1)
    dense = np.einsum("sc,fci->fsi", shares, mesh.corners).reshape(-1, 3)
    best, _ = cKDTree(dense).query(points)
    assert np.all(found.distance <= best + 1e-8)
    assert np.all(best - found.distance < 4e-4)  # the spacing of the dense points
    assert np.allclose(np.linalg.norm(points - found.points, axis=1), found.distance)


def test_distance_to_a_sphere_is_its_radius_short_of_the_facets() -> None:
    trimesh = pytest.importorskip("trimesh")
    ball = trimesh.creation.icosphere(subdivisions=5, radius=0.1)
    mesh = SurfaceMesh(np.asarray(ball.vertices), np.asarray(ball.faces))
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(500, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    for radius in (0.097, 0.103):
        signed = deviations(radius * directions, index_of(mesh))
        sagitta = 0.1 * (1 - np.cos(0.5 * 0.04))  # of facets up to 4 degrees wide
        assert np.all(signed >= radius - 0.1 - 1e-12)
        assert np.all(signed <= radius - 0.1 + 4 * sagitta)


def test_the_sign_says_the_side_and_nothing_lies_beyond_the_border() -> None:
    mesh = grid(0.2, 0.2, 0.01)
    points = np.array(
        [[0.01, 0.02, 0.003], [0.013, 0.021, -0.002], [0.15, 0.0, 0.001], [0.0, 0.0, 0.05]]
    )
    found = deviations(points, index_of(mesh), 0.02)
    assert found[:2] == pytest.approx([0.003, -0.002], abs=1e-12)
    assert np.isnan(found[2:]).all()


def test_neighbours_share_the_edge_opposite_of_the_corner() -> None:
    mesh = grid(0.04, 0.02, 0.01)
    across = edge_neighbours(mesh)
    assert np.count_nonzero(across < 0) == 2 * (4 + 2)
    for face, row in enumerate(across):
        for corner, other in enumerate(row):
            edge = set(np.delete(mesh.faces[face], corner))
            sharing = [f for f, c in enumerate(mesh.faces) if f != face and edge <= set(c)]
            assert sharing == ([] if other < 0 else [other])


def test_points_on_triangles_as_large_as_the_spacing_find_their_own() -> None:
    mesh = grid(0.6, 0.4, 0.0068, bumps)
    points = measured(mesh, np.random.default_rng(0), 60_000)
    assert index_of(mesh).closest(points).distance.max() < 1e-9


def test_points_about_a_box_of_large_triangles_are_as_far_off_as_they_are() -> None:
    half = np.array([0.1, 0.06, 0.04])
    box = trimesh.creation.box(2.0 * half)
    mesh = SurfaceMesh(np.asarray(box.vertices), np.asarray(box.faces, dtype=np.int64))
    points = np.random.default_rng(8).uniform(-1.5, 1.5, (5000, 3)) * half
    beyond = np.abs(points) - half
    inside = np.all(beyond < 0.0, axis=1)
    away = np.linalg.norm(np.maximum(beyond, 0.0), axis=1)
    found = index_of(mesh).closest(points)
    np.testing.assert_allclose(
        found.distance, np.where(inside, -beyond.max(axis=1), away), atol=1e-12
    )
    np.testing.assert_array_equal(found.signed(points) < 0.0, inside)


def test_a_mesh_without_faces_has_no_closest_point() -> None:
    empty = SurfaceMesh(np.zeros((0, 3)), np.zeros((0, 3), np.int64))
    with pytest.raises(MeshEmptyError, match="faces"):
        SurfaceIndex(empty, sample_surface(grid(0.1, 0.1, 0.05), SPACING))


# --- alignment


@pytest.mark.parametrize("seed", range(4))
def test_a_part_with_shape_is_found_wherever_the_tracker_stands(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mesh = grid(0.8, 0.5, 0.01, bumps)
    truth = random_pose(rng, 3.0, 1.0)
    initial = truth @ random_pose(rng, 0.008, np.deg2rad(0.5))
    points = apply(truth, measured(mesh, rng, 8000, 3e-5))
    found = align(points, index_of(mesh), initial)
    distance, angle = difference(truth, found.T_tracker_workpiece)
    assert found.converged
    assert distance < 2e-5
    assert angle < np.deg2rad(0.005)
    assert found.rms_m == pytest.approx(3e-5, rel=0.1)


def test_a_flat_panel_does_not_slide() -> None:
    rng = np.random.default_rng(5)
    mesh = grid(1.0, 0.6, 0.02)
    for shift in ([0.004, 0.0, 0.0], [0.0, -0.004, 0.0]):
        initial = transform(
            np.array(shift) + [0, 0, 0.003], Rotation.from_rotvec([0.003, -0.002, 0.0]).as_matrix()
        )
        # Points of the middle only, so that the border says nothing.
        points = measured(grid(0.8, 0.4, 0.02), rng, 5000, 3e-5)
        found = align(points, index_of(mesh), initial).T_tracker_workpiece
        # Out of plane the points decide, in the plane the initial pose stays.
        assert found[2, 3] == pytest.approx(0.0, abs=3e-6)
        assert found[:3, 2] == pytest.approx([0, 0, 1], abs=1e-5)
        assert found[:2, 3] == pytest.approx(np.array(shift)[:2], abs=1e-4)


def test_strangers_in_the_cloud_do_not_pull() -> None:
    rng = np.random.default_rng(6)
    mesh = grid(0.8, 0.5, 0.01, bumps)
    points = measured(mesh, rng, 6000, 3e-5)
    points[::5] += rng.uniform(-0.05, 0.05, size=(1200, 3))  # debris
    dent = np.hypot(points[:, 0] + 0.2, points[:, 1]) < 0.06
    points[dent, 2] -= 0.0005
    found = align(points, index_of(mesh), random_pose(rng, 0.005, 0.005))
    distance, angle = difference(np.eye(4), found.T_tracker_workpiece)
    assert distance < 5e-5
    assert angle < 1e-4


def test_the_result_moves_with_the_tracker_frame() -> None:
    rng = np.random.default_rng(7)
    mesh = grid(0.5, 0.4, 0.02, bumps)
    points = measured(mesh, rng, 3000, 3e-5)
    initial = random_pose(rng, 0.004, 0.004)
    move = random_pose(rng, 2.0, 2.0)
    here = align(points, index_of(mesh), initial)
    there = align(apply(move, points), index_of(mesh), move @ initial)
    assert there.T_tracker_workpiece == pytest.approx(move @ here.T_tracker_workpiece, abs=1e-8)
    assert there.rms_m == pytest.approx(here.rms_m, rel=1e-6)


def test_what_can_t_be_aligned_is_named() -> None:
    mesh = grid(0.3, 0.3, 0.02)
    index = index_of(mesh)
    points = measured(mesh, np.random.default_rng(0), 500)
    with pytest.raises(NoCloudError, match="found 5"):
        align(points[:5], index, np.eye(4))
    with pytest.raises(AlignmentError, match="0 %"):
        align(points, index, transform((1.0, 0.0, 0.0)))
    with pytest.raises(InputError, match="finite"):
        align(np.vstack([points, [[np.nan, 0, 0]]]), index, np.eye(4))
    with pytest.raises(InputError, match="shape"):
        align(points[:, :2], index, np.eye(4))
    with pytest.raises(InputError, match="initial pose"):
        align(points, index, 2 * np.eye(4))


# --- inspection


def test_a_dent_and_a_gap_are_given_back() -> None:
    rng = np.random.default_rng(8)
    mesh = grid(0.8, 0.5, 0.01, bumps)
    points = measured(mesh, rng, 60_000, 3e-5)
    points = points[points[:, 0] < 0.2]  # a quarter is missing
    dent = np.hypot(points[:, 0] + 0.25, points[:, 1] - 0.1) < 0.05
    normals = index_of(mesh).closest(points).normals
    points[dent] -= 0.0005 * normals[dent]
    truth = random_pose(rng, 2.0, 1.0)
    result = inspect(apply(truth, points), mesh, flat(mesh), truth @ random_pose(rng, 0.004, 0.004))
    assert result.points == len(points) == len(result.deviation)
    assert np.nanmean(result.deviation[dent]) == pytest.approx(-0.0005, abs=2e-5)
    assert np.nanmean(result.deviation[~dent]) == pytest.approx(0.0, abs=2e-6)
    share = mesh.face_areas[mesh.centroids[:, 0] < 0.2 + 0.008].sum() / mesh.area
    assert result.area_ratio == pytest.approx(share, abs=0.01)
    assert np.isnan(result.feature_area_ratio)
    assert difference(truth, result.alignment.T_tracker_workpiece)[0] < 3e-5


def test_results_are_written_in_the_workpiece_frame(tmp_path: Path) -> None:
    rng = np.random.default_rng(11)
    mesh = grid(0.4, 0.3, 0.02, bumps)
    local, pose = measured(mesh, rng, 3000, 3e-5), random_pose(rng, 2.0, 1.0)
    coverage = coverage_so_far(sample_surface(mesh, SPACING), flat(mesh))
    found = inspect(apply(pose, local), mesh, flat(mesh), pose, coverage=coverage)
    write_results(
        tmp_path / "cloud.ply",
        apply(pose, local),
        found,
        coverage,
        {"intensity": np.arange(3000.0)},
    )
    cloud, samples = read_ply(tmp_path / "cloud.ply"), read_ply(tmp_path / "coverage.ply")
    assert (cloud.frame, samples.frame) == ("workpiece", "workpiece")
    # So thin a cloud tells a shift along the part by its border only roughly.
    assert np.abs(cloud.points - local).max() < 4e-4
    assert cloud.values["intensity"].tolist() == list(range(3000))
    assert np.array_equal(
        cloud.values["deviation"], found.deviation.astype(np.float32), equal_nan=True
    )
    assert samples.values["measured"].mean() == pytest.approx(found.area_ratio)


def test_feature_area_is_counted_apart() -> None:
    mesh = grid(0.4, 0.4, 0.01)
    region = (mesh.centroids[:, 0] > 0).astype(np.int64)
    points = measured(mesh, np.random.default_rng(1), 20_000)
    coverage = coverage_so_far(sample_surface(mesh, SPACING), Segmentation(region, mesh))
    coverage.add(points[points[:, 0] < -0.01])
    assert coverage.area_ratio == pytest.approx(0.5, abs=0.02)
    assert coverage.feature_area_ratio == pytest.approx(0.0, abs=0.01)
    coverage.add(points[points[:, 0] > -0.02])
    assert coverage.area_ratio == coverage.feature_area_ratio == 1.0


def test_frames_one_by_one_cover_what_they_cover_together() -> None:
    rng = np.random.default_rng(3)
    mesh = grid(0.6, 0.3, 0.02, bumps)
    samples = sample_surface(mesh, SPACING)
    points = measured(mesh, rng, 4000)
    together, apart = CoverageSoFar(samples), CoverageSoFar(samples)
    together.add(points)
    fresh = sum(apart.add(frame) for frame in np.array_split(points, 17))
    assert np.array_equal(together.measured, apart.measured)
    assert fresh == np.count_nonzero(together.measured)
    assert apart.points == 4000
    # Brute force.
    near = (
        np.min(np.linalg.norm(samples.points[::50, None] - points[None], axis=2), axis=1) <= 0.008
    )
    assert np.array_equal(together.measured[::50], near)
    before = together.area_ratio
    assert together.add(points) == 0 and together.area_ratio == before


def test_the_other_side_of_a_thin_part_is_not_measured() -> None:
    top = grid(0.2, 0.2, 0.02)
    bottom = SurfaceMesh(top.vertices - [0, 0, 0.002], top.faces[:, ::-1])
    mesh = SurfaceMesh(
        np.vstack([top.vertices, bottom.vertices]),
        np.vstack([top.faces, bottom.faces + len(top.vertices)]),
    )
    samples = sample_surface(mesh, SPACING)
    up = samples.normals[:, 2] > 0
    points = measured(top, np.random.default_rng(4), 5000)
    for directions in (np.array([0.0, 0.0, -1.0]), np.tile([0.0, 0.0, -1.0], (5000, 1))):
        coverage = CoverageSoFar(samples)
        coverage.add(points, directions)
        assert np.array_equal(coverage.measured, up)
    unchecked = CoverageSoFar(samples)
    unchecked.add(points)
    assert unchecked.measured.all()
    # Per-point directions of both sides in one call.
    both = CoverageSoFar(samples)
    both.add(
        np.vstack([points, measured(bottom, np.random.default_rng(5), 5000)]),
        np.repeat([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]], 5000, axis=0),
    )
    assert both.measured.mean() > 0.99


def test_coverage_turns_with_the_part() -> None:
    rng = np.random.default_rng(9)
    mesh = grid(0.3, 0.2, 0.02, bumps)
    move = random_pose(rng, 1.0, 2.0)
    moved = SurfaceMesh(apply(move, mesh.vertices), mesh.faces)
    points = measured(mesh, rng, 500)
    here, there = (
        CoverageSoFar(sample_surface(mesh, SPACING)),
        CoverageSoFar(sample_surface(moved, SPACING)),
    )
    here.add(points, np.array([0.0, 0.0, -1.0]))
    there.add(apply(move, points), rotate(move, np.array([[0.0, 0.0, -1.0]]))[0])
    assert np.mean(here.measured == there.measured) > 0.999


def test_illegal_frames_are_named() -> None:
    coverage = CoverageSoFar(sample_surface(grid(0.1, 0.1, 0.02), SPACING))
    with pytest.raises(InputError, match="finite"):
        coverage.add(np.array([[0.0, 0.0, np.inf]]))
    with pytest.raises(InputError, match="directions"):
        coverage.add(np.zeros((4, 3)), np.zeros((2, 3)))
    with pytest.raises(InputError, match="radius"):
        CoverageSoFar(coverage.samples, radius_m=0.0)
    assert coverage.add(np.zeros((0, 3))) == 0
    assert coverage.area_ratio == 0.0


def test_an_empty_cloud_is_named() -> None:
    mesh = grid(0.1, 0.1, 0.02)
    with pytest.raises(NoCloudError):
        inspect(np.zeros((0, 3)), mesh, flat(mesh), np.eye(4), InspectionSettings())


# --- merging


def test_merging_keeps_one_point_per_voxel_whatever_the_frames() -> None:
    rng = np.random.default_rng(10)
    points = rng.uniform(-0.02, 0.02, size=(5000, 3))
    cells = np.floor(points / 0.004).astype(int)
    expected = len(np.unique(cells, axis=0))
    at_once, bit_by_bit = MergedCloud(0.004, columns=1), MergedCloud(0.004, columns=1, pending=100)
    at_once.add(points, np.arange(5000, dtype=np.float32)[:, None])
    for i in range(0, 5000, 37):
        bit_by_bit.add(
            points[i : i + 37], np.arange(i, min(i + 37, 5000), dtype=np.float32)[:, None]
        )
    assert len(at_once) == len(bit_by_bit) == expected
    kept, extra = bit_by_bit.points()
    assert np.array_equal(kept, at_once.points()[0])
    assert np.array_equal(kept, points[extra[:, 0].astype(int)])
    assert bit_by_bit.received == 5000


def test_the_merged_cloud_is_bounded() -> None:
    merged = MergedCloud(0.0005, limit=1000, pending=500)
    rng = np.random.default_rng(0)
    for _ in range(40):
        merged.add(rng.uniform(0, 1, size=(300, 3)) * [1, 1, 0])
    assert 200 < len(merged) <= 1000
    assert merged.voxel_m > 0.0005
    with pytest.raises(InputError, match="shape"):
        merged.add(np.zeros((3, 3)), np.zeros((3, 2), np.float32))
    with pytest.raises(InputError, match="found 1000000000 m"):
        merged.add(np.array([[1e9, 0, 0]]))


def test_settings_hold_the_stated_prior() -> None:
    """A wide prior lets a panel whose shape says where it lies be found; a tight one holds it."""
    mesh = grid(0.5, 0.4, 0.02, bumps)
    points = measured(mesh, np.random.default_rng(1), 2000, 3e-5)
    initial = transform((0.003, 0.0, 0.0))
    free = align(points, index_of(mesh), initial)
    held = align(
        points, index_of(mesh), initial, AlignSettings(prior_position_m=1e-9, prior_angle_rad=1e-9)
    )
    assert np.linalg.norm(free.T_tracker_workpiece[:3, 3]) < 5e-5
    assert held.T_tracker_workpiece == pytest.approx(initial, abs=1e-6)
    assert held.rms_m > free.rms_m
    assert difference(inverse(initial), inverse(held.T_tracker_workpiece))[0] < 1e-6
