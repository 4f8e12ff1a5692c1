"""A recording that was cut off is healed: valid files, nothing readable lost, losses stated."""

import os
import random
import shutil
import signal
import struct
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import yaml

from bags import texts_of_mcap, texts_of_rosbags
from skinplan.errors import BagInvalidError, BagNotFoundError, BagNotWritableError
from skinplan.recording.bag import BagSettings, BagWriter
from skinplan.recording.heal import heal_bag, is_finished
from skinplan.recording.qos import QosProfile
from skinplan.recording.reader import open_bag, read_messages

HASH = "RIHS01_" + "0123456789abcdef" * 4
LATCHED = QosProfile(depth=1, durability="transient_local")


def string(text: str) -> bytes:
    """The CDR bytes of a std_msgs/String."""
    data = text.encode() + b"\0"
    return b"\x00\x01\x00\x00" + struct.pack("<I", len(data)) + data


def texts(folder: Path) -> list[str]:
    """The texts of all messages, read by our reader."""
    return [m.data[8:-1].decode() for m in read_messages(open_bag(folder))]


def write_bag(folder: Path, count: int = 60, chunk_bytes: int = 700, **settings: object) -> Path:
    given = BagSettings(chunk_bytes=chunk_bytes, **settings)  # type: ignore[arg-type]
    with BagWriter(folder, {"job_id": "j1"}, given) as bag:
        bag.add_topic("/chatter", "std_msgs/msg/String", "string data\n", HASH, [LATCHED])
        bag.add_topic("/other", "std_msgs/msg/String", "string data\n", HASH)
        for i in range(count):
            bag.write(("/chatter", "/other")[i % 2], string(f"hello {i} {'x' * 90}"), 1000 + i)
    return folder / f"{folder.name}_0.mcap"


