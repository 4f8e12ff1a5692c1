"""The pictures of a real plan: what is where in them, and what their words say."""

import dataclasses
from io import BytesIO

import numpy as np
import pytest
import trimesh
from matplotlib.patches import Polygon
from PIL import Image

import meshes
from skinplan.errors import InputError
from skinplan.mesh.model import Finding, Segmentation
from skinplan.part.model import ScanSettings
from skinplan.part.resolve import resolve_part
from skinplan.pipeline import plan_part
from skinplan.robot.cell import CellConfig
from skinplan.scan_path.model import FEATURE, ROW, ScanPath
from skinplan.scanner.coverage import certify
from skinplan.scanner.model import ScannerModel
from skinplan.scanner.sight import Sight
from skinplan.stations.model import SkippedPoint
from skinplan.transforms import planar
from skinplan.view.coverage_picture import coverage_title, holes_sentence, percent
from skinplan.view.display_mesh import DisplayMesh
from skinplan.view.face_classes import FaceClasses, coverage_classes, holes, region_classes
from skinplan.view.floor import stations_figure
from skinplan.view.floor_marks import arm_place, footprint
from skinplan.view.path_pictures import points_figure, rows_figure, rows_of
from skinplan.view.pictures import figures, write_pictures
from skinplan.view.reasons import skipped_sentence
from skinplan.view.regions_picture import boundary_edges, findings_sentence, region_labels
from skinplan.view.sheet import Page, Panel, class_handles, draw_page, png
from skinplan.view.stage import Stage
from skinplan.view.subject import Subject, subject_of_plan

BUMP_M = 0.06


@pytest.fixture(scope="module")
def plan(tmp_path_factory):
    surface = meshes.grid(0.5, 0.3, 0.01, lambda x, y: meshes.bump(x, y, 0.05, BUMP_M))
    file = tmp_path_factory.mktemp("view") / "panel.stl"
    trimesh.Trimesh(surface.vertices, surface.faces, process=False).export(file)
    return plan_part(resolve_part(str(file), "m"), CellConfig())


@pytest.fixture(scope="module")
def subject(plan):
    return subject_of_plan(plan, CellConfig())


@pytest.fixture(scope="module")
def stage(subject):
    return Stage(subject)


def image_of(data):
    return np.asarray(Image.open(BytesIO(data)).convert("RGB")).astype(float)


def shown_at(stage, image, point):
    """Hue of the picture at a point of space: shading changes only its length."""
    view = dataclasses.replace(
        stage.front.view,
        columns=image.shape[1],
        rows=image.shape[0],
        pixel_m=stage.front.view.pixel_m * stage.front.view.columns / image.shape[1],
    )
    row, column = view.pixels(np.array([point]))[0]
    colour = image[row, column, :3].astype(float)
    return colour / np.linalg.norm(colour)


def hue(colour):
    return np.asarray(colour, dtype=float) / np.linalg.norm(colour)


def test_all_pictures_of_a_plan_are_written(subject, tmp_path):
    told = []
    written = write_pictures(subject, tmp_path / "new", lambda share, text: told.append(share))
    names = [file.name for file in written]
    assert names == [
        f"{name}.png"
        for name in (
            "regions", "points", "rows", "coverage", "stations", "reach", "order", "joints",
            "timeline",
        )
    ]  # fmt: skip
    for file in written:
        picture = image_of(file.read_bytes())
        assert picture.shape[1] == 1600
        assert 400 < picture.shape[0] < 3000
        assert 0.02 < (picture < 250).any(axis=2).mean() < 0.98
    assert told == sorted(told) and len(told) == 9


def test_only_what_is_planned_is_drawn(subject):
    bare = Subject("bare", subject.mesh, subject.segmentation)
    assert list(figures(bare)) == ["regions"]
    with_path = dataclasses.replace(subject, coverage=None, station_plan=None)
    assert list(figures(with_path)) == ["regions", "points", "rows"]
    for draw in figures(bare).values():
        assert png(draw()).startswith(b"\x89PNG")


