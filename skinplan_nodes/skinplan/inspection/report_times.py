"""The bars of a report: planning, the planned cycle, and what the job did when."""

import math
from dataclasses import dataclass
from typing import Any

from skinplan.inspection.run_files import RunFiles, items, number, section
from skinplan.inspection.wording import seconds

_STAGES = ("mesh", "scan_path", "coverage", "stations", "trajectory")


@dataclass(frozen=True)
class Bar:
    """One bar.

    Attributes:
        label: What.
        begin: Where it begins, of the width of the group [%].
        length: How long it is [%].
        value: Its duration in words.
    """

    label: str
    begin: float
    length: float
    value: str


def bars(files: RunFiles) -> list[tuple[str, list[Bar]]]:
    """Returns groups of bars with their titles; what is not known is left out."""
    planning = section(files.summary, "planning_s")
    trajectory = section(files.summary, "trajectory")
    stages = [(name.replace("_", " "), planning.get(name)) for name in _STAGES]
    cycle = [(key, trajectory.get(f"{key}_s")) for key in ("scan", "transit", "base")]
    groups = [
        (_titled("Planning", planning.get("total")), _compared(stages)),
        (_titled("Cycle, planned", trajectory.get("cycle_s")), _compared(cycle)),
        _run(items(files.summary, "timeline")),
    ]
    return [(title, found) for title, found in groups if found]


def _compared(durations: list[tuple[str, Any]]) -> list[Bar]:
    """Durations beside each other."""
    known = [(name, number(value)) for name, value in durations if math.isfinite(number(value))]
    longest = max([1e-9, *(value for _, value in known)])
    return [
        Bar(name, 0.0, max(0.0, 100.0 * value / longest), seconds(value)) for name, value in known
    ]


def _run(steps: list[dict[str, Any]]) -> tuple[str, list[Bar]]:
    """Steps one after the other."""
    spans = [(str(s.get("step")), number(s.get("begin_s")), number(s.get("end_s"))) for s in steps]
    known = [span for span in spans if math.isfinite(span[1]) and span[2] >= span[1]]
    if not known:
        return "", []
    first, last = min(begin for _, begin, _ in known), max(end for _, _, end in known)
    scale = 100.0 / max(last - first, 1e-9)
    found = [
        Bar(name, scale * (begin - first), scale * (end - begin), seconds(end - begin))
        for name, begin, end in known
    ]
    return _titled("Run, wall time", last - first), found


def _titled(title: str, total: Any) -> str:
    return f"{title}: {seconds(total)}" if math.isfinite(number(total)) else title
