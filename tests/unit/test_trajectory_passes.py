"""Optimisation of depth and angles of the scan passes (T S2, S3)."""

import dataclasses
import json
import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from meshes import bump, grid, half_cylinder, joined, moved, random_transform
from reach_scene import flat_path, path_of
from skinplan.errors import InputError, PartInvalidError, ScanPathInvalidError
from skinplan.mesh.model import SurfaceMesh
from skinplan.mesh.segment import segment_mesh
from skinplan.part.model import ScanSettings
from skinplan.part.settings import read_settings, settings_fields
from skinplan.pipeline import plan_path
from skinplan.plan_record import planning_summary, scan_path_hash, write_plan_files
from skinplan.scan_path.model import FEATURE, ROW
from skinplan.scan_path.plan import plan_scan_path
from skinplan.scanner.certifier import Certifier
from skinplan.scanner.coverage import visible
from skinplan.scanner.model import ScannerModel, SurfaceSamples
from skinplan.scanner.predict import part_certifier
from skinplan.scanner.rays import RayCaster
from skinplan.scanner.samples import sample_surface
from skinplan.trajectory.pass_error import (
    PassSettings,
    angles_of,
    effective_width,
    frames,
    pass_error,
    toward_of,
)
from skinplan.trajectory.pass_guard import CoverageGuard
from skinplan.trajectory.pass_limits import NOT_FEASIBLE
from skinplan.trajectory.pass_poses import PassPoses, pass_spacings, patch_normals
from skinplan.trajectory.passes import MISPLACED, OPTIMAL, WORSE_SEEN, optimise_passes
from skinplan.transforms import apply, rotate

SETTINGS = ScanSettings(strategy="coverage", optimise_passes=True)
SCANNER = ScannerModel.from_settings(SETTINGS)
NARROW = SCANNER.narrowed(SETTINGS.field_margin_m, SETTINGS.incidence_margin_rad)
UP = np.array([0.0, 0.0, 1.0])


def rad(*degrees):
    values = np.deg2rad(np.array(degrees, float))
    return values if len(degrees) > 1 else float(values[0])


def panel_with_bump():
    return grid(
        0.9, 0.6, 0.01, lambda x, y: 0.2 * y**2 + bump(x, y, height=0.06, radius=0.1, wall=0.03)
    )


@pytest.fixture(scope="module")
def bumpy():
    """A curved panel with a bump, its path of strategy coverage, and that path optimised."""
    mesh = panel_with_bump()
    segmentation = segment_mesh(mesh)
    path = plan_scan_path(mesh, segmentation, SETTINGS)
    certifier = part_certifier(mesh, segmentation, SETTINGS, with_seeable=False)
    after, reports = optimise_passes(path, mesh, segmentation, SETTINGS, certifier)
    return SimpleNamespace(
        mesh=mesh, segmentation=segmentation, path=path, after=after, reports=reports,
        certifier=certifier,
    )  # fmt: skip


def tilted(path, out_rad, in_rad, depth_m=0.3):
    """Rows along x over a flat panel, all views tilted by the same angles, at one depth."""
    toward = np.array([math.tan(out_rad), math.tan(in_rad), 1.0])
    toward /= np.linalg.norm(toward)
    toward = np.tile(toward, (len(path), 1))
    return dataclasses.replace(path, positions=path.targets + depth_m * toward, directions=-toward)


def flat_scene(out_deg=0.0, in_deg=0.0, depth_m=0.3):
    # The fields of the outer poses reach beyond the panel, so nothing of it is on their rim.
    mesh = grid(0.9, 0.5, 0.05)
    path = flat_path(0.8, 0.4, 0.1)
    return mesh, segment_mesh(mesh), tilted(path, rad(out_deg), rad(in_deg), depth_m)


def shares(certifier, path, least=3):
    """Areas seen at all and often enough, of the part and of its complex regions [m^2]."""
    cover = certifier.points(path)
    weights, feature = cover.samples.weights, cover.regions > 0
    return np.array(
        [
            weights[(cover.views >= n) & which].sum()
            for n in (1, least)
            for which in (np.ones_like(feature), feature)
        ]
    )


def same_poses(a, b):
    return np.array_equal(a.positions, b.positions) and np.array_equal(a.directions, b.directions)


