import numpy as np
import pytest

from meshes import bump, grid, half_cylinder, joined, moved, random_transform
from skinplan.errors import InputError, ScanPathInvalidError
from skinplan.mesh.model import Segmentation
from skinplan.scan_path.model import FEATURE, ROW, ScanPath
from skinplan.scanner.coverage import certify, seen_ratio, visible
from skinplan.scanner.model import ScannerModel
from skinplan.scanner.rays import RayCaster
from skinplan.scanner.samples import sample_surface
from skinplan.transforms import rotate, transform

SCANNER = ScannerModel(0.2, 0.2, 0.4, 0.3, np.radians(60))
DOWN = np.array([[0.0, 0.0, -1.0]])


def seen_area(mesh, position, direction, scanner=SCANNER, spacing=0.004):
    samples = sample_surface(mesh, spacing)
    views = visible(samples, RayCaster(mesh), np.array([position]), np.array([direction]), scanner)
    return samples.weights[views > 0].sum()


def path_of(positions, directions, kinds):
    positions = np.asarray(positions, dtype=float)
    directions = np.asarray(directions, dtype=float)
    kinds = np.asarray(kinds)
    targets = positions + 0.3 * directions
    return ScanPath(positions, directions, targets, kinds, np.zeros(len(kinds), int), "test", 1)


def test_samples_stand_for_the_area():
    mesh = half_cylinder(0.5, 1.0, 0.03)
    samples = sample_surface(mesh, 0.01)
    assert samples.weights.sum() == pytest.approx(mesh.area)
    assert len(samples.points) == pytest.approx(mesh.area / 0.01**2, abs=1)
    offsets = np.einsum(
        "ij,ij->i", samples.points - mesh.corners[samples.faces, 0], samples.normals
    )
    np.testing.assert_allclose(offsets, 0.0, atol=1e-12)
    # Each half gets its share, whatever the order of the faces.
    assert np.mean(samples.points[:, 0] > 0) == pytest.approx(0.5, abs=0.01)
    np.testing.assert_array_equal(samples.points, sample_surface(mesh, 0.01).points)
    few = sample_surface(mesh, 0.01, np.arange(10))
    assert few.weights.sum() == pytest.approx(mesh.face_areas[:10].sum())


@pytest.mark.parametrize("spacing", [0.0, -1.0, np.nan, 1e-6])
def test_spacing_that_can_not_be_used(spacing):
    with pytest.raises(InputError, match="accepted"):
        sample_surface(grid(1.0, 1.0, 0.1), spacing)


def test_a_roof_hides_what_is_below_it():
    roof = moved(grid(0.1, 0.1, 0.01), transform((0.0, 0.0, 0.05)))
    mesh = joined(grid(1.0, 1.0, 0.02), roof)
    # The roof itself is seen, its shadow is as large.
    assert seen_area(mesh, [0, 0, 0.3], DOWN[0]) == pytest.approx(np.pi * 0.04, rel=0.01)
    samples = sample_surface(mesh, 0.004)
    views = visible(samples, RayCaster(mesh), np.array([[0, 0, 0.3]]), DOWN, SCANNER)
    inside = np.abs(samples.points[:, :2]).max(axis=1) < 0.049
    low = samples.points[:, 2] < 0.02
    assert views[inside & low].max() == 0
    assert views[inside & ~low].min() == 1
    # Nothing behind the scanner hides anything.
    behind = joined(grid(1.0, 1.0, 0.02), moved(roof, transform((0.0, 0.0, 0.3))))
    assert seen_area(behind, [0, 0, 0.3], DOWN[0]) == pytest.approx(np.pi * 0.04, rel=0.01)


def test_certificate_counts_rows_and_features():
    mesh = grid(1.0, 0.4, 0.02)
    region = (mesh.centroids[:, 0] > 0).astype(np.int64)
    path = path_of(
        [[-0.25, 0, 0.3], [-0.25, 0, 0.3], [0.25, 0, 0.3]], np.repeat(DOWN, 3, axis=0),
        [ROW, ROW, FEATURE],
    )  # fmt: skip
    found = certify(mesh, Segmentation(region, mesh), path, SCANNER)
    disc = np.pi * 0.04
    assert found.area_ratio == pytest.approx(2 * disc / 0.4, rel=0.01)
    assert found.feature_area_ratio == pytest.approx(disc / 0.2, rel=0.01)
    assert found.views.max() == 2
    everywhere = np.ones(len(found.views), dtype=bool)
    twice = seen_ratio(found.samples, found.views, everywhere, least=2)
    assert twice == pytest.approx(disc / 0.4, rel=0.01)
    flat = certify(mesh, Segmentation(region * 0, mesh), path, SCANNER)
    assert np.isnan(flat.feature_area_ratio)


def test_certificate_moves_with_the_part():
    mesh = grid(1.0, 0.5, 0.02, lambda x, y: bump(x, y, height=0.08, radius=0.12, wall=0.04))
    positions = np.array([[-0.2, 0.1, 0.32], [0.1, -0.1, 0.33], [0.3, 0.0, 0.3]])
    path = path_of(positions, np.repeat(DOWN, 3, axis=0), [ROW, ROW, ROW])
    T = random_transform(9)
    turned = path_of(
        positions @ T[:3, :3].T + T[:3, 3], rotate(T, path.directions), [ROW, ROW, ROW]
    )
    region = np.ones(len(mesh.faces), dtype=np.int64)
    first = certify(mesh, Segmentation(region, mesh), path, SCANNER)
    second = certify(moved(mesh, T), Segmentation(region, mesh), turned, SCANNER)
    assert second.area_ratio == pytest.approx(first.area_ratio, abs=1e-3)
    assert np.mean(first.views != second.views) < 1e-3


def test_a_path_that_can_not_be_used():
    mesh = grid(0.5, 0.5, 0.05)
    segmentation = Segmentation(np.zeros(len(mesh.faces), dtype=np.int64), mesh)
    for directions in (DOWN * 2, DOWN * np.nan):
        with pytest.raises(ScanPathInvalidError, match="accepted"):
            certify(mesh, segmentation, path_of([[0, 0, 0.3]], directions, [ROW]), SCANNER)
    with pytest.raises(ScanPathInvalidError, match="shape"):
        visible(sample_surface(mesh), RayCaster(mesh), np.zeros((2, 3)), np.zeros((3, 3)), SCANNER)
