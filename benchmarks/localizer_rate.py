"""How the node aruco_localizer keeps up with a camera: 1280 x 720 at 30 Hz.

    python benchmarks/localizer_rate.py [--seconds 20] [--rate 30] [--beside scene2]

Starts the node as a program, sends it rendered images, and prints what its diagnostics say. With
`--beside` the whole graph of a mock cell measures a part meanwhile, in real time: the node under
test is one more, in a namespace of its own, and begins when the job scans.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from localization import CAMERA, CELL, FIXTURE, T_MAP_WORKPIECE, T_OPTICAL, base_at
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import CameraInfo, Image
from skinplan_msgs.msg import MarkerObservations

from skinplan.mock.camera import MockCamera
from skinplan.part.samples import write_sample
from skinplan.transforms import inverse
from skinplan_nodes.conversions import camera_info_to_msg, image_to_msg
from skinplan_nodes.qos import IMAGE, STATE

# The node under test hears nothing of the graph beside it.
SPACE = "/rate"


def images(count: int) -> list[np.ndarray]:
    """Renders a slow ride along the panel."""
    camera = MockCamera(CELL.camera, FIXTURE, seed=1)
    places = np.linspace(-0.1, 0.1, count)
    return [
        camera.render(inverse(base_at(x, 1.2, 0.1, 0.0) @ T_OPTICAL) @ T_MAP_WORKPIECE)
        for x in places
    ]


@contextmanager
def graph_beside(name: str, folder: Path) -> Iterator[None]:
    """Starts the graph of the mock cell with a job, waits until it scans, ends it afterwards."""
    part = write_sample(name, folder / "beside")
    command = [sys.executable, "-P", "-m", "skinplan_nodes.runner", "--part", str(part.source)]
    command += ["--runs-folder", str(folder / "runs"), "--json-lines", "--time-factor", "1"]
    with (folder / "runner.err").open("w") as errors:
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors, text=True)
    try:
        for line in process.stdout or ():
            if json.loads(line).get("sub_state") == "scanning":
                break
        if process.poll() is not None:
            sys.exit(f"the graph ended before it scanned: {(folder / 'runner.err').read_text()}")
        yield
        print(f"the graph {'ran on' if process.poll() is None else 'had ended'} at the end")
    finally:
        process.terminate()
        process.communicate(timeout=60.0)


@contextmanager
def localizer(folder: Path) -> Iterator[None]:
    """Starts the node under test."""
    part = write_sample("scene4", folder / "own")
    command = [sys.executable, "-m", "skinplan_nodes.aruco_localizer", "--ros-args"]
    command += ["-r", f"__ns:={SPACE}", "-p", f"watched_part:={part.source}"]
    process = subprocess.Popen([*command, "-p", "watch_rate_hz:=60.0"])
    try:
        yield
    finally:
        process.terminate()
        process.wait(20.0)


def main() -> None:
    """Runs it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--rate", type=float, default=30.0)
    parser.add_argument("--beside", default="", help="sample part that the graph measures")
    given = parser.parse_args()
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ.setdefault("ROS_DOMAIN_ID", str(40 + os.getpid() % 60))
    frames = [image_to_msg(image, "optical") for image in images(20)]
    info = camera_info_to_msg(CAMERA, "optical")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with graph_beside(given.beside, folder) if given.beside else nullcontext():
            before_s = sum(os.times()[:4])
            with localizer(folder):
                measure(frames, info, given.seconds, given.rate)
            busy_s = sum(os.times()[:4]) - before_s
            print(f"node and camera of this benchmark: {busy_s:.1f} s of CPU")


def measure(frames: list[Image], info: CameraInfo, seconds: float, rate_hz: float) -> None:
    """Sends the images and prints the node's own figures."""
    rclpy.init(args=[])
    node = rclpy.create_node("camera", namespace=SPACE)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    image = node.create_publisher(Image, "camera/color/image_raw", IMAGE)
    infos = node.create_publisher(CameraInfo, "camera/color/camera_info", IMAGE)
    told: dict[str, str] = {}
    ages: list[float] = []

    def take(msg: DiagnosticArray) -> None:
        told.update({pair.key: pair.value for pair in msg.status[0].values})

    node.create_subscription(DiagnosticArray, "diagnostics", take, STATE)
    node.create_subscription(
        MarkerObservations, "markers/observations", lambda msg: ages.append(msg.image_age), STATE
    )
    while image.get_subscription_count() == 0:
        executor.spin_once(timeout_sec=0.1)
    begin, sent = time.monotonic(), 0
    while time.monotonic() - begin < seconds:
        frame = frames[sent % len(frames)]
        frame.header.stamp = info.header.stamp = node.get_clock().now().to_msg()
        infos.publish(info)
        image.publish(frame)
        sent += 1
        while (left := begin + sent / rate_hz - time.monotonic()) > 0.0:
            executor.spin_once(timeout_sec=left)
    end = time.monotonic() + 2.5
    while time.monotonic() < end:
        executor.spin_once(timeout_sec=0.1)
    load = os.getloadavg()[0]
    print(f"{os.cpu_count()} cores, load {load:.1f}")
    late = np.percentile(ages, 95) if ages else float("nan")
    third = max(len(ages) // 3, 1)
    print(
        "| sent | received | evaluated | dropped | image age p95 (ms) | first third | last third |"
    )
    print("|---|---|---|---|---|---|---|")
    print(
        f"| {sent} | {told['images_received']} | {told['images_evaluated']} | "
        f"{told['images_dropped']} | {1e3 * late:.0f} | {1e3 * np.median(ages[:third]):.0f} | "
        f"{1e3 * np.median(ages[-third:]):.0f} |"
    )
    rclpy.shutdown()


if __name__ == "__main__":
    main()
