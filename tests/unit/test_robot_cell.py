import dataclasses

import numpy as np
import pytest
import yaml

from skinplan.errors import CellInvalidError
from skinplan.robot.cell import CellConfig, load_cell
from skinplan.transforms import quaternion


def test_without_a_file_the_defaults_hold():
    assert np.array_equal(load_cell(None).T_map_work, CellConfig().T_map_work)
    assert load_cell(None).home_rad == CellConfig().home_rad


def test_what_a_file_says_is_taken_and_the_rest_stays(tmp_path):
    values = {
        "robot": "ur5",
        "home_rad": [0, -1, 1, 0, 1, 0],
        "base_size_m": [1.0, 0.6, 0.4],
        "collision_margin_m": 0.03,
        "T_base_link_arm_base": {"translation_m": [0.1, 0, 0.9]},
        "camera": {"width": 640, "height": 480, "K": [600, 0, 320, 0, 600, 240, 0, 0, 1]},
        "quality": {"alpha": 0.4, "max_attempts": 3},
    }
    file = tmp_path / "cell.yaml"
    file.write_text(yaml.safe_dump(values))
    cell = load_cell(file)
    assert cell.home_rad == (0, -1, 1, 0, 1, 0)
    assert cell.base_size_m == (1.0, 0.6, 0.4)
    assert cell.collision_margin_m == 0.03
    assert np.allclose(cell.T_base_link_arm_base[:3, 3], (0.1, 0, 0.9))
    assert cell.camera.width == 640 and cell.camera.K[0, 0] == 600
    assert cell.quality.alpha == 0.4 and cell.quality.max_attempts == 3
    assert cell.settle_s == CellConfig().settle_s


def test_every_key_can_be_written_and_read_back(tmp_path):
    def plain(value):
        if dataclasses.is_dataclass(value):
            return {m.name: plain(getattr(value, m.name)) for m in dataclasses.fields(value)}
        if isinstance(value, np.ndarray) and value.shape == (4, 4):
            return {
                "translation_m": value[:3, 3].tolist(),
                "rotation_xyzw": quaternion(value).tolist(),
            }
        if isinstance(value, np.ndarray):
            return value.ravel().tolist()
        return list(value) if isinstance(value, tuple) else value

    file = tmp_path / "cell.yaml"
    values = plain(CellConfig())
    del values["propose_tracker"]  # said by a T_map_tracker of null
    file.write_text(yaml.safe_dump(values))
    again = plain(load_cell(file))
    assert again.keys() == plain(CellConfig()).keys()
    assert np.allclose(
        again["T_map_tracker"]["rotation_xyzw"],
        plain(CellConfig())["T_map_tracker"]["rotation_xyzw"],
    )


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("arm: ur5", "arm"),
        ("home_rad: [1, 2]", "six joint positions"),
        ("collision_margin_m: -0.1", "collision_margin_m"),
        ("velocity_max_rad_s: fast", "velocity_max_rad_s"),
        ("base_size_m: [1, 0, 1]", "base_size_m"),
        ("T_map_work: {translation_m: [1, 2]}", "T_map_work"),
        ("T_map_work: {translation_m: [1, 2, 3], rotation_xyzw: [0, 0, 0, 0]}", "quaternion"),
        ("camera: {width: 2}", "width"),
        ("camera: {K: [0, 0, 0, 0, 0, 0, 0, 0, 1]}", "focal"),
        ("camera: {zoom: 2}", "zoom"),
        ("quality: {distance_min_m: 3, distance_max_m: 1}", "below"),
        ("settle_s: .nan", "settle_s"),
        ("- 1\n- 2", "mapping"),
        ("a: [", "YAML"),
    ],
)
def test_a_bad_file_is_refused_by_key(tmp_path, text, words):
    file = tmp_path / "cell.yaml"
    file.write_text(text)
    with pytest.raises(CellInvalidError, match=words):
        load_cell(file)


def test_a_missing_or_huge_or_binary_file_is_refused(tmp_path):
    with pytest.raises(CellInvalidError, match="no cell file"):
        load_cell(tmp_path / "none.yaml")
    big = tmp_path / "big.yaml"
    big.write_text("#" * 1_100_000)
    with pytest.raises(CellInvalidError, match="bytes"):
        load_cell(big)
    binary = tmp_path / "binary.yaml"
    binary.write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(CellInvalidError, match="YAML"):
        load_cell(binary)


def written(tmp_path, values):
    file = tmp_path / "cell.yaml"
    file.write_text(yaml.safe_dump(values))
    return file


def test_tracker_and_obstacles_are_read(tmp_path):
    wall = {"name": "wall", "size_m": [4, 0.2, 3], "T_map_box": {"translation_m": [0, 2, 1.5]}}
    values = {"tracker": {"range_max_m": 4.0, "targets_least": 5}, "obstacles": [wall]}
    cell = load_cell(written(tmp_path, values))
    assert cell.tracker.range_max_m == 4.0 and cell.tracker.targets_least == 5
    assert cell.tracker.cone_rad == CellConfig().tracker.cone_rad
    assert cell.obstacles[0].name == "wall" and cell.obstacles[0].size_m == (4.0, 0.2, 3.0)
    assert np.allclose(cell.obstacles[0].T_map_box[:3, 3], (0.0, 2.0, 1.5))


@pytest.mark.parametrize(
    "values",
    [
        {"tracker": {"range_min_m": 5.0, "range_max_m": 2.0}},
        {"tracker": {"targets": 4, "targets_least": 5}},
        {"tracker": {"cone_deg": 50}},
        {"tracker": {"targets": 2.5}},
        {"obstacles": {"name": "wall"}},
        {"obstacles": [{"name": "wall", "size_m": [1, 0, 1], "T_map_box": {}}]},
        {"obstacles": [{"size_m": [1, 1, 1]}]},
        {"obstacles": [{"name": "wall", "colour": "red"}]},
    ],
)
def test_a_tracker_or_obstacle_that_can_not_be_is_refused(tmp_path, values):
    with pytest.raises(CellInvalidError, match="accepted"):
        load_cell(written(tmp_path, values))


def test_a_tracker_without_place_is_to_be_proposed(tmp_path):
    assert load_cell(written(tmp_path, {"T_map_tracker": None})).propose_tracker
    assert not load_cell(written(tmp_path, {})).propose_tracker
    with pytest.raises(CellInvalidError, match="accepted"):
        load_cell(written(tmp_path, {"propose_tracker": True}))
