"""The report: honest for every state of a run folder, self-contained, and escaped."""

import json
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import ndimage

from skinplan.errors import InputError
from skinplan.inspection.cloud import write_ply
from skinplan.inspection.figures import deviation_limit, nice_limit
from skinplan.inspection.raster import View, closed, diverging, value_image
from skinplan.inspection.report import render, write_report
from skinplan.inspection.run_files import read_run
from skinplan.inspection.verdict import verdict
from skinplan.recording.bag import BagWriter

EVIL = '<script>alert("x")</script>'
VOID = {"meta", "br", "img", "link", "input", "hr"}


class Checker(HTMLParser):
    """Tags balance, nothing is loaded from elsewhere, no script."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: set[str] = set()
        self.text: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        for key, value in attrs:
            assert not key.startswith("on"), f"{tag} {key}"
            if key in ("src", "href", "xlink:href") and value:
                assert not re.match(r"[a-z]+:|//", value) or value.startswith(
                    "data:image/png;base64,"
                ), value
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        self.handle_endtag(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text.append(data)


def checked(path: Path) -> str:
    """Returns the text of a report after checking its HTML."""
    html = path.read_text(encoding="utf-8")
    checker = Checker()
    checker.feed(html)
    checker.close()
    assert checker.open == []
    assert "script" not in checker.tags
    assert "url(" not in html and "@import" not in html
    assert "prefers-color-scheme: dark" in html
    assert 'name="viewport"' in html
    return " ".join(" ".join(checker.text).split())


def summary(**changes: Any) -> dict[str, Any]:
    document: dict[str, Any] = {
        "mesh": {"triangles": 1200, "area_m2": 2.32, "sha256": "ab" * 32},
        "scan_path": {"points": 4, "row_points": 3, "feature_points": 1, "regions": 1},
        "coverage": {"area_ratio": 0.999, "feature_area_ratio": None},
        "stations": {
            "count": 2,
            "candidates": 9,
            "lower_bound": 2,
            "proven_optimal": True,
            "reached_ratio": 1.0,
        },
        "trajectory": {
            "scan_s": 100.0,
            "transit_s": 20.0,
            "base_s": 9.0,
            "cycle_s": 129.0,
            "skipped": [],
        },
        "plan_hash": "cd" * 32,
        "planning_s": {"mesh": 1.0, "scan_path": 2.0, "total": 3.0},
        "job": {"id": "job-5", "state": "Ended"},
        "localization": [
            {
                "station": 0,
                "E": 0.912,
                "attempts": 3,
                "position_error_m": 0.00123,
                "angle_error_rad": 0.001,
            }
        ],
        "measured": {
            "points": 500,
            "area_ratio": 0.981,
            "feature_area_ratio": None,
            "deviation_rms_m": 0.000123,
        },
        "bag": {"path": "bag", "messages": 1, "bytes": 5},
    }
    return {**document, **changes}


@pytest.mark.parametrize(
    ("fits", "alike", "said", "level"),
    [
        (True, [], "it is this part", "good"),
        (True, ["panel-8"], "fits, but it may be panel-8 as well", "warn"),
        (False, ["panel-8", EVIL], f"it is another part: panel-8 or {EVIL}", "bad"),
        (False, [], "it is another, unknown part", "bad"),
    ],
)
def test_the_report_says_which_part_stands_on_the_fixture(
    tmp_path: Path, fits: bool, alike: list[str], said: str, level: str
) -> None:
    answer = {"part": "panel-7", "fits": fits, "alike": alike, "seen_ratio": 0.62, "text": "as 8"}
    run = make_run(tmp_path / "run", summary(identification=answer))
    text = checked(write_report(run))
    assert f"Asked for panel-7 : {said} (62.00 % of the part seen) as 8" in text
    assert f'<span class="state {level}">' in (run / "report.html").read_text(encoding="utf-8")
    # Once, and not among the other figures, too.
    assert text.count("Asked for") == 1 and "seen ratio" not in text


def test_a_report_of_a_run_that_asked_for_no_identification_is_silent_about_it(
    tmp_path: Path,
) -> None:
    text = checked(write_report(make_run(tmp_path / "run", summary())))
    assert "stands on the fixture" not in text
    odd = summary(identification={"fits": "yes", "alike": 3})
    text = checked(write_report(make_run(tmp_path / "odd", odd)))
    assert "the answer can't be read" in text


def make_run(folder: Path, document: dict[str, Any]) -> Path:
    (folder / "plan").mkdir(parents=True)
    (folder / "summary.json").write_text(json.dumps(document))
    points = [
        {
            "position": [x, 0, 0.3],
            "direction": [0, 0, -1],
            "target": [x, 0.1, 0],
            "kind": k,
            "group": 0,
        }
        for x, k in ((0.0, "row"), (0.1, "row"), (0.2, "feature"), (0.3, "row"))
    ]
    (folder / "plan" / "scan_path.json").write_text(
        json.dumps({"frame": "workpiece", "points": points})
    )
    stations = [
        {"id": i, "pose": {"x_m": i, "y_m": -0.8, "heading_rad": 0.1}, "points": [2 * i, 2 * i + 1]}
        for i in range(2)
    ]
    place = {"position_m": [0, 0, 1], "quaternion": [0.7071067811865476, 0, 0, 0.7071067811865476]}
    (folder / "plan" / "stations.json").write_text(
        json.dumps(
            {
                "frame": "map",
                "stations": stations,
                "workpiece": place,
                "skipped": [{"point": 3, "reason": EVIL}],
            }
        )
    )
    segments = [{"kind": "scan", "duration_s": 50.0}, {"kind": "transit", "duration_s": 5.0}]
    rows = [{"station": i, "segments": segments, "skipped": []} for i in range(2)]
    (folder / "plan" / "trajectories.json").write_text(json.dumps({"stations": rows}))
    rng = np.random.default_rng(0)
    cloud = rng.uniform([-0.5, -0.2, 0], [0.5, 0.2, 0.01], size=(500, 3))
    write_ply(folder / "cloud.ply", cloud, values={"deviation": rng.normal(scale=1e-4, size=500)})
    write_ply(
        folder / "coverage.ply", cloud, values={"measured": (cloud[:, 0] < 0.3).astype(float)}
    )
    with BagWriter(folder / "bag") as bag:
        bag.add_topic("/chatter", "std_msgs/msg/String", "string data\n")
        bag.write("/chatter", b"", 5)
    return folder


def test_a_whole_run(tmp_path: Path) -> None:
    path = write_report(make_run(tmp_path / "job-5", summary()))
    assert path == tmp_path / "job-5" / "report.html"
    text = checked(path)
    for expected in (
        "Measurement job-5",
        "Measured 98.1 % of the part's area was measured. The deviation is 0.123 mm RMS.",
        "98.10 %",
        "0.123 mm",
        "129 s",
        "0.912 3 1.23 mm 0.057°",
        "station 1 2 points",
        "/chatter std_msgs/msg/String 1",
        "ab" * 32,
        "cd" * 32,
        "closed in order yes",
        EVIL,
    ):
        assert expected in text, expected
    assert path.read_text().count("data:image/png") == 2


def test_writing_twice_gives_the_same_bytes(tmp_path: Path) -> None:
    folder = make_run(tmp_path / "run", summary())
    first = write_report(folder).read_bytes()
    assert write_report(folder).read_bytes() == first


def test_a_run_that_failed_half_way(tmp_path: Path) -> None:
    document = {
        "job": {"id": "job-6", "state": "Aborted", "error": f"localizing: no marker {EVIL}"}
    }
    (tmp_path / "summary.json").write_text(json.dumps(document))
    text = checked(write_report(tmp_path))
    assert f"Aborted localizing: no marker {EVIL}" in text
    assert "cloud.ply is missing" in text
    assert "No stations were planned." in text and "The part was not located." in text
    assert "Measured 9" not in text


def test_an_empty_folder_says_that_there_is_no_result(tmp_path: Path) -> None:
    text = checked(write_report(tmp_path))
    assert "No result" in text
    assert "summary.json is missing." in text


@pytest.mark.parametrize(
    ("document", "level", "title"),
    [
        (summary(), "good", "Measured"),
        (summary(measured={"area_ratio": 0.9}), "warn", "Measured in part"),
        (summary(measured={}), "warn", "Ended without a measurement"),
        (summary(job={"id": "a", "state": "Running"}), "warn", "Not over: Running"),
        (summary(job={"id": "a", "state": "Aborted"}), "bad", "Aborted"),
        (summary(job={}), "warn", "Planned only"),
        ({}, "bad", "No result"),
    ],
)
def test_verdicts(tmp_path: Path, document: dict[str, Any], level: str, title: str) -> None:
    if document:
        (tmp_path / "summary.json").write_text(json.dumps(document))
    found = verdict(read_run(tmp_path))
    assert (found.level, found.title) == (level, title)
    assert f'class="verdict {level}"' in render(read_run(tmp_path))


def test_steps_of_the_run_follow_each_other(tmp_path: Path) -> None:
    steps = [
        {"step": "driving", "begin_s": 0.0, "end_s": 5.0},
        {"step": "scanning", "begin_s": 5.0, "end_s": 20.0},
        {"step": "lost", "begin_s": None, "end_s": 1.0},
        {"step": "back", "begin_s": 9.0, "end_s": 1.0},
    ]
    text = render(read_run(make_run(tmp_path / "run", summary(timeline=steps))))
    assert "Run, wall time: 20 s" in text
    assert "margin-left: 0.0%; width: 25.0%" in text
    assert "margin-left: 25.0%; width: 75.0%" in text
    assert "<span>lost</span>" not in text and "<span>back</span>" not in text


def test_texts_of_others_are_escaped(tmp_path: Path) -> None:
    evil = {EVIL: EVIL}
    document = summary(
        job={"id": EVIL, "state": EVIL, "error": EVIL, **evil},
        localization=[{"station": EVIL, "E": 0.9}],
        trajectory={"skipped": [{"point": EVIL, "reason": EVIL}]},
        timeline=[{"step": EVIL, "begin_s": 0, "end_s": 3}],
        more=evil,
        text=EVIL,
    )
    folder = make_run(tmp_path / "run", document)
    stations = {
        "stations": [{"id": EVIL, "pose": {"x_m": 0, "y_m": 0, "heading_rad": 0}, "points": []}]
    }
    (folder / "plan" / "stations.json").write_text(json.dumps(stations))
    path = write_report(folder)
    text = checked(path)
    assert text.count(EVIL) >= 10
    assert "<script" not in path.read_text()


NONSENSE: list[Any] = [
    None,
    5,
    "text",
    [],
    {},
    [1, "a", None],
    [{}],
    [{"x": {}}],
    {"skipped": 5},
    1e308,
    True,
]


@pytest.mark.parametrize("value", NONSENSE, ids=lambda v: json.dumps(v))
def test_documents_of_other_shapes_do_not_stop_the_report(tmp_path: Path, value: Any) -> None:
    folder = make_run(tmp_path / "run", dict.fromkeys(summary(), value))
    for name in ("scan_path", "stations", "trajectories"):
        document = {"points": value, "stations": value, "skipped": value, "workpiece": value}
        (folder / "plan" / f"{name}.json").write_text(json.dumps(document))
    checked(write_report(folder))


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b"\xff\xfe", b'{"a": NaN}', b"[" * 100_000])
def test_damaged_files_are_remarks(tmp_path: Path, content: bytes) -> None:
    folder = make_run(tmp_path / "run", summary())
    for name in (
        "summary.json",
        "plan/scan_path.json",
        "plan/stations.json",
        "cloud.ply",
        "coverage.ply",
    ):
        (folder / name).write_bytes(content)
    (folder / "bag" / "bag_0.mcap").write_bytes(content)
    text = checked(write_report(folder))
    assert "cloud.ply can't be read" in text
    assert "bag/ can't be read" in text


def test_points_far_apart_and_few_points_are_drawn(tmp_path: Path) -> None:
    for number, points in enumerate(
        ([[0.0, 0, 0]], [[0, 0, 0], [1e6, 1e-6, 0]], [[0, 0, 0], [0, 1e4, 0]])
    ):
        folder = make_run(tmp_path / str(number), summary())
        write_ply(
            folder / "cloud.ply",
            np.array(points, float),
            values={"deviation": np.zeros(len(points))},
        )
        checked(write_report(folder))
    write_ply(folder / "cloud.ply", np.zeros((0, 3)), values={"deviation": np.zeros(0)})
    checked(write_report(folder))


def test_a_missing_folder_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nowhere"):
        write_report(tmp_path / "nowhere")


def test_pixels_stand_where_the_points_are() -> None:
    view = View(0.0, 0.0, 1.2, 0.6)
    points = np.array([[0.0005, 0.0005, 0], [1.1995, 0.5995, 0]])
    mean, shown = value_image(points, np.array([1.0, 2.0]), view)
    assert mean.shape == (600, 1200)
    assert mean[599, 0] == 1.0 and mean[0, 1199] == 2.0
    assert shown[599, 0] and shown[0, 1199]


def test_holes_larger_than_the_spacing_stay() -> None:
    x, y = np.meshgrid(np.arange(0, 1, 0.005), np.arange(0, 0.5, 0.005))
    points = np.stack([x.ravel(), y.ravel()], axis=1)
    points = points[np.hypot(points[:, 0] - 0.5, points[:, 1] - 0.25) > 0.08]
    view = View(0.0, 0.0, 1.0, 0.5)
    _, shown = value_image(points, np.ones(len(points)), view)
    v, u = np.indices(shown.shape)
    radius = np.hypot(u * view.pixel_m - 0.5, (shown.shape[0] - 1 - v) * view.pixel_m - 0.25)
    assert shown[radius > 0.082].all()
    assert not shown[radius < 0.07].any()


@pytest.mark.parametrize("share", [0.0, 0.001, 0.02, 0.3, 0.9, 1.0])
@pytest.mark.parametrize("reach", [1, 4, 30])
def test_an_area_is_closed_as_by_as_many_steps_of_a_cross(share: float, reach: int) -> None:
    random = np.random.default_rng([reach, int(share * 1000)])
    for _ in range(5):
        filled = random.uniform(size=random.integers(1, 90, 2)) < share
        padded = ndimage.binary_closing(np.pad(filled, reach), iterations=reach)
        expected = padded[reach:-reach, reach:-reach]
        np.testing.assert_array_equal(closed(filled, reach), expected)


def test_colours_and_limits() -> None:
    below, zero, above = diverging(np.array([-1.0, 0.0, 1.0]), 1.0)
    assert below[2] > below[0] and above[0] > above[2]
    assert np.ptp(zero.astype(int)) < 20
    assert [nice_limit(v) for v in (0.9, 1.0, 1.1, 2.1, 5.1, 0.00013)] == pytest.approx(
        [1, 1, 2, 5, 10, 0.0002]
    )
    assert deviation_limit(np.zeros(10)) == pytest.approx(2e-5)
