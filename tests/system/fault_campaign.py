"""Faults in the middle of runs of the whole graph: what becomes of job, motion and bag.

``PYTHONPATH=tests .venv/bin/python -m system.fault_campaign --out table.md`` runs every fault at
every state with three seeds, which takes hours; ``--faults``, ``--states`` and ``--seeds`` choose.
``--show table.md ...`` prints tables that were written as one: faults by states.
``full_disk`` needs a file system of its own, for instance

    unshare -m sh -c 'mount -t tmpfs -o size=1G tmpfs /mnt && exec "$@"' sh python ... --disk /mnt
"""

import argparse
import json
import os
import random
import shutil
import sys
import tempfile
import time
from collections import defaultdict, deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rosbags.highlevel import AnyReader
from skinplan_msgs.msg import JobStatus, Status
from skinplan_msgs.srv import JobCommand

from ros_domains import own_domain
from skinplan.part.files import load_part, save_part
from skinplan.part.model import Part
from skinplan.part.recognition_plan import RecognitionPlan
from skinplan.recording.heal import is_finished
from skinplan_nodes.graph import GraphSettings, describe
from system.served_cell import ServedCell

IDENTIFYING = "identifying"
STATES = (
    "starting",
    "driving",
    IDENTIFYING,
    "localizing",
    "planning",
    "moving",
    "scanning",
    "inspecting",
    "closing",
)
#: Node and fault, with the values of the fault.
INJECTED: dict[str, tuple[str, dict[str, str]]] = {
    "protective_stop": ("mock_ur5", {}),
    "emergency_stop": ("mock_ur5", {}),
    "stops_following": ("mock_ur5", {}),
    "blocked": ("mock_mir100", {}),
    "base.lost": ("mock_mir100", {}),
    "never_answers": ("mock_mir100", {}),
    "jump": ("mock_mir100", {"jump": "0.08"}),
    "frozen": ("mock_camera", {}),
    "dark": ("mock_camera", {}),
    "stale_stamps": ("mock_camera", {}),
    "no_images": ("mock_camera", {}),
    "hidden": ("mock_ctrack", {}),
    "tracker.lost": ("mock_ctrack", {}),
    "drops_frames": ("mock_ctrack", {"share": "0.5"}),
    "clock_jump": ("sim_clock", {"jump": "5.0"}),
}
KILLED = tuple(f"kill {node.name}" for node in describe(GraphSettings(Path("/runs"), "/part.yaml")))
FULL_DISK = "full_disk"
#: The code with which a job may end after a fault that outlasts its patience. Others have to be
#: survived: a node that was killed is back in seconds.
RIGHT_CODES: dict[str, tuple[int, ...]] = {
    "protective_stop": (Status.PROTECTIVE_STOP,),
    "emergency_stop": (Status.EMERGENCY_STOP,),
    "stops_following": (Status.DEVICE_FAILED, Status.DEVICE_TIMEOUT),
    "blocked": (Status.BASE_BLOCKED,),
    "base.lost": (Status.BASE_LOST,),
    "never_answers": (Status.DEVICE_TIMEOUT,),
    "frozen": (Status.STALE_IMAGE,),
    "dark": (Status.NO_MARKER,),
    "stale_stamps": (Status.STALE_IMAGE,),
    "no_images": (Status.NO_IMAGE,),
    "hidden": (Status.TRACKER_LOST,),
    "tracker.lost": (Status.TRACKER_LOST,),
    FULL_DISK: (Status.DISK_FULL,),
}
SEEDS = (1, 2, 3)
FAULTS = (*INJECTED, *KILLED, FULL_DISK)
#: How long a fault lasts [s of wall time]; those of the operator last until somebody looks.
LASTS_S = 3.0
#: A run that is not over by then hangs.
BOUND_S = 240.0
#: From a fault to the end the job may take as long as two undisturbed ones, besides what the fault
#: itself takes: how long it lasts, and how long the supervisor waits for what was lost.
CLEAN_JOBS = 2
#: How long the operator looks before he says RESUME [s of wall time].
LOOKS_S = 0.5
#: A bag that its recorder did not close is healed so long after the job's end [s of wall time].
HEALED_S = 15.0
FACTOR = "16"
PATIENCE = {"operator_timeout_s": 60.0, "recovery_timeout_s": 40.0}


