"""The approach-retry loop: real detection on rendered images, and every way it can fail."""

import logging
from collections import Counter
from dataclasses import replace

import cv2
import numpy as np
import pytest

from approach_cell import FIXTURE, SETTINGS, SimulatedCell, random_start
from localization_scene import CELL, base_facing
from skinplan.errors import (
    BaseBlockedError,
    BaseRefusedError,
    LocalizationCancelledError,
    LocalizationError,
    NoMarkerError,
    PartMovedError,
    QualityNotReachedError,
    SafeDistanceError,
    StaleImageError,
    WrongMarkerError,
)
from skinplan.transforms import difference, planar

START = base_facing(0.1, 2.6, 0.4)


def campaign(seeds):
    """Runs approaches; returns attempts of those that ended well, failures, nearest distance."""
    attempts, failures, nearest = [], Counter(), np.inf
    seen = 0
    for seed in seeds:
        cell = SimulatedCell(seed, random_start(seed), slips=0.1, lost=0.05)
        loop = cell.loop()
        try:
            estimate = loop.run()
        except LocalizationError as error:
            failures[type(error).__name__] += 1
            seen += any(item.pose is not None for item in cell.told_estimates)
        else:
            assert estimate.quality >= CELL.quality.threshold
            attempts.append(loop.attempts)
            seen += 1
        assert loop.attempts <= SETTINGS.max_attempts
        nearest = min(nearest, cell.nearest_m)
    return attempts, failures, nearest, seen


def check(attempts, failures, nearest, seen):
    logging.getLogger(__name__).warning(
        "%d of %d that saw a pose, failures %s, attempts median %g, most %d, nearest stop %.3f m",
        len(attempts),
        seen,
        dict(failures),
        np.median(attempts),
        max(attempts),
        nearest,
    )
    assert nearest >= CELL.quality.distance_min_m
    assert len(attempts) >= 0.99 * seen, failures
    assert np.median(attempts) <= 4


@pytest.mark.parametrize("starts", [12, pytest.param(40, marks=pytest.mark.long)])
def test_approaches_from_random_starts(starts):
    check(*campaign(range(starts)))


@pytest.mark.long
@pytest.mark.timeout(1800)
def test_five_hundred_approaches():
    check(*campaign(range(500)))


def fails(cell, error, settings=SETTINGS, **loop):
    with pytest.raises(error) as caught:
        cell.loop(settings, **loop).run()
    return caught.value


def test_on_failure_the_base_is_back_where_it_started():
    cell = SimulatedCell(1, START)
    fails(cell, QualityNotReachedError, replace(SETTINGS, threshold=1.0, max_attempts=3))
    out, back = np.split(np.array(cell.goals), 2)
    assert len(out) >= 2, "two approaches"
    for there, again in zip([START, *out[:-1]], back[::-1], strict=True):
        assert max(difference(there, again)) < 1e-9, "the way back is the way it came"
    assert max(difference(cell.base.believed, START)) < 1e-9


def test_an_unreachable_quality_ends_at_the_safe_distance():
    cell = SimulatedCell(1, START)
    fails(cell, SafeDistanceError, replace(SETTINGS, threshold=1.0, max_attempts=30))
    assert cell.nearest_m >= CELL.quality.distance_min_m
    assert cell.looks < 60


def test_marker_removed_in_the_middle():
    """The base does not drive on without a marker: nothing but the way back follows."""
    cell = SimulatedCell(2, START)
    empty = SimulatedCell(2, START @ planar(0, 0, np.pi)).camera.render(
        np.linalg.inv(START @ planar(0, 0, np.pi) @ CELL.camera.T_base_link_optical)
    )
    noise = np.random.default_rng(0)
    cell.change_image = lambda image, look: (
        image if look <= 2 else cv2.add(empty, noise.integers(0, 3, empty.shape, np.uint8))
    )
    fails(cell, NoMarkerError)
    assert len(cell.goals) == 2
    assert max(difference(cell.goals[-1], START)) < 1e-9


def test_frozen_image():
    cell = SimulatedCell(3, START)
    kept = []
    cell.change_image = lambda image, look: kept.append(image) or kept[min(look, 2) - 1]
    fails(cell, StaleImageError)
    assert len(cell.goals) == 2, "one drive by the true image, then back"


