"""Strategy ``patches``: patches, rows over them, rows of neighbouring parts made one."""

import dataclasses
import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from meshes import PANELS, bump, grid, half_cylinder, joined, moved, random_transform
from skinplan.errors import MeshRefusedError, PartInvalidError
from skinplan.mesh.check import check_mesh
from skinplan.mesh.load import load_mesh
from skinplan.mesh.model import SurfaceMesh
from skinplan.mesh.segment import segment_mesh
from skinplan.part.model import ScanSettings
from skinplan.part.samples import sample_panel
from skinplan.part.settings import check_settings, read_settings, settings_fields
from skinplan.plan_record import scan_path_hash
from skinplan.scan_path.partition import Partition, mean_normal
from skinplan.scan_path.plan import plan_scan_path
from skinplan.scanner.coverage import certify
from skinplan.scanner.model import ScannerModel
from skinplan.transforms import transform

SETTINGS = dataclasses.replace(ScanSettings(), strategy="patches")
# A spray gun 0.25 m off, that treats 0.1 m, and a pad that all but touches the part.
SPRAY = dataclasses.replace(SETTINGS, standoff_m=0.25, field_radius_m=0.05, overlap_ratio=0.0)
WIPE = dataclasses.replace(
    SETTINGS,
    standoff_m=0.02,
    range_min_m=0.001,
    range_max_m=0.05,
    clearance_m=0.005,
    field_radius_m=0.06,
    footprint_m=0.1,
    overlap_ratio=0.2,
    field_margin_m=0.0,
)


def planned(mesh, settings=SETTINGS):
    return plan_scan_path(mesh, segment_mesh(mesh), settings)


def seen(mesh, path, settings=SETTINGS):
    return certify(mesh, segment_mesh(mesh), path, ScannerModel.from_settings(settings))


def rows_of(path):
    return len(np.unique(path.groups))


def skin(length, width, place, tilt_deg, axis):
    flat = grid(length, width, 0.01, lambda x, y: -0.3 * y**2)
    turn = Rotation.from_euler(axis, tilt_deg, degrees=True).as_matrix()
    return moved(flat, transform(place, turn))


# The stated layouts: two narrow skins on a tray, leaning against each other by 8 and 12 degrees.
def end_to_end():
    return joined(
        skin(0.6, 0.3, (-0.33, 0.0, 0.0), 4.0, "y"), skin(0.6, 0.3, (0.33, 0.02, 0.01), -4.0, "y")
    )


def side_by_side():
    return joined(
        skin(0.9, 0.12, (0.0, -0.08, 0.0), 6.0, "x"),
        skin(0.9, 0.12, (0.05, 0.08, 0.01), -6.0, "x"),
    )


def test_mean_normal_weighs_by_area():
    normals = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    found = mean_normal(normals, np.array([3.0, 4.0]))
    np.testing.assert_allclose(found, [0.8, 0.0, 0.6], atol=1e-12)
    assert mean_normal(np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]), np.ones(2)) is None


@pytest.mark.parametrize("angle_deg", [20.0, 35.0])
def test_patches_of_a_cylinder_are_within_the_angle(angle_deg):
    mesh = half_cylinder(0.5, 1.0, 0.01, half_angle=np.deg2rad(60))
    angle = np.deg2rad(angle_deg)
    partition = Partition(mesh, mesh.face_normals, angle, 1e-4)
    patches = partition.patches(np.ones(len(mesh.faces), dtype=bool))
    faces = np.concatenate(patches)
    assert len(np.unique(faces)) == len(faces)
    assert mesh.face_areas[faces].sum() > 0.999 * mesh.area
    # No fewer can hold an arc of 120 degrees; halving makes at most twice as many.
    assert 60.0 / angle_deg <= len(patches) <= 2 * math.ceil(60.0 / angle_deg)
    for patch in patches:
        mean = mean_normal(mesh.face_normals[patch], mesh.face_areas[patch])
        assert np.all(mesh.face_normals[patch] @ mean >= np.cos(angle) - 1e-9)


def test_a_ring_whose_normals_cancel_out_is_split():
    mesh = half_cylinder(0.3, 0.2, 0.01, half_angle=np.pi)
    patches = Partition(mesh, mesh.face_normals, 0.6, 1e-4).patches(
        np.ones(len(mesh.faces), dtype=bool)
    )
    assert 6 <= len(patches) <= 16
    assert sum(mesh.face_areas[patch].sum() for patch in patches) > 0.98 * mesh.area


