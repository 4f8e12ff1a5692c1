"""Every fault at every state: the run finishes, or ends as failed with a code; nothing is lost."""

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from system.fault_campaign import (
    FAULTS,
    FULL_DISK,
    HEAD,
    SEEDS,
    STATES,
    Case,
    Row,
    run_cases,
    shown,
    written,
)

TESTS = Path(__file__).parents[1]
#: Room for the bags of one job, and quickly full.
DISK_SIZE = "400M"


def test_tables_are_shown_as_one_with_a_figure_per_seed(tmp_path: Path) -> None:
    """A campaign goes on where its table ends, and what was not run is seen."""
    hung = "hangs in moving of job-1: "
    for seed, ended, code, after_s, note in (
        (1, "Ended", "", 12.0, ""),
        (2, "Aborted", "201", 50.0, ""),
        (3, "no result", "", 240.0, hung),
    ):
        case = Case("frozen", "moving", seed)
        row = Row(case, ended, code, np.nan, 1, False, 9, 60.0, after_s, 75.0, note)
        mark = "" if row.is_good else " **bad**"
        (tmp_path / f"{seed}.md").write_text(f"{HEAD}\n{row.cells()} {row.note}{mark}\n")
        assert written(tmp_path / f"{seed}.md") == {case}
    paths = [tmp_path / f"{seed}.md" for seed in (1, 2, 3)]
    assert "| frozen | - - - |" in shown(paths)
    assert "| 12 50 (201) **240** |" in shown(paths)
    assert "| 12 - |" not in shown(paths[:1]) and "| 12 |" in shown(paths[:1])


@pytest.mark.long
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("fault", [fault for fault in FAULTS if fault != FULL_DISK])
def test_jobs_survive_or_end_by_name(fault: str, seed: int) -> None:
    cases = [Case(fault, state, seed) for state in STATES]
    found = list(run_cases(cases, seed, "16", "fault_campaign"))
    assert [row for row in found if not row.is_good] == []


@pytest.mark.long
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("seed", SEEDS)
def test_jobs_survive_a_full_disk(tmp_path: Path, seed: int) -> None:
    """On a disk in memory that only the campaign sees: nobody else's is filled."""
    disk, table = tmp_path / "disk", tmp_path / "table.md"
    disk.mkdir()
    mount = f"mount -t tmpfs -o size={DISK_SIZE} tmpfs '{disk}' && exec \"$@\""
    alone = ["unshare", "--map-root-user", "--mount", "sh", "-c", mount, "sh"]
    if shutil.which("unshare") is None or subprocess.run([*alone, "true"], check=False).returncode:
        pytest.skip("mounts are not allowed here (unshare --map-root-user --mount)")
    campaign = [sys.executable, "-m", "system.fault_campaign", "--seeds", str(seed)]
    campaign += ["--faults", FULL_DISK, "--disk", str(disk), "--out", str(table)]
    subprocess.run([*alone, *campaign], check=True, cwd=TESTS)
    assert written(table) == {Case(FULL_DISK, state, seed) for state in STATES}
    assert [line for line in table.read_text().splitlines() if "**bad**" in line] == []
