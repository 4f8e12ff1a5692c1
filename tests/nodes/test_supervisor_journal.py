"""The journal: on disk at once, cut lines left out, damage named."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from skinplan_nodes.supervisor.journal import (
    Journal,
    JournalError,
    read_journal,
    read_stored,
)


def test_what_is_added_is_read(tmp_path: Path) -> None:
    journal = Journal(tmp_path / "journal.jsonl")
    journal.add("state", state="scanning", station=2)
    journal.add("points", points=[3, 5], ratio=float("nan"), text="a\nb ü")
    first, second = read_journal(journal.path)
    assert (first.kind, first.values) == ("state", {"state": "scanning", "station": 2})
    assert second.values == {"points": [3, 5], "ratio": None, "text": "a\nb ü"}
    assert second.at_ns >= first.at_ns > 0


def test_a_line_that_was_cut_off_is_none_and_the_next_one_stands_alone(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    Journal(path).add("one")
    Journal(path).add("two")
    content = path.read_bytes()
    for length in range(len(content) // 2 + 1, len(content)):
        path.write_bytes(content[:length])
        assert [entry.kind for entry in read_journal(path)] == ["one"]
    Journal(path).add("three")
    assert [entry.kind for entry in read_journal(path)] == ["one", "three"]


@pytest.mark.parametrize("place", [0, 10, 30, -3])
def test_a_changed_byte_is_named_with_its_line(tmp_path: Path, place: int) -> None:
    path = tmp_path / "journal.jsonl"
    Journal(path).add("one", number=1)
    Journal(path).add("two", number=2)
    first, second = path.read_bytes().splitlines(keepends=True)
    damaged = bytearray(second)
    damaged[place] ^= 0x01
    path.write_bytes(first + bytes(damaged))
    with pytest.raises(JournalError, match="line 2"):
        read_journal(path)


def test_a_missing_journal_is_named(tmp_path: Path) -> None:
    with pytest.raises(JournalError, match=r"nothing\.jsonl"):
        read_journal(tmp_path / "nothing.jsonl")


def test_files_beside_it_are_checked(tmp_path: Path) -> None:
    journal = Journal(tmp_path / "journal.jsonl")
    stored = journal.store("plan.cdr", b"plan")
    journal.add("path", **stored)
    (entry,) = read_journal(journal.path)
    assert read_stored(tmp_path, entry.values) == b"plan"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["journal.jsonl", "plan.cdr"]
    (tmp_path / "plan.cdr").write_bytes(b"plam")
    with pytest.raises(JournalError, match="SHA-256"):
        read_stored(tmp_path, entry.values)
    (tmp_path / "plan.cdr").unlink()
    with pytest.raises(JournalError, match="can't be read"):
        read_stored(tmp_path, entry.values)
    outside = {**entry.values, "file": "../../etc/passwd"}
    with pytest.raises(JournalError, match=str(tmp_path)):
        read_stored(tmp_path, outside)


def test_a_killed_process_leaves_whole_entries(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    script = f"""
import itertools
from pathlib import Path
from skinplan_nodes.supervisor.journal import Journal
journal = Journal(Path({str(path)!r}))
for number in itertools.count():
    journal.add("number", number=number)
    if number == 20:
        print("go", flush=True)
"""
    process = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None and process.stdout.readline() == "go\n"
    os.kill(process.pid, signal.SIGKILL)
    process.wait(10)
    numbers = [entry.values["number"] for entry in read_journal(path)]
    assert numbers == list(range(len(numbers))) and len(numbers) > 20
    assert json.loads(path.read_text().splitlines()[0].split(" ", 1)[1])["kind"] == "number"
