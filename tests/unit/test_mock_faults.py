"""Faults on demand: how they are written, when they begin and end; the state of a device."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skinplan.errors import DeviceRefusedError, FaultUnknownError, InputError
from skinplan.mock.device import Device, Mode
from skinplan.mock.faults import Fault, FaultBook, FaultKind, parse_fault

KINDS = (FaultKind("stuck"), FaultKind("jump", {"jump": (0.1, 0.0, 0.1)}, at_once=True))


def book() -> FaultBook:
    return FaultBook(KINDS, "tester")


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("stuck", Fault("stuck")),
        ("stuck@12.5", Fault("stuck", at_s=12.5)),
        ("stuck+3", Fault("stuck", duration_s=3.0)),
        ("stuck@1e2+0.5;jump=0.05", Fault("stuck", 100.0, 0.5, values={"jump": 0.05})),
        ("stuck;place=1,-2", Fault("stuck", place=(1.0, -2.0, 0.0), radius_m=0.5)),
        ("stuck;radius=2;place=1,2,3", Fault("stuck", place=(1.0, 2.0, 3.0), radius_m=2.0)),
    ],
)
def test_faults_as_they_are_written(text: str, fault: Fault) -> None:
    assert parse_fault(text) == fault


@pytest.mark.parametrize(
    "text",
    [
        *("", "@3", "stuck@", "stuck@soon", "stuck+3@1", "stuck+", "stuck@nan", "stuck@1@2"),
        *("stuck;", "stuck;jump", "stuck;jump=", "stuck;jump=0.1;jump=0.1", "stuck;radius=1"),
        *("stuck;place=1", "stuck;place=1,2,3,4", "stuck;place=a,b", "stuck;place=1,2;radius=x"),
        *("stuck now", "stuck @3", "stuck+inf"),
    ],
)
def test_what_is_written_otherwise_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="is accepted|place"):
        parse_fault(text)


@given(st.text(max_size=30))
def test_any_text_is_a_fault_or_refused(text: str) -> None:
    try:
        found = parse_fault(text)
    except InputError:
        return
    assert found.name.isidentifier()


def test_a_fault_begins_at_its_time_and_ends_after_its_duration() -> None:
    faults = book()
    faults.add(Fault("stuck", at_s=5.0, duration_s=2.0))
    assert faults.step(4.9) == ([], [])
    assert faults.pending == ["stuck"] and faults.active == []
    begun, _ = faults.step(5.3)
    assert [fault.name for fault in begun] == ["stuck"]
    assert faults.values("stuck") == {}
    assert faults.step(7.2) == ([], [])
    assert faults.step(7.3) == ([], ["stuck"])
    assert faults.values("stuck") is None


def test_a_fault_waits_for_its_place() -> None:
    faults = book()
    faults.add(Fault("jump", place=(1.0, 2.0, 0.0), radius_m=0.5))
    assert faults.step(1.0) == ([], []), "where the device is, is not known"
    assert faults.step(2.0, np.array([1.6, 2.0, 0.0])) == ([], [])
    (fault,), ended = faults.step(3.0, np.array([1.4, 2.0, 0.0]))
    assert fault.values == {"jump": 0.1} and ended == []
    assert faults.active == faults.pending == [], "a jump is over at once"


def test_all_faults_end_together() -> None:
    faults = book()
    faults.add(Fault("stuck"))
    faults.step(1.0)
    faults.add(Fault("stuck", at_s=50.0))
    faults.clear()
    assert faults.step(60.0) == ([], ["stuck"])
    assert faults.pending == []


@pytest.mark.parametrize(
    ("fault", "error", "words"),
    [
        (Fault("loud"), FaultUnknownError, "process_killed"),
        (Fault("stuck", at_s=-1.0), InputError, ">= 0"),
        (Fault("stuck", duration_s=np.inf), InputError, ">= 0"),
        (Fault("stuck", radius_m=np.nan), InputError, ">= 0"),
        (Fault("stuck", place=(np.nan, 0.0, 0.0)), InputError, "finite place"),
        (Fault("stuck", values={"jump": 0.1}), InputError, "found"),
        (Fault("jump", values={"jump": 0.2}), InputError, "from 0 to 0.1"),
        (Fault("jump", values={"jump": np.nan}), InputError, "from 0 to 0.1"),
    ],
)
def test_faults_that_cannot_be_are_refused(fault: Fault, error: type, words: str) -> None:
    faults = book()
    with pytest.raises(error, match=words):
        faults.add(fault)
    assert faults.pending == []


def test_the_strongest_reason_is_the_state() -> None:
    device = Device("arm")
    assert device.record.mode is Mode.READY and device.refusal == ""
    device.busy = True
    assert device.record.mode is Mode.BUSY
    device.enabled = False
    assert device.record.mode is Mode.DISABLED and "switched off" in device.refusal
    device.stop("by hand")
    assert device.record.mode is Mode.STOPPED
    device.fail("protective_stop", "it hit something")
    assert device.record.mode is Mode.FAULT
    assert device.refusal.startswith("protective_stop: it hit")
    device.fail("emergency_stop", "pressed", emergency=True)
    assert device.record.mode is Mode.EMERGENCY_STOP


def test_a_reset_waits_for_the_cause() -> None:
    device = Device("arm")
    device.fail("protective_stop", "it hit something")
    with pytest.raises(DeviceRefusedError, match="protective_stop lasts"):
        device.reset()
    device.cause_gone("another")
    with pytest.raises(DeviceRefusedError):
        device.require_reset_done()
    device.cause_gone("protective_stop")
    assert device.record.mode is Mode.FAULT, "somebody has to reset it"
    device.reset()
    assert device.record.mode is Mode.READY
    device.require_reset_done()


def test_an_emergency_stop_that_is_released_is_a_stop() -> None:
    device = Device("base")
    device.fail("emergency_stop", "pressed", emergency=True)
    device.cause_gone("emergency_stop")
    assert device.record.mode is Mode.STOPPED and device.record.fault == ""
    device.reset()
    assert device.refusal == ""
