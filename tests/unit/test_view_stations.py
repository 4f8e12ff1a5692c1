"""The plan of the floor and the picture of the reach: what is where, and what their words say."""

import dataclasses
import functools
from io import BytesIO

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.patches import Polygon
from PIL import Image

from reach_scene import UPRIGHT, flat_panel, flat_path
from skinplan.errors import InputError
from skinplan.mesh.model import Segmentation
from skinplan.part.model import ScanSettings
from skinplan.robot.cell import CellConfig, Obstacle
from skinplan.robot.collision import CollisionWorld
from skinplan.robot.records import FIRST_PAIR
from skinplan.robot.tracker import TrackerSight
from skinplan.stations.candidate_map import BLOCKED, NOT_TRIED, CandidateMap
from skinplan.stations.model import SkippedPoint
from skinplan.stations.plan import plan_stations
from skinplan.stations.rectangle import Rectangle
from skinplan.transforms import apply, planar, transform
from skinplan.view import palette, reasons
from skinplan.view.camera import front_view, is_upside_down, raised_view
from skinplan.view.candidate_marks import candidate_places, count_colours
from skinplan.view.floor import proof_sentence, reach_sentence, stations_figure
from skinplan.view.floor_marks import floor_places, rectangle_corners
from skinplan.view.reach_picture import kinds_of_station, reach_figure
from skinplan.view.sheet import png
from skinplan.view.stage import Stage
from skinplan.view.subject import Subject
from skinplan.view.tracker_marks import tracker_margin

CABINET = Obstacle("cabinet", transform((1.4, -0.6, 0.4)), (0.3, 0.4, 0.8))
CELL = CellConfig(obstacles=(CABINET,))
PATH, PANEL = flat_path(1.2, 0.6, 0.3), flat_panel(1.2, 0.6)
HIGH = transform((0.1, 0.05, 1.95), UPRIGHT)  # the upper points are beyond the arm


@functools.cache
def planned(strategy):
    settings = ScanSettings(station_strategy=strategy)
    plan = plan_stations(PATH, HIGH, PANEL, settings, CELL)
    return Subject(
        "high", PANEL, Segmentation(np.zeros(len(PANEL.faces), dtype=np.int64), PANEL), path=PATH,
        station_plan=plan, skipped=plan.skipped, T_map_workpiece=HIGH, cell=CELL,
    )  # fmt: skip


@pytest.fixture(scope="module", params=["rectangles", "reach"])
def subject(request):
    return planned(request.param)


@pytest.fixture(scope="module")
def by_reach():
    return planned("reach")


@pytest.fixture(scope="module")
def by_rectangles():
    return planned("rectangles")


@functools.cache
def stage_of(subject):
    return Stage(subject)


@functools.cache
def floor_figure(subject):
    return stations_figure(subject)


@functools.cache
def front_figure(subject):
    return reach_figure(stage_of(subject))


def colour_at(figure, image, axes, place):
    """Colour of the picture at a place of the axes [m], in [0, 1]."""
    column, up = axes.transData.transform(place)
    return image[round(figure.bbox.height - up), round(column), :3]


def drawn(figure):
    picture = Image.open(BytesIO(png(figure))).convert("RGB")
    return np.asarray(picture).astype(float) / 255.0


def labels(figure):
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


def words(figure):
    return " ".join(text.get_text() for text in figure.texts)


def test_points_have_the_colour_of_their_station_in_the_front_view(subject):
    stage = stage_of(subject)
    figure = front_figure(subject)
    image, owner = drawn(figure), subject.station_of_points()
    assert 0 < (owner >= 0).sum() < len(owner)
    places = stage.front.view.plane(PATH.positions)
    kinds = reasons.kinds_of_points(subject.skipped)
    wanted = {point: kind.colour for kind, points in kinds.items() for point in points}
    wanted |= {int(p): palette.series(int(owner[p])) for p in np.flatnonzero(owner >= 0)}
    assert sorted(wanted) == list(range(len(PATH)))
    for point, colour in wanted.items():
        found = colour_at(figure, image, figure.axes[0], places[point])
        assert found == pytest.approx(np.array(colour), abs=0.12), point


