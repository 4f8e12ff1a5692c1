"""Player node on a bag of 2 GB: start, seek and how much it publishes per second.

    .venv/bin/python benchmarks/player_node.py [--gigabytes 2] [--folder FOLDER]

``bag_player`` runs as a program and a subscriber in another one. Start is from the program's start
to the first message heard; a seek from the call of the service to the first message heard from the
new place, and its latched state. The bag is written to a temporary folder and deleted.
"""

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from playback import asked, write
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from skinplan_msgs.srv import PlayerSeek
from std_msgs.msg import String

from skinplan.recording.reader import BagReader
from skinplan_nodes.dds_profiles import use_profiles

LISTENER = """
import json, os, threading, time
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile
from std_msgs.msg import String
from skinplan_nodes.dds_profiles import use_profiles
use_profiles(large_messages=True)
rclpy.init()
node = rclpy.create_node("listener")
found = {"messages": 0, "bytes": 0, "first": 0.0, "last": 0.0}
def take(raw):
    now = time.monotonic()
    found["first"] = found["first"] or now
    found["last"] = now
    found["messages"] += 1
    found["bytes"] += len(raw)
qos = QoSProfile(depth=2000)
for topic in ("/image", "/joints"):
    node.create_subscription(String, topic, take, qos, raw=True)
executor = SingleThreadedExecutor()
executor.add_node(node)
began = time.monotonic()
print("ready", flush=True)
def watch():
    while time.monotonic() - (found["last"] or began + 60.0) < 5.0:
        time.sleep(0.05)
    print(json.dumps(found), flush=True)
    os._exit(0)
threading.Thread(target=watch).start()
executor.spin()
"""


def player(folder: Path, **parameters: object) -> subprocess.Popen[bytes]:
    """Starts the node as a program."""
    command = [sys.executable, "-m", "skinplan_nodes.bag_player", "--ros-args"]
    for name, value in {"bag": folder, **parameters}.items():
        command += ["-p", f"{name}:={value}"]
    return subprocess.Popen(command)


def play(folder: Path, rate: float) -> None:
    """Plays a bag to a subscriber of another process."""
    listener = subprocess.Popen([sys.executable, "-c", LISTENER], stdout=subprocess.PIPE, text=True)
    assert listener.stdout is not None
    listener.stdout.readline()
    try:
        if player(folder, rate=rate, start_delay_s=4.0).wait(600):
            raise SystemExit("the player failed")
        found = json.loads(listener.stdout.readline())
    finally:
        listener.kill()
        listener.wait()
    with BagReader(folder) as reader:
        sent = sum(t.messages for t in reader.info.topics if t.name in ("/image", "/joints"))
    span = found["last"] - found["first"]
    speed = found["bytes"] / span / 1e6 if span else float("nan")
    print(
        f"play at rate {rate:g}: {found['messages']} of {sent} messages heard, "
        f"{found['bytes'] / 1e9:.2f} GB in {span:.1f} s, {speed:.0f} MB/s"
    )


class Ear:
    """Notes when something is heard on a topic of the bag."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self.heard: dict[str, float] = {}
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        for topic, qos in (("/joints", QoSProfile(depth=2000)), ("/plan", latched)):
            node.create_subscription(String, topic, self._noting(topic), qos, raw=True)

    def _noting(self, topic: str) -> Any:
        return lambda _: self.heard.setdefault(topic, time.monotonic())

    def drain(self) -> None:
        """Takes what an earlier player has left in the queues."""
        quiet_at = time.monotonic() + 0.5
        while time.monotonic() < quiet_at:
            self.heard.clear()
            rclpy.spin_once(self._node, timeout_sec=0.05)
            if self.heard:
                quiet_at = time.monotonic() + 0.5

    def wait(self, topics: tuple[str, ...], since: float, what: str) -> float:
        """Returns the seconds from a time to the first message of each topic."""
        deadline = time.monotonic() + 30.0
        while not all(topic in self.heard for topic in topics):
            rclpy.spin_once(self._node, timeout_sec=0.001)
            if time.monotonic() > deadline:
                raise SystemExit(f"{what}: nothing heard within 30 s, found {self.heard}")
        return max(self.heard[topic] for topic in topics) - since


def start_and_seek(folder: Path, node: Node) -> None:
    """Prints how long a start and twenty seeks take."""
    generator = np.random.default_rng(3)
    with BagReader(folder) as reader:
        length_s = reader.info.duration_s
    ear = Ear(node)
    starts, seeks = [], []
    client = node.create_client(PlayerSeek, "player/seek")
    for _ in range(5):
        ear.heard.clear()
        begin = time.monotonic()
        program = player(folder, start_delay_s=0.0, loop=True)
        starts.append(ear.wait(("/joints",), begin, "start"))
        client.wait_for_service(10.0)
        for place in generator.uniform(0.0, 0.75 * length_s, 4):
            ear.heard.clear()
            begin = time.monotonic()
            future = client.call_async(PlayerSeek.Request(offset=float(place)))
            rclpy.spin_until_future_complete(node, future, timeout_sec=10.0)
            # What was on its way before the seek does not count.
            ear.heard.pop("/joints", None)
            seeks.append(ear.wait(("/joints", "/plan"), begin, "seek"))
        program.terminate()
        program.wait(20)
        ear.drain()
    print(f"start: median {np.median(starts):.3f} s, longest {max(starts):.3f} s of {len(starts)}")
    print(f"seek:  median {np.median(seeks):.3f} s, longest {max(seeks):.3f} s of {len(seeks)}")


def main() -> None:
    """Runs everything."""
    given = asked(__doc__)
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    # As all programs of the cell.
    use_profiles(large_messages=True)
    folder = Path(tempfile.mkdtemp(prefix="skinplan-player-", dir=given.folder))
    rclpy.init()
    node = Node("ear")
    try:
        total = write(folder / "bag", given.gigabytes, given.compression)
        load = os.getloadavg()[0]
        print(f"bag of {total / 1e9:.2f} GB, {given.compression}; load before {load:.1f}")
        start_and_seek(folder / "bag", node)
        # 100 images of 1 MB per second of recording; and as fast as it goes.
        for rate in (1.2, 1000.0):
            play(folder / "bag", rate)
    finally:
        rclpy.try_shutdown()
        shutil.rmtree(folder)


if __name__ == "__main__":
    main()
