"""Ten thousand calls from eight processes while jobs run in the whole mock cell."""

import sys
from pathlib import Path

import psutil
import pytest
import yaml

from flooding import Floods, check_answers, memory_mib
from mes_orders import OVER, MesClient, check, orders_of, write_parts
from system.graph_run import GraphRun

_PROCESSES, _CALLS = 8, 1250
_SLOWEST_S = 1.0
# What the allocator may keep more than before.
_GROWTH_MIB = 8.0


@pytest.mark.long
@pytest.mark.timeout(2400)
def test_ten_thousand_calls_beside_jobs(tmp_path: Path, client: MesClient) -> None:
    config = tmp_path / "config"
    config.mkdir()
    document = {"/**": {"ros__parameters": {"operators": ["Anna"]}}}
    (config / "cell_supervisor.yaml").write_text(yaml.safe_dump(document))
    parts = write_parts(tmp_path)
    options = ["--serve", "--time-factor", "1", "--config-folder", str(config), "--job-id", "f"]
    run = GraphRun(tmp_path / "runs", parts[0], *options)
    floods, memory, fetched = None, [], {}
    try:
        orders = iter(orders_of(parts, 40))
        order = next(orders)
        assert client.submit(order).status.code == 1
        while client.look(order["job_id"]).sub_state in ("", "starting"):
            client.spin(0.2)
        supervisor: psutil.Process = run.node("cell_supervisor")
        floods = Floods(_PROCESSES, _CALLS, order["job_id"], str(parts[0]))
        while floods.run():
            memory.append(memory_mib(supervisor))
            client.spin(1.0)
            if client.states[order["job_id"]].state in OVER:
                fetched[order["job_id"]] = client.fetch(order["job_id"])
                order = next(orders)
                assert client.submit(order).status.code == 1
        reports = floods.reports()
        for report in reports:
            sys.stdout.write(f"{report}\n")
        told = " ".join(f"{mib:.1f}" for mib in memory)
        sys.stdout.write(f"supervisor [MiB], every second: {told}\n")
        codes = check_answers(reports, _PROCESSES * _CALLS)
        sys.stdout.write(f"codes: {dict(sorted(codes.items()))}\n")
        client.follow(order["job_id"], 900.0)
        fetched[order["job_id"]] = client.fetch(order["job_id"])
        check(fetched, {})
        sys.stdout.write(f"{len(fetched)} jobs ran meanwhile\n")
        assert max(report["slowest_s"] for report in reports) < _SLOWEST_S
        # Plans and reports of the first job are in memory after it.
        later = memory[len(memory) // 2 :]
        assert max(later) - later[0] < _GROWTH_MIB
        run.end()
    finally:
        if floods is not None:
            floods.close()
        run.close()
