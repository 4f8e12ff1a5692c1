"""Gaps between messages when a bag is played at rate 1, beside the recorded ones.

    .venv/bin/python benchmarks/playback_gaps.py [--realtime] BAG [BAG ...]

A subscriber in another process notes when each message arrives on the monotonic clock. Printed are
counts, order and the error of the gaps to the message before on any topic. The load of the machine
counts; with ``--realtime`` (needs the right to) player and subscriber come before all other
processes, so that what is left is their own.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np

from skinplan.recording.reader import BagReader

LISTENER = """
import hashlib, json, os, sys, threading, time
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile
from skinplan_nodes.message_types import message_class
rclpy.init()
node = rclpy.create_node("listener", enable_rosout=False)
found = []
def taker(topic):
    def take(raw):
        now_ns = time.monotonic_ns()
        found.append((topic, hashlib.sha256(raw[4:].rstrip(b"\\0")).hexdigest(), now_ns))
    return take
for topic, kind in json.loads(sys.argv[1]).items():
    name = topic if topic.startswith("/") else "/" + topic
    qos = QoSProfile(depth=5000)
    node.create_subscription(message_class(kind), name, taker(topic), qos, raw=True)
executor = SingleThreadedExecutor()
executor.add_node(node)
print("ready", flush=True)
quiet_s, began = float(sys.argv[2]), time.monotonic()
def watch():
    while time.monotonic() - (found[-1][2] * 1e-9 if found else began + 60.0) < quiet_s:
        time.sleep(0.05)
    print(json.dumps(found), flush=True)
    os._exit(0)
threading.Thread(target=watch).start()
executor.spin()
"""


def come_first() -> None:
    """Gives this process and those that it starts a real-time priority."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(20))
    except PermissionError:
        sys.exit("--realtime needs CAP_SYS_NICE or an rtprio limit, which this user does not have")


def measure(bag: Path) -> None:
    """Plays one bag and prints what arrived."""
    import hashlib

    from skinplan_nodes.message_types import message_class

    with BagReader(bag) as reader:
        kinds = {}
        for topic in reader.info.topics:
            try:
                message_class(topic.type_name)
            except LookupError:
                print(f"{bag.name}: {topic.name} is left out, {topic.type_name} is not installed")
                continue
            if topic.messages and topic.name != "/clock":
                kinds[topic.name] = topic.type_name
        recorded = [
            # DDS fills up to four bytes and says so in the head.
            (m.topic, hashlib.sha256(m.data[4:].rstrip(b"\0")).hexdigest(), m.log_time_ns)
            for m in reader.messages(kinds)
        ]
    if not recorded:
        print(f"{bag.name}: nothing in it can be published")
        return
    longest = max((np.diff([r[2] for r in recorded]).max(initial=0)) * 1e-9 + 3.0, 4.0)
    listener = subprocess.Popen(
        [sys.executable, "-c", LISTENER, json.dumps(kinds), str(longest)],
        stdout=subprocess.PIPE,
        text=True,
    )
    assert listener.stdout is not None
    listener.stdout.readline()
    command = [sys.executable, "-m", "skinplan_nodes.bag_player", "--ros-args"]
    for name, value in {"bag": bag, "start_delay_s": 4.0, "clock_rate_hz": 0.0}.items():
        command += ["-p", f"{name}:={value}"]
    try:
        subprocess.run(command, check=True, timeout=600, stderr=subprocess.DEVNULL)
        heard = json.loads(listener.stdout.readline())
    finally:
        listener.kill()
        listener.wait()
    same = [item[:2] for item in map(tuple, heard)] == [item[:2] for item in recorded]
    known = {item[:2] for item in recorded}
    heard = [item for item in heard if tuple(item[:2]) in known]
    orders = all(
        [h[1] for h in heard if h[0] == topic] == [r[1] for r in recorded if r[0] == topic]
        for topic in kinds
    )
    line = (
        f"{bag.name}: {len(recorded)} recorded, {len(heard)} heard, same order per topic {orders}"
    )
    print(f"{line}, over all topics {same}")
    if len(heard) == len(recorded) and len(heard) > 1:
        errors = np.diff([h[2] for h in heard]) - np.diff([r[2] for r in recorded])
        milliseconds = np.abs(errors) * 1e-6
        print(
            f"  error of the gaps: median {np.median(milliseconds):.3f} ms, 99 % "
            f"{np.percentile(milliseconds, 99):.3f} ms, largest {milliseconds.max():.3f} ms, "
            f"within 2 ms {np.mean(milliseconds <= 2.0):.1%}; load {os.getloadavg()[0]:.1f}"
        )


if __name__ == "__main__":
    if "--realtime" in sys.argv:
        come_first()
    for argument in sys.argv[1:]:
        if argument != "--realtime":
            measure(Path(argument))
