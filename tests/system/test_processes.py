"""The process manager: staged end, names of dead processes, no orphans."""

import json
import os
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType

import psutil
import pytest

from skinplan_nodes.dds_domain import domain_of_graph
from system.graph_run import command_of

TIMEOUT_S = 20.0

PROGRAM = """
import os, sys
from pathlib import Path
from skinplan_nodes.forked import Program
from skinplan_nodes.processes import EndTimes, GraphManager
from skinplan_nodes.restarts import RestartPolicy

events = []
manager = GraphManager(
    lambda name, line: print(f"line {{name}} {{line}}", flush=True),
    lambda name, code: print(f"died {{name}} {{code}}", flush=True),
    client={client!r},
    times=EndTimes(grace_s=1.0, client_s=1.0, first_s=1.0, terminate_s=1.0),
    restarts=RestartPolicy({restarts}, first_wait_s={wait_s}),
    on_restart=lambda name, code, count: print(f"restart {{name}} {{code}} {{count}}", flush=True),
)
for name, command in {processes!r}.items():
    manager.add_process(name, command)
for name, module in {forks!r}.items():
    log_file = Path({folder!r}) / f"{{name}}.log"
    given = (name, str(os.getpid()))
    manager.add_process(name, Program(module, given, log_file, heard=name == {client!r}))
manager.loop()
print(f"end {{manager.client_code() if manager._client else None}}", flush=True)
sys.exit(manager.returncode)
"""
NODE = f"exec {sys.executable} -c 'import time; time.sleep(600)'"
STUBBORN = (
    f"exec {sys.executable} -c 'import signal as s, time; s.signal(s.SIGTERM, s.SIG_IGN); "
    'print("up", flush=True); time.sleep(600)\''
)
CLIENT = (
    f"exec {sys.executable} -c 'import signal, sys, time; "
    'signal.signal(signal.SIGINT, lambda *_: (print("aborted", flush=True), sys.exit(3))); '
    'print("up", flush=True); time.sleep(600)\''
)


class Program:
    """A process manager in a program of its own, with all its processes."""

    def __init__(
        self,
        processes: dict[str, str],
        client: str | None,
        restarts: int,
        wait_s: float,
        forks: dict[str, str],
        folder: Path,
    ) -> None:
        source = textwrap.dedent(PROGRAM).format(
            client=client,
            processes=processes,
            restarts=restarts,
            wait_s=wait_s,
            forks=forks,
            folder=str(folder),
        )
        self.process = subprocess.Popen(
            [sys.executable, "-c", source],
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,
            env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[1])},
        )
        self.tree: list[psutil.Process] = []

    def wait_started(self, count: int) -> list[psutil.Process]:
        """Waits until the manager and `count` programs run; returns them all."""
        root = psutil.Process(self.process.pid)

        def started() -> bool:
            self.tree = [root, *root.children(recursive=True)]
            # One reader and one program for each.
            return len(self.tree) == 1 + 2 * count

        wait_for(started)
        return self.tree

    def lines(self) -> list[str]:
        """Waits for the end of the program and returns what it said."""
        return self.process.communicate(timeout=TIMEOUT_S)[0].splitlines()

    def running(self) -> list[psutil.Process]:
        """Returns those of the processes that still run."""
        return [p for p in self.tree if p.is_running() and p.status() != psutil.STATUS_ZOMBIE]


def wait_for(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + TIMEOUT_S
    while not condition():
        assert time.monotonic() < deadline, "the condition did not come true in time"
        time.sleep(0.02)


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[..., Program]]:
    programs: list[Program] = []

    def begin(
        processes: dict[str, str],
        client: str | None = None,
        restarts: int = 0,
        wait_s: float = 0.05,
        forks: Mapping[str, str] = MappingProxyType({}),
    ) -> Program:
        programs.append(Program(processes, client, restarts, wait_s, dict(forks), tmp_path))
        return programs[-1]

    yield begin
    for program in programs:
        for process in program.running():
            process.kill()
        program.process.wait(TIMEOUT_S)


def test_end_of_the_client_ends_the_rest(start: Callable[..., Program]) -> None:
    done = f"exec {sys.executable} -c 'import time; print(\"hello\"); time.sleep(0.5)'"
    program = start({"node": NODE, "client": done}, "client")
    program.wait_started(2)
    lines = program.lines()
    assert "line client hello" in lines
    assert lines[-1] == "end 0"
    assert program.process.returncode == 0
    assert not program.running()
    assert not any(line.startswith("died") for line in lines)