# The evaluation function


def test_the_evaluation_function_by_hand():
    plain = PassSettings()
    # d_max 400 mm: |480 - 300| * 10 degrees * 5e-5, and 1e-5 * 400 per degree in plane.
    assert pass_error(0.3, rad(10), 0.0, 0.4, plain) == pytest.approx(0.09)
    assert pass_error(0.3, rad(10), rad(5), 0.4, plain) == pytest.approx(0.09 + 0.02)
    assert pass_error(0.4, rad(10), 0.0, 0.4, plain) == pytest.approx(0.04)
    assert pass_error(0.3, 0.0, 0.0, 0.4, plain) == 0.0
    # Best angles 0.6 * 10 and 0.3 * 10 degrees: 5e-5 * 80 * |16 - 6| + 0.5 + 0.1 * |7 - 3|.
    other = PassSettings(rad(10), rad(10), penalty=0.5, in_plane_factor=0.1)
    assert pass_error(0.4, rad(16), rad(-7), 0.4, other) == pytest.approx(0.04 + 0.5 + 0.4)
    assert pass_error(0.4, rad(-6), rad(3), 0.4, other) == pytest.approx(0.5)
    # A scanner that reaches 1 m: |1200 - 900| * 2 * 5e-5 + 0.01 * 2.
    assert pass_error(0.9, rad(2), rad(2), 1.0, plain) == pytest.approx(0.03 + 0.02)


def test_the_findings_of_the_patent_hold():
    angles, depths = rad(0, 5, 10, 20), np.array([[0.2], [0.3], [0.4]])
    errors = pass_error(depths, angles, 0.0, 0.4, PassSettings())
    # It grows with the out-of-plane angle, less so the greater the depth, and is bilinear.
    slopes = np.diff(errors, axis=1) / np.diff(angles)
    assert np.all(slopes > 0) and np.all(np.diff(slopes, axis=0) < 0)
    assert np.allclose(slopes, slopes[:, :1])
    assert np.allclose(np.diff(errors, 2, axis=0), 0.0)


