"""The pictures of the timed motion: which colour is where and when, and what the words say."""

import dataclasses
import functools
from io import BytesIO

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from PIL import Image

import motion_scene as scene
from skinplan.errors import InputError
from skinplan.robot.arm import ArmModel
from skinplan.stations.model import SkippedPoint
from skinplan.trajectory.model import SCAN, TRANSIT
from skinplan.transforms import difference
from skinplan.view import palette, reasons
from skinplan.view.joints_picture import (
    LIMIT,
    acceleration_shares,
    joints_figure,
    position_shares,
    scan_speed,
    velocity_shares,
)
from skinplan.view.motion import station_motions
from skinplan.view.order_picture import not_passed, numbered, order_figure
from skinplan.view.pictures import figures
from skinplan.view.sheet import png
from skinplan.view.stage import Stage
from skinplan.view.timeline_picture import (
    BOUND,
    DRIVE,
    SCANNING,
    SETTLE,
    station_spans,
    sums,
    timeline_figure,
)
from skinplan.view.timeline_picture import TRANSIT as TRANSIT_BAR


@functools.cache
def subject():
    return scene.subject_of((scene.first_station(), scene.second_station()))


@functools.cache
def motions():
    return station_motions(subject())


@functools.cache
def stage():
    return Stage(subject())


@functools.cache
def order():
    return order_figure(stage())


def drawn(figure):
    picture = Image.open(BytesIO(png(figure))).convert("RGB")
    return np.asarray(picture).astype(float) / 255.0


def colour_at(figure, image, axes, place):
    column, up = axes.transData.transform(place)
    return image[round(figure.bbox.height - up), round(column)]


def labels(figure):
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


def words(figure):
    return " ".join(text.get_text() for text in figure.texts)


def marks(axes, shape):
    found = [np.array(line.get_xydata()) for line in axes.lines if line.get_marker() == shape]
    return np.concatenate([np.zeros((0, 2)), *found])


def test_segments_follow_each_other_on_one_clock():
    first, second = motions()
    assert first.spans.ravel().tolist() == [0, 2, 2, 6, 6, 9, 9, 12, 12, 14]
    assert second.duration_s == 7.0
    assert first.kinds.tolist() == [TRANSIT, SCAN, TRANSIT, SCAN, TRANSIT]
    assert first.points.tolist() == [*range(22, 27), *range(11, 15)]
    assert first.point_s.tolist() == [2, 3, 4, 5, 6, 9, 10, 11, 12]
    assert first.break_s.tolist() == [6.0] and len(second.break_s) == 0
    assert [first.is_scanning(t) for t in (0.0, 1.9, 2.0, 4.4, 7.5, 10.0, 13.0)] == [
        False, False, True, True, False, True, False,
    ]  # fmt: skip


def test_the_scanner_is_at_the_points_when_they_are_passed():
    for motion in motions():
        poses = motion.scanner(motion.joints(motion.point_s))
        assert poses[:, :3, 3] == pytest.approx(scene.PATH.positions[motion.points], abs=1e-6)
        assert poses[:, :3, 0] == pytest.approx(scene.PATH.directions[motion.points], abs=1e-6)
        assert motion.joints(np.array([-1.0, 0.0, 99.0])) == pytest.approx(
            np.tile(scene.HOME, (3, 1))
        )


def test_the_speed_is_the_finite_difference_of_the_way():
    motion = motions()[0]
    for sample in range(3, 6):
        q, v = motion.positions[sample], motion.velocities[sample]
        ends = scene.ARM.forward_scanner(np.stack([q - 1e-4 * v, q + 1e-4 * v]))[:, :3, 3]
        speed = np.linalg.norm(ends[1] - ends[0]) / 2e-4
        assert motion.speeds[sample] == pytest.approx(speed, rel=1e-4)
        assert speed > 0.05
    ends, rates = motion.accelerations
    assert np.all(np.diff(ends, axis=1) > 0.0)
    assert rates[0] == pytest.approx(np.zeros(6))  # the transit by hand has no velocity
    assert rates[1] == pytest.approx(motion.velocities[3] / 1.0)