def test_points_have_the_colour_of_their_station_on_the_floor(subject):
    figure = floor_figure(subject)
    image, owner, places = drawn(figure), subject.station_of_points(), floor_places(subject)
    assert (owner >= 0).any()
    for place in np.unique(places.round(6), axis=0):
        # Points above each other: what is reached lies on top of what is not.
        here = owner[np.linalg.norm(places - place, axis=1) < 1e-6]
        if here.max() < 0:
            continue
        shown = colour_at(figure, image, figure.axes[0], place)
        assert shown == pytest.approx(np.array(palette.series(int(here.max()))), abs=0.12)


def test_a_cross_stands_at_every_point_that_is_not_scanned(subject):
    axes = floor_figure(subject).axes[0]
    crosses = {
        to_rgb(line.get_color()): np.array(line.get_xydata())
        for line in axes.lines
        if line.get_marker() == "x" and len(line.get_xydata()) and line.get_zorder() == 5
    }
    places = floor_places(subject)
    kinds = reasons.kinds_of_points(subject.skipped)
    assert set(crosses) == {kind.colour for kind in kinds}
    for kind, points in kinds.items():
        assert crosses[kind.colour] == pytest.approx(places[points])


def test_the_legend_counts_the_points_and_the_reasons(subject):
    for figure in (floor_figure(subject), front_figure(subject)):
        told = labels(figure)
        owner = subject.station_of_points()
        for number, station in enumerate(subject.station_plan.stations):
            assert f"station {station.id}: {(owner == number).sum()} points" in told
        for kind, points in reasons.kinds_of_points(subject.skipped).items():
            assert f"{len(points)} not scanned: {kind.name}" in told
        assert f"{len(subject.skipped)} points not scanned" in words(figure)
        for reason in reasons.reason_of_points(subject.skipped).values():
            assert reason in words(figure)


def test_the_words_say_true_and_robust_reach(by_reach, by_rectangles):
    told = reach_sentence(by_reach)
    share = 1.0 - len(by_reach.skipped) / len(PATH)
    assert f"{np.floor(1000 * share) / 10:.1f} %" in told
    assert "50 mm and 1.0°" in told
    assert "not asked" in reach_sentence(by_rectangles)
    whole = dataclasses.replace(by_reach.station_plan, reached_ratio=0.99999, robust_ratio=1.0)
    told = reach_sentence(dataclasses.replace(by_reach, station_plan=whole))
    assert "reaches 99.9 %" in told and ", 100.0 % also" in told
    assert reach_sentence(dataclasses.replace(by_reach, station_plan=None)) == ""


def test_the_title_says_the_bound(by_reach):
    plan = dataclasses.replace(
        by_reach.station_plan, candidates=9, lower_bound=1, proven_optimal=False
    )
    count = len(plan.stations)
    bound = dataclasses.replace(plan, lower_bound=count)
    assert proof_sentence(plan).endswith("of 9 candidates, at least 1 needed")
    assert proof_sentence(dataclasses.replace(plan, lower_bound=0)).endswith("no bound known")
    proven = dataclasses.replace(bound, proven_optimal=True)
    assert proof_sentence(proven).endswith("proven minimal")
    # A chosen place was not free: the proof is not about what is left.
    left = dataclasses.replace(proven, lower_bound=count + 1)
    assert f"{count + 1} were needed" in proof_sentence(left)
    assert proof_sentence(by_reach.station_plan) in words(floor_figure(by_reach))


def test_a_rectangle_moves_with_its_base():
    rectangle = Rectangle(1.1, 0.3, 0.6)
    cell = dataclasses.replace(CELL, T_base_link_arm_base=transform((0.2, -0.1, 1.0)))
    at_home = rectangle_corners(np.eye(4), cell, rectangle)
    assert at_home.mean(axis=0) == pytest.approx([0.2, 0.5])
    assert np.ptp(at_home, axis=0) == pytest.approx([1.1, 0.3])
    pose = planar(2.0, -1.0, 0.7)
    flat = np.concatenate([at_home, np.zeros((4, 1))], axis=1)
    assert rectangle_corners(pose, cell, rectangle) == pytest.approx(apply(pose, flat)[:, :2])


