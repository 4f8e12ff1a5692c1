"""The reference MES client against the whole mock cell, whose supervisor is killed meanwhile."""

from pathlib import Path

import psutil
import pytest
from skinplan_msgs.msg import Status

from mes_orders import EVENTS, MesClient, check, hand_in, orders_of, work_through, write_parts
from skinplan.jobs.store import JobStore
from system.graph_run import GraphRun


@pytest.mark.long
@pytest.mark.timeout(2400)
def test_twenty_orders_with_all_that_happens_to_orders(tmp_path: Path, client: MesClient) -> None:
    parts = write_parts(tmp_path)
    options = ["--serve", "--time-factor", "10", "--restarts", "10", "--job-id", "served"]
    run = GraphRun(tmp_path / "runs", parts[0], *options)
    try:
        orders = orders_of(parts, 20)
        hand_in(client, orders)

        def kill() -> None:
            supervisor: psutil.Process = run.node("cell_supervisor")
            supervisor.kill()
            supervisor.wait(10)

        fetched = work_through(client, orders, EVENTS, kill, 600.0)
        check(fetched, EVENTS)
        run.end()
    finally:
        run.close()
    store = JobStore(tmp_path / "runs" / "jobs.sqlite", copy=True)
    assert len(store.list()) == 20 and store.list(include_cleared=False) == ()
    for record in store.list():
        assert store.history(record.job.job_id)[-1].reason.startswith("the command CLEAR")
    store.close()
    assert sum(f.job_status.status.code == Status.JOB_ABORTED for f in fetched.values()) == 1
