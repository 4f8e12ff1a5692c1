"""Recording: how fast bags are written and read, beside others in the same run.

Run as ``python benchmarks/recording.py``; prints a table. skinplan and rosbags write serialised
messages into MCAP, with zstd or without, and read them back. mcap-ros2-support has no writer of
serialised messages: it encodes each one, and nothing else is asked of it. Only ours brings the
file to the disk, twice a second and at the end, and its time includes that.
"""

import argparse
import os
import shutil
import struct
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from mcap.reader import make_reader
from mcap.writer import CompressionType
from mcap_ros2.writer import Writer as McapRos2Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer

from skinplan.recording.bag import BagSettings, BagWriter
from skinplan.recording.reader import open_bag, read_messages

TYPE, SCHEMA, TOPIC = "std_msgs/msg/String", "string data\n", "/data"


def message(size: int) -> bytes:
    """A std_msgs/String: half of it noise, half of it compresses well, as an image does."""
    text = os.urandom(size // 2).hex().encode()[: size - 9]
    return b"\x00\x01\x00\x00" + struct.pack("<I", len(text) + 1) + text + b"\0"


def ours(folder: Path, data: bytes, count: int, compression: str) -> None:
    """Writes with our writer."""
    with BagWriter(folder, settings=BagSettings(compression=compression)) as bag:
        bag.add_topic(TOPIC, TYPE, SCHEMA)
        for i in range(count):
            bag.write(TOPIC, data, 1000 + i)


def theirs(folder: Path, data: bytes, count: int, compression: str) -> None:
    """Writes with rosbags."""
    writer = Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP)
    if compression == "zstd":
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection(TOPIC, TYPE, msgdef=SCHEMA, rihs01="RIHS01_" + "0" * 64)
        for i in range(count):
            writer.write(connection, 1000 + i, data)


def encoded(folder: Path, data: bytes, count: int, compression: str) -> None:
    """Writes with mcap-ros2-support, which encodes each message."""
    folder.mkdir()
    kind = CompressionType.ZSTD if compression == "zstd" else CompressionType.NONE
    with (folder / "bag_0.mcap").open("wb") as stream:
        writer = McapRos2Writer(stream, compression=kind)
        schema = writer.register_msgdef(TYPE, SCHEMA)
        text = {"data": data[8:-1].decode()}
        for i in range(count):
            writer.write_message(TOPIC, schema, text, 1000 + i, 1000 + i)
        writer.finish()


def read_with_mcap(folder: Path) -> int:
    """Reads with Foxglove's reader, without decoding; returns the bytes."""
    with (folder / "bag_0.mcap").open("rb") as stream:
        return sum(len(message.data) for _, _, message in make_reader(stream).iter_messages())


def read_ours(folder: Path) -> int:
    """Reads with our reader; returns the bytes."""
    return sum(len(m.data) for m in read_messages(open_bag(folder)))


def read_theirs(folder: Path) -> int:
    """Reads with rosbags; returns the bytes."""
    with Reader(folder) as reader:
        return sum(len(data) for _, _, data in reader.messages())


def timed(work: Callable[[], object]) -> float:
    """Returns the wall time [s]."""
    begin = time.perf_counter()
    work()
    return time.perf_counter() - begin


def main() -> None:
    """Runs all cases and prints the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--megabytes", type=int, default=300, help="of large messages")
    parser.add_argument("--small", type=int, default=100_000, help="number of small messages")
    options = parser.parse_args()
    cases = [
        ("1 MB, zstd", 2**20, options.megabytes, "zstd"),
        ("1 MB, none", 2**20, options.megabytes, "none"),
        ("100 B, zstd", 100, options.small, "zstd"),
        ("100 B, none", 100, options.small, "none"),
    ]
    print(f"{'messages':<12} {'':<9} {'write':>12} {'read':>12} {'write':>14} {'file':>9}")
    for name, size, count, compression in cases:
        data = message(size)
        for who, write, read in (
            ("skinplan", ours, read_ours),
            ("rosbags", theirs, read_theirs),
            ("mcap-ros2", encoded, read_with_mcap),
        ):
            folder = Path(tempfile.mkdtemp()) / "bag"
            written = timed(lambda: write(folder, data, count, compression))  # noqa: B023
            size_mb = sum(f.stat().st_size for f in folder.iterdir()) / 1e6
            done = timed(lambda: read(folder))  # noqa: B023
            total = len(data) * count / 1e6
            print(
                f"{name:<12} {who:<9} {total / written:>7.0f} MB/s {total / done:>7.0f} MB/s "
                f"{count / written:>10,.0f} /s {size_mb:>6.0f} MB"
            )
            shutil.rmtree(folder.parent)


if __name__ == "__main__":
    main()