def random_units(rng, count):
    vectors = rng.normal(size=(count, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def test_angles_and_directions_undo_each_other():
    rng = np.random.default_rng(0)
    normals, motions = random_units(rng, 50), rng.normal(size=(50, 3))
    out, inside = rng.uniform(-1.0, 1.0, (2, 50))
    along, across = frames(normals, motions, normals)
    for first, second in ((along, normals), (across, normals), (along, across)):
        assert np.allclose(np.einsum("ij,ij->i", first, second), 0.0, atol=1e-12)
    toward = toward_of(out, inside, normals, along, across)
    assert np.allclose(np.linalg.norm(toward, axis=1), 1.0)
    assert np.allclose(angles_of(toward, normals, along, across), (out, inside))


def test_out_of_plane_is_along_the_motion_and_in_plane_across_it():
    along, across = frames(UP[None], np.array([[2.0, 0.0, 0.5]]), UP[None])
    assert np.allclose(along, [[1, 0, 0]]) and np.allclose(across, [[0, 1, 0]])
    pitched = np.array([[math.sin(0.3), 0.0, math.cos(0.3)]])
    assert np.allclose(angles_of(pitched, UP[None], along, across), [[0.3], [0.0]])
    rolled = np.array([[0.0, -math.sin(0.2), math.cos(0.2)]])
    assert np.allclose(angles_of(rolled, UP[None], along, across), [[0.0], [-0.2]])


def test_without_motion_the_whole_tilt_is_out_of_plane():
    toward = random_units(np.random.default_rng(1), 1)
    toward[0, 2] = abs(toward[0, 2])
    along, across = frames(UP[None], np.zeros((1, 3)), toward)
    out, inside = angles_of(toward, UP[None], along, across)
    assert out == pytest.approx(math.acos(toward[0, 2])) and inside == pytest.approx(0.0, abs=1e-9)
    along, across = frames(UP[None], np.zeros((1, 3)), UP[None])
    assert np.allclose(np.cross(along, across), UP)


# Effective width


def width(depth, tilt_rad, scanner=SCANNER):
    toward = np.array([[0.0, math.sin(tilt_rad), math.cos(tilt_rad)]])
    return effective_width(
        np.array([depth]), toward, UP[None], np.array([[0.0, 1.0, 0.0]]), scanner
    )[0]


def test_the_effective_width_by_hand():
    assert width(0.3, 0.0) == pytest.approx(0.4)
    # 30 degrees: the radius / cos 30 is 231 mm, the range allows 100 mm / sin 30 to both sides.
    assert width(0.3, rad(30)) == pytest.approx(0.2 + 0.2)
    # At 390 mm one side has 10 mm / sin 30 left, the other its radius.
    assert width(0.39, rad(30)) == pytest.approx(0.02 + 0.2 / math.cos(rad(30)))
    assert width(0.3, rad(61)) == 0.0  # too oblique
    assert width(0.41, 0.0) == width(0.19, 0.0) == 0.0  # out of range
    # The cone is 300 mm in radius at 300 mm.
    assert width(0.3, 0.0, dataclasses.replace(SCANNER, field="cone")) == pytest.approx(0.6)


@pytest.mark.parametrize("field", ["cylinder", "cone"])
@pytest.mark.parametrize("seed", range(8))
def test_the_effective_width_is_what_the_scanner_sees_of_a_line_across(field, seed):
    rng = np.random.default_rng(seed)
    scanner = dataclasses.replace(SCANNER, field=field, incidence_max_rad=1.4)
    depth, (out, inside) = rng.uniform(0.22, 0.38), rng.uniform(-0.7, 0.7, 2)
    normal, motion = random_units(rng, 1), rng.normal(size=(1, 3))
    along, across = frames(normal, motion, normal)
    toward = toward_of(np.array([out]), np.array([inside]), normal, along, across)
    step = 1e-3
    x = np.arange(-1.5, 1.5, step)
    line = SurfaceSamples(
        x[:, None] * across, np.repeat(normal, len(x), 0), np.zeros(len(x), int), np.ones(len(x))
    )
    nothing_near = RayCaster(moved(grid(0.1, 0.1, 0.1), np.eye(4) + 50.0 * np.eye(4, k=3)))
    seen = visible(line, nothing_near, depth * toward, -toward, scanner)
    expected = effective_width(np.array([depth]), toward, normal, across, scanner)[0]
    assert seen.sum() * step == pytest.approx(expected, abs=2.5 * step)


# Surface and spacing


def test_the_normal_of_a_point_is_that_of_its_surroundings():
    shell = half_cylinder(1.0, 0.6, 0.01)
    angles = np.linspace(-0.6, 0.6, 7)
    targets = np.stack([0 * angles, np.sin(angles), np.cos(angles)], axis=1)
    assert np.allclose(patch_normals(sample_surface(shell), targets, 0.04), targets, atol=3e-3)


def test_the_other_side_of_a_thin_part_does_not_count():
    top = grid(0.4, 0.4, 0.02)
    back = SurfaceMesh(top.vertices - [0.0, 0.0, 0.001], top.faces[:, ::-1])
    samples = sample_surface(joined(top, back))
    assert np.allclose(patch_normals(samples, np.array([[0.0, 0.0, 0.0005]]), 0.04), UP)


def test_far_from_the_part_the_nearest_normal_counts():
    samples = sample_surface(grid(0.4, 0.4, 0.02))
    assert np.allclose(patch_normals(samples, np.array([[0.0, 0.0, 0.2]]), 0.04), UP)


def test_the_spacing_of_passes():
    path = flat_path(0.8, 0.4, 0.1)
    assert np.allclose(pass_spacings(path, 0.2), 0.1)
    one_row = path_of(*(a[:9] for a in (path.targets, path.directions, path.kinds, path.groups)))
    assert np.all(pass_spacings(one_row, 0.2) == 0.0)
    # Halves of a row with numbers of their own are no neighbours of each other.
    halves = np.where(path.positions[:, 0] > 0.0, path.groups + 10, path.groups)
    split = path_of(path.targets, path.directions, path.kinds, halves)
    assert np.allclose(pass_spacings(split, 0.2), 0.1)
    features = path_of(path.targets, path.directions, np.full(len(path), FEATURE), path.groups)
    assert np.all(pass_spacings(features, 0.2) == 0.0)


# The optimisation


def test_the_error_falls_in_every_pass_that_is_changed(bumpy):
    assert sum(report.improved for report in bumpy.reports) >= 2
    moved_points = (bumpy.after.positions != bumpy.path.positions).any(axis=1)
    assert moved_points.sum() == sum(report.moved for report in bumpy.reports)
    for report in bumpy.reports:
        which = (bumpy.path.kinds == report.kind) & (bumpy.path.groups == report.group)
        assert report.points == which.sum()
        assert report.improved == moved_points[which].any()
        assert bool(report.reason) == (report.moved < report.points)
        if report.improved:
            assert report.error_after < report.error_before
        else:
            assert report.error_after == report.error_before
    assert bumpy.after.passes == bumpy.reports
    assert {(r.kind, r.group) for r in bumpy.reports} == set(
        zip(bumpy.path.kinds.tolist(), bumpy.path.groups.tolist(), strict=True)
    )


def test_what_is_reported_is_the_error_of_the_poses(bumpy):
    for path, name in ((bumpy.path, "error_before"), (bumpy.after, "error_after")):
        poses = PassPoses.of(path, bumpy.certifier.samples, SCANNER, 0.5 * SETTINGS.row_interval_m)
        depth, inside, out = poses.values
        errors = pass_error(depth, out, inside, SETTINGS.range_max_m, PassSettings())
        for report in bumpy.reports:
            which = (path.kinds == report.kind) & (path.groups == report.group)
            assert errors[which].mean() == pytest.approx(getattr(report, name), abs=1e-9)


def test_only_poses_change(bumpy):
    before, after = bumpy.path, bumpy.after
    for name in ("targets", "kinds", "groups"):
        assert np.array_equal(getattr(before, name), getattr(after, name))
    assert (before.strategy, before.lower_bound) == (after.strategy, after.lower_bound)
    assert np.allclose(np.linalg.norm(after.directions, axis=1), 1.0)
    depth = np.linalg.norm(after.targets - after.positions, axis=1)
    assert np.allclose(after.positions + depth[:, None] * after.directions, after.targets)


@pytest.mark.parametrize("scanner", [SCANNER, NARROW], ids=["scanner", "with margins"])
def test_the_certificate_is_not_worse(bumpy, scanner):
    certifier = Certifier(bumpy.mesh, bumpy.segmentation, scanner)
    before, after = shares(certifier, bumpy.path), shares(certifier, bumpy.after)
    assert np.all(after >= before - 1e-9)


def test_the_guard_is_what_holds_the_certificate(bumpy):
    """Without it the same moves would be made further, and the part seen less."""
    one = dataclasses.replace(SETTINGS, least_views=1, field_margin_m=0.0, incidence_margin_rad=0.0)
    after, _ = optimise_passes(bumpy.path, bumpy.mesh, bumpy.segmentation, one)
    certifier = Certifier(bumpy.mesh, bumpy.segmentation, SCANNER)
    assert shares(certifier, after)[2] < shares(certifier, bumpy.path)[2] - 1e-4


def test_the_constraints_hold_for_every_point_after(bumpy):
    after = bumpy.after
    depth = np.linalg.norm(after.targets - after.positions, axis=1)
    margin = SETTINGS.field_margin_m
    assert depth.min() >= SETTINGS.range_min_m + margin - 1e-9
    assert depth.max() <= SETTINGS.range_max_m - margin + 1e-9
    fine = sample_surface(bumpy.mesh, 0.004)
    tree = cKDTree(np.concatenate([fine.points, bumpy.mesh.vertices]))
    assert tree.query(after.positions)[0].min() >= SETTINGS.clearance_m - 1e-6
    changed = np.flatnonzero((after.positions != bumpy.path.positions).any(axis=1))
    for point in changed:
        near = np.linalg.norm(fine.points - after.targets[point], axis=1) <= 0.04
        normal = fine.normals[near].mean(axis=0)
        tilt = math.acos(np.clip(-after.directions[point] @ normal / np.linalg.norm(normal), -1, 1))
        was = math.acos(
            np.clip(-bumpy.path.directions[point] @ normal / np.linalg.norm(normal), -1, 1)
        )
        assert tilt <= SETTINGS.incidence_max_rad
        assert tilt <= max(was, SETTINGS.tilt_max_rad) + rad(1)
    hits, _ = RayCaster(bumpy.mesh).hits(after.positions[changed], after.directions[changed])
    assert hits.min() >= SETTINGS.range_min_m


def test_doing_it_again_changes_nothing(bumpy):
    again, reports = optimise_passes(
        bumpy.after, bumpy.mesh, bumpy.segmentation, SETTINGS, bumpy.certifier
    )
    assert np.allclose(again.positions, bumpy.after.positions, atol=1e-9)
    assert not any(report.improved for report in reports)


def test_the_result_turns_with_the_part(bumpy):
    T = random_transform(3)
    path = dataclasses.replace(
        bumpy.path,
        positions=apply(T, bumpy.path.positions),
        directions=rotate(T, bumpy.path.directions),
        targets=apply(T, bumpy.path.targets),
    )
    after, reports = optimise_passes(path, moved(bumpy.mesh, T), bumpy.segmentation, SETTINGS)
    assert np.allclose(after.positions, apply(T, bumpy.after.positions), atol=1e-6)
    assert [r.moved for r in reports] == [r.moved for r in bumpy.reports]
    assert [r.error_after for r in reports] == pytest.approx(
        [r.error_after for r in bumpy.reports], abs=1e-6
    )


def test_tilted_rows_over_a_flat_panel_are_put_straight():
    mesh, segmentation, path = flat_scene(out_deg=10, in_deg=-6)
    after, reports = optimise_passes(path, mesh, segmentation, SETTINGS)
    assert np.allclose(after.directions, -UP, atol=1e-9)
    for report in reports:
        # 5e-5 * 180 * 10 + 0.004 * 6 before, nothing after.
        assert report.error_before == pytest.approx(0.09 + 0.024)
        assert report.error_after == pytest.approx(0.0, abs=1e-9)
        assert report.moved == report.points and report.reason == ""


def test_passes_at_their_optimum_are_not_touched():
    mesh, segmentation, path = flat_scene()
    after, reports = optimise_passes(path, mesh, segmentation, SETTINGS)
    assert same_poses(after, path)
    assert {(r.reason, r.moved, r.error_after) for r in reports} == {(OPTIMAL, 0, 0.0)}


def test_rows_move_as_a_whole():
    mesh, segmentation, path = flat_scene(out_deg=8)
    # Depths that differ from point to point keep their differences.
    wavy = path.positions - 0.01 * np.sin(np.arange(len(path)))[:, None] * path.directions
    path = dataclasses.replace(path, positions=wavy)
    after, reports = optimise_passes(
        path, mesh, segmentation, SETTINGS,
        feasible=lambda positions, directions: directions[:, 0] < -0.1,
    )  # fmt: skip
    assert all(report.improved for report in reports)
    before, now = (np.linalg.norm(p.targets - p.positions, axis=1) for p in (path, after))
    for row in np.unique(path.groups):
        rise = (now - before)[path.groups == row]
        assert np.ptp(rise) < 1e-9 and rise[0] > 0.0


def test_a_robot_that_can_do_nothing_leaves_everything_as_it_is():
    mesh, segmentation, path = flat_scene(out_deg=10)
    after, reports = optimise_passes(
        path, mesh, segmentation, SETTINGS,
        feasible=lambda positions, directions: np.zeros(len(positions), dtype=bool),
    )  # fmt: skip
    assert same_poses(after, path)
    assert {(r.reason, r.improved) for r in reports} == {(NOT_FEASIBLE, False)}
    assert all(r.error_after == r.error_before == pytest.approx(0.09) for r in reports)


def test_the_robot_says_how_far_a_pass_goes():
    mesh, segmentation, path = flat_scene(out_deg=10)
    asked = []

    def low_and_tilted(positions, directions):
        asked.append(len(positions))
        return (positions[:, 2] <= 0.34) & (directions[:, 0] <= -math.sin(rad(4)))

    after, _ = optimise_passes(path, mesh, segmentation, SETTINGS, feasible=low_and_tilted)
    assert after.positions[:, 2].max() <= 0.34
    tilt = np.arcsin(-after.directions[:, 0])
    # To within an eighth of what is left, less what is not worth a move.
    assert np.all(tilt >= rad(4)) and np.all(tilt <= rad(5.5))
    assert max(asked) == 9  # a row at a time


def test_another_scanner_s_least_angle_is_approached():
    mesh, segmentation, path = flat_scene()
    options = PassSettings(out_of_plane_min_rad=rad(20))
    after, reports = optimise_passes(path, mesh, segmentation, SETTINGS, options=options)
    tilt = np.arccos(-after.directions[:, 2])
    assert np.all(tilt <= rad(12) + 1e-9) and tilt.max() > rad(5)
    assert any(r.improved for r in reports)


def test_a_pose_beside_its_target_is_left_alone():
    mesh, segmentation, path = flat_scene(out_deg=10)
    beside = dataclasses.replace(path, targets=path.targets + [0.0, 0.01, 0.0])
    far = tilted(path, rad(10), 0.0, 0.45)
    for misplaced in (beside, far):
        after, reports = optimise_passes(misplaced, mesh, segmentation, SETTINGS)
        assert same_poses(after, misplaced)
        assert {r.reason for r in reports} == {MISPLACED}


def test_a_view_keeps_the_tilt_that_shows_more():
    # A tilted field covers an ellipse of the panel, longer than the circle seen straight on.
    mesh = grid(0.45, 0.3, 0.05)
    toward = np.array([math.sin(rad(20)), 0.0, math.cos(rad(20))])
    path = path_of(np.zeros((1, 3)), -toward[None], [FEATURE], [1])
    settings = dataclasses.replace(SETTINGS, least_views=1)
    segmentation = segment_mesh(mesh)
    after, reports = optimise_passes(path, mesh, segmentation, settings)
    certifier = Certifier(mesh, segmentation, SCANNER, least_views=1)
    straight = dataclasses.replace(path, positions=0.3 * UP[None], directions=-UP[None])
    assert certifier.points(straight).area_ratio < certifier.points(path).area_ratio - 0.01
    assert certifier.points(after).area_ratio >= certifier.points(path).area_ratio - 1e-9
    assert math.acos(-after.directions[0, 2]) == pytest.approx(rad(20))
    # The far rim of the ellipse lies 73 mm deeper than its middle: so far the depth may grow.
    assert 0.3 <= np.linalg.norm(after.positions[0]) <= 0.4 - 0.072
    unmoved = dataclasses.replace(path, positions=0.325 * toward[None])
    _, reports = optimise_passes(unmoved, mesh, segmentation, settings)
    assert [(r.kind, r.points, r.moved, r.reason) for r in reports] == [(FEATURE, 1, 0, WORSE_SEEN)]


def test_nothing_to_do_without_points():
    mesh, segmentation, path = flat_scene()
    none = path_of(np.zeros((0, 3)), np.zeros((0, 3)), [], [])
    assert optimise_passes(none, mesh, segmentation, SETTINGS) == (none, ())


# The guard


def random_move(path, rng):
    """Numbers of some poses, and the path with these moved a little or a lot."""
    unit = rng.choice(len(path), rng.integers(1, 4), replace=False)
    shake = rng.normal(size=(len(unit), 3)) * rng.choice([0.0005, 0.1])
    toward = shake - path.directions[unit]
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    positions, directions = path.positions.copy(), path.directions.copy()
    positions[unit] = path.targets[unit] + rng.uniform(0.29, 0.36) * toward
    directions[unit] = -toward
    return unit, dataclasses.replace(path, positions=positions, directions=directions)


def test_the_guard_judges_as_the_whole_certificate(bumpy):
    rng, path, verdicts = np.random.default_rng(0), bumpy.path, []
    regions = bumpy.segmentation.face_region
    guard = CoverageGuard(bumpy.certifier, SETTINGS, regions, (path.positions, path.directions))
    scanners = [Certifier(bumpy.mesh, bumpy.segmentation, each) for each in (SCANNER, NARROW)]
    for _ in range(16):
        unit, new = random_move(path, rng)
        now, then = ((p.positions[unit], p.directions[unit]) for p in (path, new))
        looked = guard.looked_at(path.targets[unit], now)
        better = all(np.all(shares(c, new) >= shares(c, path) - 1e-9) for c in scanners)
        assert (guard.keeps(looked, then) is not None) == better
        verdicts.append(better)
        # What is moved all the same is in the counts from then on.
        guard.moved(looked, then)
        path = new
    assert {True, False} == set(verdicts)


# Settings, record and hook


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("out_of_plane_min_rad", -0.1), ("out_of_plane_min_rad", 2.0), ("in_plane_min_rad", -1.0),
        ("penalty", -1.0), ("penalty", math.nan), ("in_plane_factor", -0.1), ("least_gain", 0.0),
        ("least_gain_ratio", 0.0), ("least_gain_ratio", math.inf), ("halvings", -1), ("sweeps", 0),
    ],
)  # fmt: skip
def test_options_out_of_range_are_named(name, value):
    with pytest.raises(InputError, match=rf"{name}: found .*accepted"):
        PassSettings(**{name: value})


