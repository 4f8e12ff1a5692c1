"""Tools of the set-up: their errors, the lock, what a killed set-up leaves behind."""

import os
import subprocess
import sys
import threading

import pytest

from bootstrap.paths import Paths, tool_environment
from bootstrap.process import MARK, SetupError, exclusive, run_tool, stop_orphans
from bootstrap.ros import WHEELS_GUARD, Ros


def run(tmp_path, *command):
    log = tmp_path / "log"
    return run_tool(command, cwd=tmp_path, env=os.environ, log=log, what="the tool")


def test_output_is_returned_and_logged(tmp_path):
    assert run(tmp_path, sys.executable, "-c", "print('said')") == "said\n"
    assert "said" in (tmp_path / "log").read_text()


def test_failed_tool_is_named_with_the_end_of_its_output(tmp_path):
    code = "import sys; print('no space left'); sys.exit(3)"
    with pytest.raises(SetupError, match=r"the tool failed \(exit code 3\)[\s\S]*no space left"):
        run(tmp_path, sys.executable, "-c", code)


def test_missing_tool_is_named(tmp_path):
    with pytest.raises(SetupError, match="the tool: cannot start /no/such/program"):
        run(tmp_path, "/no/such/program")


def test_lock_lets_one_in_at_a_time(tmp_path, capsys):
    inside, order = threading.Event(), []

    def second():
        with exclusive(tmp_path / "lock"):
            order.append("second")

    with exclusive(tmp_path / "lock"):
        thread = threading.Thread(target=second)
        thread.start()
        inside.wait(0.2)
        order.append("first")
    thread.join(10)
    assert order == ["first", "second"]
    assert "another set-up" in capsys.readouterr().out


def test_orphans_of_this_work_tree_are_stopped_and_others_are_not(tmp_path):
    command = [sys.executable, "-c", "import time; print(flush=True); time.sleep(60)"]
    children = []
    for root in (tmp_path, tmp_path / "other"):
        env = {**os.environ, MARK: str(root)}
        children.append(subprocess.Popen(command, env=env, stdout=subprocess.PIPE))
        children[-1].stdout.readline()
    ours, others = children
    try:
        assert stop_orphans(tmp_path) == 1
        assert ours.wait(10) == -9
        assert others.poll() is None
    finally:
        for child in children:
            child.kill()
            child.communicate()


def test_tools_do_not_inherit_another_environment(tmp_path):
    foreign = {
        WHEELS_GUARD: "1",
        "LD_LIBRARY_PATH": "/elsewhere/lib",
        "PYTHONPATH": "/elsewhere",
        "PIP_TARGET": "/elsewhere",
        "PATH": "/usr/bin",
    }
    env = tool_environment(foreign, Paths(tmp_path), Ros())
    assert not any("elsewhere" in value for value in env.values())
    assert WHEELS_GUARD not in env
    assert env["AMENT_PREFIX_PATH"] == env["CMAKE_PREFIX_PATH"] == str(tmp_path / ".venv")
    assert env["PATH"] == f"{tmp_path}/.venv/bin:/usr/bin"


def test_tools_find_the_sourced_installation(tmp_path):
    sourced = {"PYTHONPATH": "/opt/ros/jazzy/x", "LD_LIBRARY_PATH": "/opt/ros/jazzy/lib"}
    env = tool_environment(sourced, Paths(tmp_path), Ros(prefixes=(tmp_path / "jazzy",)))
    assert env["AMENT_PREFIX_PATH"] == f"{tmp_path}/.venv:{tmp_path}/jazzy"
    assert env["PYTHONPATH"] == sourced["PYTHONPATH"]
    assert env["LD_LIBRARY_PATH"] == sourced["LD_LIBRARY_PATH"]
