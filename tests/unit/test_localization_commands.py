"""Marker sheets at true scale, and the hand-eye calibration; as a user meets them."""

import json
import re

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from skinplan.cli import app
from skinplan.errors import InputError, PartInvalidError
from skinplan.localization.detect import detect_markers
from skinplan.localization.hand_eye import PosePair, calibrate
from skinplan.localization.hand_eye_methods import SOLVERS
from skinplan.localization.sheets import marker_sheet, svg
from skinplan.part.fields import pose_fields
from skinplan.part.fixture_file import load_fixture
from skinplan.part.model import Fixture, Marker
from skinplan.transforms import difference, inverse, transform

RUNNER = CliRunner()
FIXTURE = Fixture(
    "DICT_5X5_100", np.eye(4), (Marker(7, 0.10, np.eye(4)), Marker(9, 0.25, transform((1, 0, 0))))
)
FIXTURE_FILE = """dictionary: DICT_5X5_100
markers:
  - {id: 7, size_m: 0.10, pose_in_fixture: {translation_m: [0, 0, 0]}}
  - {id: 9, size_m: 0.25, pose_in_fixture: {translation_m: [1, 0, 0]}}
"""


def run(*arguments):
    result = RUNNER.invoke(app, [str(item) for item in arguments])
    assert "Traceback" not in result.output
    return result


@pytest.fixture
def fixture_file(tmp_path):
    path = tmp_path / "fixture.yaml"
    path.write_text(FIXTURE_FILE, encoding="utf-8")
    return path


def rasterised(text, per_mm):
    """Draws the cells of an SVG sheet, read from its path."""
    width, height = map(float, re.search(r'viewBox="0 0 (\S+) (\S+)"', text).groups())
    image = np.full((round(height * per_mm), round(width * per_mm)), 255, np.uint8)
    cells = re.search(r'<path d="([^"]*)" fill="#000"', text).group(1)
    for x, y, w, h in re.findall(r"M(\S+) (\S+)h(\S+)v(\S+)h", cells):
        left, top = float(x) * per_mm, float(y) * per_mm
        right, bottom = left + float(w) * per_mm, top + float(h) * per_mm
        image[round(top) : round(bottom), round(left) : round(right)] = 0
    return image


@pytest.mark.parametrize(("number", "paper"), [(0, "A4"), (1, "A2")])
def test_the_printed_marker_is_found_and_has_its_true_size(number, paper):
    marker = FIXTURE.markers[number]
    sheet = marker_sheet(FIXTURE, marker)
    assert sheet.paper == paper
    found = detect_markers(rasterised(svg(sheet), 4.0), FIXTURE.dictionary)
    assert found.ids.tolist() == [marker.id]
    sides = np.linalg.norm(np.roll(found.corners[0], -1, axis=0) - found.corners[0], axis=1)
    np.testing.assert_allclose(sides / 4.0, 1e3 * marker.size_m, atol=0.3)
    top_left, top_right = found.corners[0, :2]
    assert top_left[1] == pytest.approx(top_right[1], abs=0.2)
    assert top_left[0] < top_right[0], "the print stands upright"


def test_the_ruler_is_a_hundred_millimetres():
    sheet = marker_sheet(FIXTURE, FIXTURE.markers[0])
    x1, _, x2, _ = sheet.lines[0]
    assert x2 - x1 == 100.0


def test_pdf_has_a_page_per_marker_of_the_paper_size(fixture_file, tmp_path):
    result = run("markers", fixture_file, "--out", tmp_path / "out", "--json")
    assert result.exit_code == 0
    document = json.loads(result.stdout)
    assert [s["paper"] for s in document["sheets"]] == ["A4", "A2"]
    content = (tmp_path / "out" / "markers.pdf").read_bytes()
    boxes = re.findall(rb"/MediaBox \[ ?0 0 (\S+) (\S+) ?\]", content)
    sizes = [(float(w) * 25.4 / 72, float(h) * 25.4 / 72) for w, h in boxes]
    np.testing.assert_allclose(sizes, [(210, 297), (420, 594)], atol=0.01)


def test_svg_files_and_what_is_refused(fixture_file, tmp_path):
    out = tmp_path / "out"
    assert run("markers", fixture_file, "--out", out, "--format", "svg", "--id", 9).exit_code == 0
    assert [path.name for path in out.iterdir()] == ["marker_9.svg"]
    for extra, words in (
        (["--id", 3], "markers [3]"),
        (["--paper", "A4"], "a larger paper"),
        (["--paper", "B5"], "A4, A3"),
        (["--format", "png"], "pdf, svg"),
    ):
        result = run("markers", fixture_file, "--out", out, *extra)
        assert result.exit_code == 2
        assert words in result.stderr
    assert run("markers", tmp_path / "none.yaml").exit_code == 2
    assert run("markers", "scene4", "--out", out).exit_code == 0


def test_a_fixture_file_is_read_and_its_mistakes_are_named(fixture_file):
    assert [marker.id for marker in load_fixture(fixture_file).markers] == [7, 9]
    fixture_file.write_text(FIXTURE_FILE.replace("0.25", "250"), encoding="utf-8")
    with pytest.raises(PartInvalidError, match=r"markers\[1\].size_m"):
        load_fixture(fixture_file)


T_ARM_BASE_CAMERA = transform((0.3, -0.2, -0.5), Rotation.from_euler("x", -1.6).as_matrix())
T_TOOL0_MARKER = transform((0.02, 0.01, 0.08), Rotation.from_euler("y", 0.3).as_matrix())