def test_best_angles_beyond_the_tilt_are_refused():
    mesh, segmentation, path = flat_scene()
    with pytest.raises(InputError, match=r"best_out_of_plane_rad.*accepted is up to 0\.2618"):
        optimise_passes(
            path, mesh, segmentation, SETTINGS, options=PassSettings(out_of_plane_min_rad=rad(30))
        )


def test_paths_and_answers_that_are_none_are_refused():
    mesh, segmentation, path = flat_scene(out_deg=10)
    broken = dataclasses.replace(path, positions=path.positions * math.nan)
    with pytest.raises(ScanPathInvalidError, match="finite"):
        optimise_passes(broken, mesh, segmentation, SETTINGS)
    lost = dataclasses.replace(path, targets=np.full_like(path.targets, math.inf))
    with pytest.raises(ScanPathInvalidError, match="finite targets"):
        optimise_passes(lost, mesh, segmentation, SETTINGS)
    with pytest.raises(InputError, match=r"an answer of shape \(9,\)"):
        optimise_passes(path, mesh, segmentation, SETTINGS, feasible=lambda p, d: np.ones(2, bool))
    with pytest.raises(PartInvalidError, match="clearance_m"):
        bad = dataclasses.replace(SETTINGS, clearance_m=-1.0)
        optimise_passes(path, mesh, segmentation, bad)


