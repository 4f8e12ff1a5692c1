"""Shared memory of killed participants is given back, that of others is not touched."""

import fcntl
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from skinplan_nodes.dds_segments import remove_orphaned_segments

SHARED = Path("/dev/shm")
PARTICIPANT = """
import rclpy, sys, time
rclpy.init(args=[])
node = rclpy.create_node("participant")
sys.stdout.write("up\\n")
sys.stdout.flush()
time.sleep(600)
"""


def make(folder: Path, name: str, age_s: float = 60.0) -> Path:
    """Makes a segment and its lock as old as asked; returns the lock."""
    (folder / name).write_bytes(bytes(1000))
    lock = folder / f"{name}_el"
    lock.write_bytes(b"")
    then = time.time() - age_s
    os.utime(lock, (then, then))
    return lock


def test_only_what_nobody_owns_is_removed(tmp_path: Path) -> None:
    make(tmp_path, "fastrtps_0123456789abcdef")
    make(tmp_path, "fastdds_0123456789abcdef")
    owned = make(tmp_path, "fastrtps_1111111111111111")
    make(tmp_path, "fastrtps_2222222222222222", age_s=0.0)
    make(tmp_path, "fastrtps_port7413")
    make(tmp_path, "fastrtps_of_somebody_else")
    with owned.open("rb") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        assert remove_orphaned_segments(tmp_path) == 2000
        left = {path.name for path in tmp_path.iterdir() if not path.name.endswith("_el")}
    assert left == {
        "fastrtps_1111111111111111",
        "fastrtps_2222222222222222",
        "fastrtps_port7413",
        "fastrtps_of_somebody_else",
    }
    assert remove_orphaned_segments(tmp_path) == 1000, "its owner has gone"


def test_none_where_there_is_no_shared_memory(tmp_path: Path) -> None:
    assert remove_orphaned_segments(tmp_path / "none") == 0


@pytest.mark.skipif(not SHARED.is_dir(), reason="no /dev/shm")
def test_a_participant_keeps_its_segment_until_it_is_killed() -> None:
    before = set(SHARED.glob("fast*_el"))
    process = subprocess.Popen([sys.executable, "-c", PARTICIPANT], stdout=subprocess.PIPE)
    try:
        assert process.stdout is not None and process.stdout.readline() == b"up\n"
        (lock,) = [
            path
            for path in set(SHARED.glob("fast*_el")) - before
            if "port" not in path.name and _opened(path, process.pid)
        ]
        then = time.time() - 60.0
        os.utime(lock, (then, then))
        remove_orphaned_segments()
        assert lock.exists()
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait()
    remove_orphaned_segments()
    assert not lock.exists()
    assert not lock.with_name(lock.name.removesuffix("_el")).exists()


def _opened(path: Path, pid: int) -> bool:
    files = Path(f"/proc/{pid}/fd")
    return any(file.readlink() == path for file in files.iterdir())
