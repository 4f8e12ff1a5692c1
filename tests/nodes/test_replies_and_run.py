"""An answer always goes out; a node as a program ends in order."""

import errno
import inspect
import os
import signal
import subprocess
import sys
from typing import Any

import pytest
from skinplan_msgs.msg import Heartbeat, Status
from skinplan_msgs.srv import IdentifyPart, PlayerSeek
from std_srvs.srv import Trigger

from nodes.bench import TIMEOUT_S, Bench
from skinplan import errors
from skinplan_nodes.node import CellNode
from skinplan_nodes.qos import STATE
from skinplan_nodes.replies import CODES, RefusedError, replies, replies_in_thread, status_of

#: Bases that mean nothing of their own.
BASES = {errors.SkinplanError, errors.InputError, errors.StageError}


class Moody(CellNode):
    """A node whose handlers raise what they are told to."""

    NAME = "moody"
    error: Exception | None = None

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self.create_service(Trigger, "trigger", self._on_trigger)
        self.create_service(PlayerSeek, "seek", self._on_seek)
        self.create_service(IdentifyPart, "identify", self._on_identify)

    def _react(self) -> None:
        if self.error is not None:
            raise self.error

    @replies
    def _on_trigger(self, _: Any, response: Any) -> None:
        response.message = "half-filled"
        self._react()

    @replies(invalid=Status.BAG_INVALID)
    def _on_seek(self, _: Any, response: Any) -> None:
        self._react()

    @replies_in_thread(invalid=Status.PART_INVALID, blank={"index": -1})
    def _on_identify(self, _: Any, response: Any) -> None:
        response.index = 3
        self._react()


def test_every_error_of_the_library_has_a_code() -> None:
    kinds = {k for _, k in inspect.getmembers(errors, inspect.isclass)} - BASES
    kinds = {k for k in kinds if issubclass(k, errors.SkinplanError)}
    without = [k.__name__ for k in kinds if not set(k.__mro__) & set(CODES)]
    assert not without


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (errors.MeshEmptyError("x"), Status.MESH_EMPTY),
        (errors.MeshError("x"), Status.MESH_REFUSED),
        (RefusedError(Status.NO_IMAGE, "x"), Status.NO_IMAGE),
        (errors.StageError("mesh", 0, errors.MeshEmptyError("x")), Status.MESH_EMPTY),
        (errors.InputError("x"), Status.BAG_INVALID),
        (errors.SkinplanError("x"), Status.INTERNAL),
        (KeyError("x"), Status.INTERNAL),
    ],
)
def test_status_of_errors(error: Exception, code: int) -> None:
    status = status_of(error, invalid=Status.BAG_INVALID)
    assert status.code == code
    assert "x" in status.message


def test_a_full_disk_has_its_code_whatever_could_not_be_written() -> None:
    full = OSError(errno.ENOSPC, "no space left on device", "/runs/x")
    assert status_of(full).code == Status.DISK_FULL
    try:
        raise errors.CloudInvalidError("/runs/x: the cloud can't be written") from full
    except errors.CloudInvalidError as error:
        status = status_of(error, invalid=Status.NO_CLOUD)
    assert (status.code, "the cloud" in status.message) == (Status.DISK_FULL, True)
    try:
        raise (again := errors.NoMarkerError("none")) from again
    except errors.NoMarkerError as error:
        assert status_of(error).code == Status.NO_MARKER, "it is its own cause"
    denied = OSError(errno.EACCES, "permission denied", "/runs/x")
    assert status_of(denied).code == Status.INTERNAL


def test_handlers_answer_whatever_happens(bench: Bench) -> None:
    node = bench.start(Moody, simulated=False)
    assert bench.call(Trigger, "trigger", Trigger.Request()).success
    assert bench.call(PlayerSeek, "seek", PlayerSeek.Request()).status.code == Status.OK
    assert bench.call(IdentifyPart, "identify", IdentifyPart.Request()).index == 3
    node.error = ZeroDivisionError("divided")
    trigger = bench.call(Trigger, "trigger", Trigger.Request())
    assert not trigger.success
    assert "ZeroDivisionError" in trigger.message
    seek = bench.call(PlayerSeek, "seek", PlayerSeek.Request())
    assert seek.status.code == Status.INTERNAL
    identify = bench.call(IdentifyPart, "identify", IdentifyPart.Request())
    assert (identify.status.code, identify.index) == (Status.INTERNAL, -1)
    node.error = None
    assert bench.call(Trigger, "trigger", Trigger.Request()).success, "it is still alive"


def environment() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}


@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_a_node_in_order(bench: Bench, sent: signal.Signals) -> None:
    beats = bench.collect_before(Heartbeat, "heartbeat", STATE)
    command = [sys.executable, "-m", "skinplan_nodes.part_recognizer"]
    process = subprocess.Popen(command, env=environment(), stderr=subprocess.PIPE, text=True)
    try:
        bench.wait(lambda: [beat for beat in beats if beat.pid == process.pid])
        process.send_signal(sent)
        _, told = process.communicate(timeout=TIMEOUT_S)
    finally:
        process.kill()
        process.wait()
    assert process.returncode == 0, told
    assert "Traceback" not in told


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["-p", "voxel_m:=7.5"], "out of range"),
        (["-p", "voxel_m:=1"], "type"),
    ],
)
def test_parameters_that_are_none_end_it_with_a_sentence(arguments: list[str], words: str) -> None:
    command = [sys.executable, "-m", "skinplan_nodes.part_recognizer", "--ros-args", *arguments]
    done = subprocess.run(
        command, env=environment(), timeout=TIMEOUT_S, capture_output=True, text=True
    )
    assert done.returncode == 2, done.stderr
    assert words in done.stderr
    assert "Traceback" not in done.stderr


def test_a_missing_cell_file_ends_it_with_a_sentence() -> None:
    command = [sys.executable, "-m", "skinplan_nodes.station_planner", "--ros-args"]
    done = subprocess.run(
        [*command, "-p", "cell_file:=/no/such/cell.yaml"],
        env=environment(), timeout=TIMEOUT_S, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 2, done.stderr
    assert "no cell file" in done.stderr
    assert "Traceback" not in done.stderr


FAILS_LATE = """
import sys, threading
from skinplan.errors import InputError
from skinplan_nodes.node import CellNode
from skinplan_nodes.run import run_node

class FailsLate(CellNode):
    NAME = "fails_late"

    def __init__(self):
        super().__init__()
        raise InputError("nothing is accepted")

code = run_node(FailsLate, [])
print(code, [thread.name for thread in threading.enumerate() if thread.name == "heartbeat"])
"""


def test_a_node_that_can_not_start_sends_nothing_any_more() -> None:
    done = subprocess.run(
        [sys.executable, "-c", FAILS_LATE],
        env=environment(), timeout=TIMEOUT_S, capture_output=True, text=True,
    )  # fmt: skip
    assert (done.returncode, done.stdout.split(maxsplit=1)) == (0, ["2", "[]\n"]), done.stderr