def test_the_setting_is_read_and_written():
    assert not ScanSettings().optimise_passes
    assert read_settings({"optimise_passes": True}, "scan", "part.yaml").optimise_passes
    assert settings_fields(SETTINGS)["optimise_passes"] is True
    for wrong in (1, "yes", [True]):
        with pytest.raises(PartInvalidError, match=r"scan\.optimise_passes: found .*true or false"):
            read_settings({"optimise_passes": wrong}, "scan", "part.yaml")


def test_the_scan_path_stage_optimises_when_asked(bumpy):
    prepared = SimpleNamespace(mesh=bumpy.mesh, segmentation=bumpy.segmentation)
    plain = plan_path(prepared, dataclasses.replace(SETTINGS, optimise_passes=False))
    assert same_poses(plain, bumpy.path) and plain.passes == ()
    asked = plan_path(prepared, SETTINGS)
    assert scan_path_hash(asked) == scan_path_hash(bumpy.after)
    assert scan_path_hash(asked) != scan_path_hash(plain)


def test_the_passes_are_on_record(bumpy, tmp_path):
    def summary(path):
        return planning_summary(
            triangles=1, area_m2=1.0, mesh_sha256="", path=path, coverage=None, station_plan=None,
            trajectories=(), cycle=None, planning_s={},
        )["scan_path"]  # fmt: skip

    found = summary(bumpy.after)["passes"]
    assert found["count"] == len(bumpy.reports)
    assert found["improved"] == sum(report.improved for report in bumpy.reports)
    points = sum(report.points for report in bumpy.reports)
    mean = sum(report.points * report.error_after for report in bumpy.reports) / points
    assert found["error_after"] == pytest.approx(mean) and mean < found["error_before"]
    assert "passes" not in summary(bumpy.path)
    write_plan_files(tmp_path, bumpy.after)
    written = json.loads((tmp_path / "scan_path.json").read_text())["passes"]
    assert [each["group"] for each in written] == [report.group for report in bumpy.reports]
    assert {each["kind"] for each in written} <= {"row", "feature"}
    rows = [report for report in bumpy.reports if report.kind == ROW]
    assert sum(each["kind"] == "row" for each in written) == len(rows)