def test_rows_of_a_flat_plate_are_those_of_the_formula():
    mesh = grid(1.0, 0.4, 0.01)
    path = planned(mesh)
    interval = SETTINGS.row_interval_m
    assert rows_of(path) == 1 + math.ceil((0.4 - 0.25 * interval) / interval)
    np.testing.assert_allclose(path.directions, np.tile([0, 0, -1.0], (len(path), 1)), atol=1e-9)
    np.testing.assert_allclose(path.positions[:, 2], SETTINGS.standoff_m, atol=1e-9)
    across = np.unique(np.round(path.targets[:, 1], 9))
    assert np.diff(across).max() <= interval + 1e-9
    for row in np.unique(path.groups):
        along = path.targets[path.groups == row, 0]
        assert np.all(np.diff(along) > 0) or np.all(np.diff(along) < 0)
        assert np.abs(np.diff(along)).max() <= interval + 1e-9
    assert seen(mesh, path).area_ratio == 1.0


def test_height_is_that_of_the_highest_place_below_the_row():
    def ridge(x, y):
        return 0.03 * np.clip((0.3 - np.abs(x)) / 0.1, 0.0, 1.0)

    mesh = grid(1.2, 0.3, 0.01, ridge)
    path = planned(mesh)
    assert len(np.unique(np.round(path.directions, 6), axis=0)) == 1
    half = SETTINGS.row_interval_m / 2
    place = np.abs(path.targets[:, 0])
    expected = ridge(np.maximum(place - half, 0.0), 0.0)
    np.testing.assert_allclose(path.targets[:, 2], expected, atol=3e-3)
    assert (expected > 0.029).any()
    assert (expected == 0.0).any()


@pytest.mark.parametrize("tilt", [0.3, -0.3])
def test_a_tilted_tool_leans_along_the_row_and_stands_lower(tilt):
    mesh = grid(1.0, 0.4, 0.01)
    path = planned(mesh, dataclasses.replace(SETTINGS, tool_tilt_rad=tilt))
    np.testing.assert_allclose(-path.directions[:, 2], np.cos(tilt), atol=1e-9)
    # The direction of the rows is that of the rectangle around samples: good to a milliradian.
    np.testing.assert_allclose(path.directions[:, 1], 0.0, atol=1e-3)
    np.testing.assert_allclose(path.positions[:, 2], 0.3 * np.cos(tilt), atol=1e-9)
    straight = planned(mesh)
    along = np.sign(straight.targets[1, 0] - straight.targets[0, 0])
    assert np.all(np.sign(-path.directions[:, 0]) == along * np.sign(tilt))


@pytest.mark.parametrize(
    ("layout", "settings"),
    [(end_to_end, SETTINGS), (end_to_end, SPRAY), (side_by_side, SETTINGS)],
)
def test_merged_rows_of_neighbours_take_fewer_turns(layout, settings):
    mesh, _ = check_mesh(layout())
    separate = planned(mesh, dataclasses.replace(settings, merge_gap_m=0.0))
    merged = planned(mesh, settings)
    turns, before = rows_of(merged) - 1, rows_of(separate) - 1
    assert turns <= 0.85 * before
    for path in (separate, merged):
        assert seen(mesh, path, settings).area_ratio > 0.999
    # One direction for both: the mean of eq (1) of both skins.
    normal = mean_normal(mesh.face_normals, mesh.face_areas)
    np.testing.assert_allclose(merged.directions, np.tile(-normal, (len(merged), 1)), atol=1e-3)


@pytest.mark.parametrize(
    ("apart", "lean_deg"), [(0.3, 0.0), (0.02, 40.0)], ids=["too far", "too steep"]
)
def test_parts_that_are_no_neighbours_keep_their_rows(apart, lean_deg):
    half = 0.3 + apart / 2
    mesh = joined(
        skin(0.6, 0.3, (-half, 0.0, 0.0), lean_deg, "y"),
        skin(0.6, 0.3, (half, 0.0, 0.0), -lean_deg, "y"),
    )
    separate = planned(mesh, dataclasses.replace(SETTINGS, merge_gap_m=0.0))
    np.testing.assert_array_equal(planned(mesh).positions, separate.positions)


def test_points_stand_only_where_a_part_is():
    settings = dataclasses.replace(SETTINGS, merge_gap_m=0.35)
    mesh = joined(
        skin(0.6, 0.3, (-0.45, 0.0, 0.0), 0.0, "y"), skin(0.6, 0.3, (0.45, 0.0, 0.0), 0.0, "y")
    )
    path = planned(mesh, settings)
    assert rows_of(path) == 5
    for row in np.unique(path.groups):
        along = path.targets[path.groups == row, 0]
        assert along.min() < -0.6
        assert along.max() > 0.6
    assert np.abs(path.targets[:, 0]).min() >= 0.15 - settings.row_interval_m / 2


def small():
    return grid(
        1.0,
        0.6,
        0.01,
        lambda x, y: 0.2 * y**2 + bump(x - 0.1, y + 0.05, height=0.05, radius=0.1, wall=0.03),
    )


def test_walls_of_a_bump_have_rows_of_their_own():
    mesh = small()
    path = planned(mesh)
    directions = np.unique(np.round(path.directions, 6), axis=0)
    assert len(directions) >= 4
    assert np.allclose(path.positions + SETTINGS.standoff_m * path.directions, path.targets)
    np.testing.assert_array_equal(np.unique(path.groups), np.arange(rows_of(path)))
    found = seen(mesh, path)
    assert found.area_ratio > 0.999
    assert found.feature_area_ratio > 0.999