def pairs_of(count, noise_m=0.0, seed=0):
    random = np.random.default_rng(seed)
    found = []
    for _ in range(count):
        turn = Rotation.from_rotvec(random.uniform(-0.7, 0.7, 3)).as_matrix()
        flange = transform(random.uniform([-0.3, 0.3, 0.1], [0.3, 0.7, 0.5]), turn)
        noise = transform(
            random.normal(0, noise_m, 3),
            Rotation.from_rotvec(random.normal(0, noise_m, 3)).as_matrix(),
        )
        marker = inverse(T_ARM_BASE_CAMERA) @ flange @ T_TOOL0_MARKER @ noise
        found.append(PosePair(flange, marker))
    return found


@pytest.mark.parametrize("name", SOLVERS)
def test_every_method_is_exact_without_noise(name):
    pairs = pairs_of(8)
    flange = np.array([pair.T_arm_base_tool0 for pair in pairs])
    found = SOLVERS[name](flange, np.array([pair.T_camera_marker for pair in pairs]))
    assert max(difference(found, T_ARM_BASE_CAMERA)) < 1e-9


@pytest.mark.parametrize("name", SOLVERS)
@pytest.mark.parametrize(("noise_m", "bound_m"), [(2e-4, 6e-4), (2e-3, 6e-3)])
def test_every_method_is_near_the_truth_with_noise(name, noise_m, bound_m):
    """Thirty noisy stands: the error of the calibration stays below that of three stands."""
    errors = []
    for seed in range(12):
        pairs = pairs_of(30, noise_m, seed)
        flange = np.array([pair.T_arm_base_tool0 for pair in pairs])
        found = SOLVERS[name](flange, np.array([pair.T_camera_marker for pair in pairs]))
        assert np.linalg.det(found[:3, :3]) == pytest.approx(1.0)
        errors.append(difference(found, T_ARM_BASE_CAMERA))
    assert np.median([distance for distance, _ in errors]) < bound_m
    assert np.median([angle for _, angle in errors]) < bound_m


def test_noise_shows_in_the_held_out_residual_and_in_the_verdict():
    calm, wild = calibrate(pairs_of(25, 2e-4)), calibrate(pairs_of(25, 2e-2))
    assert calm.verdict == "good"
    assert wild.verdict == "poor"
    assert difference(calm.T_arm_base_camera, T_ARM_BASE_CAMERA)[0] < 1e-3
    assert 2e-4 < calm.held_out_m < 1e-3
    least = min(m + rad for m, rad in calm.methods.values())
    assert sum(calm.methods[calm.method]) == least


def test_seven_methods_are_compared():
    tried = calibrate(pairs_of(25, 2e-4)).methods
    assert set(tried) == {"TSAI", "PARK", "HORAUD", "ANDREFF", "DANIILIDIS", "SHAH", "REFINED"}
    assert all(m < 1.5e-3 and rad < 1.5e-3 for m, rad in tried.values())


def test_a_wrong_pair_is_left_out_and_named():
    pairs = pairs_of(15, 2e-4)
    pairs[4] = PosePair(pairs[4].T_arm_base_tool0, pairs[5].T_camera_marker)
    found = calibrate(pairs)
    assert found.outliers == (4,)
    assert np.isnan(found.residual_m[4])
    assert found.verdict == "good"


def test_pairs_that_leave_it_open_are_refused():
    with pytest.raises(InputError, match="6 to"):
        calibrate(pairs_of(5))
    upright = [
        PosePair(
            turned := transform((0.1 * k, 0.5, 0.3), Rotation.from_euler("z", 0.3 * k).as_matrix()),
            inverse(T_ARM_BASE_CAMERA) @ turned @ T_TOOL0_MARKER,
        )
        for k in range(8)
    ]
    with pytest.raises(InputError, match="two axes"):
        calibrate(upright)


def write_pairs(path, pairs):
    values = [
        {
            "T_arm_base_tool0": pose_fields(pair.T_arm_base_tool0),
            "T_camera_marker": pose_fields(pair.T_camera_marker),
        }
        for pair in pairs
    ]
    path.write_text(json.dumps(values), encoding="utf-8")
    return path


def test_calibrate_command(tmp_path):
    file = write_pairs(tmp_path / "pairs.json", pairs_of(20, 2e-4))
    cell = tmp_path / "camera.yaml"
    result = run("calibrate", file, "--json", "--out", cell)
    assert result.exit_code == 0
    document = json.loads(result.stdout)
    assert document["verdict"] == "good"
    from skinplan.robot.cell import load_cell

    config = load_cell(cell)
    found = inverse(config.T_base_link_arm_base) @ config.camera.T_base_link_optical
    assert difference(found, T_ARM_BASE_CAMERA)[0] < 1e-3
    assert config.camera.mounting_error_m == pytest.approx(
        document["held_out"]["position_m"], abs=1e-6
    )
    assert run("calibrate", file).exit_code == 0
    bad = write_pairs(tmp_path / "bad.json", pairs_of(20, 2e-2))
    assert run("calibrate", bad).exit_code == 1


@pytest.mark.parametrize("text", ["", "{}", "[1]", '[{"T_arm_base_tool0": 1}]', "[" * 10000, "[]"])
def test_calibrate_refuses_what_is_no_list_of_pairs(tmp_path, text):
    file = tmp_path / "pairs.json"
    file.write_text(text, encoding="utf-8")
    result = run("calibrate", file)
    assert result.exit_code == 2
    assert "accepted" in result.stderr


def test_calibrate_refuses_missing_and_binary_files(tmp_path):
    assert run("calibrate", tmp_path / "none.json").exit_code == 2
    picture = tmp_path / "picture.png"
    cv2.imwrite(str(picture), np.zeros((4, 4), np.uint8))
    assert run("calibrate", picture).exit_code == 2
    assert run("calibrate", tmp_path / "none.mcap").exit_code == 2