def cut_bag(tmp_path: Path, file: Path, size: int) -> Path:
    folder = tmp_path / "cut"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    (folder / file.name).write_bytes(file.read_bytes()[:size])
    return folder


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
def test_a_file_cut_anywhere_keeps_all_that_was_whole(tmp_path: Path, compression: str) -> None:
    file = write_bag(tmp_path / "bag", compression=compression)
    everything, size = texts(tmp_path / "bag"), file.stat().st_size
    kept = []
    for cut in [0, 3, 8, 20, *range(30, size, max(1, size // 25)), size - 1]:
        folder = cut_bag(tmp_path, file, cut)
        try:
            before = len(texts(folder))
        except BagInvalidError:
            before = 0
        report = heal_bag(folder)
        assert report.healed and report.metadata_rebuilt and is_finished(folder)
        found = texts(folder)
        assert found == everything[: len(found)]
        assert before <= len(found) == report.files[0].messages
        assert open_bag(folder).complete
        assert not [*folder.glob(".*")]
        kept.append(len(found))
    assert kept == sorted(kept) and kept[-1] == len(everything) and len(set(kept)) > 5


def test_a_healed_bag_is_read_by_others(tmp_path: Path) -> None:
    file = write_bag(tmp_path / "bag")
    folder = cut_bag(tmp_path, file, file.stat().st_size * 6 // 10)
    report = heal_bag(folder)
    expected = [f"hello {i} {'x' * 90}" for i in range(report.files[0].messages)]
    assert len(expected) > 20
    assert texts_of_rosbags(folder) == texts_of_mcap(folder) == texts(folder) == expected
    found = yaml.safe_load((folder / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert found["message_count"] == len(expected)
    assert found["custom_data"]["job_id"] == "j1"
    assert found["custom_data"]["healed"] == report.sentence()
    assert f"{report.files[0].bytes_lost} of" in report.sentence()
    topic = found["topics_with_message_count"][0]
    assert topic["topic_metadata"]["offered_qos_profiles"][0]["durability"] == "transient_local"
    assert topic["topic_metadata"]["type_description_hash"] == HASH
    again = heal_bag(folder)
    assert not again.healed and "in order" in again.sentence()


def test_damage_in_the_middle_costs_one_chunk_and_keeps_the_old_file(tmp_path: Path) -> None:
    file = write_bag(tmp_path / "bag", compression="none")
    damaged = bytearray(file.read_bytes())
    place = damaged.find(b"hello 30 ")
    damaged[place + 20] ^= 0xFF
    file.write_bytes(bytes(damaged))
    assert not heal_bag(tmp_path / "bag").healed, "closed in order: only a thorough look finds it"
    report = heal_bag(tmp_path / "bag", thorough=True)
    found = texts(tmp_path / "bag")
    lost = {f"hello {i} {'x' * 90}" for i in range(60)} - set(found)
    assert f"hello 30 {'x' * 90}" in lost and len(lost) < 10
    assert report.files[0].kept is not None and "places damaged" in report.sentence()
    assert report.files[0].kept.read_bytes() == bytes(damaged)
    assert texts_of_rosbags(tmp_path / "bag") == found


def test_flipped_bytes_and_huge_lengths_end_in_a_healed_bag_or_a_named_error(
    tmp_path: Path,
) -> None:
    file = write_bag(tmp_path / "bag", count=30)
    whole, everything = file.read_bytes(), set(texts(tmp_path / "bag"))
    rng = np.random.default_rng(1)
    kept = 0
    for number in range(120):
        damaged = bytearray(whole)
        for place in rng.integers(8, len(whole), 1 + number % 3):
            damaged[place] ^= int(rng.integers(1, 256))
        if number % 4 == 0:
            place = int(rng.integers(8, len(whole) - 8))
            damaged[place : place + 8] = struct.pack("<Q", int(rng.integers(2**31, 2**63)))
        folder = cut_bag(tmp_path, file, 0)
        (folder / file.name).write_bytes(bytes(damaged))
        heal_bag(folder, thorough=True)
        found = set(texts(folder))
        assert found <= everything
        kept += len(found)
    assert kept > 120 * 30 * 0.6


@pytest.mark.parametrize("content", [b"hello", bytes(5000), b"\x89MCAP1\r\n" + bytes(50)])
def test_what_is_no_mcap_file_is_named_and_left_alone(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "bad_0.mcap").write_bytes(content)
    with pytest.raises(BagInvalidError, match=r"bad_0\.mcap"):
        heal_bag(tmp_path)
    assert (tmp_path / "bad_0.mcap").read_bytes() == content
    with pytest.raises(BagNotFoundError, match="nowhere"):
        heal_bag(tmp_path / "nowhere")
    (tmp_path / "empty").mkdir()
    with pytest.raises(BagInvalidError, match="none in it"):
        heal_bag(tmp_path / "empty")


def test_a_bag_under_way_is_not_healed(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("/chatter", "std_msgs/msg/String", "string data\n")
        bag.write("/chatter", string("a"), 1)
        with pytest.raises(BagNotWritableError, match="being recorded"):
            heal_bag(tmp_path / "bag")
    assert not heal_bag(tmp_path / "bag").healed


RECORDER = """
import struct, sys, time
from pathlib import Path
from skinplan.recording.bag import BagWriter, BagSettings
settings = BagSettings(compression=sys.argv[2], split_bytes=3_000_000)
bag = BagWriter(Path(sys.argv[1]), {"job_id": "j7"}, settings)
bag.add_topic("/chatter", "std_msgs/msg/String", "string data\\n")
print("begun", flush=True)
filler, number = "abcdefghij" * 200, 0
while True:
    text = f"{number} {time.time_ns()} {filler}".encode() + b"\\0"
    now = time.time_ns()
    bag.write("/chatter", b"\\0\\1\\0\\0" + struct.pack("<I", len(text)) + text, now)
    number += 1
    time.sleep(0.0002)
"""


def check_killed(folder: Path, compression: str, delay_s: float) -> float:
    """Kills a recorder under load and heals its bag; returns the loss [s]."""
    command = [sys.executable, "-c", RECORDER, str(folder), compression]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None and process.stdout.readline() == "begun\n"
    time.sleep(delay_s)
    killed_ns = time.time_ns()
    os.kill(process.pid, signal.SIGKILL)
    process.wait(10)
    process.stdout.close()
    heal_bag(folder)
    found = texts(folder)
    assert [int(text.split()[0]) for text in found] == list(range(len(found)))
    assert texts_of_rosbags(folder) == texts_of_mcap(folder) == found
    end_ns = open_bag(folder).end_ns
    return (killed_ns - end_ns) * 1e-9 if found else delay_s


@pytest.mark.parametrize("compression", ["zstd", "none"])
def test_a_killed_recorder_loses_less_than_a_second(tmp_path: Path, compression: str) -> None:
    assert check_killed(tmp_path / "bag", compression, 1.3) <= 1.0


@pytest.mark.long
@pytest.mark.timeout(1500)
def test_two_hundred_killed_recorders_lose_less_than_a_second_each(tmp_path: Path) -> None:
    rng = random.Random(5)
    for number in range(200):
        folder = tmp_path / f"bag{number}"
        compression = ("zstd", "lz4", "none")[number % 3]
        assert check_killed(folder, compression, rng.uniform(0.0, 2.0)) <= 1.0
        shutil.rmtree(folder)
