"""Parts on the tray in an image: outlines, classes, light, named answers."""

import dataclasses

import cv2
import numpy as np
import pytest
import trimesh

from skinplan.errors import ImageInvalidError, InputError
from skinplan.localization.model import CameraModel
from skinplan.recognition.tray.layout import TRAY_SIZE_M, PlacedPart, resting
from skinplan.recognition.tray.parts import part_mesh
from skinplan.recognition.tray.photo import Light, Photographer, camera_above
from skinplan.recognition.tray_classes import Classifier
from skinplan.recognition.tray_image import BlobSettings, blobs, blobs_of, difference_mask
from skinplan.recognition.tray_light import light_ratio
from skinplan.recognition.tray_view import TrayView, ViewSettings

NAMES = ("zee_clip", "doubler", "curved_skin", "machined_bracket", "formed_skin")
CAMERA, T_TRAY_CAMERA = camera_above(648, 512)


@pytest.fixture(scope="module")
def taker():
    return Photographer(CAMERA, T_TRAY_CAMERA)


@pytest.fixture(scope="module")
def view(taker):
    return TrayView(CAMERA, taker.T_camera_tray, TRAY_SIZE_M, ViewSettings(pixel_m=0.002))


@pytest.fixture(scope="module")
def background(taker):
    return taker.photo((), seed=1)


@pytest.fixture(scope="module")
def classifier(view):
    return Classifier(view, {name: part_mesh(name) for name in NAMES})


def put(name, x, y, heading=0.0):
    mesh = part_mesh(name)
    pose = resting(mesh, heading, False)
    pose[:2, 3] += (x, y)
    return PlacedPart(name, pose, mesh)


LAYOUT = (
    put("zee_clip", 0.25, 0.25, 0.4),
    put("doubler", 0.6, 0.6, 2.0),
    put("machined_bracket", 1.0, 0.25, 1.1),
    put("formed_skin", 1.4, 0.6, 0.7),
)


@pytest.fixture(scope="module")
def photo(taker):
    return taker.photo(LAYOUT, seed=2)


def middle(part):
    return (part.points[:, :2].min(axis=0) + part.points[:, :2].max(axis=0)) / 2


def require_right(finding):
    assert finding.answer == ""
    assert len(finding.sightings) == len(LAYOUT)
    for part in LAYOUT:
        near = min(finding.sightings, key=lambda s: np.linalg.norm(s.place - middle(part)))
        assert part.name in near.names
        assert set(near.names) <= {part.name, "doubler", "curved_skin"}
        assert np.linalg.norm(near.place - middle(part)) < 0.004


def test_a_rectangle_on_the_plane_has_its_figures(view):
    # Pixels whose middles are inside 0.3 x 0.1 m, turned by 0.5 rad.
    turn = np.array([[np.cos(0.5), -np.sin(0.5)], [np.sin(0.5), np.cos(0.5)]])
    corners = np.array([[-0.15, -0.05], [0.15, -0.05], [0.15, 0.05], [-0.15, 0.05]]) @ turn.T
    rows, columns = np.mgrid[: view.shape[0], : view.shape[1]]
    own = (view.metres(np.stack([columns, rows], axis=2)) - (0.9, 0.45)) @ turn
    inside = (np.abs(own[..., 0]) <= 0.15) & (np.abs(own[..., 1]) <= 0.05)
    mask = inside.astype(np.uint8) * 255
    (found,) = blobs_of(mask, view, 1e-4)
    assert found.area_m2 == pytest.approx(0.03, rel=0.03)
    assert found.size_m == pytest.approx((0.3, 0.1), abs=0.003)
    assert found.aspect == pytest.approx(3.0, rel=0.04)
    assert found.heading_rad == pytest.approx(0.5, abs=0.01)
    np.testing.assert_allclose(found.centre, (0.9, 0.45), atol=1e-3)
    gaps = np.linalg.norm(found.corners[:, None] - (corners + (0.9, 0.45)), axis=2).min(axis=1)
    assert gaps.max() < 0.004
    assert not found.cut_off


def test_the_view_is_metric_through_the_camera_model(view, taker):
    # Corners of the tray's outer bars, seen in a photo, are where the tray is.
    flat = view.flat(taker.photo((), Light(noise=0.0)), "image")
    bright = np.argwhere(flat > 35)
    low, high = view.metres(bright.min(axis=0)[::-1]), view.metres(bright.max(axis=0)[::-1])
    np.testing.assert_allclose(low, (0.0, 0.0), atol=0.004)
    np.testing.assert_allclose(high, TRAY_SIZE_M, atol=0.004)


def test_parts_have_their_classes_and_places(photo, background, view, classifier):
    finding = classifier.find(blobs(photo, background, view))
    require_right(finding)
    # What looks alike from above is said, not guessed.
    doubler = min(finding.sightings, key=lambda s: np.linalg.norm(s.place - middle(LAYOUT[1])))
    assert set(doubler.names) == {"doubler", "curved_skin"}
    assert " or " in doubler.label


def test_of_each_class_the_part_nearest_to_the_middle_is_scanned(taker, background, view):
    parts = [put("doubler", 0.3, 0.3), put("doubler", 0.8, 0.5, 1.0), put("zee_clip", 1.5, 0.3)]
    classifier = Classifier(view, {name: part_mesh(name) for name in ("doubler", "zee_clip")})
    finding = classifier.find(blobs(taker.photo(parts, seed=3), background, view))
    chosen = finding.to_scan(np.array(TRAY_SIZE_M) / 2)
    assert set(chosen) == {("doubler",), ("zee_clip",)}
    np.testing.assert_allclose(chosen["doubler",].place, (0.8, 0.5), atol=0.004)


