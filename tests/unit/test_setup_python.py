"""Which Python the set-up takes."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[2] / "ros2_ws/find_python.sh"


@pytest.fixture
def machine(tmp_path):
    """A work tree with the script and a folder of programs that holds nothing but the basics."""
    (tmp_path / "ros2_ws").mkdir()
    shutil.copy(SCRIPT, tmp_path / "ros2_ws/find_python.sh")
    (tmp_path / "bin").mkdir()
    for name in ("sh", "cat", "sed", "dirname"):
        (tmp_path / "bin" / name).symlink_to(shutil.which(name))
    return tmp_path


def add_python(folder: Path, name: str, version: str | None) -> Path:
    """Put a program there that answers like Python of that version; None = cannot be run."""
    program = folder / name
    if version is None:
        body = "echo 'the version is not installed' >&2; exit 127"
    else:
        supported = version.startswith(("3.11.", "3.12."))
        body = f"""case "$2" in
*version_info*) echo {version}; exit {0 if supported else 1} ;;
*) echo {program} ;;
esac"""
    program.write_text(f"#!/bin/sh\n{body}\n")
    program.chmod(0o755)
    return program


def find(machine: Path, python: str = "") -> subprocess.CompletedProcess:
    env = {"PATH": str(machine / "bin"), "PYTHON": python}
    command = ["sh", str(machine / "ros2_ws/find_python.sh")]
    return subprocess.run(command, env=env, text=True, capture_output=True, check=False)


def test_newest_supported_python_is_taken(machine):
    wanted = add_python(machine / "bin", "python3.12", "3.12.1")
    add_python(machine / "bin", "python3.11", "3.11.7")
    assert find(machine).stdout.strip() == str(wanted)


def test_shim_without_a_python_behind_it_is_passed_over(machine):
    add_python(machine / "bin", "python3.12", None)
    wanted = add_python(machine / "bin", "python3.11", "3.11.7")
    assert find(machine).stdout.strip() == str(wanted)


def test_python3_counts_if_it_is_a_supported_one(machine):
    wanted = add_python(machine / "bin", "python3", "3.12.3")
    assert find(machine).stdout.strip() == str(wanted)


def test_unsupported_pythons_are_named(machine):
    add_python(machine / "bin", "python3.11", None)
    add_python(machine / "bin", "python3", "3.13.0")
    result = find(machine)
    assert result.returncode == 1
    assert result.stdout == ""
    assert "needs Python 3.11 or 3.12" in result.stderr
    assert "python3.11 (not found or not runnable)" in result.stderr
    assert "python3 (3.13.0)" in result.stderr
    assert "apt install" in result.stderr


def test_named_python_is_the_only_candidate(machine):
    add_python(machine / "bin", "python3.12", "3.12.1")
    other = add_python(machine, "other", "3.11.9")
    assert find(machine, str(other)).stdout.strip() == str(other)
    old = add_python(machine, "old", "3.9.18")
    result = find(machine, str(old))
    assert result.returncode == 1
    assert f"{old} (3.9.18)" in result.stderr


def test_python_of_a_finished_set_up_is_kept(machine):
    add_python(machine / "bin", "python3.12", "3.12.1")
    wanted = add_python(machine, "earlier", "3.11.7")
    (machine / ".venv").mkdir()
    (machine / ".venv/pyvenv.cfg").write_text(f"home = {machine}\nexecutable = {wanted}\n")
    assert find(machine).stdout.strip() == str(wanted)


def test_this_python_is_accepted():
    env = {"PATH": os.environ["PATH"], "PYTHON": sys.executable}
    result = subprocess.run(
        ["sh", str(SCRIPT)], env=env, text=True, capture_output=True, check=True
    )
    assert Path(result.stdout.strip()).exists()
