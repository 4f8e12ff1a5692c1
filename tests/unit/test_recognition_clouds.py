"""Planes, clusters, thinning and normals of clouds; what the virtual camera gives."""

import numpy as np
import pytest
import trimesh

from skinplan.errors import InputError, NoCloudError
from skinplan.recognition.clusters import clusters, crowd, normals, spread, thinned
from skinplan.recognition.planes import between, find_plane
from skinplan.recognition.tray.camera import CameraSettings, Scene, VirtualCamera, looking_at

UP = np.array([0.0, 0.0, 1.0])


def plate(size: float, z: float = 0.0) -> trimesh.Trimesh:
    mesh = trimesh.creation.box((size, size, 0.01))
    mesh.apply_translation((0.0, 0.0, z - 0.005))
    return mesh


def test_a_plane_is_found_among_more_points_beside_it() -> None:
    rng = np.random.default_rng(0)
    normal = np.array([0.1, -0.2, 0.97])
    normal /= np.linalg.norm(normal)
    flat = rng.uniform(-1, 1, (2000, 3))
    flat += np.outer(0.3 - flat @ normal + rng.normal(0.0, 1e-4, 2000), normal)
    plane = find_plane(np.concatenate([flat, rng.uniform(-1, 1, (3000, 3))]), 10.0 * normal)
    assert plane.normal @ normal == pytest.approx(1.0, abs=1e-8)
    assert plane.offset_m == pytest.approx(0.3, abs=2e-5)
    assert plane.inlier_ratio == pytest.approx(0.4, abs=0.01)
    assert plane.rms_m == pytest.approx(1e-4, rel=0.1)
    other = find_plane(flat, -10.0 * normal)
    assert other.normal @ normal == pytest.approx(-1.0, abs=1e-8)
    np.testing.assert_allclose(other.heights(flat), -plane.heights(flat), atol=1e-4)
    assert between(np.array([0.0, 1.0, 2.0]), 0.5, 1.5).tolist() == [False, True, False]


def test_where_there_is_no_plane_it_is_said() -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(InputError, match="lie on the best one"):
        find_plane(rng.uniform(-1, 1, (3000, 3)), UP)
    with pytest.raises(InputError, match="one line"):
        find_plane(np.outer(np.arange(10.0), UP), UP)
    with pytest.raises(NoCloudError, match="3 points"):
        find_plane(np.zeros((2, 3)), UP)


def test_clusters_agree_with_brute_force() -> None:
    rng = np.random.default_rng(2)
    middles = rng.uniform(0, 0.3, (8, 3))
    points = np.concatenate([middle + rng.normal(0, 0.004, (30, 3)) for middle in middles])
    gap = 0.012
    near = np.linalg.norm(points[:, None] - points[None], axis=-1) <= gap
    for _ in range(9):
        near = (near.astype(np.int64) @ near) > 0
    brute = {tuple(np.flatnonzero(row)) for row in near}
    found = {tuple(np.sort(group)) for group in clusters(points, gap)}
    # Cells stand for their points: pairs within a cell's size of the gap may fall either way.
    assert len(found) == len(brute) and found == brute
    assert clusters(points, gap, fewest=31) == [
        group for group in clusters(points, gap) if len(group) > 30
    ]
    assert clusters(np.zeros((0, 3)), gap) == []


def test_from_above_a_gap_in_height_does_not_count() -> None:
    points = np.array([[0.0, 0.0, 0.0], [0.001, 0.0, 0.05]])
    assert len(clusters(points, 0.01)) == 2
    assert len(clusters(points, 0.01, height_weight=0.0)) == 1


def test_thinning_keeps_one_point_to_a_cell_and_spreading_an_even_density() -> None:
    rng = np.random.default_rng(3)
    points = rng.uniform(0, 0.1, (20_000, 3)) * [1, 1, 0]
    # On the wall of the grid noise puts half of the points on either side.
    points[:, 2] = rng.normal(0, 1e-5, len(points))
    chosen = thinned(points, 0.005)
    cells = np.floor(points[chosen] / 0.005).astype(int)
    assert len(np.unique(cells, axis=0)) == len(cells) == 800
    even = points[spread(points, 0.005)]
    assert 330 < len(even) <= 420
    away = np.linalg.norm(even[:, None] - even[None], axis=-1) + np.eye(len(even))
    assert away.min() >= 0.7 * 0.005
    with pytest.raises(InputError, match="positive spacing"):
        thinned(points, 0.0)


