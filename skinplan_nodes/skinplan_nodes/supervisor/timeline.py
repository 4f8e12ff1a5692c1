"""When a job did what, over restarts of its supervisor: from the run's journal. Needs no ROS."""

from collections.abc import Iterable
from typing import Any

from skinplan_nodes.supervisor.journal import Entry
from skinplan_nodes.supervisor.machine import State

# At a station these take turns for every segment: together they are one step.
_AT_STATION = (State.MOVING, State.SCANNING)
# These are about the whole part.
_AFTER_STATIONS = (State.INSPECTING, State.FINISHING, State.CLOSING)


def timeline(entries: Iterable[Entry]) -> list[dict[str, Any]]:
    """Returns the steps of a job, ``timeline`` in ``summary.json``.

    Args:
        entries: The run's journal.

    Returns:
        In the order of time: ``step``, and ``begin_s`` and ``end_s`` of wall time since the job's
        first state [s].
    """
    steps: list[dict[str, Any]] = []
    first_ns = None
    for entry in entries:
        if entry.kind not in ("state", "over"):
            continue
        first_ns = entry.at_ns if first_ns is None else first_ns
        at_s = (entry.at_ns - first_ns) * 1e-9
        if steps:
            steps[-1]["end_s"] = at_s
        if entry.kind == "over":
            break
        name = _name(entry)
        if not steps or steps[-1]["step"] != name:
            steps.append({"step": name, "begin_s": at_s, "end_s": at_s})
    return steps


def _name(entry: Entry) -> str:
    state, station = State(entry.values["state"]), entry.values["station"]
    words = "scanning" if state in _AT_STATION else state.value.replace("_", " ")
    words += f", station {station}" if station and state not in _AFTER_STATIONS else ""
    return words + (f", re-scan {entry.values['rescan']}" if entry.values["rescan"] else "")
