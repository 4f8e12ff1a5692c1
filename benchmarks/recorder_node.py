"""Recorder node: how many messages per second reach the bag over DDS, none lost.

Run as ``python benchmarks/recorder_node.py``; starts ``run_recorder`` as a program, publishes at a
rate for some seconds from this process, and prints a table of what the bag holds.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from skinplan_msgs.srv import RecorderStart, RecorderStop
from std_msgs.msg import String


def call(node: Node, kind: Any, name: str, request: Any) -> Any:
    """Calls a service of the recorder."""
    client = node.create_client(kind, name)
    client.wait_for_service(30.0)
    future = client.call_async(request)
    rclpy.spin_until_future_complete(node, future, timeout_sec=60.0)
    node.destroy_client(client)
    return future.result()


def measure(node: Node, folder: Path, rate: float, size: int, seconds: float) -> tuple[Any, int]:
    """Publishes at a rate [1/s]; returns the recorder's answer and the messages published."""
    call(node, RecorderStart, "recorder/start", RecorderStart.Request(folder=str(folder)))
    publisher = node.create_publisher(String, "/load", QoSProfile(depth=5000))
    while not publisher.get_subscription_count():
        rclpy.spin_once(node, timeout_sec=0.05)
    data = serialize_message(String(data="x" * size))
    begin, sent = time.perf_counter(), 0
    while (now := time.perf_counter() - begin) < seconds:
        for _ in range(int(now * rate) - sent):
            publisher.publish(data)
            sent += 1
        time.sleep(0.001)
    time.sleep(2.0)
    node.destroy_publisher(publisher)
    return call(node, RecorderStop, "recorder/stop", RecorderStop.Request()), sent


def main() -> None:
    """Runs all cases and prints the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=10.0)
    options = parser.parse_args()
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    recorder = subprocess.Popen([sys.executable, "-m", "skinplan_nodes.run_recorder"])
    rclpy.init()
    node = Node("load")
    print(f"{'size':>10} {'asked':>10} {'published':>10} {'in the bag':>10} {'dropped':>8}")
    try:
        for size, rate in ((100, 1000), (100, 5000), (100, 20000), (2**20, 50), (2**20, 150)):
            folder = Path(tempfile.mkdtemp()) / "bag"
            answer, sent = measure(node, folder, rate, size, options.seconds)
            counts = load_messages(folder)
            print(
                f"{size:>8} B {rate:>8}/s {sent:>10} {counts:>10} {answer.dropped:>8}", flush=True
            )
    finally:
        recorder.terminate()
        recorder.wait(20)
        rclpy.try_shutdown()


def load_messages(folder: Path) -> int:
    """Returns the messages of the load in a bag."""
    from skinplan.recording.reader import open_bag

    return sum(topic.messages for topic in open_bag(folder).topics if topic.name == "/load")


if __name__ == "__main__":
    main()
