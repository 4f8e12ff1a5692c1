"""What the whole graph costs: a measurement on the mock cell, one process per node.

    python benchmarks/graph.py [scene4] [--time-factor 10] [--json FILE]

Starts the runner as `skinplan run` does, samples every process, listens to `/clock`, and prints CPU
seconds, largest resident and proportional memory per node, and how fast the cell's time ran in each
phase of the job.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rosgraph_msgs.msg import Clock

from skinplan.part.samples import write_sample
from skinplan_nodes.conversions import stamp_from_msg
from skinplan_nodes.qos import STATE

_READERS = "(readers of the runner)"
_SAMPLE_S = 1.0
_MIB = 2.0**20


@dataclass
class Usage:
    """Largest memory of a node [bytes]."""

    rss: int = 0
    pss: int = 0


class Sampler(threading.Thread):
    """Samples the processes of the runner until it ends."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        super().__init__(daemon=True)
        self._process = process
        self.usage: dict[str, Usage] = defaultdict(Usage)
        # A process begins as a shell, before it is a node: what it used counts for its last name.
        self._cpu: dict[int, tuple[str, float]] = {}
        self.rss = self.pss = 0

    def run(self) -> None:
        """Samples."""
        while self._process.poll() is None:
            self._sample()
            time.sleep(_SAMPLE_S)

    def cpu(self) -> dict[str, float]:
        """Returns the CPU time of each node so far [s]."""
        found: dict[str, float] = defaultdict(float)
        for name, used_s in list(self._cpu.values()):
            found[name] += used_s
        return found

    def _sample(self) -> None:
        rss: dict[str, int] = defaultdict(int)
        pss: dict[str, int] = defaultdict(int)
        try:
            root = psutil.Process(self._process.pid)
            processes = [root, *root.children(recursive=True)]
        except psutil.NoSuchProcess:
            return
        for process in processes:
            try:
                name = _name(process, root)
                times, memory = process.cpu_times(), process.memory_full_info()
            except (psutil.NoSuchProcess, psutil.AccessDenied, psutil.ZombieProcess):
                continue
            if name == _READERS and process.pid in self._cpu:
                # One that ends has no command any more.
                name = self._cpu[process.pid][0]
            self._cpu[process.pid] = (name, times.user + times.system)
            rss[name] += memory.rss
            pss[name] += memory.pss
        for name in rss:
            self.usage[name].rss = max(self.usage[name].rss, rss[name])
            self.usage[name].pss = max(self.usage[name].pss, pss[name])
        self.rss, self.pss = max(self.rss, sum(rss.values())), max(self.pss, sum(pss.values()))


def _name(process: psutil.Process, root: psutil.Process) -> str:
    if process.pid == root.pid:
        return "(runner)"
    # A fork tells its command as one word.
    for word in " ".join(process.cmdline()).split()[:7]:
        if word.startswith("skinplan_nodes.") and word != "skinplan_nodes.runner":
            return word.removeprefix("skinplan_nodes.")
    return _READERS


class ClockEar:
    """Hears the cell's time."""

    def __init__(self) -> None:
        rclpy.init(args=[])
        self._node = rclpy.create_node("graph_benchmark")
        self._node.create_subscription(Clock, "/clock", self._on_clock, STATE)
        executor = SingleThreadedExecutor()
        executor.add_node(self._node)
        threading.Thread(target=executor.spin, daemon=True).start()
        self.now_s = 0.0

    def _on_clock(self, message: Clock) -> None:
        self.now_s = stamp_from_msg(message.clock)


def run(part: Path, runs: Path, factor: float, domain: int, extra: list[str]) -> dict[str, Any]:
    """Measures a part and returns what it cost."""
    command = [sys.executable, "-P", "-m", "skinplan_nodes.runner", "--part", str(part)]
    command += ["--runs-folder", str(runs), "--time-factor", str(factor), "--json-lines", *extra]
    environment = {**os.environ, "ROS_DOMAIN_ID": str(domain)}
    began_s = time.monotonic()
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)
    ear, sampler = ClockEar(), Sampler(process)
    sampler.start()
    phases: dict[str, list[float]] = defaultdict(lambda: [0.0, 0.0, 0.0])
    last: dict[str, Any] = {}
    phase, before = "starting", (began_s, 0.0, 0.0)
    assert process.stdout is not None
    for line in process.stdout:
        event = json.loads(line)
        now = (time.monotonic(), ear.now_s, sum(sampler.cpu().values()))
        for place in range(3):
            phases[phase][place] += now[place] - before[place]
        before = now
        if event["event"] == "status" and event["sub_state"]:
            phase = event["sub_state"].split(" ")[0]
        if event["event"] == "result":
            last = event
    process.wait()
    used = sampler.cpu()
    return {
        "result": last,
        "wall_s": time.monotonic() - began_s,
        "phases": dict(phases),
        "nodes": {
            name: {"cpu_s": used[name], "rss": u.rss, "pss": u.pss}
            for name, u in sampler.usage.items()
        },
        "rss": sampler.rss,
        "pss": sampler.pss,
    }


def show(found: dict[str, Any]) -> None:
    """Prints the tables."""
    print(f"\n{'node':26} {'CPU s':>8} {'RSS MiB':>8} {'PSS MiB':>8}")
    nodes = sorted(found["nodes"].items(), key=lambda item: -item[1]["cpu_s"])
    for name, used in nodes:
        memory = f"{used['rss'] / _MIB:8.0f} {used['pss'] / _MIB:8.0f}"
        print(f"{name:26} {used['cpu_s']:8.1f} {memory}")
    total = sum(used["cpu_s"] for _, used in nodes)
    print(f"{'all':26} {total:8.1f} {found['rss'] / _MIB:8.0f} {found['pss'] / _MIB:8.0f}")
    print(f"\n{'phase':14} {'wall s':>8} {'cell s':>8} {'factor':>7} {'CPU s':>8}")
    for name, (wall, cell, cpu) in found["phases"].items():
        print(f"{name:14} {wall:8.1f} {cell:8.1f} {cell / max(wall, 1e-9):7.2f} {cpu:8.1f}")
    moving = [v for k, v in found["phases"].items() if k not in _STANDING]
    wall, cell = sum(v[0] for v in moving), sum(v[1] for v in moving)
    print(f"{'without plan.':14} {wall:8.1f} {cell:8.1f} {cell / max(wall, 1e-9):7.2f}")
    print(f"\nwall time {found['wall_s']:.1f} s, {found['result']}")


# The cell waits for a computer in these.
_STANDING = ("starting", "planning", "inspecting", "closing")


def main() -> None:
    """Runs it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("part", nargs="?", default="scene4", help="name of a sample part")
    parser.add_argument("--time-factor", type=float, default=10.0)
    parser.add_argument("--runs-folder", type=Path, help="keeps the run there")
    parser.add_argument("--json", type=Path, help="the figures as JSON, too")
    given, extra = parser.parse_known_args()
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    domain = int(os.environ.setdefault("ROS_DOMAIN_ID", str(40 + os.getpid() % 60)))
    with tempfile.TemporaryDirectory() as folder:
        runs = (given.runs_folder or Path(folder) / "runs").absolute()
        part = write_sample(given.part, Path(folder))
        assert part.source is not None
        found = run(part.source, runs, given.time_factor, domain, extra)
        summary = Path(found["result"].get("run_folder") or folder) / "summary.json"
        if summary.is_file():
            found["measured"] = json.loads(summary.read_text())["measured"]
            print(found["measured"])
    show(found)
    if given.json:
        given.json.write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