def test_a_region_has_its_colour_where_it_is(stage, subject):
    classes = region_classes(subject.mesh, subject.segmentation)
    assert len(classes.names) >= 2
    image = stage.image(stage.front, classes.of(stage.display).face_colours)
    top = subject.mesh.centroids[np.argmax(subject.mesh.centroids[:, 2])]
    region = classes.codes[np.argmin(np.linalg.norm(subject.mesh.centroids - top, axis=1))]
    assert region > 0
    assert shown_at(stage, image, top) == pytest.approx(hue(classes.colours[region]), abs=0.02)
    corner = [0.23, 0.13, 0.0]
    assert shown_at(stage, image, corner) == pytest.approx(hue(classes.colours[0]), abs=0.02)


def test_region_numbers_stand_on_their_regions(stage, subject):
    classes = region_classes(subject.mesh, subject.segmentation)
    labels = dict(region_labels(stage, classes))
    assert sorted(labels) == list(range(1, len(classes.names)))
    for number, (u, v) in labels.items():
        flat = stage.front.view.plane(subject.mesh.centroids)
        nearest = np.argmin(np.linalg.norm(flat - (u, v), axis=1))
        assert classes.codes[nearest] == number


def test_a_hole_has_the_colour_of_its_reason_where_it_is(stage, subject):
    coverage = subject.rows_only
    classes = coverage_classes(coverage, stage.display)
    image = stage.image(stage.front, classes.face_colours)
    steep = np.flatnonzero(classes.codes == Sight.TOO_OBLIQUE)
    assert len(steep)
    slope = stage.display.mesh.face_normals[steep] @ stage.front.view.toward
    face = steep[np.argmax(slope * np.sqrt(stage.display.mesh.face_areas[steep]))]
    place = stage.display.mesh.centroids[face]
    assert np.hypot(place[0], place[1]) == pytest.approx(BUMP_M, abs=0.03)
    wanted = hue(classes.colours[Sight.TOO_OBLIQUE])
    assert shown_at(stage, image, place) == pytest.approx(wanted, abs=0.1)
    flat = shown_at(stage, image, [0.2, 0.1, 0.0])
    assert flat == pytest.approx(hue(classes.colours[Sight.SEEN_OFTEN]), abs=0.02)


def test_the_marked_holes_are_all_of_what_is_not_seen(subject):
    coverage = subject.rows_only
    found = holes(coverage)
    unseen = coverage.views == 0
    assert sum(hole.area_m2 for hole in found) == pytest.approx(
        coverage.samples.weights[unseen].sum()
    )
    assert sum(len(hole.points) for hole in found) == unseen.sum()
    areas = [hole.area_m2 for hole in found]
    assert areas == sorted(areas, reverse=True)
    everything = dataclasses.replace(coverage, views=np.ones_like(coverage.views))
    assert holes(everything) == ()


def test_two_holes_apart_are_two(subject):
    coverage = subject.coverage
    points = coverage.samples.points
    views = np.full(len(points), 9)
    views[np.hypot(points[:, 0] - 0.2, points[:, 1]) < 0.02] = 0
    views[np.hypot(points[:, 0] + 0.2, points[:, 1]) < 0.04] = 0
    found = holes(dataclasses.replace(coverage, views=views))
    assert len(found) == 2
    assert found[0].points.mean(axis=0)[:2] == pytest.approx([-0.2, 0.0], abs=0.005)
    assert found[0].area_m2 == pytest.approx(np.pi * 0.04**2, rel=0.1)