def test_the_scan_has_the_colour_of_its_time_where_it_is():
    figure, longest = order(), 14.0
    image = drawn(figure)
    for axes, motion in zip(figure.axes, motions(), strict=False):
        for begin, end in motion.scan_spans:
            for time in np.linspace(begin, end, 9)[1::2] + 0.06:  # between points and marks
                pose = motion.scanner(motion.joints(np.array([min(time, end - 0.2)])))
                place = stage().front.view.plane(pose[:, :3, 3])[0]
                wanted = palette.time_colours(np.array([min(time, end - 0.2) / longest]))[0]
                found = colour_at(figure, image, axes, place)
                assert found == pytest.approx(wanted, abs=0.08), (motion.name, time)


def test_colours_of_time_are_told_apart():
    colours = palette.time_colours(np.linspace(0.0, 1.0, 6))
    assert np.linalg.norm(np.diff(colours, axis=0), axis=1).min() > 0.15
    grey = colours @ [0.3, 0.59, 0.11]
    assert np.all(np.diff(grey) > 0.05) and grey[-1] < 0.8
    assert palette.time_colours(np.array([-3.0, 7.0])) == pytest.approx(colours[[0, -1]])


def test_the_bar_of_time_has_the_colours_of_the_way():
    figure = order()
    axes = figure.axes[-1]
    assert axes.get_xlim() == (0.0, 14.0)
    assert "[s]" in axes.get_xlabel()
    image = drawn(figure)
    for time in (0.5, 5.0, 9.0, 13.5):
        wanted = palette.time_colours(np.array([time / 14.0]))[0]
        assert colour_at(figure, image, axes, (time, 0.5)) == pytest.approx(wanted, abs=0.03)


def test_transits_are_thin_and_dashed_and_between_the_scans():
    for axes, motion in zip(order().axes, motions(), strict=False):
        dashed = [line for line in axes.lines if line.is_dashed()]
        assert len(dashed) == (motion.kinds == TRANSIT).sum()
        widths = [c.get_linewidths()[0] for c in axes.collections]
        assert len(widths) == (motion.kinds == SCAN).sum()
        assert max(line.get_linewidth() for line in dashed) < 0.5 * min(widths)
        for line, segment in zip(dashed, np.flatnonzero(motion.kinds == TRANSIT), strict=True):
            ends = motion.scanner(motion.joints(motion.spans[segment]))[:, :3, 3]
            assert line.get_xydata()[[0, -1]] == pytest.approx(stage().front.view.plane(ends))


def test_start_end_breaks_and_points_are_marked_where_they_are():
    view = stage().front.view
    for axes, motion in zip(order().axes, motions(), strict=False):
        home = view.plane(motion.scanner(scene.HOME[None])[:, :3, 3])
        assert marks(axes, ">") == pytest.approx(home)
        assert marks(axes, "s") == pytest.approx(home)
        broken = motion.scanner(motion.joints(motion.break_s))[:, :3, 3]
        assert marks(axes, "D") == pytest.approx(view.plane(broken).reshape(-1, 2))
        places = view.plane(scene.PATH.positions[motion.points])
        assert marks(axes, "o") == pytest.approx(places, abs=1e-6)
        texts = {t.get_text(): t.xy for t in axes.texts}
        assert {"1", str(len(motion.points))} <= set(texts)
        for text, place in texts.items():
            assert place == pytest.approx(places[int(text) - 1], abs=1e-6)


def test_breaks_and_skipped_points_are_counted():
    figure = order()
    assert "15 points, 1 break " in words(figure)
    assert "1 break: the scan stops here, to go on elsewhere" in labels(figure)
    assert "1 not scanned: collision" in labels(figure)
    assert "1 × collision of wrist with part" in words(figure)
    titles = [axes.get_title("left") for axes in figure.axes]
    assert titles[0] == "station 0: 9 points, 1 break, 14.0 s, 1 point skipped"
    assert titles[1] == "station 1: 6 points, 0 breaks, 7.0 s"
    crosses = marks(figure.axes[0], "x")
    wanted = stage().front.view.plane(scene.PATH.positions[[scene.SKIPPED.point]])
    assert crosses == pytest.approx(wanted)
    assert len(marks(figure.axes[1], "x")) == 0