def test_frozen_from_the_start():
    cell = SimulatedCell(3, START)
    kept = []
    cell.change_image = lambda image, look: kept.append(image) or kept[0]
    fails(cell, StaleImageError, replace(SETTINGS, images=3))
    assert not cell.goals


def nearer(seed):
    """Returns an image from a place where E is good enough, as a camera that froze there gives."""
    cell = SimulatedCell(seed, START)
    shown = []
    cell.change_image = lambda image, _: shown.append(image) or image
    assert cell.loop(replace(SETTINGS, images=1)).run().quality >= SETTINGS.threshold
    return shown[-1]


@pytest.mark.parametrize("frozen", [1, 2])
@pytest.mark.parametrize("images", [2, 3, 4])
def test_a_camera_that_was_frozen_elsewhere_until_now(frozen, images):
    """The old images are good ones, and may be more than the only one of now."""
    old, cell = nearer(5), SimulatedCell(5, START)
    cell.change_image = lambda image, look: old if look <= frozen else image
    settings = replace(SETTINGS, images=images, may_move=False)
    assert "px from where the image before" in str(fails(cell, StaleImageError, settings))
    assert [estimate.pose for estimate in cell.told_estimates] == []


def test_a_camera_that_froze_at_the_last_goal():
    """With one image per estimate nothing but the image of the last goal tells."""
    old, cell = nearer(6), SimulatedCell(6, START)
    cell.change_image = lambda *_: old
    settings = replace(SETTINGS, images=1, may_move=False)
    loop = cell.loop(settings, last_image=old)
    with pytest.raises(StaleImageError, match="repeats the same one"):
        loop.run()
    assert loop.last_image is old
    again = SimulatedCell(6, START)
    again.change_image = lambda image, look: old if look == 1 else image
    with pytest.raises(QualityNotReachedError):
        again.loop(settings, last_image=old).run()


def test_an_old_image_before_some_without_markers_locates_nothing():
    old, cell = nearer(7), SimulatedCell(7, START @ planar(0, 0, np.pi))
    cell.change_image = lambda image, look: old if look == 1 else image
    fails(cell, NoMarkerError, replace(SETTINGS, images=3, may_move=False))
    assert all(estimate.pose is None for estimate in cell.told_estimates)


