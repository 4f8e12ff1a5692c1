"""The recorder as a program under load: killed at any moment, and on a disk that runs full."""

import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.task import Future
from skinplan_msgs.msg import Status
from skinplan_msgs.srv import RecorderStart, RecorderStop
from std_msgs.msg import String

from bags import texts_of_mcap, texts_of_rosbags
from nodes.bench import TIMEOUT_S, Bench
from skinplan.recording.heal import heal_bag
from skinplan.recording.reader import open_bag

RATE_HZ = 2000
FILLER = "abcdefghij" * 40


@contextmanager
def recorder(
    tmp_path: Path, *parameters: str, disk: Path | None = None
) -> Iterator[subprocess.Popen[bytes]]:
    """`run_recorder` as a program, on request with a disk of 20 MB of its own."""
    command = [sys.executable, "-m", "skinplan_nodes.run_recorder", "--ros-args"]
    for parameter in (f"state_folder:={tmp_path / 'state'}", *parameters):
        command += ["-p", parameter]
    if disk is not None:
        mount = f"mount -t tmpfs -o size=20M tmpfs {disk}"
        command = ["unshare", "-m", "sh", "-c", f'{mount} && exec "$@"', "sh", *command]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    process = subprocess.Popen(command, env=environment, stderr=subprocess.DEVNULL)
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def start(bench: Bench, folder: Path, compression: str = "zstd") -> Publisher:
    """Begins a recording; returns the publisher of what it records.

    A recorder that was killed before stays in the graph for a while: a request that only the dead
    one got is repeated, and the topic is one that it does not know.
    """
    topic = f"/said_in_{folder.name}"
    request = RecorderStart.Request(
        folder=str(folder), topics=[topic], compression=compression, split_bytes=3_000_000
    )
    client = bench.tester.create_client(RecorderStart, "recorder/start")
    futures: list[Future] = []

    def answered() -> Future | None:
        if client.service_is_ready() and len(futures) <= (time.monotonic() - begin) / 2.0:
            futures.append(client.call_async(request))
        return next((future for future in futures if future.done()), None)

    begin = time.monotonic()
    answer = bench.wait(answered).result()
    bench.tester.destroy_client(client)
    assert answer.status.code == Status.OK, answer.status.message
    publisher = bench.tester.create_publisher(String, topic, QoSProfile(depth=1000))
    bench.wait(lambda: publisher.get_subscription_count() > 0)
    return publisher


def check_killed(tmp_path: Path, number: int, seconds: float) -> None:
    """Kills the recorder under load: what was said a second before is there, for all readers.

    With a context of its own: the killed process may leave shared memory locked that both had.
    """
    folder = tmp_path / f"bag{number}"
    bench = Bench()
    said_s: list[float] = []
    with recorder(tmp_path) as process:
        publisher = start(bench, folder, ("zstd", "lz4", "none")[number % 3])
        begin = time.monotonic()
        while (now := time.monotonic()) - begin < seconds:
            while len(said_s) < (now - begin) * RATE_HZ:
                publisher.publish(String(data=f"{len(said_s)} {FILLER}"))
                said_s.append(time.monotonic())
            time.sleep(0.001)
        killed_s = time.monotonic()
        os.kill(process.pid, signal.SIGKILL)
        process.wait(TIMEOUT_S)
    bench.close()
    heal_bag(folder)
    found = texts_of_mcap(folder)
    assert found == texts_of_rosbags(folder)
    numbers = [int(text.split()[0]) for text in found]
    # What is said before both sides know each other is nobody's.
    first = numbers[0] if numbers else 0
    assert numbers == list(range(first, first + len(numbers)))
    lost_from = first + len(numbers)
    assert lost_from == len(said_s) or killed_s - said_s[lost_from] <= 1.0
    shutil.rmtree(folder)


def test_a_killed_recorder_keeps_all_but_the_last_second(tmp_path: Path) -> None:
    check_killed(tmp_path, 0, 1.5)


@pytest.mark.long
@pytest.mark.timeout(3000)
def test_two_hundred_kills(tmp_path: Path) -> None:
    rng = random.Random(7)
    for number in range(200):
        check_killed(tmp_path, number, rng.uniform(0.0, 2.5))


def test_a_program_of_large_messages_has_shared_memory_for_them(
    bench: Bench, tmp_path: Path
) -> None:
    with recorder(tmp_path) as process:
        start(bench, tmp_path / "bag")
        maps = Path(f"/proc/{process.pid}/maps").read_text().splitlines()
    segments = [line.split()[0].split("-") for line in maps if "/dev/shm/fastrtps_" in line]
    assert max(int(end, 16) - int(begin, 16) for begin, end in segments) >= 32 * 2**20


def own_disk() -> bool:
    """Whether a disk of one's own can be mounted here."""
    if shutil.which("unshare") is None:
        return False
    tried = ["unshare", "-m", "mount", "-t", "tmpfs", "-o", "size=1M", "tmpfs", "/mnt"]
    return subprocess.run(tried, capture_output=True, check=False).returncode == 0


@pytest.mark.skipif(not own_disk(), reason="a tmpfs of one's own can't be mounted here")
@pytest.mark.parametrize(
    ("min_free_bytes", "reason"), [(0, "No space left on device"), (4_000_000, "free")]
)
def test_a_full_disk_ends_the_recording_and_what_was_there_is_readable(
    bench: Bench, tmp_path: Path, min_free_bytes: int, reason: str
) -> None:
    disk = tmp_path / "disk"
    disk.mkdir()
    with recorder(tmp_path, f"min_free_bytes:={min_free_bytes}", disk=disk) as process:
        publisher = start(bench, disk / "bag", "none")
        seen = Path(f"/proc/{process.pid}/root{disk}")
        for number in range(300):
            publisher.publish(String(data=f"{number} {'x' * 100_000}"))
            time.sleep(0.004)
        answer = bench.call(RecorderStop, "recorder/stop", RecorderStop.Request())
        assert answer.status.code == Status.DISK_FULL
        assert str(disk / "bag") in answer.status.message and reason in answer.status.message
        shutil.copytree(seen / "bag", tmp_path / "bag")
    found = texts_of_mcap(tmp_path / "bag")
    assert found == texts_of_rosbags(tmp_path / "bag")
    numbers = [int(text.split()[0]) for text in found]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    assert open_bag(tmp_path / "bag").complete
    room = sum(path.stat().st_size for path in (tmp_path / "bag").iterdir())
    assert 10_000_000 < room <= 20 * 2**20 - min_free_bytes