def test_a_large_face_may_be_a_hole_in_part():
    plate = meshes.grid(0.8, 0.3, 0.8)
    assert len(plate.faces) == 2
    flat = Segmentation(np.zeros(2, dtype=np.int64), plate)
    path = ScanPath(
        positions=np.tile([-0.2, 0.0, 0.3], (3, 1)),
        directions=np.tile([0.0, 0.0, -1.0], (3, 1)),
        targets=np.tile([-0.2, 0.0, 0.0], (3, 1)),
        kinds=np.zeros(3, dtype=np.int64),
        groups=np.zeros(3, dtype=np.int64),
        strategy="by hand",
        regions=0,
    )
    scanner = ScannerModel.from_settings(ScanSettings())
    coverage = certify(plate, flat, path, scanner)
    stage = Stage(Subject("plate", plate, flat, path=path, scanner=scanner, coverage=coverage))
    classes = coverage_classes(coverage, stage.display)
    away = np.hypot(stage.display.mesh.centroids[:, 0] + 0.2, stage.display.mesh.centroids[:, 1])
    assert set(classes.codes[away < scanner.field_radius_m - 0.01]) == {Sight.SEEN_OFTEN}
    assert Sight.SEEN_OFTEN not in classes.codes[away > scanner.field_radius_m + 0.01]
    image = stage.image(stage.front, classes.face_colours)
    seen, unseen = (shown_at(stage, image, [x, 0.0, 0.0]) for x in (-0.2, 0.2))
    assert seen == pytest.approx(hue(classes.colours[Sight.SEEN_OFTEN]), abs=0.02)
    assert unseen == pytest.approx(hue(classes.colours[Sight.NOT_REACHED]), abs=0.02)


def test_words_say_the_figures_of_the_coverage(subject):
    title = coverage_title("row cutting alone", subject.rows_only)
    assert percent(subject.rows_only.area_ratio) in title
    assert percent(subject.rows_only.feature_area_ratio) in title
    told = holes_sentence("row cutting alone", subject.rows_only, holes(subject.rows_only))
    assert "too oblique" in told
    assert holes_sentence("x", subject.rows_only, ()) == "X: no holes."


@pytest.mark.parametrize(
    ("ratio", "text"),
    [(1.0, "100.00 %"), (0.99999, "99.99 %"), (0.7111, "71.11 %"), (0.0, "0.00 %")],
)
def test_only_what_is_complete_reads_100(ratio, text):
    assert percent(ratio) == text


def test_classes_that_do_not_fit_are_refused(subject):
    colours = np.zeros((2, 3))
    with pytest.raises(InputError, match="one colour"):
        FaceClasses(np.zeros(3, int), ("a",), colours)
    with pytest.raises(InputError, match="codes from 0 to 1"):
        FaceClasses(np.array([0, 2]), ("a", "b"), colours)
    other = meshes.grid(2.0, 2.0, 0.01)
    with pytest.raises(InputError, match="certificate of this mesh"):
        coverage_classes(subject.coverage, DisplayMesh(other, np.arange(len(other.faces))))


def test_outline_and_hole_edges_are_told_apart():
    plate = meshes.grid(0.6, 0.4, 0.02)
    holed = meshes.without(plate, lambda x, y: (np.abs(x) < 0.1) & (np.abs(y) < 0.06))
    debris = meshes.moved(meshes.grid(0.04, 0.04, 0.02), planar(2.0, 0.0, 0.0))
    outline, inner = boundary_edges(meshes.joined(holed, debris))

    def length(edges):
        return np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1).sum()

    assert length(outline) == pytest.approx(2 * (0.6 + 0.4) + 4 * 0.04)
    assert length(inner) == pytest.approx(2 * (0.2 + 0.12))
    assert np.abs(inner[..., 0]).max() == pytest.approx(0.1)


def test_findings_are_in_the_caption():
    assert findings_sentence(()) == "Mesh doctor: no findings."
    found = (Finding("holes", 3, "noted", "three"), Finding("debris", 1, "repaired", "one"))
    assert findings_sentence(found) == "Mesh doctor: holes 3 (noted); debris 1 (repaired)."


def test_rows_come_in_their_order(subject):
    path = subject.path
    points = [point for _, members in rows_of(path) for point in members]
    assert sorted(points) == np.flatnonzero(path.kinds == ROW).tolist()
    for number, members in rows_of(path):
        assert set(path.groups[members]) == {number}
        assert (np.diff(members) > 0).all()


