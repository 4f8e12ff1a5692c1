"""The animation of the arm: how long, how large, and what is where in its frames."""

import dataclasses
import functools
import itertools
from io import BytesIO

import numpy as np
import pytest
from PIL import Image

import motion_scene as scene
from skinplan.errors import InputError
from skinplan.scanner.samples import sample_surface
from skinplan.transforms import apply, transform
from skinplan.view import animation
from skinplan.view.animation import (
    FRAME_MS,
    HEAD_PX,
    HEAD_WIDTH_PX,
    LAST_MS,
    Frame,
    _views,
    drawn_frames,
    moments,
    motion_gif,
)
from skinplan.view.animation_view import (
    IN_VIEW,
    SEEN,
    UNSEEN,
    AnimationView,
    SeenSurface,
    shown_colours,
)
from skinplan.view.arm_shapes import SCANNER_COLOUR, arm_pose
from skinplan.view.motion import station_motions
from skinplan.view.pictures import write_pictures
from skinplan.view.stage import Stage

WIDTH = 240
FRAMES = 24
SCAN_END_S = 6.0


@pytest.fixture(autouse=True)
def few_frames(monkeypatch):
    monkeypatch.setattr(animation, "MOST_FRAMES", FRAMES)


@functools.cache
def stage():
    return Stage(scene.subject_of((scene.first_station(), scene.second_station())))


@functools.cache
def motions():
    return station_motions(stage().subject)


@functools.cache
def gif():
    return motion_gif(stage(), width_px=WIDTH)


@functools.cache
def view():
    return AnimationView(stage(), motions(), WIDTH)


def hue(colour):
    return np.asarray(colour, dtype=float) / np.linalg.norm(colour)


def plain():
    return np.tile(UNSEEN, (len(stage().display.mesh.faces), 1))


def frames_of(data):
    picture = Image.open(BytesIO(data))
    for number in range(picture.n_frames):
        picture.seek(number)
        yield np.asarray(picture.convert("RGB")).astype(float), picture.info["duration"]


def test_the_file_has_its_frames_times_and_size():
    frames = moments(motions())[1]
    shown = list(frames_of(gif()))
    assert len(shown) == len(frames) <= FRAMES
    durations = [duration for _, duration in shown]
    assert durations == [FRAME_MS] * (len(frames) - 1) + [LAST_MS]
    height, width, _ = shown[0][0].shape
    assert width == HEAD_WIDTH_PX and height == view().view.rows + HEAD_PX
    assert len(gif()) < 2_000_000
    assert Image.open(BytesIO(gif())).info["loop"] == 0  # for ever


def test_the_moments_are_all_of_the_motion():
    faster, frames = moments(motions())
    for motion in motions():
        times = [frame.time_s for frame in frames if frame.motion is motion]
        assert times[0] == 0.0 and times[-1] == motion.duration_s
        assert np.diff(times)[:-1] == pytest.approx(faster * FRAME_MS / 1000.0)
    # As slow as it may be: one less would have too many frames.
    step = (faster - 1) * FRAME_MS / 1000.0
    assert sum(motion.duration_s / step + 1 for motion in motions()) > FRAMES
    assert [frame.motion.number for frame in frames] == sorted(f.motion.number for f in frames)


def test_no_animation_lasts_longer_than_12_seconds(monkeypatch):
    monkeypatch.undo()
    for count in (1, 3, 9):
        faster, frames = moments(motions() * count)
        assert (len(frames) - 1) * FRAME_MS + LAST_MS <= 12_000
        assert faster == {1: 2, 3: 7, 9: 24}[count]


def test_many_stations_end_with_two_frames_each():
    short = dataclasses.replace(motions()[1])
    _, frames = moments([short] * 80)
    assert len(frames) == 160


def test_the_scanner_is_in_the_frame_where_it_is():
    for motion, time in itertools.product(motions(), (0.0, 2.5, 6.9)):
        q = motion.joints(np.array([time]))[0]
        image = view().image(motion, q, plain()).astype(float)
        T_map_arm = arm_pose(stage().subject, motion.number)
        ball = (T_map_arm @ scene.ARM.forward_scanner(q[None])[0])[:3, 3]
        row, column = view().view.pixels(ball[None])[0]
        # The wrist may stand before the middle of the ball: most of the ball is to be seen.
        radius = int(0.8 * scene.CELL.scanner_radius_m / view().view.pixel_m)
        rows, columns = np.mgrid[-radius : radius + 1, -radius : radius + 1]
        disc = rows**2 + columns**2 <= radius**2
        around = image[row + rows[disc], column + columns[disc]]
        hues = around / np.linalg.norm(around, axis=1, keepdims=True)
        orange = np.linalg.norm(hues - hue(SCANNER_COLOUR), axis=1) < 0.12
        assert orange.mean() > 0.3, (motion.name, time)
        everywhere = image / np.maximum(np.linalg.norm(image, axis=2, keepdims=True), 1.0)
        all_orange = np.argwhere(np.linalg.norm(everywhere - hue(SCANNER_COLOUR), axis=2) < 0.05)
        away = np.linalg.norm(all_orange - (row, column), axis=1) * view().view.pixel_m
        assert away.max() < scene.CELL.scanner_radius_m + 2 * view().view.pixel_m