def test_a_driver_that_gives_each_image_twice_is_no_camera_that_froze():
    cell, kept = SimulatedCell(8, START), []
    cell.change_image = lambda image, look: kept.append(image) or kept[2 * ((look - 1) // 2)]
    found = cell.loop(replace(SETTINGS, images=3, threshold=0.1, may_move=False)).run()
    assert found.attempt == 1 and cell.looks == 5


def test_base_that_reports_success_without_moving():
    cell = SimulatedCell(4, START)
    cell.drive = lambda goal, is_cancelled: cell.goals.append(goal) or True
    error = fails(cell, BaseBlockedError)
    assert "2 drives" in str(error)
    assert cell.looks == 3 * SETTINGS.images, "one look, and one after each of two drives"
    assert max(difference(cell.goals[-1], START)) < 1e-9


def test_base_that_refuses():
    cell = SimulatedCell(4, START)

    def refuse(goal, is_cancelled):
        raise BaseRefusedError("a drive was asked for, but no navigator answers")

    cell.drive = refuse
    error = fails(cell, BaseRefusedError)
    assert "could not be brought back" in str(error)


def test_markers_swapped_for_those_of_another_part():
    cell = SimulatedCell(5, START)
    other = replace(
        FIXTURE, markers=tuple(replace(marker, id=marker.id + 40) for marker in FIXTURE.markers)
    )
    swapped = SimulatedCell(5, START, fixture=other)

    def image_of_other(image, look):
        if look <= 2:
            return image
        swapped.base = cell.base
        return swapped.look(0.0, None).image

    cell.change_image = image_of_other
    error = fails(cell, WrongMarkerError)
    assert "another fixture" in str(error)


def test_two_equal_ids_are_no_marker_and_the_others_count():
    first, second, third = FIXTURE.markers[2:5]
    twins = replace(FIXTURE, markers=(first, replace(second, id=first.id), third))
    known = replace(FIXTURE, markers=(first, third))
    cell = SimulatedCell(6, base_facing(-0.2, 1.3, 0.0), fixture=twins)
    sightings = []
    cell.seen = lambda sighting, view: sightings.append(sighting)
    cell.loop(fixture=known).run()
    assert all(seen.duplicates == (first.id,) for seen in sightings)
    assert all(item.id == third.id for seen in sightings for item in seen.markers)


def test_only_equal_ids_are_a_wrong_marker():
    first, second = FIXTURE.markers[2:4]
    twins = replace(FIXTURE, markers=(first, replace(second, id=first.id)))
    cell = SimulatedCell(6, base_facing(-0.4, 1.5, 0.0), fixture=twins)
    error = fails(cell, WrongMarkerError, fixture=replace(FIXTURE, markers=(first,)))
    assert "several times" in str(error)
    assert not cell.goals


def test_mirrored_prints_are_a_wrong_marker():
    cell = SimulatedCell(7, base_facing(0.0, 1.3, 0.0))
    cell.change_image = lambda image, _: np.ascontiguousarray(image[:, ::-1])
    error = fails(cell, WrongMarkerError)
    assert "mirrored" in str(error)


def test_a_part_that_jumps_farther_than_the_base_can_have_driven():
    cell = SimulatedCell(8, base_facing(0.0, 1.7, 0.0))
    jumped = SimulatedCell(8, base_facing(0.0, 1.7, 0.0))

    def far_away(image, look):
        if look <= 2:
            return image
        jumped.base = type("Base", (), {"true": base_facing(0.8, 2.6, 0.0)})()
        return jumped.look(0.0, None).image

    cell.change_image = far_away
    error = fails(cell, PartMovedError)
    assert "the camera was driven" in str(error)
    assert cell.looks == 2 * SETTINGS.images, "nothing was driven by what is seen then"
    assert max(difference(cell.goals[-1], base_facing(0.0, 1.7, 0.0))) < 1e-9, "but the way back"


def test_a_camera_that_comes_too_near_while_driving_stops_the_base():
    """What the images of a drive show counts, whatever odometry says; two in a row have to."""
    cell, near = SimulatedCell(11, START), SimulatedCell(11, base_facing(0.0, 0.6, 0.0))
    near.watching = True
    looked = []

    def nearer(*_):
        looked.append(cell.base.moving)
        return near.glance() if len(cell.goals) == 1 and len(looked) != 2 else None

    cell.glance = nearer
    error = fails(cell, SafeDistanceError)
    assert "the base was stopped" in str(error)
    assert "0.6" in str(error)
    assert looked[2], "in the middle of the drive"
    assert len(cell.goals) == 2, "nothing but the way back follows"
    assert max(difference(cell.base.believed, START)) < 1e-9


def test_one_image_that_shows_it_too_near_stops_nothing():
    cell, near = SimulatedCell(11, START), SimulatedCell(11, base_facing(0.0, 0.6, 0.0))
    near.watching = True
    looked = []
    cell.glance = lambda: looked.append(1) or (near.glance() if len(looked) == 3 else None)
    assert cell.loop().run().quality >= CELL.quality.threshold
    assert len(looked) > 3


def test_the_images_of_a_good_drive_stop_nothing():
    cell = SimulatedCell(12, base_facing(0.0, 2.0, 0.3))
    cell.watching = True
    assert cell.loop().run().quality >= CELL.quality.threshold


def test_a_start_without_room_is_not_left():
    cell = SimulatedCell(13, base_facing(0.0, 0.78, 0.3))
    fails(cell, SafeDistanceError, replace(SETTINGS, threshold=1.0))
    assert not cell.goals


@pytest.mark.parametrize("after", [0, 3, 12, 40])
def test_cancel_at_any_time_stops_the_base(after):
    asked = []
    cell = SimulatedCell(9, START)
    with pytest.raises(LocalizationCancelledError):
        cell.loop(
            replace(SETTINGS, threshold=1.0, max_attempts=50),
            is_cancelled=lambda: asked.append(1) or len(asked) > after,
        ).run()
    cell.base.step(cell.now_s + 100.0)
    assert cell.base.speed == 0.0


def test_without_moving_the_quality_is_said():
    cell = SimulatedCell(10, START)
    fails(cell, QualityNotReachedError, replace(SETTINGS, may_move=False))
    assert not cell.goals