def test_candidates_of_rectangles_count_what_lies_in_their_rectangle(by_rectangles):
    seen = by_rectangles.station_plan.candidates_seen
    assert len(seen) == by_rectangles.station_plan.candidates
    places = floor_places(by_rectangles)
    for pose, count in zip(seen.poses, seen.counts, strict=True):
        corners = rectangle_corners(pose, CELL, seen.rectangle)
        low, high = corners.min(axis=0) - 1e-6, corners.max(axis=0) + 1e-6
        assert np.all((places >= low) & (places <= high), axis=1).sum() == count
    figure = floor_figure(by_rectangles)
    patches = [p.get_xy()[:4] for p in figure.axes[0].patches if isinstance(p, Polygon)]
    for station in by_rectangles.station_plan.stations:
        corners = rectangle_corners(station.T_map_base_link, CELL, seen.rectangle)
        assert any(np.allclose(corners, patch) for patch in patches)
    title = figure.axes[2].get_title("left")
    assert f"the {len(seen)} candidate rectangles" in title
    assert f"{seen.rectangle.length_m:.2f}" in title and f"{seen.rectangle.depth_m:.2f}" in title
    assert len(figure.axes[2].collections[-1].get_paths()) == len(seen)


def test_candidates_of_reach_are_all_on_the_plan(by_reach):
    plan = by_reach.station_plan
    seen = plan.candidates_seen
    assert seen.tried.sum() == plan.candidates
    assert seen.blocked.any()
    figure = floor_figure(by_reach)
    axes = figure.axes[0]
    places = candidate_places(seen, CELL)
    dots = next(c for c in axes.collections if len(c.get_offsets()) == seen.tried.sum())
    counts = seen.counts[seen.tried]
    order = np.argsort(counts, kind="stable")
    assert np.array(dots.get_offsets()) == pytest.approx(places[seen.tried][order])
    shown = count_colours(counts[order], int(counts.max()))
    assert dots.get_facecolors() == pytest.approx(shown)
    grey = [np.array(line.get_xydata()) for line in axes.lines if line.get_marker() == "x"]
    assert any(len(g) and np.array_equal(g, places[seen.blocked]) for g in grey)
    assert f"{seen.blocked.sum()} × not free for base or arm" in labels(figure)
    assert f"candidate that robustly reaches {counts.max()} points" in labels(figure)


def test_the_map_of_candidates_agrees_with_the_plan(by_reach):
    plan = by_reach.station_plan
    seen = plan.candidates_seen
    for number, station in enumerate(plan.stations):
        gaps = np.abs(seen.poses - station.T_map_base_link).max(axis=(1, 2))
        row = int(np.argmin(gaps))
        assert gaps[row] < 1e-9
        # The records try finer tilts than the choice: they may reach more.
        assert 0 < seen.counts[row] <= plan.records.reached[number].sum()
        assert plan.robust[number].sum() <= seen.counts[row]
    mesh = PANEL
    T_arm = seen.poses[seen.tried][0] @ CELL.T_base_link_arm_base
    world = CollisionWorld(CELL, mesh, np.linalg.inv(T_arm) @ HIGH, np.linalg.inv(T_arm))
    assert world.pair(np.array(CELL.home_rad)) is None


def test_more_points_are_darker():
    colours = count_colours(np.arange(11), 10)
    assert np.all(np.diff(colours[:, :3].sum(axis=1)) < 0)
    assert count_colours(np.zeros(1, dtype=np.int64), 0).shape == (1, 4)