def test_what_no_station_reaches_is_crossed_at_every_station():
    lost = SkippedPoint(50, "out of the arm's reach")
    both = (scene.first_station(), scene.second_station())
    figure = order_figure(Stage(scene.subject_of(both, of_stations=(lost,))))
    place = stage().front.view.plane(scene.PATH.positions[[50]])
    for axes in figure.axes[:2]:
        cross = [li for li in axes.lines if to_rgb(li.get_color()) == reasons.OUT_OF_REACH.colour]
        assert any(np.allclose(line.get_xydata(), place) for line in cross)
    assert "2 points not scanned" in words(figure)


def test_a_point_that_another_station_passes_is_not_missing():
    entries = (SkippedPoint(27, "joint limits"), SkippedPoint(40, "joint limits"))
    assert not_passed(motions(), entries) == entries[1:]


def test_numbers_do_not_lie_on_each_other():
    rng = np.random.default_rng(2)
    flat = rng.uniform(0.0, 1.0, (200, 2))
    chosen = numbered(flat, 0.1)
    assert chosen == sorted(set(chosen)) and chosen[0] == 0 and 199 in chosen
    assert 5 < len(chosen) < 20
    for one in chosen:
        for other in chosen:
            assert one == other or np.abs(flat[one] - flat[other]).max() >= 0.1
    assert numbered(np.zeros((0, 2)), 0.1) == []
    assert numbered(np.zeros((2, 2)), 0.1) == [0]
    assert numbered(np.array([[0.0, 0.0], [1.0, 0.0]]), 0.1) == [0, 1]


def test_the_joints_are_drawn_as_shares_of_their_limits():
    figure = joints_figure(subject())
    assert len(figure.axes) == 8  # two stations beside each other
    for column, motion in enumerate(motions()):
        positions, velocities, rates, speed = figure.axes[column::2]
        for axes, shares in ((positions, position_shares), (velocities, velocity_shares)):
            lines = [line for line in axes.lines if len(line.get_xdata()) == len(motion.times)]
            found = np.stack([line.get_ydata() for line in lines], axis=1)
            assert found == pytest.approx(shares(motion))
            assert lines[0].get_xdata() == pytest.approx(motion.times)
        drawn_speed = next(li for li in speed.lines if to_rgb(li.get_color()) == palette.INK)
        assert drawn_speed.get_ydata() == pytest.approx(motion.speeds)
        for axes in (positions, velocities, rates):
            assert limits(axes) == [-1.0, 1.0]
            assert axes.get_ylim()[0] < -1.0 and axes.get_ylim()[1] > 1.0
            assert axes.get_xlim() == (0.0, motion.duration_s)
        assert limits(speed) == [scene.SCAN_SETTINGS.tcp_speed_m_s]


def limits(axes):
    return sorted(float(li.get_ydata()[0]) for li in axes.lines if to_rgb(li.get_color()) == LIMIT)


def test_a_joint_at_its_limit_has_the_share_1():
    arm = scene.ARM
    at = np.stack([arm.lower, arm.upper, 0.5 * (arm.lower + arm.upper)])
    fast = scene.segment(SCAN, [0.0, 1.0, 2.0], at, ())
    fast = dataclasses.replace(fast, velocities=np.outer([1.0, -0.5, 0.0], arm.velocity))
    motion = station_motions(scene.subject_of(((fast,), None)))[0]
    assert position_shares(motion) == pytest.approx(np.outer([-1.0, 1.0, 0.0], np.ones(6)))
    assert velocity_shares(motion) == pytest.approx(np.outer([1.0, -0.5, 0.0], np.ones(6)))
    rates = acceleration_shares(motion, 5.0)
    assert rates[0] == pytest.approx(-1.5 * arm.velocity / 5.0)
    told = labels(joints_figure(scene.subject_of(((fast,), None))))
    name = ArmModel.load(scene.CELL).joint_names[2].removesuffix("_joint")
    share = 100.0 * 1.5 * arm.velocity[2] / 5.0
    assert f"{name}: position 100 %, velocity 100 %, acceleration {share:.0f} % at most" in told


def test_the_legend_says_the_largest_speed_of_the_scan_only():
    told = [text for text in labels(joints_figure(subject())) if text.startswith("scanner")]
    fastest = max(scan_speed(motion) for motion in motions())
    share = 100.0 * fastest / scene.SCAN_SETTINGS.tcp_speed_m_s
    expected = f"scanner: at most {fastest:.3f} m/s while scanning, {share:.0f} % of its limit"
    assert told == [expected]
    assert scan_speed(station_motions(scene.subject_of((scene.first_station()[:1], None)))[0]) == 0


