"""Reading and playing a bag of 2 GB, beside rosbags and mcap-ros2-support, in the same run.

    .venv/bin/python benchmarks/playback.py [--gigabytes 2] [--folder FOLDER]

The bag is written to a temporary folder and deleted. Peers are asked for the bytes of every
message, as we are; their decoding is switched off. What the node makes of it: player_node.py.
"""

import argparse
import os
import shutil
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader

from skinplan.recording.bag import BagSettings, BagWriter
from skinplan.recording.latched import latched_state
from skinplan.recording.qos import QosProfile
from skinplan.recording.reader import BagReader

_IMAGE = "string data"
_LARGE = 1_000_000
_SMALL = 200
_LATCHED = QosProfile(depth=1, durability="transient_local")


def write(folder: Path, gigabytes: float, compression: str) -> int:
    """Writes 1 MB messages, 20 small ones beside each, and a latched one every 100."""
    generator = np.random.default_rng(1)
    noise = generator.bytes(8 * _LARGE)
    total = 0
    with BagWriter(folder, settings=BagSettings(compression)) as writer:
        for topic in ("/image", "/joints"):
            writer.add_topic(topic, "std_msgs/msg/String", _IMAGE)
        writer.add_topic("/plan", "std_msgs/msg/String", _IMAGE, qos=[_LATCHED])
        for number in range(int(gigabytes * 1e9 / (_LARGE + 20 * _SMALL))):
            at = 10**9 + number * 10**7
            start = int(generator.integers(7 * _LARGE))
            writer.write("/image", cdr(noise[start : start + _LARGE]), at)
            for small in range(20):
                writer.write("/joints", cdr(noise[start : start + _SMALL]), at + small)
            if number % 100 == 0:
                writer.write("/plan", cdr(str(number).encode()), at)
            total += _LARGE + 20 * _SMALL
    return total


def cdr(content: bytes) -> bytes:
    """A std_msgs/String of bytes; nobody decodes it."""
    return bytes([0, 1, 0, 0]) + (len(content) + 1).to_bytes(4, "little") + content + b"\0"


def ours(folder: Path) -> int:
    """Our reader: bytes of all messages."""
    with BagReader(folder) as reader:
        return sum(len(message.data) for message in reader.messages())


def rosbags_reads(folder: Path) -> int:
    """The reader of rosbags."""
    with Reader(folder) as reader:
        return sum(len(data) for _, _, data in reader.messages())


def mcap_reads(folder: Path) -> int:
    """Foxglove's reader, on which mcap-ros2-support stands."""
    total = 0
    for path in sorted(folder.glob("*.mcap")):
        with path.open("rb") as stream:
            total += sum(len(m.data) for _, _, m in make_reader(stream).iter_messages())
    return total


def timed(work: Callable[[], int]) -> tuple[float, int]:
    """Seconds and result."""
    begin = time.perf_counter()
    found = work()
    return time.perf_counter() - begin, found


def seeks(folder: Path) -> list[float]:
    """Seconds until the first message and the latched state of 20 places are there."""
    generator = np.random.default_rng(2)
    found = []
    with BagReader(folder) as reader:
        info = reader.info
        for place in generator.integers(info.start_ns, info.end_ns, 20):
            begin = time.perf_counter()
            latched_state(reader, {"/plan": 1}, int(place))
            next(reader.messages(start_ns=int(place)))
            found.append(time.perf_counter() - begin)
    return found


def peer_seeks(folder: Path, kind: str) -> list[float]:
    """Seconds until a peer has the first message of the same places."""
    generator = np.random.default_rng(2)
    with BagReader(folder) as reader:
        info = reader.info
    found = []
    for place in generator.integers(info.start_ns, info.end_ns, 20):
        begin = time.perf_counter()
        if kind == "rosbags":
            with Reader(folder) as peer:
                next(peer.messages(start=int(place)))
        else:
            (path,) = folder.glob("*.mcap")
            with path.open("rb") as stream:
                next(make_reader(stream).iter_messages(starting_at=int(place)))
        found.append(time.perf_counter() - begin)
    return found


def opened(folder: Path) -> int:
    """Messages of a bag, from its index."""
    with BagReader(folder) as reader:
        return reader.info.messages


def asked(description: str | None) -> argparse.Namespace:
    """What the command line says about the bag to be written."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--gigabytes", type=float, default=2.0)
    parser.add_argument("--compression", default="zstd", choices=("zstd", "lz4", "none"))
    parser.add_argument("--folder", type=Path, default=None)
    return parser.parse_args()


def main() -> None:
    """Runs everything."""
    given = asked(__doc__)
    folder = Path(tempfile.mkdtemp(prefix="skinplan-playback-", dir=given.folder))
    try:
        bag = folder / "bag"
        total = write(bag, given.gigabytes, given.compression)
        load = os.getloadavg()[0]
        print(f"bag of {total / 1e9:.2f} GB, {given.compression}; load before {load:.1f}")
        spent, count = timed(lambda: opened(bag))
        print(f"open: {spent:.3f} s, {count} messages")
        readers = {"skinplan": ours, "rosbags": rosbags_reads, "mcap": mcap_reads}
        for _ in range(2):
            for name, read in readers.items():
                spent, found = timed(lambda read=read: read(bag))
                print(f"read, {name:9}: {spent:6.2f} s, {found / spent / 1e6:7.0f} MB/s")
        for name, places in (
            ("skinplan", seeks(bag)),
            ("rosbags", peer_seeks(bag, "rosbags")),
            ("mcap", peer_seeks(bag, "mcap")),
        ):
            print(f"seek, {name:9}: median {np.median(places):.4f} s, longest {max(places):.4f} s")
    finally:
        shutil.rmtree(folder)


if __name__ == "__main__":
    main()
