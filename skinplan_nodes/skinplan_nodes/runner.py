"""Starts the node graph with one process per node, and measures a part in it.

``python -m skinplan_nodes.runner --part PART.yaml --runs-folder runs --json-lines`` runs graph and
job client and ends with the job; with ``--serve`` the graph runs until it is interrupted. Needs no
ROS itself.
"""

import json
import logging
import os
import signal
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import yaml

from skinplan_nodes.dds_domain import domain_of_graph
from skinplan_nodes.dds_segments import remove_orphaned_segments
from skinplan_nodes.forked import Program
from skinplan_nodes.graph import PACKAGE, NodeSpec
from skinplan_nodes.processes import EndTimes, GraphManager
from skinplan_nodes.runner_options import RunnerOptions, parse_arguments

CLIENT = "measure"
SUPERVISOR = "cell_supervisor"
DIED = "died.txt"
# What the time was last: a clock that is started again goes on from there.
CLOCK = "sim_clock.time"
EXIT_FAILED = 1
EXIT_BAD_INPUT = 2
# One thread per process: there are more processes than cores.
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS")
_log = logging.getLogger(__name__)


@dataclass
class Runner:
    """One run of the graph.

    Attributes:
        options: What was asked for.
        died: How the nodes ended that died for good, one sentence each.
        result: The client's last event; None until it came.
    """

    options: RunnerOptions
    died: list[str] = field(default_factory=list)
    result: dict[str, Any] | None = None
    _manager: GraphManager = field(init=False)
    _unheard: bool = False

    def run(self) -> int:
        """Starts everything, waits for the end, leaves no process.

        Returns:
            Exit code: 0 when the job ended well, 130 or 143 after a signal, 1 otherwise.
        """
        log_folder = self._log_folder()
        log_folder.mkdir(parents=True, exist_ok=True)
        # Of an earlier graph: this one's time begins anew.
        (log_folder / CLOCK).unlink(missing_ok=True)
        # Before anything is imported that looks at it: the nodes are forks of this process.
        os.environ.update(graph_environment(dict(os.environ)))
        remove_orphaned_segments()
        # The job ends while the others are still there: the client aborts it; a served cell has
        # none, and where that takes too long the supervisor writes down what there is.
        client, first = None if self.options.serve else CLIENT, self._first()
        self._manager = manager = GraphManager(
            self._on_line,
            self._on_death,
            client,
            first,
            # Time for the supervisor to end its job, where there is one.
            EndTimes() if client or first else EndTimes(grace_s=0.0),
            restarts=self.options.restarts,
            on_restart=self._on_restart,
        )
        settings = replace(self.options.graph, clock_file=str(log_folder / CLOCK))
        for node in self.options.nodes(settings):
            manager.add_process(node.name, self._node_program(node, log_folder))
        if not self.options.serve:
            manager.add_process(CLIENT, self._client_program(log_folder))
        domain = int(os.environ["ROS_DOMAIN_ID"])
        self._emit({"event": "graph", "ros_domain_id": domain, "log_folder": str(log_folder)})
        manager.loop()
        self._finish(manager.returncode or 0)
        return self._exit_code(manager)

    def _first(self) -> str | None:
        only = self.options.only
        return SUPERVISOR if not only or SUPERVISOR in only else None

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
        cause = self.died[0] if self.died else f"the job client ended with code {code}"
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
        times = self._manager.recent_deaths(name)
        said = f"node {name} died ({_how(code)})"
        if times > 1:
            said += f" {times} times within {self.options.restarts.window_s:g} s"
        self.died.append(said)
        # The client reads it when it is interrupted, and gives it as the reason.
        (self._log_folder() / DIED).write_text(said + "\n", encoding="utf-8")
        self._emit({"event": "node_died", "node": name, **_codes(code), "restarted": False})

    def _on_restart(self, name: str, code: int | None, count: int) -> None:
        if code is None:
            remove_orphaned_segments()
            self._emit({"event": "node_restarted", "node": name, "restarts": count})
        else:
            self._emit({"event": "node_died", "node": name, **_codes(code), "restarted": True})

    def _emit(self, event: dict[str, Any]) -> None:
        text = json.dumps(event) if self.options.json_lines else _sentence(event)
        if self._unheard:
            return
        try:
            sys.stdout.write(text + "\n")
            sys.stdout.flush()
        except OSError as error:
            # Who started the run has gone: it ends as at a signal, and leaves nothing.
            self._unheard = True
            _log.warning("events can't be told (%s); the run ends", error.strerror or error)
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            signal.raise_signal(signal.SIGTERM)

    def _node_program(self, node: NodeSpec, log_folder: Path) -> Program:
        arguments = ["--ros-args", "--disable-external-lib-logs"]
        if self.options.namespace:
            arguments += ["-r", f"__ns:={self.options.namespace}"]
        if self.options.config_folder is not None:
            config = self.options.config_folder / f"{node.name}.yaml"
            arguments += ["--params-file", str(config)] if config.is_file() else []
        arguments += ["--params-file", str(write_parameters(node, log_folder))]
        return Program(node.module, tuple(arguments), log_folder / f"{node.name}.log")

    def _client_program(self, log_folder: Path) -> Program:
        options = self.options
        arguments = ["--part-uri", str(options.part)]
        arguments += ["--runs-folder", str(options.graph.runs_folder), "--job-id", options.job_id]
        arguments += ["--serial-number", options.serial_number, "--operator", options.operator_name]
        arguments += ["--namespace", options.namespace]
        arguments += ["--cell-file", options.graph.cell_file, "--json-lines"]
        log_file = log_folder / f"{CLIENT}.log"
        return Program(f"{PACKAGE}.{CLIENT}", tuple(arguments), log_file, heard=True)

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
    # Each thread of DDS would get an arena of its own, and keep what it once used.
    defaults["MALLOC_ARENA_MAX"] = "2"
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


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point.

    Returns:
        Exit code of the program.
    """
    logging.basicConfig(
        level=logging.WARNING, stream=sys.stderr, format="%(levelname)s %(name)s: %(message)s"
    )
    return Runner(parse_arguments(arguments)).run()


def _codes(code: int) -> dict[str, int]:
    return {"code": code} if code >= 0 else {"signal": -code}


def _how(code: int) -> str:
    return f"exit code {code}" if code >= 0 else f"signal {-code}"


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
