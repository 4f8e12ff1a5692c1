"""Stations from where the camera locates the part, and what is said where there are none."""

import dataclasses

import numpy as np
import pytest

from localization_scene import observed
from reach_scene import flat_panel, flat_path, upright
from skinplan.errors import LocalizationError, MarkersUnseenError
from skinplan.localization.approach import stop_miss_m
from skinplan.localization.camera import camera_model
from skinplan.localization.edge_lines import narrowest_px
from skinplan.localization.pose import locate
from skinplan.localization.stand import predicted_quality
from skinplan.part.defaults import default_fixture
from skinplan.part.model import Fixture, Marker, ScanSettings
from skinplan.plan_record import station_hash
from skinplan.robot.cell import CellConfig, QualitySettings
from skinplan.stations.candidate_map import BLIND
from skinplan.stations.marker_view import MARGIN, MarkerView
from skinplan.stations.plan import plan_stations
from skinplan.stations.standing import standing
from skinplan.transforms import inverse, planar, transform

CELL = CellConfig()
SCAN = ScanSettings(station_strategy="reach")
PATH, PANEL, PLACE = flat_path(0.6, 0.6, 0.3), flat_panel(0.6, 0.6), upright(0.6)
FIXTURE = default_fixture(np.array([[-0.3, -0.3, 0.0], [0.3, 0.3, 0.0]]))
CAMERA = camera_model(CELL.camera)


def plan(markers=None, path=PATH, settings=SCAN, cell=CELL):
    return plan_stations(path, PLACE, PANEL, settings, cell, markers=markers)


def moved_fixture(*translation):
    """The default fixture with its markers elsewhere in the workpiece."""
    return dataclasses.replace(
        FIXTURE, T_workpiece_fixture=transform(translation) @ FIXTURE.T_workpiece_fixture
    )


@pytest.fixture(scope="module")
def unasked():
    return plan()


@pytest.fixture(scope="module")
def asked():
    return plan(MarkerView(FIXTURE))


def test_the_prediction_is_what_the_localiser_finds():
    """Poses all over the floor, also turned away, before markers of different heights and turns."""
    random = np.random.default_rng(17)
    turned = planar(0.0, 0.0, 0.3)[[1, 2, 0, 3]][:, [1, 2, 0, 3]]
    others = (Marker(7, 0.08, transform((0.2, 0.12, 0.05))), Marker(9, 0.12, turned))
    fixture = dataclasses.replace(FIXTURE, markers=(*FIXTURE.markers, *others))
    poses = np.array(
        [
            planar(*random.uniform((-1.5, -3.5), (1.0, -0.6)), random.normal(0.0, 0.5))
            for _ in range(200)
        ]
    )
    predicted = predicted_quality(poses, PLACE, fixture, CAMERA, CELL, 0.0)
    optical = inverse(poses @ CELL.camera.T_base_link_optical) @ PLACE
    good = np.flatnonzero(predicted > 0.0)
    assert 30 < len(good) < 170
    same = 0
    for number in good:
        seen = observed(optical[number], fixture)
        found = locate(seen, CAMERA, fixture, CELL.quality)
        assert found.quality >= predicted[number] - 1e-6
        # These corners are exact, however small and oblique a marker is and near the rim: real ones
        # would not be found, so the prediction does not count on them.
        if all(_large_and_inside(item.corners) for item in seen.markers):
            same += 1
            assert found.quality == pytest.approx(predicted[number], abs=1e-6)
    assert same > 20


def _large_and_inside(corners):
    size = np.array([CAMERA.width, CAMERA.height])
    away = np.minimum(corners, size - 1.0 - corners).min()
    return away > 10.5 and narrowest_px(corners) > 34.0


def test_what_the_localiser_cannot_use_is_predicted_as_nothing():
    facing_away = planar(0.0, -1.2, np.pi)
    edge_on = np.diag([1.0, 1.0, 1.0, 1.0])
    edge_on[:3, :3] = planar(0.0, 0.0, np.radians(80.0))[:3, :3]
    beside = edge_on @ planar(-0.3, -1.2, 0.0)
    far_away = planar(-0.3, -9.0, 0.0)
    before = planar(-0.3, -1.2, 0.0)
    poses = np.array([facing_away, beside, far_away, before])
    predicted = predicted_quality(poses, PLACE, FIXTURE, CAMERA, CELL, 0.0)
    assert predicted[:3].tolist() == [0.0, 0.0, 0.0] and predicted[3] > 0.8
    with pytest.raises(LocalizationError):
        optical = inverse(poses[0] @ CELL.camera.T_base_link_optical) @ PLACE
        locate(observed(optical, FIXTURE), CAMERA, FIXTURE, CELL.quality)


