"""Facts about a cell's calibration: noted, read, out of date, another file under the same name."""

import json
from datetime import UTC, date, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

from skinplan.cli import app
from skinplan.errors import CalibrationInvalidError
from skinplan.part.fields import pose_fields
from skinplan.robot.calibration import (
    NAMES,
    calibration_path,
    load_calibration,
    note_calibration,
)
from skinplan.transforms import inverse, transform

NOW = datetime(2026, 11, 3, 12, 0, tzinfo=UTC)
runner = CliRunner()


def noted(folder: Path, name: str = "hand_eye", due: date = date(2026, 11, 3)) -> Path:
    facts, file = folder / "cell.calibration.yaml", folder / f"{name}.json"
    file.write_text("{}")
    note_calibration(facts, name, file, NOW - timedelta(days=9), due, 0.0003, "m")
    return facts


def states(facts: Path | None, now: datetime = NOW) -> dict[str, str]:
    return {fact.name: fact.state for fact in load_calibration(facts, now)}


def test_without_a_file_nothing_is_calibrated(tmp_path: Path) -> None:
    for path in (None, tmp_path / "cell.calibration.yaml"):
        assert states(path) == dict.fromkeys(NAMES, "missing")
    assert calibration_path(tmp_path / "cell.yaml") == tmp_path / "cell.calibration.yaml"
    assert calibration_path("") is None


def test_what_was_noted_is_read_and_is_valid_until_the_end_of_its_last_day(tmp_path: Path) -> None:
    facts = noted(tmp_path)
    fact = load_calibration(facts, NOW)[0]
    assert fact.document() == {
        "name": "hand_eye",
        "file": str(tmp_path / "hand_eye.json"),
        "sha256": "44136fa355b3678a1146ad16f7e8649e94fb4fc21fe77e8310c060f61caaff8a",
        "date": "2026-10-25T12:00:00Z",
        "due": "2026-11-03T23:59:59Z",
        "residual": 0.0003,
        "unit": "m",
        "state": "valid",
    }
    assert states(facts, datetime(2026, 11, 4, tzinfo=UTC))["hand_eye"] == "due"
    assert states(facts)["tool"] == "missing"


def test_a_second_note_takes_the_place_of_the_first(tmp_path: Path) -> None:
    facts = noted(tmp_path, "tool")
    noted(tmp_path, "camera")
    noted(tmp_path, "tool", date(2027, 1, 1))
    found = {fact.name: fact for fact in load_calibration(facts, NOW)}
    assert found["tool"].due == "2027-01-01T23:59:59Z" and found["camera"].state == "valid"


def test_another_file_under_the_same_name_is_no_calibration(tmp_path: Path) -> None:
    facts = noted(tmp_path)
    (tmp_path / "hand_eye.json").write_text("{ }")
    fact = load_calibration(facts, NOW)[0]
    assert fact.state == "missing" and "another file" in fact.reason
    (tmp_path / "hand_eye.json").unlink()
    assert load_calibration(facts, NOW)[0].state == "missing"


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"elbow": {}}, "elbow"),
        ({"tool": {"file": "a", "date": "2026-11-01", "due": "soon"}}, "tool.due"),
        ({"tool": {"file": "a", "due": "2026-11-01"}}, "tool.date"),
        ({"tool": {"date": "2026-11-01", "due": "2026-11-01"}}, "tool.file"),
        ({"tool": {"file": "a", "date": 5, "due": "2026-11-01"}}, "tool.date"),
        ({"tool": {"file": "a", "date": "2026-11-01", "due": "2026-11-01", "residual": -1}},
         "tool.residual"),
        ({"tool": {"file": "a", "date": "2026-11-01", "due": "2026-11-01", "unit": "m" * 20}},
         "tool.unit"),
        ({"tool": []}, "tool"),
        ([], "mapping"),
    ],
)  # fmt: skip
def test_bad_files_are_named_with_the_place(tmp_path: Path, change: object, named: str) -> None:
    path = tmp_path / "cell.calibration.yaml"
    path.write_text(yaml.safe_dump(change if change else [1]))
    with pytest.raises(CalibrationInvalidError, match=named):
        load_calibration(path, NOW)


def test_bad_notes_are_named(tmp_path: Path) -> None:
    facts, day = tmp_path / "cell.calibration.yaml", date(2026, 1, 1)
    with pytest.raises(CalibrationInvalidError, match="elbow"):
        note_calibration(facts, "elbow", tmp_path, NOW, day, 0.0, "m")
    with pytest.raises(CalibrationInvalidError, match="exists"):
        note_calibration(facts, "tool", tmp_path / "none", NOW, day, 0.0, "m")
    assert not facts.exists()


def test_the_command_notes_and_shows(tmp_path: Path) -> None:
    cell, file = tmp_path / "cell.yaml", tmp_path / "camera.json"
    file.write_text("{}")
    arguments = ["calibration", "note", cell, "camera", file, "--residual", "0.2", "--unit", "px"]
    result = runner.invoke(app, [*map(str, arguments), "--date", "2026-11-01", "--json"])
    assert result.exit_code == 0, result.output
    shown = runner.invoke(app, ["calibration", "show", str(cell), "--json"])
    facts = {fact["name"]: fact for fact in json.loads(shown.stdout)["calibration"]}
    assert facts["camera"]["due"] == "2027-01-30T23:59:59Z", "90 days"
    assert (facts["camera"]["residual"], facts["camera"]["unit"]) == (0.2, "px")
    assert facts["tool"]["state"] == "missing"
    assert "camera" in runner.invoke(app, ["calibration", "show", str(cell)]).stdout
    bad = runner.invoke(app, [*map(str, arguments), "--due", "soon"])
    assert bad.exit_code == 2 and "soon" in bad.stderr


def test_calibrate_notes_what_it_finds(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    truth, marker = transform((0.3, 0.1, 0.2), (0.0, 0.6, 0.8, 0.0)), transform((0.0, 0.0, 0.05))
    pairs = []
    for _ in range(16):
        quaternion = rng.normal(size=4)
        flange = transform(rng.uniform(0.2, 0.6, 3), quaternion / np.linalg.norm(quaternion))
        seen = inverse(truth) @ flange @ marker
        pairs.append(
            {"T_arm_base_tool0": pose_fields(flange), "T_camera_marker": pose_fields(seen)}
        )
    cell, recording = tmp_path / "cell.yaml", tmp_path / "pairs.json"
    cell.write_text("{}")
    recording.write_text(json.dumps(pairs))
    arguments = ["calibrate", str(recording), "--cell", str(cell), "--valid-days", "30"]
    result = runner.invoke(app, arguments)
    assert result.exit_code == 0, result.output
    today = datetime.now(UTC)
    fact = load_calibration(calibration_path(cell), today)[0]
    assert (fact.name, fact.state, fact.unit) == ("hand_eye", "valid", "m")
    assert fact.due.startswith((today + timedelta(days=30)).date().isoformat())
    kept = json.loads(Path(fact.file).read_text())
    assert fact.residual == pytest.approx(kept["held_out"]["position_m"])
    without = runner.invoke(app, ["calibrate", str(recording), "--valid-days", "30"])
    assert without.exit_code == 2 and "--cell" in without.stderr