def test_planning_twice_gives_the_same_hash():
    assert scan_path_hash(planned(small())) == scan_path_hash(planned(small()))


def test_a_turned_part_has_turned_rows():
    mesh = grid(1.3, 0.5, 0.011, lambda x, y: 0.3 * y**2 + 0.05 * x**2 + 0.02 * x**3)
    T = random_transform(5)
    here, there = planned(mesh), planned(moved(mesh, T))
    np.testing.assert_allclose(here.positions @ T[:3, :3].T + T[:3, 3], there.positions, atol=1e-6)


@pytest.mark.parametrize("settings", [SPRAY, WIPE], ids=["spray", "wipe"])
def test_a_tool_keeps_its_stand_off_and_treats_all(settings):
    mesh = grid(0.6, 0.3, 0.005, lambda x, y: 0.4 * y**2)
    path = planned(mesh, settings)
    assert not path.left_out
    assert seen(mesh, path, settings).area_ratio > 0.999
    np.testing.assert_allclose(
        path.positions + settings.standoff_m * path.directions, path.targets, atol=1e-9
    )
    narrower = dataclasses.replace(settings, footprint_m=0.06)
    assert rows_of(planned(mesh, narrower)) > rows_of(path)


@pytest.mark.parametrize("name", PANELS)
def test_panels_of_others_are_seen(shared_data, name):
    mesh, _ = check_mesh(load_mesh(shared_data / "panels" / name, "m"))
    segmentation = segment_mesh(mesh)
    path = plan_scan_path(mesh, segmentation, SETTINGS)
    scanner = ScannerModel.from_settings(SETTINGS)
    assert certify(mesh, segmentation, path, scanner, spacing_m=0.01).area_ratio > 0.995


@pytest.mark.long
@pytest.mark.parametrize("name", ["scene2", "scene3", "scene4"])
def test_features_of_the_scenes_are_seen(name):
    mesh = SurfaceMesh(*sample_panel(name).triangulate(100_000))
    found = seen(mesh, planned(mesh))
    assert found.area_ratio > 0.999
    assert found.feature_area_ratio > 0.999


@pytest.mark.parametrize(
    ("key", "value", "accepted"),
    [
        ("patch_angle_rad", 0.0, "0.05 to 1.4"),
        ("patch_angle_rad", "wide", "0.05 to 1.4"),
        ("patch_angle_rad", 1.2, "incidence_max_rad"),
        ("footprint_m", -0.1, "0.005 to 4"),
        ("footprint_m", 0.5, "twice field_radius_m"),
        ("tool_tilt_rad", 1.2, "-1.0472 to 1.0472"),
        ("tool_tilt_rad", float("nan"), "-1.0472 to 1.0472"),
        ("tool_tilt_rad", -1.04719, "incidence_max_rad less the tilt"),
        ("merge_gap_m", -0.01, "0 to 2"),
        ("merge_gap_m", [0.1], "0 to 2"),
    ],
)
def test_bad_settings_are_named(key, value, accepted):
    with pytest.raises(PartInvalidError) as error:
        read_settings({"strategy": "patches", key: value}, "scan", "part.yaml")
    assert f"part.yaml: scan.{'patch_angle_rad' if 'tilt' in accepted else key}" in str(error.value)
    assert accepted in str(error.value)


def test_a_tilt_beyond_the_incidence_limit_is_named():
    values = {"strategy": "patches", "tool_tilt_rad": 0.6, "incidence_max_rad": 0.5}
    with pytest.raises(PartInvalidError, match=r"tool_tilt_rad: found 0\.6; .*incidence_max_rad"):
        read_settings(values, "scan", "part.yaml")
    # The other strategies do not read it.
    assert read_settings({**values, "strategy": "coverage"}, "scan", "x").tool_tilt_rad == 0.6


def test_settings_are_read_as_they_were_written():
    settings = dataclasses.replace(WIPE, tool_tilt_rad=-0.2, merge_gap_m=0.0)
    assert read_settings(settings_fields(settings), "scan", "part.yaml") == settings
    assert check_settings(SETTINGS).footprint_m is None


def test_what_can_not_be_planned():
    with pytest.raises(PartInvalidError, match="row_direction"):
        planned(grid(0.5, 0.5, 0.05), dataclasses.replace(SETTINGS, row_direction=(0.0, 0.0, 1.0)))
    pit = grid(0.1, 0.1, 0.005, lambda x, y: 20 * (x**2 + y**2))
    with pytest.raises(MeshRefusedError, match="keeps"):
        planned(pit, dataclasses.replace(SETTINGS, clearance_m=0.29, tilt_max_rad=0.0))
    with pytest.raises(MeshRefusedError, match="all sides"):
        planned(half_cylinder(0.3, 0.2, 0.01, half_angle=np.pi))
