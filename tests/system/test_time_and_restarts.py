"""Time that waits and never runs back; restarts that are bounded; a supervisor that comes back."""

from pathlib import Path

import pytest

from skinplan_nodes.absence import Absence
from skinplan_nodes.restarts import RestartCounter, RestartPolicy
from skinplan_nodes.sim_time import SimTime, SlowNodes, TimeFile

S = 10**9


def test_time_runs_by_the_factor_and_not_beyond_its_limit() -> None:
    time = SimTime(5.0, 10.0, 0.15)
    assert time.tick(0) == 5 * S
    assert time.tick(S // 10) == 6 * S
    # A late tick counts for the longest step only.
    assert time.tick(10 * S) == pytest.approx(7.5 * S)
    assert not time.held
    assert time.tick(10 * S + S // 10, 8 * S) == 8 * S
    assert time.held
    # A limit in the past holds time, it does not turn it back.
    assert time.tick(10 * S + S // 5, 3 * S) == 8 * S
    assert time.held
    time.jump(-S)
    assert time.now_ns == 8 * S


def test_time_waits_for_the_slowest_node_that_it_was_told_to_wait_for() -> None:
    nodes = SlowNodes(["a", "b"], 2.0, 1.0)
    assert nodes.limit_ns() is None
    nodes.tell("stranger", S, 0.0)
    assert nodes.limit_ns() is None
    nodes.tell("a", 10 * S, 0.0)
    nodes.tell("b", 7 * S, 0.0)
    assert nodes.limit_ns() == 9 * S
    nodes.tell("b", 9 * S, 0.5)
    assert nodes.limit_ns() == 11 * S
    nodes.tell("b", 0, 0.6)
    assert nodes.limit_ns() == 12 * S


def test_time_gives_up_a_node_without_progress_until_it_tells_again() -> None:
    nodes = SlowNodes(["a", "b"], 2.0, 1.0)
    nodes.tell("a", 10 * S, 0.0)
    nodes.tell("b", 5 * S, 0.0)
    assert nodes.give_up(7 * S, 0.9) == []
    # Slow, but it comes on: time waits.
    nodes.tell("b", 6 * S, 0.9)
    assert nodes.give_up(8 * S, 1.8) == []
    assert nodes.give_up(8 * S, 2.0) == ["b"]
    assert nodes.give_up(8 * S, 9.0) == []
    assert nodes.limit_ns() == 12 * S
    nodes.tell("b", 8 * S, 9.0)
    assert nodes.limit_ns() == 10 * S


def test_kept_time_is_read_back_whatever_the_file_holds(tmp_path: Path) -> None:
    path = tmp_path / "time"
    file = TimeFile(path)
    assert file.read() is None
    file.write(123456789)
    file.write(987654321)
    file.close()
    content = path.read_bytes()
    file = TimeFile(path)
    assert file.read() == 987654321
    for cut in range(len(content)):
        path.write_bytes(content[:cut])
        assert file.read() is None
        damaged = bytearray(content)
        damaged[cut] ^= 0x20
        path.write_bytes(damaged)
        assert file.read() is None
    file.close()


def test_restarts_are_bounded_within_the_window() -> None:
    counter = RestartCounter(RestartPolicy(3, window_s=60.0, first_wait_s=0.5, longest_wait_s=1.5))
    assert [counter.wait_after(-9, t) for t in (0.0, 10.0, 20.0)] == [0.5, 1.0, 1.5]
    assert counter.wait_after(-9, 30.0) is None
    assert counter.recent == 4
    # Those long ago are forgotten.
    assert counter.wait_after(-9, 85.0) == 1.0
    assert counter.total == 4
    assert counter.wait_after(2, 400.0) is None
    assert RestartCounter(RestartPolicy()).wait_after(-9, 0.0) is None


def test_a_supervisor_that_comes_back_has_to_go_on_with_the_job() -> None:
    absence = Absence(silent_s=10.0, return_s=60.0)
    absence.heard(1, 0.0)
    assert absence.problem(1000.0, "") == "", "before the job nobody is missed"
    absence.expect(0.0)
    absence.heard(1, 5.0)
    assert absence.problem(74.0, "") == ""
    assert "did not come back within 60 s" in absence.problem(76.0, "")
    absence.heard(2, 70.0)
    assert absence.asking
    for now_s in range(71, 131):
        absence.heard(2, now_s)
    assert "is Interrupted" in absence.problem(131.0, "Interrupted")
    absence.goes_on()
    assert not absence.asking
    assert absence.problem(131.0, "") == ""
