"""Latency that recording adds to the graph: a probe from one process to another, with and without.

Run as ``python benchmarks/recorder_latency.py``. A publisher sends the time 200 times a second
beside a load of small and large messages; a subscriber in another process notes how old each is.
Rounds without ``run_recorder`` and with it, recording all of it, take turns.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from recorder_node import call
from skinplan_msgs.srv import RecorderStart, RecorderStop
from std_msgs.msg import String

from skinplan_nodes.dds_profiles import use_profiles

PROBES_HZ = 200

LISTENER = """
import json, sys, time
import rclpy
from rclpy.qos import QoSProfile
from std_msgs.msg import String
rclpy.init()
node = rclpy.create_node("listener")
ages, loads = [], [0]
def take(message):
    ages.append(time.monotonic() - float(message.data))
def count(raw):
    loads[0] += 1
node.create_subscription(String, "/probe", take, QoSProfile(depth=2000))
node.create_subscription(String, "/large", count, QoSProfile(depth=100), raw=True)
print("ready", flush=True)
end = time.monotonic() + float(sys.argv[1])
while time.monotonic() < end:
    rclpy.spin_once(node, timeout_sec=0.1)
print(json.dumps(ages), flush=True)
rclpy.shutdown()
"""


def publish(node: Node, seconds: float, small_hz: int, large_hz: int) -> None:
    """Sends probes and load for some seconds."""
    topics = {"/probe": PROBES_HZ, "/small": small_hz, "/large": large_hz}
    publishers = {
        name: node.create_publisher(String, name, QoSProfile(depth=1000)) for name in topics
    }
    small = serialize_message(String(data="x" * 100))
    large = serialize_message(String(data="x" * 2**20))
    time.sleep(1.5)
    begin = time.monotonic()
    sent = dict.fromkeys(topics, 0)
    while (now := time.monotonic() - begin) < seconds:
        for name, rate in topics.items():
            while sent[name] < int(now * rate):
                sent[name] += 1
                if name == "/probe":
                    publishers[name].publish(String(data=repr(time.monotonic())))
                else:
                    publishers[name].publish(small if name == "/small" else large)
        time.sleep(0.0005)
    for publisher in publishers.values():
        node.destroy_publisher(publisher)


def measured(node: Node, options: argparse.Namespace, recorded: bool) -> np.ndarray:
    """Ages of the probes [s] of one round."""
    listener = subprocess.Popen(
        [sys.executable, "-c", LISTENER, str(options.seconds + 4.0)],
        stdout=subprocess.PIPE,
        text=True,
    )
    assert listener.stdout is not None
    listener.stdout.readline()
    recorder = None
    if recorded:
        recorder = subprocess.Popen([sys.executable, "-m", "skinplan_nodes.run_recorder"])
        folder = Path(tempfile.mkdtemp()) / "bag"
        call(node, RecorderStart, "recorder/start", RecorderStart.Request(folder=str(folder)))
    publish(node, options.seconds, options.small, options.large)
    ages = np.array(json.loads(listener.stdout.readline()))
    listener.wait(20)
    if recorder is not None:
        answer = call(node, RecorderStop, "recorder/stop", RecorderStop.Request())
        if answer.dropped:
            print(f"the recorder dropped {answer.dropped}")
        recorder.terminate()
        recorder.wait(20)
    return ages


def main() -> None:
    """Takes turns and prints the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--small", type=int, default=2000, help="small messages per second")
    parser.add_argument("--large", type=int, default=20, help="messages of 1 MiB per second")
    options = parser.parse_args()
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    # As a node of ours that publishes megabytes.
    use_profiles(large_messages=True)
    rclpy.init()
    node = Node("load")
    print(f"{'':10} {'probes':>7} {'median':>10} {'95 %':>10} {'99 %':>10} {'largest':>10}")
    for _ in range(options.rounds):
        for name, recorded in (("without", False), ("recorded", True)):
            ages = measured(node, options, recorded) * 1e3
            figures = [np.median(ages), *np.percentile(ages, [95, 99]), ages.max()]
            row = " ".join(f"{figure:>7.3f} ms" for figure in figures)
            print(f"{name:10} {len(ages):>7} {row}; load {os.getloadavg()[0]:.1f}", flush=True)
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