def test_the_part_hides_what_is_behind_it():
    """The same arm on the other side of the panel is hidden where the panel is before it."""
    motion = motions()[0]
    q = motion.joints(np.array([2.5]))[0]
    T_map_arm = arm_pose(stage().subject, 0)
    ball = (T_map_arm @ scene.ARM.forward_scanner(q[None])[0])[:3, 3]
    assert orange_pixels(view().image(motion, q, plain())) > 30
    # The panel moved to 0.3 m nearer to the viewer than the scanner, right before it.
    shift = ball + 0.3 * view().view.toward - scene.HIGH[:3, 3]
    before = dataclasses.replace(stage().subject, T_map_workpiece=transform(shift) @ scene.HIGH)
    hidden = AnimationView(Stage(before), motions(), WIDTH)
    assert orange_pixels(hidden.image(motion, q, plain())) == 0


def orange_pixels(image):
    hues = image / np.maximum(np.linalg.norm(image, axis=2, keepdims=True), 1.0)
    return (np.linalg.norm(hues - hue(SCANNER_COLOUR), axis=2) < 0.05).sum()


def test_all_bodies_are_in_the_window_at_all_times():
    for motion in motions():
        T_map_arm = arm_pose(stage().subject, motion.number)
        times = np.linspace(0.0, motion.duration_s, 30)
        frames = T_map_arm @ motion.arm.links(motion.joints(times))
        for shape in view()._shapes:
            for pose in frames[:, shape.joint]:
                cells = view().view.pixels(apply(pose, shape.mesh.vertices))
                assert cells.min() >= 0
                assert np.all(cells < (view().view.rows, view().view.columns))


def test_the_seen_area_grows_to_what_brute_force_finds():
    subject = stage().subject
    seen = SeenSurface(stage(), subject.scanner)
    motion = motions()[0]
    shares, poses = [seen.share], motion.scanner(motion.joints(motion.point_s))
    for pose in poses:
        seen.look(pose[None], True)
        shares.append(seen.share)
    assert shares[0] == 0.0 and np.all(np.diff(shares) >= 0.0)
    samples = sample_surface(subject.mesh, 0.012)
    gaps = samples.points[:, None] - poses[None, :, :3, 3]
    depth = np.einsum("spi,pi->sp", gaps, poses[:, :3, 0])
    beside = np.linalg.norm(gaps - depth[..., None] * poses[None, :, :3, 0], axis=2)
    near = (beside <= subject.scanner.field_radius_m) & (depth > subject.scanner.range_min_m)
    wanted = samples.weights[near.any(axis=1)].sum() / samples.weights.sum()
    assert shares[-1] == pytest.approx(wanted, abs=1e-9)


def test_faces_have_the_colour_of_what_was_and_is_seen():
    seen = SeenSurface(stage(), stage().subject.scanner)
    motion = motions()[0]
    seen.look(motion.scanner(motion.joints(motion.point_s[:1])), True)
    seen.look(motion.scanner(motion.joints(motion.point_s[4:5])), True)
    colours = seen.face_colours()
    middles = stage().display.mesh.centroids[:, :2]
    radius = stage().subject.scanner.field_radius_m
    now, before = (scene.PATH.targets[motion.points[n], :2] for n in (4, 0))
    in_view = np.linalg.norm(middles - now, axis=1) < radius - 0.02
    was_seen = np.linalg.norm(middles - before, axis=1) < radius - 0.02
    far = (np.linalg.norm(middles - now, axis=1) > radius + 0.02) & (
        np.linalg.norm(middles - before, axis=1) > radius + 0.02
    )
    assert np.all(colours[in_view] == IN_VIEW) and in_view.any()
    only_before = was_seen & (np.linalg.norm(middles - now, axis=1) > radius + 0.02)
    assert np.all(colours[only_before] == SEEN) and only_before.any()
    assert np.all(colours[far] == UNSEEN) and far.any()
    seen.look(np.zeros((0, 4, 4)), False)
    assert not np.any(np.all(seen.face_colours() == IN_VIEW, axis=1))