def test_markers_that_a_miss_of_the_base_takes_out_of_the_image_do_not_count():
    pose = planar(-0.3, -1.2, 0.0)[None]
    lever = np.linalg.norm(CELL.camera.T_base_link_optical[:2, 3])
    miss = stop_miss_m(CELL, float(lever))
    assert predicted_quality(pose, PLACE, FIXTURE, CAMERA, CELL, miss)[0] > 0.0
    assert predicted_quality(pose, PLACE, FIXTURE, CAMERA, CELL, 0.7)[0] == 0.0


def test_no_candidate_is_left_from_where_the_markers_are_seen_too_badly(asked, unasked):
    seen, view = asked.candidates_seen, MarkerView(FIXTURE)
    quality = view.quality(CELL, PLACE, seen.poses)
    assert view.required(CELL) == pytest.approx(CELL.quality.threshold + MARGIN)
    assert np.any(seen.blind) and np.all(quality[seen.blind] < view.required(CELL))
    free = seen.counts > BLIND + 1
    assert np.any(free) and np.all(quality[free] >= view.required(CELL))
    stations = np.array([s.T_map_base_link for s in asked.stations])
    assert np.all(view.suffices(CELL, PLACE, stations))
    assert asked.candidates < unasked.candidates


def test_a_better_view_asked_for_brings_the_station_nearer(unasked):
    view = MarkerView(FIXTURE, margin=0.03)
    strict = plan(view)
    assert not view.suffices(CELL, PLACE, unasked.stations[0].T_map_base_link[None])[0]
    nearer = strict.stations[0].T_map_base_link[1, 3]
    assert nearer > unasked.stations[0].T_map_base_link[1, 3]
    assert len(strict.stations) == len(unasked.stations) and strict.reached_ratio == 1.0


def test_without_markers_nothing_changes(unasked):
    none = plan(MarkerView(Fixture(FIXTURE.dictionary, FIXTURE.T_workpiece_fixture, ())))
    assert station_hash(none) == station_hash(unasked) and np.isnan(none.marker_quality)
    assert not none.candidates_seen.blind.any() and none.candidates == unasked.candidates


def test_what_was_asked_is_part_of_the_hash_and_the_plan_stays_the_same(asked):
    again = plan(MarkerView(FIXTURE))
    assert station_hash(again) == station_hash(asked)
    changed = dataclasses.replace(asked, marker_quality=asked.marker_quality + 0.001)
    assert station_hash(changed) != station_hash(asked)
    assert asked.marker_quality == pytest.approx(0.85 + MARGIN)


@pytest.mark.parametrize("strategy", ["reach", "rectangles", "axial_radial"])
def test_an_empty_remainder_says_what_was_asked_what_was_found_and_what_helps(strategy):
    settings = dataclasses.replace(SCAN, station_strategy=strategy)
    # The camera may come nearer than any place allows.
    near = dataclasses.replace(CELL, quality=QualitySettings(distance_min_m=0.2))
    with pytest.raises(MarkersUnseenError, match=r"E >= 0\.990 .*the best is 0\.\d+, from") as told:
        plan(MarkerView(FIXTURE, 0.0, 0.99), settings=settings, cell=near)
    assert "lower T_E" in str(told.value) and "T_E 0.990" in str(told.value)


def test_markers_on_the_ceiling_are_in_no_image():
    with pytest.raises(MarkersUnseenError, match="from none enough of them are in the image"):
        plan(MarkerView(moved_fixture(0.0, 4.0, 0.0)))


@pytest.mark.parametrize("strategy", ["reach", "rectangles"])
def test_points_that_only_places_left_out_reach_have_that_reason(strategy):
    """Of a panel of 2.4 m only one end has markers."""
    path, panel = flat_path(2.4, 0.3, 0.3), flat_panel(2.4, 0.3)
    view, settings = (
        MarkerView(moved_fixture(-0.9, 0.0, 0.0)),
        ScanSettings(station_strategy=strategy),
    )
    found = plan_stations(path, PLACE, panel, settings, CELL, markers=view)
    assert 0.2 < found.reached_ratio < 0.9
    far = [s.reason for s in found.skipped if path.positions[s.point, 0] > 0.9]
    assert far and all("camera sees no marker with E >= 0.865" in reason for reason in far)


def test_places_in_the_part_are_not_told_as_blind():
    inside, blind = planar(0.0, 0.0, 0.0), planar(0.0, -4.0, 0.0)
    poses = np.array([inside, blind, planar(-0.3, -1.1, 0.0)])
    found = standing(CELL, PANEL, PLACE, poses, MarkerView(FIXTURE))
    assert found.blind.tolist() == [False, True, False]
    assert found.free.tolist() == [False, False, True]
    assert standing(CELL, PANEL, PLACE, poses).free.tolist() == [False, True, True]