@pytest.mark.parametrize("shape", [(2, 4, 4), (3, 4), (3, 3, 3)])
def test_a_map_that_does_not_fit_its_counts_is_refused(shape):
    with pytest.raises(InputError, match="3 candidates"):
        CandidateMap(np.zeros(shape), np.array([1, BLOCKED, NOT_TRIED]))
    poses = np.tile(np.eye(4), (3, 1, 1))
    assert CandidateMap(poses, np.array([1, BLOCKED, NOT_TRIED])).tried.tolist() == [1, 0, 0]
    with pytest.raises(InputError, match="finite"):
        CandidateMap(np.full((3, 4, 4), np.nan), np.zeros(3, dtype=np.int64))


def test_every_reason_of_the_records_has_its_kind(by_reach):
    table = by_reach.station_plan.records
    kinds = [reasons.kind_of(table.reason(code)) for code in range(1, FIRST_PAIR)]
    assert kinds == [reasons.OUT_OF_REACH, reasons.SINGULAR, reasons.LIMITS]
    first = FIRST_PAIR + len(table.pairs)
    for code in range(FIRST_PAIR, first):
        assert reasons.kind_of(table.reason(code)) is reasons.COLLISION
    assert table.sights
    for code in range(first, first + len(table.sights)):
        assert reasons.kind_of(table.reason(code)) is reasons.HIDDEN
    assert reasons.kind_of("lost") is reasons.OTHER and reasons.kind_of("") is reasons.OTHER
    colours = [kind.colour for kind in reasons.KINDS]
    assert len(set(colours)) == len(colours) and not set(colours) & set(palette.SERIES)


def test_reasons_are_grouped_without_their_places():
    skipped = (
        SkippedPoint(4, "joint limits (at best, from (0.10, -0.85) m)"),
        SkippedPoint(2, "joint limits (at best, from (-1.25, 0.00) m)"),
        SkippedPoint(7, "reached only while the base stands exactly on its goal, at best, from "
                        "(0.10, -0.85) m"),
        SkippedPoint(2, "a later stage left it out, too"),
        SkippedPoint(9, "collision of wrist with part (no candidate covers it)"),
    )  # fmt: skip
    assert reasons.reason_of_points(skipped) == {
        4: "joint limits",
        2: "joint limits",
        7: "reached only while the base stands exactly on its goal",
        9: "collision of wrist with part (no candidate covers it)",
    }
    kinds = reasons.kinds_of_points(skipped)
    assert kinds == {reasons.LIMITS: [2, 4], reasons.COLLISION: [9], reasons.EXACT_BASE: [7]}
    told = reasons.skipped_sentence(skipped)
    assert told.startswith("4 points not scanned: 2 × joint limits; 1 × ")
    assert reasons.skipped_sentence(()) == "All points are scanned."
    many = tuple(SkippedPoint(n, f"collision of a with {n}") for n in range(9))
    assert reasons.skipped_sentence(many).endswith("; 4 × 4 other reasons.")


def test_a_station_s_panel_shows_all_points(by_reach):
    stage = stage_of(by_reach)
    figure = front_figure(by_reach)
    plan = by_reach.station_plan
    places = stage.front.view.plane(PATH.positions)
    for number, axes in enumerate(figure.axes[1:]):
        kinds = kinds_of_station(plan.records, number)
        left = np.sort(np.concatenate([*kinds.values(), np.zeros(0, dtype=np.int64)]))
        assert left.tolist() == np.flatnonzero(~plan.records.reached[number]).tolist()
        lines = [np.array(line.get_xydata()) for line in axes.lines]
        firm, only, *crosses = lines
        assert firm == pytest.approx(places[plan.robust[number]])
        reached = plan.records.reached[number]
        assert only == pytest.approx(places[reached & ~plan.robust[number]])
        assert sum(map(len, crosses)) == len(left)
        title = axes.get_title("left").replace("\n", " ")
        assert f"reaches {reached.sum()} of {len(PATH)}, {plan.robust[number].sum()} also" in title
    assert len(figure.axes) == 1 + len(plan.stations)


def test_without_records_and_candidates_the_pictures_are_smaller(by_reach):
    bare = dataclasses.replace(
        by_reach.station_plan, records=None, robust=None, candidates_seen=None
    )
    subject = dataclasses.replace(by_reach, station_plan=bare)
    assert len(front_figure(subject).axes) == 1
    assert len(floor_figure(subject).axes) == 2
    with pytest.raises(InputError, match="station plan"):
        reach_figure(Stage(dataclasses.replace(subject, station_plan=None)))