def test_points_of_each_station_are_counted_without_the_skipped_ones(subject):
    first = int(subject.station_plan.stations[0].points[0])
    left_out = dataclasses.replace(subject, skipped=(SkippedPoint(first, "too far"),))
    assert left_out.station_of_points()[first] == -1
    owner = subject.station_of_points()
    for number, station in enumerate(subject.station_plan.stations):
        kept = set(station.points.tolist()) - {entry.point for entry in subject.skipped}
        assert kept == set(np.flatnonzero(owner == number).tolist())
    assert "too far" in skipped_sentence(left_out.skipped)


def test_the_footprint_turns_with_the_base():
    cell = CellConfig()
    length, width, _ = cell.base_size_m
    corners = footprint(planar(1.0, 2.0, np.pi / 2), cell)
    assert corners.mean(axis=0) == pytest.approx([1.0, 2.0])
    assert np.ptp(corners, axis=0) == pytest.approx([width, length])
    assert arm_place(planar(1.0, 2.0, 0.3), cell) == pytest.approx([1.0, 2.0, 1.0])


def test_stations_stand_where_the_plan_says(subject):
    figure = figures(subject)["stations"]()
    axes = figure.axes[0]
    drawn = [patch.get_xy()[:4] for patch in axes.patches if isinstance(patch, Polygon)]
    stations = subject.station_plan.stations
    assert stations
    for station in stations:
        wanted = footprint(station.T_map_base_link, subject.cell)
        assert sum(np.allclose(corners, wanted) for corners in drawn) == 1


def test_a_long_legend_is_cut_and_says_so():
    count = 40
    classes = FaceClasses(
        np.arange(count), tuple(f"region {i}" for i in range(count)), np.full((count, 3), 0.5)
    )
    handles = class_handles(classes, range(count))
    assert len(handles) < 20
    assert handles[-1].get_label() == f"and {count - len(handles) + 1} more"


@pytest.mark.parametrize("ratio", [0.1, 0.7, 3.0])
@pytest.mark.parametrize(("panels", "small"), [(1, 0), (2, 0), (3, 0), (1, 1), (1, 3), (1, 5)])
def test_no_text_lies_on_another(ratio, panels, small):
    extent = (0.0, 1.0, 0.0, ratio)
    words = "a rather long title of a panel that has to go on in a second line, or even a third one"
    classes = FaceClasses(
        np.arange(9), tuple(f"class {i} of nine" for i in range(9)), np.ones((9, 3))
    )
    legend = class_handles(classes, range(9))
    panel = Panel(words, extent, lambda axes: None)
    page = Page("headline", (panel,) * panels, legend, words * 6, (panel,) * small)
    figure = draw_page(page)
    png(figure)
    renderer = figure.canvas.get_renderer()
    boxes = [text.get_window_extent(renderer) for text in figure.texts]
    boxes += [legend.get_window_extent(renderer) for legend in figure.legends]
    for axes in figure.axes:
        title = axes.get_title("left")
        assert title
        boxes.append(axes.get_tightbbox(renderer))
    page_box = figure.bbox
    for i, box in enumerate(boxes):
        assert box.x0 >= page_box.x0 and box.x1 <= page_box.x1 + 1
        assert box.y0 >= page_box.y0 and box.y1 <= page_box.y1
        for other in boxes[:i]:
            apart = (
                box.x0 >= other.x1 - 1 or other.x0 >= box.x1 - 1
                or box.y0 >= other.y1 - 1 or other.y0 >= box.y1 - 1
            )  # fmt: skip
            assert apart, (box, other)


def test_row_and_feature_points_are_where_the_path_has_them(subject, stage):
    figure = figures(subject)["points"]()
    lines = {
        tuple(np.round(np.array(line.get_xydata()), 9).ravel()) for line in figure.axes[0].lines
    }
    for kind in (ROW, FEATURE):
        flat = stage.front.view.plane(subject.path.positions[subject.path.kinds == kind])
        assert tuple(np.round(flat, 9).ravel()) in lines


def test_a_picture_of_what_is_not_planned_is_refused(subject):
    bare = Subject("bare", subject.mesh, subject.segmentation)
    for draw in (points_figure, rows_figure):
        with pytest.raises(InputError, match="scan path"):
            draw(Stage(bare))
    with pytest.raises(InputError, match="station plan"):
        stations_figure(bare)