def test_dead_node_is_named_and_the_client_gets_its_grace(start: Callable[..., Program]) -> None:
    program = start({"victim": NODE, "other": NODE, "client": CLIENT}, "client")
    tree = program.wait_started(3)
    victim = next(
        p for p in tree if p.cmdline()[1:2] == ["-c"] and p.cmdline()[2].startswith("import time")
    )
    victim.send_signal(signal.SIGKILL)
    lines = program.lines()
    assert f"died victim {-signal.SIGKILL}" in lines or f"died other {-signal.SIGKILL}" in lines
    assert "line client aborted" in lines
    assert lines[-1] == "end 3"
    assert not program.running()


@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGTERM])
def test_signal_aborts_by_the_client_and_leaves_nothing(
    start: Callable[..., Program], sent: signal.Signals
) -> None:
    program = start({"stubborn": STUBBORN, "client": CLIENT}, "client")
    tree = program.wait_started(2)
    assert program.process.stdout is not None
    assert sorted(program.process.stdout.readline().split()[-1] for _ in range(2)) == ["up", "up"]
    tree[0].send_signal(sent)
    lines = program.lines()
    assert "line client aborted" in lines
    assert program.process.returncode == 128 + sent
    assert not program.running()


def test_killed_manager_leaves_nothing(start: Callable[..., Program]) -> None:
    program = start({"node": NODE, "client": CLIENT}, "client")
    tree = program.wait_started(2)
    tree[0].kill()
    program.process.wait(TIMEOUT_S)
    wait_for(lambda: not program.running())
    assert program.tree, "there was something to end"


def node_of(program: Program, marker: str, before: int = 0) -> psutil.Process:
    """Waits for the program with a marker in its command, another one than before."""
    found: list[psutil.Process] = []

    def there() -> bool:
        root = psutil.Process(program.process.pid)
        program.tree = [root, *root.children(recursive=True)]
        found[:] = [p for p in program.tree if marker in command_of(p)[1:] and p.pid != before]
        return bool(found)

    wait_for(there)
    return found[0]


def marked(marker: str) -> str:
    """A node that runs until it is killed."""
    return f"exec {sys.executable} -c 'import time; time.sleep(600)' {marker}"


def read_until(program: Program, line: str) -> None:
    """Reads what the manager says up to a line."""
    assert program.process.stdout is not None
    for said in program.process.stdout:
        if said.strip() == line:
            return
    raise AssertionError(f"never said: {line}")


def test_a_killed_node_is_started_again_and_the_rest_goes_on(start: Callable[..., Program]) -> None:
    program = start({"victim": marked("m1"), "other": marked("m2")}, restarts=2)
    victim, other = node_of(program, "m1"), node_of(program, "m2")
    for count in (1, 2):
        victim.kill()
        read_until(program, f"restart victim {-signal.SIGKILL} {count}")
        read_until(program, f"restart victim None {count}")
        victim = node_of(program, "m1", victim.pid)
    assert other.is_running()
    # Once too often: it is named, and everything ends.
    victim.kill()
    lines = program.lines()
    assert f"died victim {-signal.SIGKILL}" in lines
    assert not any(line.startswith("died other") for line in lines)
    assert program.process.returncode == -signal.SIGKILL % 256
    assert not program.running()


def test_a_node_with_bad_parameters_is_not_started_again(start: Callable[..., Program]) -> None:
    bad = f"exec {sys.executable} -c 'import sys; sys.exit(2)'"
    program = start({"bad": bad, "other": NODE}, restarts=5)
    lines = program.lines()
    assert lines[0] == "died bad 2"
    assert not any(line.startswith("restart") for line in lines)


@pytest.mark.parametrize("sent", [signal.SIGTERM, signal.SIGKILL])
def test_the_end_does_not_wait_for_a_restart(
    start: Callable[..., Program], sent: signal.Signals
) -> None:
    program = start({"victim": marked("m1"), "other": marked("m2")}, restarts=2, wait_s=300.0)
    victim = node_of(program, "m1")
    node_of(program, "m2")
    victim.kill()
    read_until(program, f"restart victim {-signal.SIGKILL} 1")
    program.process.send_signal(sent)
    program.process.wait(TIMEOUT_S)
    wait_for(lambda: not program.running())
    assert program.tree, "there was something to end"


