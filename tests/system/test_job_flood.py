"""Ten thousand calls from eight processes while a job runs in the whole mock cell."""

import sys
import time
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest
import rclpy
import yaml

from flooding import Floods, check_answers, memory_mib
from mes_orders import OVER, MesClient, check, orders_of, write_parts
from system.graph_run import GraphRun

_PROCESSES, _CALLS = 8, 1250
_SLOWEST_S = 1.0
# What the allocator may keep more than before.
_GROWTH_MIB = 8.0


@pytest.fixture
def client() -> Iterator[MesClient]:
    rclpy.init(args=[])
    found = MesClient("Anna", patience_s=120.0)
    yield found
    found.node.destroy_node()
    rclpy.try_shutdown()


@pytest.mark.long
@pytest.mark.timeout(2400)
def test_ten_thousand_calls_beside_a_job(tmp_path: Path, client: MesClient) -> None:
    config = tmp_path / "config"
    config.mkdir()
    document = {"/**": {"ros__parameters": {"operators": ["Anna"]}}}
    (config / "cell_supervisor.yaml").write_text(yaml.safe_dump(document))
    parts = write_parts(tmp_path)
    options = ["--serve", "--time-factor", "1", "--config-folder", str(config), "--job-id", "f"]
    run = GraphRun(tmp_path / "runs", parts[0], *options)
    floods, memory = None, []
    try:
        (order,) = orders_of(parts, 1)
        assert client.submit(order).status.code == 1
        while client.look(order["job_id"]).sub_state in ("", "starting"):
            client.spin(0.2)
        supervisor: psutil.Process = run.node("cell_supervisor")
        floods = Floods(_PROCESSES, _CALLS, order["job_id"], str(parts[0]))
        while floods.run():
            memory.append((time.monotonic(), memory_mib(supervisor)))
            time.sleep(1.0)
        state = client.look(order["job_id"])
        reports = floods.reports()
        for report in reports:
            sys.stdout.write(f"{report}\n")
        told = [f"{mib:.1f}" for _, mib in memory]
        sys.stdout.write(f"supervisor [MiB], every second: {' '.join(told)}\n")
        codes = check_answers(reports, _PROCESSES * _CALLS)
        sys.stdout.write(f"codes: {dict(sorted(codes.items()))}; the job: {state.sub_state}\n")
        assert state.state not in OVER, "the flood was over before the job"
        client.follow(order["job_id"], 900.0)
        check({order["job_id"]: client.fetch(order["job_id"])}, {})
        assert max(report["slowest_s"] for report in reports) < _SLOWEST_S
        third = len(memory) // 3
        assert max(mib for _, mib in memory[third:]) - memory[third][1] < _GROWTH_MIB
    finally:
        if floods is not None:
            floods.close()
        run.close()
