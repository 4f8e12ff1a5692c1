"""The node graph, described once.

Two starters read it: ``runner.py`` (one process per node, for the ROS wheels) and
``launch_scripts/skinplan.launch.py`` (``ros2 launch`` on a full installation). It lives in the
package, so that an installed one finds it too. Needs no ROS.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

ParameterValue = str | int | float | bool | list[str]

PACKAGE = "skinplan_nodes"
# Every tick costs every node of the graph about 1 ms: at 50 Hz, 13 nodes use up a core.
CLOCK_RATE_HZ = 20.0
# Joint states per second of simulated time, as the controller of the UR5 (CB3) reports them.
JOINT_RATE_HZ = 125.0

# Cell time runs no faster while plans are made: every node works for time that nobody needs, and
# the planner waits for a core.
COMPUTING_FACTOR = 1.0
# Images per second of wall time at most: rendering, sending and packing one costs 0.06 s of CPU,
# and who looks for the part waits for a dozen of them.
IMAGE_RATE_HZ = 8.0

# Nodes whose queues must not overflow: time waits for them.
_TIME_WAITS_FOR = ("scan_inspector", "run_recorder")


@dataclass(frozen=True)
class NodeSpec:
    """One node of the graph, one process.

    Attributes:
        name: Name of the node; the same as its module's.
        simulated: Part of the mock cell; left out where real devices stand.
        required: A job ends when this node is lost.
        parameters: Values that differ from the node's defaults.
    """

    name: str
    simulated: bool = False
    required: bool = True
    parameters: Mapping[str, ParameterValue] = field(default_factory=dict)

    @property
    def module(self) -> str:
        """Python module that runs the node as a program."""
        return f"{PACKAGE}.{self.name}"


@dataclass(frozen=True)
class GraphSettings:
    """What the graph is started for.

    Attributes:
        runs_folder: Absolute path of the folder that gets the run folders.
        part_uri: Part that stands in the mock cell; absolute path or file:// URI. Empty = a graph
            without the mock cell.
        cell_file: Absolute path of the cell file; empty = the default cell.
        time_factor: Times faster than real time (mock cell).
        seed: Seed of every random draw of the mock cell.
        jobs_file: Absolute path of the job store; empty = ``jobs.sqlite`` in the runs folder.
        report: The supervisor writes the report; False = the job client does.
        clock_file: Absolute path of the file from which a clock that is started again goes on;
            empty = it begins anew.
    """

    runs_folder: Path
    part_uri: str = ""
    cell_file: str = ""
    time_factor: float = 1.0
    seed: int = 1
    jobs_file: str = ""
    report: bool = True
    clock_file: str = ""

    @property
    def simulated(self) -> bool:
        """Whether the mock cell is part of the graph."""
        return bool(self.part_uri)


def describe(settings: GraphSettings) -> tuple[NodeSpec, ...]:
    """Returns the nodes to start, in the order of start; the clock first, the supervisor last.

    Args:
        settings: What the graph is started for.
    """
    clock: dict[str, ParameterValue] = {"use_sim_time": settings.simulated}
    cell = {**clock, "cell_file": settings.cell_file}
    mock = {**cell, "part_uri": settings.part_uri, "seed": settings.seed}
    nodes = [
        NodeSpec(
            "sim_clock",
            True,
            True,
            {
                "time_factor": float(settings.time_factor),
                "rate_hz": CLOCK_RATE_HZ,
                "computing_factor": COMPUTING_FACTOR,
                "time_file": settings.clock_file,
                "wait_for": list(_TIME_WAITS_FOR),
            },
        ),
        NodeSpec("mock_mir100", True, True, {**mock, **_stands(settings, "base")}),
        NodeSpec(
            "mock_ur5",
            True,
            True,
            {
                **cell,
                "seed": settings.seed,
                "rate_hz": JOINT_RATE_HZ,
                **_stands(settings, "arm"),
            },
        ),
        NodeSpec("mock_ctrack", True, True, mock),
        NodeSpec("mock_camera", True, True, {**mock, "rate_hz": _image_rate_hz(settings)}),
        NodeSpec("run_recorder", parameters=clock),
        NodeSpec("scan_path_planner", parameters=clock),
        NodeSpec("station_planner", parameters=cell),
        NodeSpec("trajectory_planner", parameters=cell),
        NodeSpec("aruco_localizer", parameters={**cell, **_patience(settings)}),
        NodeSpec("part_recognizer", required=False, parameters=cell),
        NodeSpec("scan_inspector", parameters=cell),
        NodeSpec("cell_view", required=False, parameters={**cell, "part_uri": settings.part_uri}),
    ]
    started = [node for node in nodes if settings.simulated or not node.simulated]
    return (*started, _supervisor(settings, started, cell))


def _stands(settings: GraphSettings, device: str) -> dict[str, ParameterValue]:
    """A device whose process is started again goes on where it stood, as its clock does."""
    if not settings.clock_file:
        return {}
    return {"state_file": str(Path(settings.clock_file).with_name(f"{device}.state"))}


def _patience(settings: GraphSettings) -> dict[str, ParameterValue]:
    """Waits on the cell's clock that allow for the load of this machine are longer in fast time."""
    return {"image_timeout_s": 5.0 * max(1.0, settings.time_factor)} if settings.simulated else {}


def _image_rate_hz(settings: GraphSettings) -> float:
    return float(min(1.0, max(0.1, IMAGE_RATE_HZ / settings.time_factor)))


def _calibration(settings: GraphSettings) -> dict[str, ParameterValue]:
    """The mock cell is as its files say: nobody has to calibrate it."""
    return {"calibration_required": False} if settings.simulated else {}


def _supervisor(
    settings: GraphSettings, others: list[NodeSpec], cell: Mapping[str, ParameterValue]
) -> NodeSpec:
    return NodeSpec(
        "cell_supervisor",
        parameters={
            **cell,
            "runs_folder": str(settings.runs_folder),
            "jobs_file": settings.jobs_file,
            "report": settings.report,
            **_calibration(settings),
            "required_nodes": [node.name for node in others if node.required],
        },
    )