class Case(NamedTuple):
    """One fault at one state."""

    fault: str
    state: str
    seed: int


@dataclass(frozen=True)
class Row:
    """What became of one run."""

    case: Case
    ended: str
    code: str
    area_ratio: float
    interruptions: int
    moved_while_stopped: bool
    bag_messages: int
    wall_s: float
    after_fault_s: float
    stated_s: float
    note: str

    @property
    def is_good(self) -> bool:
        """Finished, or failed with the right code; in time; nothing moved, nothing was lost."""
        right = [str(code) for code in RIGHT_CODES.get(self.case.fault, ())]
        named = self.ended == "Ended" or (self.ended == "Aborted" and self.code in right)
        in_time = self.after_fault_s <= self.stated_s
        return named and in_time and not self.moved_while_stopped and self.bag_messages > 0

    def cells(self) -> str:
        """As a line of a table."""
        area = "" if np.isnan(self.area_ratio) else f"{self.area_ratio:.4f}"
        moved = "**yes**" if self.moved_while_stopped else "no"
        case = self.case
        what = f"{case.fault} | {case.state} | {case.seed} | {self.ended} {self.code}"
        figures = f"{self.interruptions} | {area} | {moved} | {self.bag_messages}"
        figures += f" | {self.wall_s:.0f} | {self.after_fault_s:.0f} | {self.stated_s:.0f}"
        return f"| {what} | {figures} |"


HEAD_NAMES = (
    "fault",
    "state",
    "seed",
    "end",
    "interruptions",
    "area",
    "moved while stopped",
    "bag messages",
    "wall [s]",
    "after the fault [s]",
    "stated [s]",
)
HEAD = "| " + " | ".join(HEAD_NAMES) + " |\n" + "|---" * len(HEAD_NAMES) + "|"


class Timetable(NamedTuple):
    """What the stated times are made of: how long an undisturbed job of each part takes [s]."""

    plain_s: float
    identified_s: float

    def stated_s(self, case: Case) -> float:
        """Returns the time from a fault to the end of the job that is stated."""
        job_s = self.identified_s if case.state == IDENTIFYING else self.plain_s
        return LASTS_S + LOOKS_S + PATIENCE["recovery_timeout_s"] + CLEAN_JOBS * job_s


def timetable(cell: ServedCell, identified: Part) -> Timetable:
    """Runs undisturbed jobs; a cell's first one, in which planners learn the part, is not taken."""
    taken: list[float] = []
    for number, part in enumerate((None, None, identified)):
        begin = time.monotonic()
        cell.order(f"clean-{number}", part)
        assert cell.until_over(f"clean-{number}", BOUND_S), cell.watch.status
        assert cell.watch.status.state == JobStatus.ENDED, cell.watch.status
        taken.append(time.monotonic() - begin)
        shutil.rmtree(cell.runs / f"clean-{number}", ignore_errors=True)
    return Timetable(*taken[1:])


def identified_part(cell: ServedCell, folder: Path) -> Part:
    """Writes the cell's part once more, as one that is identified before it is measured."""
    path = folder / "identified.yaml"
    checked = replace(cell.part, recognition=RecognitionPlan(True, ()))
    save_part(checked, path)
    return load_part(path)


def run_case(cell: ServedCell, job_id: str, case: Case, part: Part | None, stated_s: float) -> Row:
    """Runs one job with one fault in a cell that is served."""
    begin = time.monotonic()
    # A fault that met the end of the last job was seen by nobody.
    cell.watch.reset_devices()
    cell.order(job_id, part)
    note = ""
    if cell.until(job_id, case.state, BOUND_S):
        time.sleep(random.Random(str(case)).uniform(0.0, 0.6))
        begin_fault(cell, case.fault)
    else:
        note = f"{case.state} never came"
    began = time.monotonic()
    follow(cell, job_id, case.fault, began)
    if not cell.watch.is_over(job_id):
        status = cell.watch.status
        note = f"hangs in {status.sub_state} of {status.job_id}: {status.status.message}"
    wall_s, after_s = time.monotonic() - begin, time.monotonic() - began
    return row(cell, job_id, case, (wall_s, after_s, stated_s), note)