def test_what_is_done_is_shaded():
    axes = joints_figure(subject()).axes[0]
    spans = [(p.get_x(), p.get_x() + p.get_width(), p.get_facecolor()) for p in axes.patches]
    assert [span[:2] for span in spans] == [tuple(span) for span in motions()[0].spans]
    assert spans[0][2] == spans[2][2] != spans[1][2] == spans[3][2]


def test_the_sums_of_the_timeline_are_the_cycle_time():
    shown, cycle = subject(), subject().cycle
    spans = station_spans(shown, motions())
    total = sums([span for own in spans for span in own])
    assert total[SCANNING] == pytest.approx(cycle.scan_s) == 12.0
    assert total[TRANSIT_BAR] == pytest.approx(cycle.transit_s) == 9.0
    assert total[DRIVE] + total[SETTLE] == pytest.approx(cycle.base_s)
    drive = difference(*scene.POSES)[0] / scene.CELL.base_speed_m_s
    assert sums(spans[0])[DRIVE] == 0.0
    assert sums(spans[1])[DRIVE] == pytest.approx(drive) == 0.6
    everything = [span for own in spans for span in own]
    assert everything[0].begin_s == 0.0
    assert everything[-1].end_s == pytest.approx(cycle.cycle_s)
    for one, after in zip(everything, everything[1:], strict=False):
        assert after.begin_s == pytest.approx(one.end_s)


def test_the_bars_stand_where_the_times_are():
    figure = timeline_figure(subject())
    image = drawn(figure)
    clock, bars = figure.axes
    for row, (time, colour) in enumerate([(5.0 + 4.0, SCANNING), (19.0 + 0.6 + 2.0, SETTLE)]):
        found = colour_at(figure, image, clock, (time, row))
        assert found == pytest.approx(np.array(colour), abs=0.05)
    total = 2
    for time, colour in ((0.3, DRIVE), (2.0, SETTLE), (11.5, TRANSIT_BAR), (31.0, SCANNING)):
        found = colour_at(figure, image, bars, (time, total))
        assert found == pytest.approx(np.array(colour), abs=0.05), time
    bound = subject().cycle.lower_bound_s
    assert bound > 0.0
    assert colour_at(figure, image, bars, (0.9 * bound, 3)) == pytest.approx(
        np.array(BOUND), abs=0.05
    )
    assert colour_at(figure, image, bars, (bound + 3.0, 3)) == pytest.approx(np.ones(3), abs=0.2)
    texts = [text.get_text() for text in bars.texts]
    assert f"{subject().cycle.cycle_s:.1f} s" in texts and f"{bound:.1f} s" in texts


@pytest.mark.parametrize("bound", [0.0, np.nan])
def test_without_a_bound_none_is_drawn(bound):
    cycle = dataclasses.replace(subject().cycle, lower_bound_s=bound)
    figure = timeline_figure(dataclasses.replace(subject(), cycle=cycle))
    assert "no bound known" in [text.get_text() for text in figure.axes[1].texts]
    assert not any("least scan:" in text for text in labels(figure))
    assert "nan" not in words(figure)


def test_only_what_is_planned_is_drawn():
    all_of_it = list(figures(subject()))
    assert all_of_it[-3:] == ["order", "joints", "timeline"]
    bare = scene.subject_of((None, None))
    assert not {"order", "joints", "timeline"} & set(figures(bare))
    for draw in (joints_figure, timeline_figure):
        with pytest.raises(InputError, match="trajector"):
            draw(bare)
    with pytest.raises(InputError, match="trajector"):
        order_figure(Stage(bare))


def test_a_station_without_segments_is_told():
    skipped = ((scene.SKIPPED,), tuple(SkippedPoint(p, "joint limits") for p in range(27, 33)))
    shown = scene.subject_of((scene.first_station(), ()), skipped=skipped)
    figure = order_figure(Stage(shown))
    assert figure.axes[1].get_title("left") == "station 1: no motion, 6 points skipped"
    assert len(marks(figure.axes[1], "x")) == 6
    assert "6 not scanned: joint limits" in labels(figure)
    for draw in (figures(shown)[name] for name in ("order", "joints", "timeline")):
        assert png(draw()).startswith(b"\x89PNG")
    assert len(joints_figure(shown).axes) == 4


