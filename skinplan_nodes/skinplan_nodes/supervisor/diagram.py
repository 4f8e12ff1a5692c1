"""Draws the state machine of `machine` into ``docs/supervisor.md``.

``python -m skinplan_nodes.supervisor.diagram FILE`` says whether the file is up to date, with
``--write`` it brings it up to date. Needs no ROS.
"""

import argparse
import sys
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

from skinplan_nodes.supervisor.machine import FAILURES, FINAL, LIMITS, TABLE, State, job_state

BEGIN, END = "<!-- machine: begin -->", "<!-- machine: end -->"


def diagram() -> str:
    """Returns the regular way as a mermaid diagram: failures stand in the table below it."""
    lines = ["```mermaid", "stateDiagram-v2", f"  [*] --> {State.STARTING}"]
    edges: dict[tuple[State, State], list[str]] = defaultdict(list)
    for (before, event), following in TABLE.items():
        if event not in FAILURES:
            edges[before, following].append(event.value)
    for (before, following), events in edges.items():
        lines.append(f"  {before} --> {following}: {', '.join(events)}")
    lines += [f"  {state} --> [*]" for state in FINAL]
    return "\n".join([*lines, "```"])


def failure_table() -> str:
    """Returns which state follows on each failure in each state, and how long each may last."""
    heads = [event.value for event in FAILURES]
    lines = ["| state | ISA-95 | limit | " + " | ".join(heads) + " |"]
    lines.append("|" + "---|" * (len(heads) + 3))
    for state, (figure, clock) in LIMITS.items():
        following = [TABLE[state, event].value for event in FAILURES]
        cells = [state.value, job_state(state).title, f"`{figure}`, {clock} time", *following]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def generated() -> str:
    """Returns what stands between the marks."""
    return f"{BEGIN}\n{diagram()}\n\n{failure_table()}\n{END}"


def with_machine(text: str) -> str:
    """Returns a document with the part between the marks made anew.

    Raises:
        ValueError: The marks are missing.
    """
    head, begin, rest = text.partition(BEGIN)
    _, end, tail = rest.partition(END)
    if not begin or not end:
        raise ValueError(f"a document with the lines {BEGIN} and {END} is accepted")
    return head + generated() + tail


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of the program.

    Returns:
        0 when the file is up to date, or was brought up to date; 1 when it is not.
    """
    parser = argparse.ArgumentParser(
        prog="python -m skinplan_nodes.supervisor.diagram", description=__doc__
    )
    parser.add_argument("file", type=Path, nargs="?", default=Path("docs/supervisor.md"))
    parser.add_argument("--write", action="store_true", help="bring the file up to date")
    given = parser.parse_args(arguments)
    text = given.file.read_text(encoding="utf-8")
    wanted = with_machine(text)
    if given.write:
        given.file.write_text(wanted, encoding="utf-8")
    elif text != wanted:
        sys.stderr.write(f"{given.file} is not up to date: call again with --write\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