def begin_fault(cell: ServedCell, fault: str) -> None:
    """Kills a process or injects a fault."""
    if fault.startswith("kill "):
        cell.kill(fault.removeprefix("kill "))
        return
    if fault == FULL_DISK:
        cell.fill_disk()
        return
    node, values = INJECTED[fault]
    cell.watch.inject(node, fault.rpartition(".")[2], values)


def follow(cell: ServedCell, job_id: str, fault: str, began: float) -> None:
    """Follows a job to its end as an operator would, and ends the fault."""
    watch = cell.watch
    cleared = fault.startswith("kill ") or fault == "clock_jump"
    while not (cleared and watch.is_over(job_id)) and time.monotonic() - began < BOUND_S:
        time.sleep(0.05)
        waits = watch.waits(job_id)
        if not cleared and (waits or time.monotonic() - began > LASTS_S):
            cleared = end_fault(cell, fault)
        if waits and cleared:
            time.sleep(LOOKS_S)
            if watch.waits(job_id):
                watch.command(job_id, JobCommand.Request.RESUME)
                time.sleep(0.5)


def end_fault(cell: ServedCell, fault: str) -> bool:
    """Ends a fault; a node that does not answer any more has ended with its graph."""
    if fault == FULL_DISK:
        cell.free_disk()
        return True
    try:
        cell.watch.inject(INJECTED[fault][0], "", {})
    except AssertionError:
        return False
    return True


def row(
    cell: ServedCell, job_id: str, case: Case, times_s: tuple[float, float, float], note: str
) -> Row:
    """Reads what a job left; `times_s` are those of `Row`."""
    folder = cell.runs / job_id
    path = folder / "summary.json"
    summary: dict[str, Any] = json.loads(path.read_text()) if path.is_file() else {}
    ended = {JobStatus.ENDED: "Ended", JobStatus.ABORTED: "Aborted"}
    over = cell.watch.is_over(job_id)
    error = summary.get("error") or {}
    if over and ended[cell.watch.status.state] == "Aborted" and not error:
        status = cell.watch.status.status
        error = {"code": status.code, "message": f"no summary: {status.message}"}
    return Row(
        case,
        ended[cell.watch.status.state] if over else "no result",
        str(error.get("code", "")),
        float(summary.get("measured", {}).get("area_ratio", np.nan)),
        len(summary.get("interruptions", [])),
        cell.watch.moved_while_standing(),
        messages_in(sorted(folder.glob("bag*"))),
        *times_s,
        note or str(error.get("message", "")),
    )


def messages_in(bags: Sequence[Path]) -> int:
    """Counts the messages of all parts of a bag, with a foreign reader; -1 = not all readable.

    A recorder that was killed heals, beside other work, what it left; it gets some time for that.
    """
    deadline = time.monotonic() + HEALED_S
    while time.monotonic() < deadline and not all(is_finished(bag) for bag in bags):
        time.sleep(0.1)
    count = 0
    for bag in bags:
        try:
            with AnyReader([bag]) as reader:
                found = sum(1 for _ in reader.messages())
                if found != reader.message_count:
                    return -1
                count += found
        except Exception:
            return -1
    return count


def run_cases(
    cases: Iterable[Case], seed: int, factor: str, name: str, disk: Path | None = None
) -> Iterator[Row]:
    """Runs jobs one after the other in one graph; a new graph after each that is not good.

    A graph goes on after an aborted job, so that the next job shows whether the cell is well.
    """
    left = deque(cases)
    number = 0
    while left:
        if disk is not None:
            shutil.rmtree(disk / "runs", ignore_errors=True)
        with tempfile.TemporaryDirectory(prefix=name) as folder:
            cell = ServedCell(Path(folder), seed, factor, PATIENCE, disk=disk)
            identified = identified_part(cell, Path(folder))
            good = True
            try:
                times = timetable(cell, identified)
                while left and good:
                    number += 1
                    case = left.popleft()
                    part = identified if case.state == IDENTIFYING else None
                    found = run_case(cell, f"job-{number}", case, part, times.stated_s(case))
                    good = found.is_good
                    if not good:
                        keep(cell, number, seed)
                    shutil.rmtree(cell.runs / f"job-{number}", ignore_errors=True)
                    yield found
            finally:
                cell.end()