def test_uneven_light_is_taken_off(taker, background, view, classifier):
    lit = taker.photo(LAYOUT, Light(ratio=3.0, heading_rad=0.6), seed=4)
    require_right(classifier.find(blobs(lit, background, view)))
    plain = blobs(lit, background, view, BlobSettings(compensate_light=False))
    finding = classifier.find(plain)
    right = [s for s in finding.sightings if s.names and not s.answer]
    assert len(right) < len(LAYOUT) or len(plain) != len(LAYOUT)


def test_the_ratio_of_light_is_found_beneath_parts(taker, background, view):
    light = Light(ratio=3.0, heading_rad=0.6, noise=0.0)
    lit = view.flat(taker.photo(LAYOUT, light, seed=5), "image")
    found = light_ratio(lit, view.flat(background, "background"))
    rows, columns = np.mgrid[30 : view.shape[0] - 30 : 20, 30 : view.shape[1] - 30 : 20]
    places = view.metres(np.stack([columns.ravel(), rows.ravel()], axis=1))
    ratio = found[rows.ravel(), columns.ravel()] / light.at(places)
    # Openings are lit as the tray above them; grey values are rounded.
    assert np.abs(ratio - 1.0).max() < 0.12


def test_an_empty_tray_is_said(taker, background, view, classifier):
    finding = classifier.find(blobs(taker.photo((), Light(2.0), seed=6), background, view))
    assert finding.sightings == ()
    assert "the tray is empty" in finding.answer


def test_overlapping_parts_have_no_class(taker, background, view, classifier):
    parts = [put("doubler", 0.8, 0.4), put("machined_bracket", 0.9, 0.44, 0.5)]
    finding = classifier.find(blobs(taker.photo(parts, seed=7), background, view))
    (odd,) = finding.sightings
    assert odd.names == ()
    assert odd.label == "no class"
    assert "is of no class" in odd.answer
    assert "do not touch or overlap" in odd.answer
    assert finding.answer.startswith("1 of 1 outlines are refused")
    assert finding.to_scan(np.zeros(2)) == {}


def test_a_foreign_part_has_no_class(taker, background, view, classifier):
    box = trimesh.creation.box((0.5, 0.3, 0.02))
    foreign = PlacedPart("box", resting(box, 0.2, False), box)
    foreign.T_tray_part[:2, 3] += (0.9, 0.45)
    finding = classifier.find(blobs(taker.photo([foreign], seed=8), background, view))
    assert finding.sightings[0].names == ()
    assert "no type is nearly as large" in finding.answer


@pytest.mark.parametrize("x", [0.0, TRAY_SIZE_M[0]])
def test_a_part_half_outside_is_said(x, taker, background, view, classifier):
    finding = classifier.find(
        blobs(taker.photo([put("formed_skin", x, 0.4)], seed=9), background, view)
    )
    assert "half outside the tray" in finding.answer


def test_a_part_over_the_edge_is_said(taker, background, view, classifier):
    part = put("doubler", 0.08, 0.4)
    finding = classifier.find(blobs(taker.photo([part], seed=10), background, view))
    assert "over the edge of the tray" in finding.answer
    assert "doubler" in finding.answer


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda photo, empty: (None, empty), "no image was given"),
        (lambda photo, empty: (photo, None), "no background image was given"),
        (lambda photo, empty: (photo, empty[:-2]), "648 x 510 px; 648 x 512"),
        (lambda photo, empty: (photo[:, :-8], empty), "640 x 512 px"),
        (lambda photo, empty: (photo.astype(float), empty), "8 bit is accepted"),
        (lambda photo, empty: (np.full_like(photo, 255), empty), "over-exposed: 100 %"),
        (lambda photo, empty: (np.zeros_like(photo), empty), "under-exposed: 100 %"),
    ],
)
def test_images_that_can_not_be_used(change, message, photo, background, view):
    with pytest.raises(ImageInvalidError, match=message):
        blobs(*change(photo, background), view)


def test_an_over_exposed_photo_is_refused(taker, background, view):
    photo = taker.photo(LAYOUT, Light(exposure=700.0), seed=11)
    with pytest.raises(ImageInvalidError, match=r"the image is over-exposed: \d+ %"):
        blobs(photo, background, view)


def test_colour_images_are_taken(photo, background, view):
    colour = cv2.cvtColor(photo, cv2.COLOR_GRAY2BGR)
    assert len(blobs(colour, background, view)) == len(LAYOUT)


def test_cameras_that_do_not_see_the_tray(taker):
    narrow = CameraModel(648, 512, CAMERA.K @ np.diag([3.0, 3.0, 1.0]), CAMERA.D)
    with pytest.raises(ImageInvalidError, match="0 of the 4 corners"):
        TrayView(narrow, taker.T_camera_tray, TRAY_SIZE_M)
    with pytest.raises(InputError, match="pixels"):
        TrayView(CAMERA, taker.T_camera_tray, TRAY_SIZE_M, ViewSettings(pixel_m=1e-5))


def test_figures_that_are_none():
    with pytest.raises(InputError, match="threshold -1"):
        BlobSettings(threshold=-1.0)
    with pytest.raises(InputError, match="no part types"):
        Classifier(None, {})


def test_bars_of_a_tray_that_moved_a_little_are_no_parts(background, view):
    moved = np.roll(background, 1, axis=1)
    assert blobs(moved, background, view) == []
    flat, empty = view.flat(moved, "image"), view.flat(background, "background")
    keeps_all = dataclasses.replace(BlobSettings(), open_m=1e-6, close_m=1e-6)
    kept = np.count_nonzero(difference_mask(flat, empty, view, keeps_all))
    opened = np.count_nonzero(difference_mask(flat, empty, view, BlobSettings()))
    assert opened < 0.5 * kept