def test_thinning_keeps_the_point_nearest_the_middle_of_its_cell_the_first_of_equals() -> None:
    side = 0.25
    # Multiples of a sixteenth: distances are exact, and many are equal.
    points = np.random.default_rng(6).integers(-16, 16, (3000, 3)) / 16.0
    cells = np.floor(points / side)
    off = np.sum((points / side - cells - 0.5) ** 2, axis=1)
    brute: dict[tuple[float, ...], int] = {}
    for number, cell in enumerate(map(tuple, cells)):
        if cell not in brute or off[number] < off[brute[cell]]:
            brute[cell] = number
    assert thinned(points, side).tolist() == sorted(brute.values())
    assert thinned(points[:1], side).tolist() == [0]


def test_the_crowd_is_what_brute_force_counts() -> None:
    points = np.random.default_rng(4).uniform(-0.02, 0.02, (500, 3))
    chosen, side = np.arange(0, 500, 7), 0.006
    cells = np.floor(points / side)
    near = np.abs(cells[chosen][:, None] - cells[None]).max(axis=-1) <= 1
    np.testing.assert_array_equal(crowd(points, chosen, side), near.sum(axis=1))


def test_normals_of_a_sphere_point_outward() -> None:
    rng = np.random.default_rng(5)
    outward = rng.normal(size=(5000, 3))
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    found = normals(0.1 * outward, outward)
    angle = np.arccos(np.clip(np.einsum("ij,ij->i", found, outward), -1, 1))
    assert np.median(angle) < 0.02 and angle.max() < 0.2
    with pytest.raises(InputError, match="3 points"):
        normals(np.zeros((2, 3)), UP)


def test_the_camera_looks_where_it_is_told() -> None:
    for azimuth, tilt in ((0.0, 0.0), (1.0, 0.6), (4.0, 1.2)):
        target = np.array([0.3, -0.2, 0.1])
        pose = looking_at(target, 0.5, azimuth, tilt)
        np.testing.assert_allclose(pose @ [0, 0, 0.5, 1], [*target, 1], atol=1e-12)
        assert np.linalg.det(pose[:3, :3]) == pytest.approx(1.0)
        assert pose[2, 3] == pytest.approx(0.1 + 0.5 * np.cos(tilt))
    with pytest.raises(InputError, match="positive distance"):
        looking_at(np.zeros(3), 0.0, 0.0, 0.0)


def test_the_camera_has_the_noise_of_its_settings_and_sees_no_flat_rays() -> None:
    camera = VirtualCamera(Scene([plate(1.0)]), CameraSettings(pixels=120, noise_m=5e-6))
    view = camera.shot(looking_at(np.zeros(3), 0.5, 0.0, 0.0), np.random.default_rng(0))
    assert len(view.points) == 120**2
    along = (view.points - view.seen_from)[:, 2] / np.linalg.norm(
        view.points - view.seen_from, axis=1
    )
    error = view.points[:, 2] / along
    assert error.mean() == pytest.approx(0.0, abs=2e-7)
    assert error.std() == pytest.approx(5e-6, rel=0.03)
    flat = camera.shot(looking_at(np.zeros(3), 0.5, 0.0, 1.5), np.random.default_rng(0))
    steep = np.degrees(
        np.arcsin(
            np.abs((flat.points - flat.seen_from)[:, 2])
            / np.linalg.norm(flat.points - flat.seen_from, axis=1)
        )
    )
    assert steep.min() > np.degrees(np.pi / 2 - 1.4) - 0.1


def test_only_beside_depth_steps_points_hang_in_mid_air() -> None:
    scene = Scene([plate(0.08, 0.05), plate(0.6)])
    pose = looking_at(np.zeros(3), 0.6, 0.0, 0.0)
    settings = CameraSettings(pixels=200, noise_m=0.0, edge_ratio=0.3)
    points = VirtualCamera(scene, settings).shot(pose, np.random.default_rng(0)).points
    hanging = (points[:, 2] > 1e-6) & (points[:, 2] < 0.05 - 1e-6)
    assert 50 < np.count_nonzero(hanging) < 0.05 * len(points)
    assert np.abs(points[hanging, :2]).max() < 0.046
    clean = VirtualCamera(scene, CameraSettings(pixels=200, noise_m=0.0, edge_ratio=0.0))
    z = clean.shot(pose, np.random.default_rng(0)).points[:, 2]
    assert np.all((np.abs(z) < 1e-6) | (np.abs(z - 0.05) < 1e-6))
    with pytest.raises(InputError, match="at least one body"):
        Scene([])
