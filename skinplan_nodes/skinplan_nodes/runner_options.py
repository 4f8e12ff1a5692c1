"""What the runner is asked for on the command line. Needs no ROS."""

import argparse
import os
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from skinplan.jobs.checks import ID_PATTERN
from skinplan_nodes.graph import GraphSettings, NodeSpec, describe
from skinplan_nodes.restarts import RestartPolicy

_DESCRIPTION = "Starts the node graph with one process per node, and measures a part in it."


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
        operator_name: Who asks; one of the cell's list of operators, where it has one.
        namespace: Of all nodes; may be empty.
        config_folder: Folder of parameter files ``<node>.yaml``; None = the nodes' defaults.
        restarts: How often a node that died is started again.
        only: Names of the nodes to start; empty = all.
    """

    graph: GraphSettings
    part: Path | None
    serve: bool = False
    json_lines: bool = False
    job_id: str = ""
    serial_number: str = ""
    operator_name: str = ""
    namespace: str = ""
    config_folder: Path | None = None
    restarts: RestartPolicy = RestartPolicy()
    only: tuple[str, ...] = ()

    def nodes(self, graph: GraphSettings) -> tuple[NodeSpec, ...]:
        """Returns the nodes to start."""
        return tuple(n for n in describe(graph) if not self.only or n.name in self.only)


def parse_arguments(arguments: Sequence[str] | None = None) -> RunnerOptions:
    """Reads the command line.

    Raises:
        SystemExit: With code 2 for bad input, named on stderr.
    """
    parser = _parser()
    given = parser.parse_args(arguments)
    if given.part is None and (not given.serve or given.devices == "mock"):
        parser.error("--part is needed: it is measured, and it stands in the mock cell")
    if given.part is not None and not given.part.is_file():
        parser.error(f"--part {given.part}: there is no such file; a part.yaml is accepted")
    if not 0.1 <= given.time_factor <= 50.0:
        parser.error(f"--time-factor {given.time_factor:g}: 0.1 to 50 is accepted")
    if not (0 <= given.restarts <= 1000 and 1.0 <= given.restart_window_s <= 86400.0):
        parser.error(
            f"--restarts {given.restarts} --restart-window-s {given.restart_window_s:g}: 0 to 1000 "
            f"within 1 to 86400 s are accepted"
        )
    job_id = given.job_id or time.strftime("%Y%m%d-%H%M%S", time.gmtime()) + f"-{os.getpid()}"
    options = _options(given, job_id)
    used = options.graph.runs_folder / job_id
    names = [node.name for node in describe(options.graph)]
    if options.only and not (options.serve and set(options.only) <= set(names)):
        found = " ".join(options.only)
        parser.error(f"--only {found}: with --serve, {', '.join(names)} are accepted")
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
        operator_name=given.operator,
        namespace=given.namespace,
        config_folder=given.config_folder,
        restarts=RestartPolicy(given.restarts, given.restart_window_s),
        only=tuple(given.only),
    )


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m skinplan_nodes.runner", description=_DESCRIPTION
    )
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
    parser.add_argument("--operator", default="", help="who asks, where the cell has a list")
    parser.add_argument("--namespace", default="", help="namespace of all nodes, e.g. /cell1")
    parser.add_argument("--config-folder", type=Path, help="folder of parameter files <node>.yaml")
    parser.add_argument(
        "--devices",
        choices=("mock", "real"),
        default="mock",
        help="mock cell, or drivers elsewhere",
    )
    parser.add_argument(
        "--restarts",
        type=int,
        default=3,
        help="a node that died is started again so often within the window; 0 = never",
    )
    parser.add_argument(
        "--restart-window-s", type=float, default=120.0, help="the window, wall time"
    )
    parser.add_argument(
        "--serve", action="store_true", help="run the graph without a job until interrupted"
    )
    parser.add_argument(
        "--only",
        action="append",
        default=[],
        metavar="NODE",
        help="with --serve: start this node only, or these; the others run elsewhere",
    )
    parser.add_argument("--json-lines", action="store_true", help="events on stdout as JSON lines")
    return parser