def test_nothing_is_in_view_in_a_transit_after_a_scan():
    """Between two frames a scan ended: its views count, but none of them is now."""
    motion = motions()[0]
    seen, end = SeenSurface(stage(), stage().subject.scanner), SCAN_END_S
    views = _views(Frame(motion, end - 0.5), Frame(motion, end + 0.5))
    assert 5 <= len(views) <= 8 and not motion.is_scanning(end + 0.5)
    seen.look(views, motion.is_scanning(end + 0.5))
    assert seen.share > 0.1
    assert not np.any(np.all(seen.face_colours() == IN_VIEW, axis=1))
    seen.look(views, True)
    assert np.any(np.all(seen.face_colours() == IN_VIEW, axis=1))


def test_views_of_another_station_are_not_taken_in_again():
    first, second = motions()
    assert len(_views(Frame(first, 14.0), Frame(second, 0.5))) == 0
    whole = _views(None, Frame(second, 7.0))
    # All of the scan from 1 s to 6 s, ten a second; its points are among them.
    assert 50 <= len(whole) <= 60
    gaps = np.linalg.norm(whole[:, None, :3, 3] - scene.PATH.positions[None, second.points], axis=2)
    assert gaps.min(axis=0) == pytest.approx(0.0, abs=1e-6)


def test_the_animation_shows_the_seen_area_growing():
    shown = [image[HEAD_PX:] for image, _ in frames_of(gif())]

    def green(image):
        hues = image / np.maximum(np.linalg.norm(image, axis=2, keepdims=True), 1.0)
        return (np.linalg.norm(hues - hue(SEEN), axis=2) < 0.03).sum()

    assert green(shown[0]) == 0
    assert green(shown[-1]) > green(shown[len(shown) // 2]) > 200


def test_the_colours_of_a_frame_survive_the_file():
    drawn = [image for _, image in drawn_frames(stage(), WIDTH)]
    for number in (0, len(drawn) // 3, len(drawn) - 1):
        before = np.asarray(drawn[number]).astype(float)
        after = next(itertools.islice(frames_of(gif()), number, None))[0]
        assert np.abs(after - before).max(axis=2).mean() < 3.0
    assert len(shown_colours(stage().subject)) >= 7


def test_a_file_that_is_too_large_is_made_smaller():
    small = motion_gif(stage(), width_px=WIDTH, most_bytes=len(gif()) // 2)
    assert len(small) <= len(gif()) // 2
    assert len(list(frames_of(small))) == len(list(frames_of(gif())))


def test_the_same_plan_gives_the_same_bytes():
    again = Stage(scene.subject_of((scene.first_station(), scene.second_station())))
    assert motion_gif(again, width_px=WIDTH) == gif()


def test_stations_without_a_motion_are_left_out():
    one = Stage(scene.subject_of(((), scene.second_station())))
    numbers = {frame.motion.number for frame in moments(station_motions(one.subject)[1:])[1]}
    assert numbers == {1}
    data = motion_gif(one, width_px=WIDTH)
    assert len(list(frames_of(data))) == len(moments(motions()[1:])[1])
    for nothing in (((), ()), (None, None)):
        with pytest.raises(InputError, match="with a motion"):
            motion_gif(Stage(scene.subject_of(nothing)), width_px=WIDTH)


def test_names_may_have_any_letters_and_any_length():
    for name in ("Flügelschale – обшивка", "a very long name " * 20):
        shown = dataclasses.replace(stage().subject, part_id=name)
        _, image = next(drawn_frames(Stage(shown), WIDTH))
        head = np.asarray(image)[:22].min(axis=2)
        dark = np.flatnonzero((head < 128).any(axis=0))
        assert dark.min() >= 6 and dark.max() < image.width - 6


def test_the_animation_is_written_beside_the_pictures(tmp_path):
    told = []
    subject = scene.subject_of((None, scene.second_station()))
    written = write_pictures(
        subject, tmp_path, lambda share, text: told.append(share), animate=True
    )
    assert [file.name for file in written[-4:]] == [
        "order.png", "joints.png", "timeline.png", "motion.gif",
    ]  # fmt: skip
    assert written[-1].read_bytes().startswith(b"GIF89a")
    assert told == sorted(told) and 0.0 <= told[0] and told[-1] <= 1.0 + 1e-9
