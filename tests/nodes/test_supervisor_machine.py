"""The state machine of the supervisor: complete, without dead ends, drawn as it is."""

from pathlib import Path

import pytest
from skinplan_msgs.msg import JobStatus, Status

from skinplan.jobs.states import TRANSITIONS
from skinplan_nodes.supervisor import faults
from skinplan_nodes.supervisor.diagram import main, with_machine
from skinplan_nodes.supervisor.limits import Limits
from skinplan_nodes.supervisor.machine import (
    FAILURES,
    FINAL,
    INTERRUPTED,
    LIMITS,
    TABLE,
    WORKING,
    Event,
    State,
    after,
    ignored,
    job_state,
    sub_state,
)

DOCUMENT = Path(__file__).resolve().parents[2] / "docs" / "supervisor.md"
GOING_ON = sorted(set(State) - set(FINAL))


@pytest.mark.parametrize("state", GOING_ON)
@pytest.mark.parametrize("event", FAILURES)
def test_every_state_has_an_answer_to_every_failure(state: State, event: Event) -> None:
    assert isinstance(after(state, event), State)


@pytest.mark.parametrize("state", GOING_ON)
def test_every_state_has_a_time_out(state: State) -> None:
    figure, clock = LIMITS[state]
    assert figure in Limits.__dataclass_fields__
    assert clock in ("wall", "cell")
    assert TABLE[state, Event.TIMED_OUT] is not state, "it would last forever"


@pytest.mark.parametrize("state", GOING_ON)
def test_from_every_state_a_job_can_come_to_its_end(state: State) -> None:
    reached, todo = {state}, [state]
    while todo:
        here = todo.pop()
        following = {end for (begin, _), end in TABLE.items() if begin is here}
        todo += following - reached
        reached |= following
    assert State.ABORTED in reached
    if state is not State.ABORTING:
        assert State.ENDED in reached


def test_nothing_follows_on_the_end_and_every_state_is_reached() -> None:
    assert not [key for key in TABLE if key[0] in FINAL]
    assert {*TABLE.values(), State.STARTING} == set(State)
    with pytest.raises(KeyError):
        after(State.ENDED, Event.DONE)


def test_an_abort_ends_a_job_from_everywhere_without_a_step_between() -> None:
    for state in GOING_ON:
        assert after(state, Event.ABORT) is State.ABORTING
    for state in (*WORKING, State.STOPPING):
        if state is not State.FINISHING:
            assert after(state, Event.STOP) is State.STOPPING, "everything stands before it ends"


def test_only_a_restored_job_moves_again() -> None:
    moving = {State.DRIVING, State.LOCALIZING, State.MOVING, State.SCANNING}
    for state in INTERRUPTED:
        following = {end for (begin, _), end in TABLE.items() if begin is state}
        assert not following & moving


def test_a_stop_behind_the_last_point_goes_on_as_the_scan_would_have() -> None:
    for event in (Event.MOVE, Event.SCAN, Event.NEXT_STATION, Event.ALL_SCANNED):
        assert after(State.RESTORING, event) is after(State.SCANNING, event)


def test_changes_of_the_state_are_changes_that_job_control_knows() -> None:
    for (before, _), following in TABLE.items():
        first, second = job_state(before), job_state(following)
        assert first == second or second in TRANSITIONS[first], (before, following)


def test_what_is_ignored_leaves_the_state_as_it_is() -> None:
    assert ignored(State.FINISHING) == {Event.STOP}
    assert ignored(State.SCANNING) == frozenset()
    assert ignored(State.CLOSING) == {Event.FAULT, Event.NODE_LOST, Event.PAUSE, Event.STOP}


def test_names_of_the_states_are_short_and_one_is_empty_at_the_end() -> None:
    assert sub_state(State.PLANNING_STATIONS) == "planning"
    assert sub_state(State.FINISHING) == "inspecting"
    assert {sub_state(state) for state in FINAL} == {""}
    assert len({sub_state(state) for state in GOING_ON}) == len(GOING_ON) - 3


def test_codes_are_those_of_the_message() -> None:
    names = [name for name in vars(faults) if name.isupper() and hasattr(Status, name)]
    assert len(names) > 20
    for name in names:
        assert getattr(faults, name) == getattr(Status, name), name
    known = {value for name, value in vars(faults).items() if isinstance(value, int)}
    assert known >= faults.AUTOMATIC | faults.OPERATOR
    assert not faults.AUTOMATIC & faults.OPERATOR
    assert faults.BASE_MAY_HAVE_MOVED <= faults.AUTOMATIC | faults.OPERATOR
    assert faults.ENDS_A_START <= faults.AUTOMATIC | faults.OPERATOR
    assert int(job_state(State.PAUSED)) == JobStatus.INTERRUPTED


def test_the_diagram_in_the_docs_is_the_machine(tmp_path: Path) -> None:
    text = DOCUMENT.read_text(encoding="utf-8")
    assert with_machine(text) == text, (
        "call python -m skinplan_nodes.supervisor.diagram --write docs/supervisor.md"
    )
    old = tmp_path / "old.md"
    old.write_text(text.replace("scanning --> scanning", "scanning --> nowhere"), encoding="utf-8")
    assert main([str(old)]) == 1
    assert main([str(old), "--write"]) == 0
    assert main([str(old)]) == 0
    with pytest.raises(ValueError, match="machine: begin"):
        with_machine("no marks")
