"""The synchronous twin: every verb of the async drive, and what differs because there is a second thread."""

from __future__ import annotations

import inspect
import threading
import time

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
    "transact",
    "start_polling",
    "trace",
    "now",
    "stop_epoch",
    "presence",
    "settings",
}
LOOP_ONLY |= {"open", "is_open", "is_closed", "data_received", "port_lost", "overdue_s"}
"""Of Bus: its wiring. ``blocking.Bus.bus`` is the bus itself; ``health`` tells presence."""


def verbs(kind: type) -> set[str]:
    return {name for name in dir(kind) if not name.startswith("_")}


@pytest.mark.parametrize(
    ("mirrored", "twin"), [(drivebus.Drive, blocking.Drive), (Monitor, blocking.Monitor)], ids=["drive", "monitor"]
)
def test_the_twin_has_every_verb_with_the_same_arguments(mirrored: type, twin: type) -> None:
    assert verbs(mirrored) <= verbs(twin)
    for name in verbs(mirrored):
        theirs, ours = getattr(mirrored, name), getattr(twin, name)
        if callable(theirs):
            assert list(inspect.signature(ours).parameters) == list(inspect.signature(theirs).parameters), name


def test_the_twin_of_the_bus_has_every_verb_but_the_wiring() -> None:
    assert verbs(drivebus.Bus) - LOOP_ONLY <= verbs(blocking.Bus)


def test_a_monitor_polls_in_the_background_until_it_is_closed() -> None:
    received = threading.Event()
    with blocking.open_bus("sim://vc660@1?baud=38400") as bus:
        drive = blocking.Drive(bus, "vc660", 1)
        with drive.monitor(["output_frequency"], on_change=lambda _: received.set()) as monitor:
            assert received.wait(10.0)
            deadline = time.monotonic() + 10.0
            while str(monitor.status().state) != "stopped" and time.monotonic() < deadline:
                time.sleep(0.02)
            assert str(monitor.status().state) == "stopped"
            assert monitor.last_error is None
        sent = bus.statistics().transactions
        time.sleep(0.6)  # longer than the period: nothing more is asked
        assert bus.statistics().transactions <= sent + 1


def test_after_a_bus_stop_the_bus_is_latched_until_somebody_releases_it() -> None:
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


def test_the_person_who_watched_is_asked_on_the_callers_thread() -> None:
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


def test_a_proof_that_is_refused_asks_nobody() -> None:
    with blocking.open_bus("sim://vc660@1?baud=38400") as bus, pytest.raises(drivebus.DrivebusError):
        blocking.Drive(bus, "vc660", 1).calibrate("direction", lambda: pytest.fail("asked"))


def test_nobody_who_walks_away_from_a_proof_settles_it() -> None:
    def away() -> Direction:
        raise KeyboardInterrupt

    with blocking.open_bus("sim://df800@1") as bus:
        drive = blocking.Drive(bus, "df800", 1)
        with pytest.raises(KeyboardInterrupt):
            drive.calibrate("direction", away)
        with pytest.raises(StartInhibited):
            drive.run(10.0, "reverse")


def test_a_coding_that_the_drive_does_not_show_is_not_settled() -> None:
    """The keypad of this drive stands at 0 Hz, whoever says 12.3."""
    with blocking.open_bus("sim://dzb100@1?baud=9600") as bus:
        drive = blocking.Drive(bus, "dzb100", 1)
        with pytest.raises(TargetNotReached):
            drive.calibrate("query_coding", keypad_hz=12.3)
        with pytest.raises(StartInhibited):
            drive.calibrate("setpoint_coding")
