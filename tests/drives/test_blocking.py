"""Blocking API: every method of the asynchronous drive, and the differences that the second thread makes."""

from __future__ import annotations

import inspect
import threading
import time
from collections.abc import Callable
from typing import Any

import pytest

import drivebus
from drivebus import blocking
from drivebus.drives import Monitor
from drivebus.drives.outcome import OutcomeStatus
from drivebus.drives.state import Direction
from drivebus.errors import StartInhibited, TargetNotReached

LOOP_ONLY = {
    "add_station",
    "remove_station",
    "submit",
    "is_queued",
    "transact",
    "start_polling",
    "trace",
    "now",
    "motions_sent",
    "stop_epoch",
    "withdraw_commands",
    "presence",
    "settings",
}
LOOP_ONLY |= {"open", "is_open", "is_closed", "data_received", "port_lost", "port_opened_at", "overdue_s"}
"""Internal attributes of Bus. ``blocking.Bus.bus`` is the bus itself; ``health`` reports presence."""


def verbs(kind: type) -> set[str]:
    return {name for name in dir(kind) if not name.startswith("_")}


def arguments(method: Callable[..., Any]) -> list[tuple[str, Any, Any]]:
    """Return the arguments of a method or function, how each may be passed, and its default: of functions any."""
    parameters = inspect.signature(method).parameters.values()
    return [(each.name, each.kind, inspect.isfunction(each.default) or each.default) for each in parameters]


@pytest.mark.parametrize(
    ("mirrored", "twin"), [(drivebus.Drive, blocking.Drive), (Monitor, blocking.Monitor)], ids=["drive", "monitor"]
)
def test_the_blocking_class_has_every_method_with_the_same_arguments(mirrored: type, twin: type) -> None:
    assert verbs(mirrored) <= verbs(twin)
    for name in verbs(mirrored):
        theirs, ours = getattr(mirrored, name), getattr(twin, name)
        if callable(theirs):
            assert arguments(ours) == arguments(theirs), name


@pytest.mark.parametrize("name", ["Drive", "open_bus", "stop_bus", "stop_all_addresses"])
def test_a_blocking_drive_or_function_is_called_with_the_same_arguments(name: str) -> None:
    """``stop_bus(bus, drives=...)`` failed there, and a sweep had no ``on_progress``."""
    assert arguments(getattr(blocking, name)) == arguments(getattr(drivebus, name))


def test_the_progress_of_a_blocking_sweep_names_the_drives_of_the_caller() -> None:
    reported: list[tuple[blocking.Drive, float]] = []
    with blocking.open_bus("sim://vc660@2?baud=38400") as bus:
        drives = [blocking.Drive(bus, "vc660", address) for address in (1, 2)]
        report = blocking.stop_all_addresses(bus, drives, lambda drive, share: reported.append((drive, share)))
    assert reported == [(drives[0], 0.5), (drives[1], 1.0), (drives[0], 1.0)]
    assert (report.absent, report.confirmed) == ((1,), 1)


def test_the_blocking_bus_has_every_method_but_the_internal_ones() -> None:
    assert verbs(drivebus.Bus) - LOOP_ONLY <= verbs(blocking.Bus)


def test_a_monitor_polls_in_the_background_until_it_is_closed() -> None:
    received = threading.Event()
    with blocking.open_bus("sim://vc660@1?baud=38400") as bus:
        drive = blocking.Drive(bus, "vc660", 1)
        with drive.monitor(["output_frequency"], on_change=lambda _: received.set()) as monitor:
            assert received.wait(10.0)
            monitor.poll_state()
            deadline = time.monotonic() + 10.0
            while str(monitor.status().state) != "stopped" and time.monotonic() < deadline:
                time.sleep(0.02)
            assert str(monitor.status().state) == "stopped"
            assert monitor.last_error is None
        sent = bus.statistics().transactions
        time.sleep(0.6)  # longer than the period: nothing more is asked
        assert bus.statistics().transactions <= sent + 1


def test_starts_stay_inhibited_after_a_bus_stop_until_they_are_released() -> None:
    with blocking.open_bus("sim://vc660@1?baud=38400&ramp=1") as bus:
        drive = blocking.Drive(bus, "vc660", 1)
        drive.run(5.0)
        assert blocking.stop_bus(bus, [drive]).confirmed
        assert bus.start_inhibited(1) and not drive.stop_pending
        with pytest.raises(StartInhibited):
            drive.run(5.0)
        bus.release_start()
        assert drive.run(5.0).status is OutcomeStatus.CONFIRMED
        drive.stop()
        assert bus.health(1).presence == "online"
        drive.close()
        with pytest.raises(KeyError):
            bus.health(1)


def test_the_observation_is_requested_on_the_callers_thread() -> None:
    asked_on: list[threading.Thread] = []

    def watched() -> Direction:
        asked_on.append(threading.current_thread())
        return Direction.FORWARD

    with blocking.open_bus("sim://df800@1") as bus:
        drive = blocking.Drive(bus, "df800", 1)
        outcome = drive.calibrate("direction", watched).outcome
        assert outcome is not None and outcome.status is OutcomeStatus.ACKNOWLEDGED
        assert asked_on == [threading.main_thread()]
        assert drive.run(10.0, "reverse").status is OutcomeStatus.ACKNOWLEDGED
        drive.stop()


def test_a_refused_calibration_requests_no_observation() -> None:
    with blocking.open_bus("sim://vc660@1?baud=38400") as bus, pytest.raises(drivebus.DrivebusError):
        blocking.Drive(bus, "vc660", 1).calibrate("direction", lambda: pytest.fail("asked"))


def test_a_calibration_whose_observation_is_interrupted_determines_nothing() -> None:
    def away() -> Direction:
        raise KeyboardInterrupt

    with blocking.open_bus("sim://df800@1") as bus:
        drive = blocking.Drive(bus, "df800", 1)
        with pytest.raises(KeyboardInterrupt):
            drive.calibrate("direction", away)
        with pytest.raises(StartInhibited):
            drive.run(10.0, "reverse")


def test_a_coding_that_the_drive_does_not_show_stays_undetermined() -> None:
    """The keypad of this drive shows 0 Hz, not 12.3."""
    with blocking.open_bus("sim://dzb100@1?baud=9600") as bus:
        drive = blocking.Drive(bus, "dzb100", 1)
        with pytest.raises(TargetNotReached) as differs:
            drive.calibrate("query_coding", keypad_hz=12.3)
        assert (differs.value.key, differs.value.params["word"]) == ("drives.coding_no_match", "0000H")
        with pytest.raises(StartInhibited):
            drive.calibrate("setpoint_coding")