def test_the_field_of_the_tracker_is_where_it_sees_a_scanner():
    turn = np.array([[0.0, -0.8, -0.6], [1.0, 0.0, 0.0], [0.0, -0.6, 0.8]]).T
    cell = dataclasses.replace(CELL, T_map_tracker=transform((0.3, -3.0, 2.2), turn))
    rng = np.random.default_rng(3)
    places = cell.T_map_tracker[:3, 3] + rng.uniform(-7.0, 7.0, (4000, 3))
    margin = tracker_margin(cell.tracker, cell.T_map_tracker, places)
    clear = np.abs(margin) > 0.15  # the targets' ring is 0.1 m large
    scanners = np.tile(np.eye(4), (len(places), 1, 1))
    scanners[:, :3, 3] = places
    seen = TrackerSight(cell, None).in_view(scanners)
    assert 100 < (clear & seen).sum() < (clear & ~seen).sum()
    assert np.array_equal(margin[clear] > 0, seen[clear])


def test_obstacles_are_on_the_plan(by_reach):
    axes = floor_figure(by_reach).axes[0]
    patches = [p.get_xy()[:4] for p in axes.patches if isinstance(p, Polygon)]
    corners = [(1.55, -0.4), (1.25, -0.4), (1.25, -0.8), (1.55, -0.8)]
    assert any(np.allclose(patch, corners) for patch in patches)
    assert "cabinet" in [text.get_text() for text in axes.texts]


def test_the_tracker_is_on_the_plan_of_the_shop(subject):
    axes = floor_figure(subject).axes[1]
    marks = [line.get_xydata() for line in axes.lines if line.get_marker() == "^"]
    assert any(np.allclose(mark, CELL.T_map_tracker[:2, 3]) for mark in marks if len(mark) == 1)
    left, right = axes.get_xlim()
    bottom, top = axes.get_ylim()
    x, y = CELL.T_map_tracker[:2, 3]
    assert left < x < right and bottom < y < top


def test_a_proposed_tracker_is_shown_instead_of_the_cell_s(by_reach):
    proposed = CELL.T_map_tracker @ transform((0.0, 1.5, 0.0))
    plan = dataclasses.replace(by_reach.station_plan, T_map_tracker=proposed)
    axes = floor_figure(dataclasses.replace(by_reach, station_plan=plan)).axes[1]
    marks = [line.get_xydata() for line in axes.lines if line.get_marker() == "^"]
    assert any(np.allclose(mark, proposed[:2, 3]) for mark in marks if len(mark) == 1)
    assert not any(np.allclose(m, CELL.T_map_tracker[:2, 3]) for m in marks if len(m) == 1)


@pytest.mark.parametrize("turn", [0.0, np.pi])
def test_up_in_the_front_view_is_up_in_the_shop(turn):
    T_map_workpiece = HIGH @ planar(0.0, 0.0, turn)
    turned = is_upside_down(PANEL, T_map_workpiece)
    front = front_view(PANEL, 300, turned)
    assert T_map_workpiece[2, :3] @ front.up > 0.99
    assert T_map_workpiece[2, :3] @ raised_view(PANEL, 300, turned=turned).toward > 0.5
    assert front.toward == pytest.approx([0.0, 0.0, 1.0])
    lying = planar(0.0, 0.0, turn)
    assert not is_upside_down(PANEL, lying)


def test_the_stage_turns_what_is_upside_down():
    flat = Segmentation(np.zeros(len(PANEL.faces), dtype=np.int64), PANEL)
    for turn in (0.0, np.pi):
        T_map_workpiece = HIGH @ planar(0.0, 0.0, turn)
        stage = Stage(Subject("turned", PANEL, flat, T_map_workpiece=T_map_workpiece))
        assert T_map_workpiece[2, :3] @ stage.front.view.up > 0.99
