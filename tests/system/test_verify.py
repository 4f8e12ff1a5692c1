"""A fresh run is verified: identical; after one change the first stage that differs is named."""

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from nodes.small_part import write_small_part
from system.graph_run import GraphRun

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def part_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("part")
    source = write_small_part(folder, size_m=(0.6, 0.5)).source
    assert source is not None
    return source


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory, part_file: Path) -> Iterator[Path]:
    folder = tmp_path_factory.mktemp("runs")
    run = GraphRun(folder, part_file, "--time-factor", "8", "--job-id", "job-1")
    try:
        run.until(lambda event: event["event"] == "result")
    finally:
        run.close()
    yield folder / "job-1" / "bag"


def verified(bag: Path, *arguments: str) -> tuple[int, dict[str, Any]]:
    command = [sys.executable, "-m", "skinplan.cli", "replay", str(bag), "--verify", "--json"]
    done = subprocess.run(
        [*command, *arguments], capture_output=True, text=True, timeout=280, check=False
    )
    assert "Traceback" not in done.stderr
    return done.returncode, json.loads(done.stdout)


def test_a_fresh_run_is_identical(bag: Path) -> None:
    code, document = verified(bag)
    assert (code, document["identical"]) == (0, True), document
    assert all(stage["compared"] for stage in document["stages"])


@pytest.mark.parametrize(
    ("setting", "stage"),
    [({"standoff_m": 0.31}, "scan_path"), ({"tcp_speed_m_s": 0.15}, "trajectory")],
)
def test_one_setting_of_the_part(
    bag: Path, part_file: Path, tmp_path: Path, setting: dict[str, Any], stage: str
) -> None:
    document = yaml.safe_load(part_file.read_text())
    document["scan"].update(setting)
    document["mesh"]["file"] = str(part_file.with_name(document["mesh"]["file"]))
    (tmp_path / "part.yaml").write_text(yaml.safe_dump(document))
    code, found = verified(bag, "--part", str(tmp_path / "part.yaml"))
    assert (code, found["first_difference"]) == (1, stage), found["stages"][0]


def test_one_parameter_of_a_node(bag: Path) -> None:
    code, found = verified(bag, "--set", "aruco_localizer.images=1")
    assert (code, found["first_difference"]) == (1, "localization")