def test_end_of_the_client_does_not_wait_for_a_restart(start: Callable[..., Program]) -> None:
    program = start({"victim": marked("m1"), "client": CLIENT}, "client", 2, 300.0)
    victim = node_of(program, "m1")
    read_until(program, "line client up")
    victim.kill()
    read_until(program, f"restart victim {-signal.SIGKILL} 1")
    client = next(p for p in program.tree if "signal.signal(signal.SIGINT," in command_of(p))
    client.send_signal(signal.SIGINT)
    assert program.lines()[-1] == "end 3"
    assert not program.running()


FORK = "system.forked_program"


def test_a_fork_is_a_program_of_its_own(start: Callable[..., Program], tmp_path: Path) -> None:
    program = start({}, "client", forks={"node": FORK, "client": FORK})
    lines = program.lines()
    # The client's words are heard; what it says to stderr, and all that a node says, is in its log.
    told = json.loads(next(li for li in lines if li.startswith("line client ")).split(" ", 2)[2])
    assert lines[-1] == "end 7"
    assert (tmp_path / "client.log").read_text() == "client to stderr\n"
    first, second = (tmp_path / "node.log").read_text().splitlines()[:2]
    assert second == "node to stderr"
    for found in (told, json.loads(first)):
        assert found["pid"] not in (program.process.pid, found["parent"])
        assert found["parent"] != program.process.pid, "a reader of honcho is between them"
        assert found["group"] == found["session"] == found["pid"]
        assert found["handlers"] == [signal.SIG_DFL, signal.SIG_DFL]
        assert found["open"] <= 1, "no file of the parent"
        assert found["modules"] == "there", "what the parent imported"
        assert found["title"][1:4] == ["-m", FORK, found["name"]]
    assert not program.running()


def test_forks_that_fail_say_so_in_their_logs(
    start: Callable[..., Program], tmp_path: Path
) -> None:
    program = start({"other": NODE}, restarts=0, forks={"none": "system.no_such_program"})
    assert "died none 1" in program.lines()
    assert "No module named 'system.no_such_program'" in (tmp_path / "none.log").read_text()
    program = start({"other": NODE}, restarts=0, forks={"raises": FORK})
    assert "died raises 1" in program.lines()
    assert "ZeroDivisionError" in (tmp_path / "raises.log").read_text()
    assert not program.running()


@pytest.mark.parametrize("sent", [signal.SIGTERM, signal.SIGKILL])
def test_forks_end_with_the_manager(start: Callable[..., Program], sent: signal.Signals) -> None:
    program = start({"node": NODE}, forks={"sleeps": FORK})
    tree = program.wait_started(2)
    tree[0].send_signal(sent)
    program.process.wait(TIMEOUT_S)
    wait_for(lambda: not program.running())
    assert program.tree, "there was something to end"


def test_a_fork_that_is_killed_is_forked_again(start: Callable[..., Program]) -> None:
    program = start({}, restarts=2, forks={"sleeps": FORK})
    first = node_of(program, "sleeps")
    first.kill()
    read_until(program, "restart sleeps None 1")
    assert node_of(program, "sleeps", first.pid).is_running()


def test_domain_asked_for_is_taken() -> None:
    assert domain_of_graph({"ROS_DOMAIN_ID": "17"}) == 17


def test_domain_in_use_is_avoided(tmp_path: Path) -> None:
    table = tmp_path / "udp"
    header = "  sl  local_address rem_address   st\n"
    table.write_text(header)
    assert domain_of_graph({}, table) == 0
    port = 7400 + 11
    table.write_text(header + f"  12: 00000000:{port:04X} 00000000:0000 07\n")
    assert domain_of_graph({}, table) == 1 + os.getpid() % 100


def test_runner_refuses_a_missing_part(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "skinplan_nodes.runner", "--part", str(tmp_path / "none.yaml")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_S, check=False)
    assert done.returncode == 2
    assert "there is no such file" in done.stderr
    assert "Traceback" not in done.stderr
    assert not json.loads(done.stdout or "[]")
