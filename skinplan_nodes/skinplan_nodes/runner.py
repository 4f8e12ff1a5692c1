"""Starts the node graph with one process per node, and measures a part in it.

``python -m skinplan_nodes.runner --part PART.yaml --runs-folder runs --json-lines`` runs graph and
job client and ends with the job; with ``--serve`` the graph runs until it is interrupted. Needs no
ROS itself.
"""

import argparse
import json
import logging
import os
import shlex
import signal
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from skinplan.jobs.checks import ID_PATTERN
from skinplan_nodes.graph import PACKAGE, GraphSettings, NodeSpec, describe
from skinplan_nodes.processes import GraphManager, domain_of_graph

CLIENT = "measure"
SUPERVISOR = "cell_supervisor"
DIED = "died.txt"
EXIT_FAILED = 1
EXIT_BAD_INPUT = 2
# One thread per process: there are more processes than cores.
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS")
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class RunnerOptions:
    """What the runner was asked for.

    Attributes:
        graph: What the graph is started for.
        part: Part file to measure; None with `serve`.
        serve: Run the graph without a job.
        json_lines: Events on stdout as JSON lines.
        job_id: Id of the job; empty = made here.
        serial_number: Of the individual part; may be empty.
        namespace: Of all nodes; may be empty.
        config_folder: Folder of parameter files ``<node>.yaml``; None = the nodes' defaults.
    """

    graph: GraphSettings
    part: Path | None
    serve: bool = False
    json_lines: bool = False
    job_id: str = ""
    serial_number: str = ""
    namespace: str = ""
    config_folder: Path | None = None


@dataclass
class Runner:
    """One run of the graph.

    Attributes:
        options: What was asked for.
        died: Names of the nodes that died.
        result: The client's last event; None until it came.
    """

    options: RunnerOptions
    died: list[str] = field(default_factory=list)
    result: dict[str, Any] | None = None

    def run(self) -> int:
        """Starts everything, waits for the end, leaves no process.

        Returns:
            Exit code: 0 when the job ended well, 130 or 143 after a signal, 1 otherwise.
        """
        log_folder = self._log_folder()
        log_folder.mkdir(parents=True, exist_ok=True)
        environment = graph_environment(dict(os.environ))
        # A served cell ends its job while the others are still there; otherwise the
        # client does that.
        client, first = (None, SUPERVISOR) if self.options.serve else (CLIENT, None)
        manager = GraphManager(self._on_line, self._on_death, client, first)
        for node in describe(self.options.graph):
            manager.add_process(node.name, self._node_command(node, log_folder), env=environment)
        if not self.options.serve:
            manager.add_process(CLIENT, self._client_command(log_folder), env=environment)
        domain = int(environment["ROS_DOMAIN_ID"])
        self._emit({"event": "graph", "ros_domain_id": domain, "log_folder": str(log_folder)})
        manager.loop()
        self._finish(manager.returncode or 0)
        return self._exit_code(manager)

    def _exit_code(self, manager: GraphManager) -> int:
        if manager.returncode in (130, 143):
            return int(manager.returncode)
        if self.died:
            return EXIT_FAILED
        return manager.client_code() or 0

    def _finish(self, code: int) -> None:
        """Emits the last event when the client could not."""
        if self.options.serve or self.result is not None:
            return
        cause = (
            f"node {self.died[0]} died" if self.died else f"the job client ended with code {code}"
        )
        if code in (128 + signal.SIGINT, 128 + signal.SIGTERM):
            cause = "the run was interrupted"
        job_id, folder = self.options.job_id, str(self._run_folder())
        self._emit(
            {
                "event": "result",
                "job_id": job_id,
                "state": "Aborted",
                "run_folder": folder,
                "error": f"{cause}; the log files are in {self._log_folder()}",
            }
        )

    def _on_line(self, name: str, line: str) -> None:
        event = _parsed(line) if name == CLIENT else None
        if event is None:
            _log.warning("%s: %s", name, line)
            return
        if event["event"] == "result":
            self.result = event
        self._emit(event)

    def _on_death(self, name: str, code: int) -> None:
        self.died.append(name)
        # The client reads it when it is interrupted, and gives it as the reason.
        (self._log_folder() / DIED).write_text(f"node {name} died\n", encoding="utf-8")
        how = {"code": code} if code >= 0 else {"signal": -code}
        self._emit({"event": "node_died", "node": name, **how})

    def _emit(self, event: dict[str, Any]) -> None:
        text = json.dumps(event) if self.options.json_lines else _sentence(event)
        sys.stdout.write(text + "\n")
        sys.stdout.flush()

    def _node_command(self, node: NodeSpec, log_folder: Path) -> str:
        arguments = [sys.executable, "-m", node.module, "--ros-args", "--disable-external-lib-logs"]
        if self.options.namespace:
            arguments += ["-r", f"__ns:={self.options.namespace}"]
        if self.options.config_folder is not None:
            config = self.options.config_folder / f"{node.name}.yaml"
            arguments += ["--params-file", str(config)] if config.is_file() else []
        arguments += ["--params-file", str(write_parameters(node, log_folder))]
        return f"exec {shlex.join(arguments)} >>{shlex.quote(str(log_folder / node.name))}.log 2>&1"

    def _client_command(self, log_folder: Path) -> str:
        options = self.options
        arguments = [sys.executable, "-m", f"{PACKAGE}.{CLIENT}", "--part-uri", str(options.part)]
        arguments += ["--runs-folder", str(options.graph.runs_folder), "--job-id", options.job_id]
        arguments += ["--serial-number", options.serial_number, "--namespace", options.namespace]
        arguments += ["--cell-file", options.graph.cell_file, "--json-lines"]
        return f"exec {shlex.join(arguments)} 2>>{shlex.quote(str(log_folder / CLIENT))}.log"

    def _run_folder(self) -> Path:
        return self.options.graph.runs_folder / self.options.job_id

    def _log_folder(self) -> Path:
        if self.options.serve:
            return self.options.graph.runs_folder / "log" / self.options.job_id
        return self._run_folder() / "log"


