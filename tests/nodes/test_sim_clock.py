"""The owner of the cell's time: jumps on demand, waiting for slow nodes, going on after an end."""

from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import KeyValue
from rosgraph_msgs.msg import Clock
from skinplan_msgs.msg import JobStatus, Status
from skinplan_msgs.srv import InjectFault
from std_msgs.msg import Header

from nodes.bench import Bench
from skinplan_nodes.conversions import stamp_from_msg, stamp_to_msg
from skinplan_nodes.qos import LATCHED, STATE
from skinplan_nodes.sim_clock import SimClock
from skinplan_nodes.time_ack import TimeAck


def start(bench: Bench, **parameters: Any) -> tuple[SimClock, list[Any]]:
    ticks = bench.collect_before(Clock, "/clock", STATE)
    clock = bench.start(SimClock, simulated=False, **parameters)
    bench.wait(lambda: len(ticks) > 2)
    return clock, ticks


def seconds(ticks: list[Any]) -> list[float]:
    return [stamp_from_msg(tick.clock) for tick in ticks]


def inject(bench: Bench, fault: str = "clock_jump", at: float = 0.0, **values: str) -> Any:
    request = InjectFault.Request(fault=fault, at=at)
    request.values = [KeyValue(key=key, value=value) for key, value in values.items()]
    return bench.call(InjectFault, "sim_clock/inject_fault", request)


def test_the_clock_jumps_ahead_on_demand(bench: Bench) -> None:
    _, ticks = start(bench)
    answer = inject(bench, jump="1000")
    assert (answer.status.code, answer.active, answer.pending) == (Status.OK, [], [])
    bench.wait(lambda: seconds(ticks)[-1] > 1000.0)
    later = inject(bench, at=5000.0, jump="500")
    assert (later.status.code, later.pending) == (Status.OK, ["clock_jump"])
    assert inject(bench, fault="").pending == []
    assert seconds(ticks)[-1] < 1400.0
    assert seconds(ticks) == sorted(seconds(ticks))


def test_a_jump_at_a_time(bench: Bench) -> None:
    clock, ticks = start(bench, time_factor=10.0)
    due_s = seconds(ticks)[-1] + 5.0
    assert inject(bench, at=due_s, jump="100").pending == ["clock_jump"]
    bench.wait(lambda: seconds(ticks)[-1] > 100.0)
    before = [s for s in seconds(ticks) if s < 100.0]
    assert before[-1] == pytest.approx(due_s, abs=1.0)
    assert not clock._jumps


@pytest.mark.parametrize(
    ("fault", "values", "code", "words"),
    [
        ("clock_jump", {"jump": "-3"}, Status.REQUEST_INVALID, "never runs back"),
        ("clock_jump", {"jump": "nan"}, Status.REQUEST_INVALID, "nan s"),
        ("clock_jump", {"jump": "soon"}, Status.REQUEST_INVALID, "nan s"),
        ("clock_jump", {}, Status.REQUEST_INVALID, "above 0"),
        ("clock_jump", {"jump": "1", "by": "2"}, Status.REQUEST_INVALID, "by"),
        ("stop", {}, Status.FAULT_UNKNOWN, "clock_jump"),
    ],
)
def test_other_faults_are_refused(
    bench: Bench, fault: str, values: dict[str, str], code: int, words: str
) -> None:
    _, ticks = start(bench)
    answer = inject(bench, fault, **values)
    assert answer.status.code == code
    assert words in answer.status.message
    assert seconds(ticks) == sorted(seconds(ticks))


def test_time_waits_for_a_node_that_lags(bench: Bench) -> None:
    _, ticks = start(bench, time_factor=10.0, wait_for=["slow"], lag_max_s=2.0, wait_max_s=60.0)
    progress = bench.tester.create_publisher(Header, "clock/progress", STATE)
    bench.wait(lambda: bench.tester.count_subscribers("clock/progress") > 0)
    for _ in range(3):
        reached_s = seconds(ticks)[-1] + 1.0
        progress.publish(Header(frame_id="slow", stamp=stamp_to_msg(reached_s)))
        bench.wait(lambda s=reached_s: seconds(ticks)[-1] == pytest.approx(s + 2.0, abs=1e-6))
        count = len(ticks)
        bench.wait(lambda n=count: len(ticks) > n + 5)
        assert seconds(ticks)[-1] == pytest.approx(reached_s + 2.0, abs=1e-6)
    # Nothing to wait for any more.
    progress.publish(Header(frame_id="slow"))
    bench.wait(lambda: seconds(ticks)[-1] > reached_s + 10.0)


def test_time_gives_up_a_node_that_makes_no_progress(bench: Bench) -> None:
    waiting = {"wait_for": ["tester"], "lag_max_s": 1.0, "wait_max_s": 0.5}
    clock, ticks = start(bench, time_factor=10.0, **waiting)
    bench.wait(lambda: bench.tester.count_subscribers("clock/progress") > 0)
    ack = TimeAck(bench.tester)
    reached_s = seconds(ticks)[-1] + 5.0
    ack.reached(reached_s)
    bench.wait(lambda: seconds(ticks)[-1] > reached_s + 3.0)
    assert "node tester" in clock._health[1] and "0.5 s" in clock._health[1]
    assert clock.health_values()["ticks_held_back"] > 0


def test_time_is_slower_while_a_plan_is_computed(bench: Bench) -> None:
    clock, ticks = start(bench, time_factor=20.0, computing_factor=2.0)
    status = bench.tester.create_publisher(JobStatus, "job_status", LATCHED)
    for sub_state, factor in (("", 2.0), ("scanning", 20.0), ("planning", 2.0), ("moving", 20.0)):
        status.publish(JobStatus(job_id="a", sub_state=sub_state))
        bench.wait(lambda f=factor: clock._time._factor == f)
        count = len(ticks)
        bench.wait(lambda n=count: len(ticks) > n + 3)
        # One tick is 20 ms of wall time; a late one counts for three at most.
        steps = np.diff(seconds(ticks)[-3:])
        assert np.all(steps <= 0.06 * factor + 1e-9)
        assert np.all(steps > 0.0)


def test_a_clock_that_is_started_again_goes_on(tmp_path: Path) -> None:
    last_s = 0.0
    for _ in range(2):
        with closing(Bench()) as bench:
            _, ticks = start(bench, time_file=str(tmp_path / "time"), time_factor=50.0)
            assert seconds(ticks)[0] >= last_s
            bench.wait(lambda t=ticks, s=last_s: seconds(t)[-1] > s + 5.0)
        last_s = max(seconds(ticks))
    assert last_s > 10.0
