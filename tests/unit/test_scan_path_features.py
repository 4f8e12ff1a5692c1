import numpy as np
import pytest
from scipy.spatial import cKDTree

from meshes import bump, grid
from skinplan.mesh.segment import segment_mesh
from skinplan.mesh.smooth import smooth_mesh
from skinplan.scan_path.features import FLOOR_RATIO, sample_features
from skinplan.scan_path.frame import base_normal, part_frame
from skinplan.scan_path.spacing import equivalent_spacing

MESH = grid(0.8, 0.8, 0.008, lambda x, y: bump(x, y, height=0.06, radius=0.2, wall=0.03))
SMOOTHED = smooth_mesh(MESH)
FRAME = part_frame(MESH, base_normal(MESH))
ALL = np.ones(len(MESH.faces), dtype=bool)


def sampled(k, faces=ALL, interval=0.08):
    return sample_features(MESH, SMOOTHED, faces, FRAME, interval, k)


@pytest.mark.parametrize("k", [0.0, 2.0, 6.0])
def test_targets_keep_their_distance_and_leave_no_room(k):
    found = sampled(k)
    apart = np.linalg.norm(found.targets[:, None] - found.targets[None], axis=2)
    spacing = equivalent_spacing(found.normals[:, None], found.normals[None], 0.08, k)
    least = np.maximum(spacing, FLOOR_RATIO * 0.08)
    np.fill_diagonal(apart, np.inf)
    assert np.all(apart >= least - 1e-9)
    # No place is farther from a target than the spacing and the distance of the candidates.
    far, _ = cKDTree(found.targets).query(MESH.centroids)
    assert far.max() < 0.08 + 0.008


def test_sensitivity_densifies_features_and_leaves_the_flat_alone():
    """Fig. 10: k = 2 to 6 makes features denser by over 1.25, the flat by less than 2 %."""
    wall = segment_mesh(MESH).face_region > 0
    on_wall = {k: len(sampled(k, wall).targets) for k in (2.0, 6.0)}
    assert on_wall[6.0] > 1.25 * on_wall[2.0]
    flat = MESH.centroids[:, 0] < -0.28
    on_flat = {k: len(sampled(k, flat, 0.02).targets) for k in (2.0, 6.0)}
    assert on_flat[2.0] > 100
    assert on_flat[6.0] == pytest.approx(on_flat[2.0], rel=0.02)


def test_targets_lie_on_the_chosen_faces_and_never_change():
    chosen = MESH.centroids[:, 0] > 0.1
    first, second = sampled(2.0, chosen), sampled(2.0, chosen)
    np.testing.assert_array_equal(first.targets, second.targets)
    assert chosen[first.faces].all()
    offsets = np.einsum(
        "ij,ij->i", first.targets - MESH.corners[first.faces, 0], MESH.face_normals[first.faces]
    )
    np.testing.assert_allclose(offsets, 0.0, atol=1e-12)


def test_no_faces_no_targets():
    assert len(sampled(2.0, ~ALL).targets) == 0