def test_all_points_skipped_still_gives_pictures():
    skipped = (tuple(SkippedPoint(p, "joint limits") for p in range(11, 27)), ())
    shown = scene.subject_of(((), ()), skipped=skipped)
    makers = figures(shown)
    assert "joints" not in makers and {"order", "timeline"} <= set(makers)
    figure = makers["order"]()
    assert "0 points, 0 breaks" in words(figure) and "16 points not scanned" in words(figure)
    assert len(figure.axes) == 2  # no bar of a time that does not pass
    png(makers["timeline"]())


def test_two_points_are_enough():
    q = scene.joints_at(0, np.array([22, 23]))
    way = (
        scene.segment(TRANSIT, [0, 1], [scene.HOME, q[0]]),
        scene.segment(SCAN, [0, 1], q, (22, 23)),
        scene.segment(TRANSIT, [0, 1], [q[1], scene.HOME]),
    )
    shown = scene.subject_of((way, None), skipped=((), ()))
    figure = order_figure(Stage(shown))
    assert {t.get_text() for t in figure.axes[0].texts} == {"1", "2"}
    assert "All points are scanned." in words(figure)


@pytest.mark.filterwarnings("error")
def test_a_motion_without_duration_has_no_time_to_divide_by():
    still = scene.segment(SCAN, [0.0], scene.joints_at(0, np.array([22])), (22,))
    shown = scene.subject_of(((still,), None), skipped=((), ()))
    figure = order_figure(Stage(shown))
    png(figure)
    assert len(figure.axes) == 1 and "1 point, 0 breaks" in words(figure)
    png(timeline_figure(shown))
    with pytest.raises(InputError, match="with a motion"):
        joints_figure(shown)


def test_values_that_are_not_finite_never_reach_a_picture():
    good = scene.first_station()
    for name in ("positions", "velocities", "times"):
        values = np.array(getattr(good[1], name))
        values[1] = np.nan
        bad = (good[0], dataclasses.replace(good[1], **{name: values}), *good[2:])
        with pytest.raises(InputError, match="finite"):
            station_motions(scene.subject_of((bad, None)))
    short = (good[0], dataclasses.replace(good[1], point_s=np.zeros(2)))
    with pytest.raises(InputError, match="one time for each"):
        station_motions(scene.subject_of((short, None)))


def test_a_trajectory_of_no_station_is_refused():
    stranger = dataclasses.replace(subject().trajectories[0], station_id=7)
    with pytest.raises(InputError, match="found one of station 7"):
        station_motions(dataclasses.replace(subject(), trajectories=(stranger,)))


@pytest.mark.filterwarnings("error")
def test_names_may_have_any_letters():
    shown = dataclasses.replace(subject(), part_id=r"Flügelschale Ø3 – обшивка $\x_1$")
    for name in ("order", "joints", "timeline"):
        figure = figures(shown)[name]()
        assert png(figure).startswith(b"\x89PNG")
        assert words(figure).startswith(r"Flügelschale Ø3 – обшивка $\x_1$:")


def test_the_same_plan_gives_the_same_bytes():
    makers = figures(subject())
    for name in ("order", "joints", "timeline"):
        assert png(makers[name]()) == png(makers[name]())


@pytest.mark.parametrize("name", ["order", "joints", "timeline"])
def test_no_text_lies_on_another(name):
    figure = figures(subject())[name]()
    png(figure)
    renderer = figure.canvas.get_renderer()
    boxes = [text.get_window_extent(renderer) for text in figure.texts]
    boxes += [legend.get_window_extent(renderer) for legend in figure.legends]
    boxes += [axes.get_tightbbox(renderer) for axes in figure.axes]
    for number, box in enumerate(boxes):
        assert box.x0 >= 0 and box.x1 <= figure.bbox.x1 + 1
        for other in boxes[:number]:
            assert (
                box.x0 >= other.x1 - 1 or other.x0 >= box.x1 - 1
                or box.y0 >= other.y1 - 1 or other.y0 >= box.y1 - 1
            ), (box, other)  # fmt: skip