def graph_environment(environment: dict[str, str]) -> dict[str, str]:
    """Returns the environment of the nodes: DDS domain, this machine only, one thread each.

    Args:
        environment: Environment of the runner; what it sets itself is kept.
    """
    defaults = dict.fromkeys(_THREADS, "1")
    defaults["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    defaults["RCUTILS_COLORIZED_OUTPUT"] = "0"
    # Safe path: the folder that the runner is started in may hold a folder of a package's name.
    fixed = {"PYTHONUNBUFFERED": "1", "PYTHONSAFEPATH": "1"}
    fixed["ROS_DOMAIN_ID"] = str(domain_of_graph(environment))
    return {**defaults, **environment, **fixed}


def write_parameters(node: NodeSpec, folder: Path) -> Path:
    """Writes a node's parameters as a ROS parameter file and returns its path."""
    path = folder / f"{node.name}.params.yaml"
    document = {"/**": {"ros__parameters": dict(node.parameters)}}
    path.write_text(yaml.safe_dump(document, sort_keys=False), encoding="utf-8")
    return path


def parse_arguments(arguments: Sequence[str] | None = None) -> RunnerOptions:
    """Reads the command line.

    Raises:
        SystemExit: With code 2 for bad input, named on stderr.
    """
    parser = argparse.ArgumentParser(prog="python -m skinplan_nodes.runner", description=__doc__)
    parser.add_argument(
        "--part", type=Path, help="part file to measure; it also stands in the mock cell"
    )
    parser.add_argument(
        "--runs-folder", type=Path, default=Path("runs"), help="folder that gets the run's folder"
    )
    parser.add_argument("--cell-file", type=Path, help="cell file; without it the default cell")
    parser.add_argument(
        "--time-factor", type=float, default=1.0, help="times faster than real time"
    )
    parser.add_argument(
        "--seed", type=int, default=1, help="seed of every random draw of the mock cell"
    )
    parser.add_argument("--job-id", default="", help="id of the job; made here without it")
    parser.add_argument("--serial-number", default="", help="serial number of the individual part")
    parser.add_argument("--namespace", default="", help="namespace of all nodes, e.g. /cell1")
    parser.add_argument("--config-folder", type=Path, help="folder of parameter files <node>.yaml")
    parser.add_argument(
        "--devices",
        choices=("mock", "real"),
        default="mock",
        help="mock cell, or drivers elsewhere",
    )
    parser.add_argument(
        "--serve", action="store_true", help="run the graph without a job until interrupted"
    )
    parser.add_argument("--json-lines", action="store_true", help="events on stdout as JSON lines")
    given = parser.parse_args(arguments)
    if given.part is None and (not given.serve or given.devices == "mock"):
        parser.error("--part is needed: it is measured, and it stands in the mock cell")
    if given.part is not None and not given.part.is_file():
        parser.error(f"--part {given.part}: there is no such file; a part.yaml is accepted")
    if not 0.1 <= given.time_factor <= 50.0:
        parser.error(f"--time-factor {given.time_factor:g}: 0.1 to 50 is accepted")
    job_id = given.job_id or time.strftime("%Y%m%d-%H%M%S", time.gmtime()) + f"-{os.getpid()}"
    options = _options(given, job_id)
    used = options.graph.runs_folder / job_id
    if not ID_PATTERN.fullmatch(job_id):
        parser.error(f"--job-id {job_id!r}: 1 to 64 of [A-Za-z0-9_.-] are accepted")
    if not options.serve and used.is_dir() and any(used.iterdir()):
        parser.error(
            f"--job-id {job_id}: {used} exists already; an id that was not used yet is accepted"
        )
    return options


def _options(given: argparse.Namespace, job_id: str) -> RunnerOptions:
    runs_folder = given.runs_folder.absolute()
    part = None if given.part is None else given.part.absolute()
    # A single run keeps its job to itself; a served cell remembers its jobs.
    jobs_file = "" if given.serve else str(runs_folder / job_id / "log" / "jobs.sqlite")
    graph = GraphSettings(
        runs_folder=runs_folder,
        part_uri=str(part) if part is not None and given.devices == "mock" else "",
        cell_file="" if given.cell_file is None else str(given.cell_file.absolute()),
        time_factor=given.time_factor,
        seed=given.seed,
        jobs_file=jobs_file,
        report=given.serve,
    )
    return RunnerOptions(
        graph=graph,
        part=part,
        serve=given.serve,
        json_lines=given.json_lines,
        job_id=job_id,
        serial_number=given.serial_number,
        namespace=given.namespace,
        config_folder=given.config_folder,
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point.

    Returns:
        Exit code of the program.
    """
    logging.basicConfig(
        level=logging.WARNING, stream=sys.stderr, format="%(levelname)s %(name)s: %(message)s"
    )
    return Runner(parse_arguments(arguments)).run()


def _parsed(line: str) -> dict[str, Any] | None:
    try:
        event = json.loads(line)
    except json.JSONDecodeError:
        return None
    return event if isinstance(event, dict) and "event" in event else None


def _sentence(event: dict[str, Any]) -> str:
    details = ", ".join(
        f"{key} {value}"
        for key, value in event.items()
        if key != "event" and value not in ("", None)
    )
    return f"{event['event']}: {details}"


if __name__ == "__main__":
    sys.exit(main())