def keep(cell: ServedCell, number: int, seed: int) -> None:
    """Keeps what a job left that is not good."""
    place = Path(tempfile.gettempdir()) / f"fault_campaign_seed{seed}_job{number}"
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir()
    for folder in (cell.runs / f"job-{number}", cell.runs / "log"):
        if folder.is_dir():
            shutil.copytree(folder, place / folder.name, ignore=shutil.ignore_patterns("*.ply"))


def rows_of(table: Path) -> Iterator[dict[str, str]]:
    """Returns the rows of a written table, by the names of its columns and ``note``."""
    for line in table.read_text(encoding="utf-8").splitlines():
        cells = [cell.strip() for cell in line.split("|", len(HEAD_NAMES) + 1)[1:]]
        if len(cells) > len(HEAD_NAMES) and cells[0] not in ("fault", "---"):
            yield dict(zip((*HEAD_NAMES, "note"), cells, strict=True))


def written(table: Path) -> set[Case]:
    """Returns the cases that a table has already: a campaign goes on where it ended."""
    return {Case(row["fault"], row["state"], int(row["seed"])) for row in rows_of(table)}


def shown(tables: Iterable[Path]) -> str:
    """Returns written tables as one of faults by states.

    A number is how long a job took from the fault to its end [s], when it was Ended; one that was
    Aborted has its code, too. There is one for each seed, in their order; ``-`` = not run.
    """
    found: dict[tuple[str, str], dict[int, str]] = defaultdict(dict)
    for values in (values for table in tables for values in rows_of(table)):
        end, _, code = values["end"].partition(" ")
        text = values["after the fault [s]"] + (f" ({code})" if end == "Aborted" else "")
        bad = values["note"].endswith("**bad**")
        case = found[values["fault"], values["state"]]
        case[int(values["seed"])] = f"**{text}**" if bad else text
    seeds = sorted({seed for case in found.values() for seed in case})
    lines = ["| fault | " + " | ".join(STATES) + " |", "|---" * (len(STATES) + 1) + "|"]
    for fault in FAULTS:
        cases = [found.get((fault, state), {}) for state in STATES]
        if any(cases):
            cells = [" ".join(case.get(seed, "-") for seed in seeds) for case in cases]
            lines.append(f"| {fault} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> None:
    """Runs the campaign and writes the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--faults", nargs="*", default=list(FAULTS))
    parser.add_argument("--states", nargs="*", default=list(STATES))
    parser.add_argument("--seeds", nargs="*", type=int, default=list(SEEDS))
    parser.add_argument("--disk", type=Path, help="file system of its own, for full_disk")
    parser.add_argument("--time-factor", default=FACTOR)
    parser.add_argument("--out", type=Path, default=Path("fault_campaign.md"))
    parser.add_argument("--show", nargs="+", type=Path, help="written tables; nothing is run")
    given = parser.parse_args()
    if given.show:
        sys.stdout.write(shown(given.show) + "\n")
        return
    if given.disk is None:
        given.faults = [fault for fault in given.faults if fault != FULL_DISK]
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    done = written(given.out) if given.out.is_file() else set()
    with own_domain(), given.out.open("a", encoding="utf-8") as table:
        if not done:
            table.write(HEAD + "\n")
        for seed in given.seeds:
            cases = [Case(f, s, seed) for f in given.faults for s in given.states]
            cases = [case for case in cases if case not in done]
            # Faults come in any order: each meets a cell that another one has left.
            random.Random(seed).shuffle(cases)
            for found in run_cases(cases, seed, given.time_factor, "fault_campaign", given.disk):
                good = "" if found.is_good else " **bad**"
                table.write(f"{found.cells()} {found.note}{good}\n")
                table.flush()


if __name__ == "__main__":
    main()
