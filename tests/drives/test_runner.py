"""Runner of operations: slow buses, repeated stops, a blocked event loop, the blocking API, the public names."""

from __future__ import annotations

import asyncio
import subprocess
import sys
import threading
import time
from collections.abc import Callable

import pytest

import drivebus
from drivebus import blocking
from drivebus.bus.trace import TraceEvent, TraceKind
from drivebus.drives.operations.calibration import calibration_steps
from drivebus.drives.outcome import Outcome, OutcomeStatus, raise_for_status
from drivebus.errors import (
    DrivebusError,
    DriveRejected,
    NoReply,
    OutcomeUnknown,
    PortUnavailable,
    StartInhibited,
    StopUnconfirmed,
    TargetNotReached,
)
from drivebus.protocols.codec import Effect
from fixtures.drives import SAFE_HZ, ScriptedJog, SimulatedDrives, dialect_for, run_virtual


@pytest.mark.parametrize(
    ("model", "baud"), [("c320", 1200), ("c320", 19200), ("dzb100", 1200), ("vc660", 300), ("vc660", 38400)]
)
def test_a_drive_runs_and_stops_at_the_slowest_and_the_fastest_baud_rate(model: str, baud: int) -> None:
    async def scenario() -> None:
        async with SimulatedDrives(model, query=f"baud={baud}") as bench:
            drive = bench.drive()
            assert (await drive.run(SAFE_HZ[model])).status is OutcomeStatus.CONFIRMED
            assert (await drive.stop()).status is OutcomeStatus.CONFIRMED

    run_virtual(scenario())


@pytest.mark.parametrize(("model", "encoding"), [("c320", "hex"), ("df800", "ascii")])
def test_a_drive_runs_in_its_other_encoding(model: str, encoding: str) -> None:
    async def scenario() -> None:
        query = f"encoding={encoding}" if model == "df800" else ""
        async with SimulatedDrives(model, query=query, encoding=encoding) as bench:
            await bench.drive().run(SAFE_HZ[model])
            await asyncio.sleep(1)
            assert bench.station().running

    run_virtual(scenario())


@pytest.mark.parametrize(
    ("word", "error"),
    [
        (OutcomeStatus.REFUSED, DriveRejected),
        (OutcomeStatus.FAILED, TargetNotReached),
        (OutcomeStatus.UNKNOWN, OutcomeUnknown),
    ],
)
def test_what_was_not_done_is_raised_with_its_outcome(word: OutcomeStatus, error: type[DrivebusError]) -> None:
    outcome = Outcome(status=word, key="drives.start_unknown")
    with pytest.raises(error) as caught:
        raise_for_status(outcome)
    assert caught.value.outcome is outcome


@pytest.mark.parametrize("word", [OutcomeStatus.CONFIRMED, OutcomeStatus.ACKNOWLEDGED])
def test_what_was_done_is_returned(word: OutcomeStatus) -> None:
    assert raise_for_status(Outcome(status=word, key="drives.stop_confirmed"), stop=True).status is word


def test_a_stop_that_is_not_done_is_always_an_unconfirmed_stop() -> None:
    with pytest.raises(StopUnconfirmed) as caught:
        raise_for_status(
            Outcome(
                status=OutcomeStatus.UNKNOWN, key="drives.stop_unconfirmed", params={"found": "running", "reads": 8}
            ),
            stop=True,
        )
    assert str(caught.value) == (
        "STOP NOT CONFIRMED: the stop was sent repeatedly, and the drive still reported running (reads: 8). "
        "Use the hard-wired stop"
    )


def test_a_start_that_is_refused_does_not_end_the_repetition_of_an_old_stop() -> None:
    async def scenario() -> None:
        async with SimulatedDrives("c320") as bench:
            drive = bench.drive()
            await drive.run(20.0)
            bench.station().faults.silent = True
            with pytest.raises(StopUnconfirmed):
                await drive.stop()
            with pytest.raises(NoReply):
                await drive.run(20.0)
            assert drive.stop_pending
            bench.station().faults.silent = False
            await asyncio.sleep(30)
            assert not bench.station().running

    run_virtual(scenario())


def test_a_run_that_did_not_run_the_drive_does_not_end_the_repetition_of_an_old_stop() -> None:
    """The new frequency came while the drive slowed down; then the stop was no longer repeated."""

    async def scenario() -> None:
        async with SimulatedDrives("c320", query="ramp=40") as bench:
            drive = bench.drive()
            await drive.run(20.0)
            await asyncio.sleep(30)
            assert (await drive.stop(wait=False)).key == "drives.stop_answered"
            with pytest.raises(TargetNotReached) as caught:
                await drive.run(20.0)
            assert caught.value.key == "drives.run_while_decelerating"
            assert drive.stop_pending

    run_virtual(scenario())


def test_an_answered_stop_without_a_waiting_caller_is_confirmed_in_the_background() -> None:
    async def scenario() -> None:
        async with SimulatedDrives("c320") as bench:
            drive = bench.drive()
            await drive.run(20.0, wait=True)
            outcome = await drive.stop(wait=False)
            assert (outcome.status, outcome.key) == (OutcomeStatus.UNKNOWN, "drives.stop_answered")
            assert drive.stop_pending
            await asyncio.sleep(20)
            assert not drive.stop_pending
            assert not bench.station().running

    run_virtual(scenario())


@pytest.mark.parametrize(("may_turn", "ends"), [(False, 0), (True, 1)])
def test_a_jog_that_is_given_up_is_ended_only_where_something_of_it_may_have_left(may_turn: bool, ends: int) -> None:
    """The end of a jog that never began would stop another command."""

    class HangingJog(ScriptedJog):
        async def _begin(self) -> Outcome:
            await asyncio.Event().wait()
            raise AssertionError("it began")

        def _may_be_running(self) -> bool:
            return may_turn

    session = HangingJog(0.5)

    async def scenario() -> None:
        async def jog() -> None:
            async with session:
                raise AssertionError("it began")

        task = asyncio.ensure_future(jog())
        await asyncio.sleep(0)
        task.cancel()
        await asyncio.wait([task])
        assert task.cancelled()

    asyncio.run(scenario())
    assert session.stops_sent == ends


def test_a_lease_that_ran_out_while_the_loop_was_held_up_can_not_be_renewed() -> None:
    """After a suspension of the host the renewal comes before the timer has run."""

    async def scenario() -> bool:
        async with ScriptedJog(0.02) as lease:
            time.sleep(0.05)  # noqa: ASYNC251 - exactly what must not keep a motor running
            with pytest.raises(StartInhibited):
                lease.renew()
            return lease.expired

    assert asyncio.run(scenario())


def test_an_interrupted_block_ends_its_jog() -> None:
    async def scenario() -> None:
        async with SimulatedDrives("c320") as bench:
            drive = bench.drive()
            with pytest.raises(ZeroDivisionError):
                async with drive.jog(5.0):
                    raise ZeroDivisionError
            assert not bench.station().running

    run_virtual(scenario())


# --- the synchronous twin -----------------------------------------------------------------------------------------


def test_the_blocking_api_runs_reads_writes_and_stops() -> None:
    with blocking.open_bus("sim://vc660@1?baud=38400&ramp=1") as bus:
        drive = blocking.Drive(bus, "vc660", 1)
        assert drive.run(5.0, wait=True).key == "drives.running_at"
        assert drive.status().readings["output_frequency"].value == pytest.approx(5.0, abs=0.1)
        assert drive.write({"F00.02": 20.0}).succeeded
        assert drive.read(["F00.02"])["F00.02"].value == 20.0
        assert drive.stop().status == "confirmed"
        with drive.jog() as lease:
            lease.renew()
        assert not lease.expired
        assert blocking.stop_bus(bus, [drive]).confirmed
        with pytest.raises(StartInhibited) as caught:
            drive.run(5.0)
        assert caught.value.key == "drives.start_inhibited"
        assert bus.statistics().transactions > 10


def test_a_bus_that_can_not_be_opened_leaves_no_thread() -> None:
    before = threading.active_count()
    with pytest.raises(PortUnavailable):
        blocking.open_bus("/dev/there-is-no-such-port")
    assert threading.active_count() == before


def test_closing_twice_is_harmless() -> None:
    before = threading.active_count()
    bus = blocking.open_bus("sim://vc660@1")
    assert threading.active_count() > before
    bus.close()
    bus.close()
    assert threading.active_count() == before


# --- the public names ---------------------------------------------------------------------------------------------


def test_every_public_name_is_there() -> None:
    missing: Callable[[str], bool] = lambda name: not hasattr(drivebus, name)  # noqa: E731
    assert not [name for name in drivebus.__all__ if missing(name)]
    assert set(dir(drivebus)) == set(drivebus.__all__)


def test_importing_drivebus_loads_no_subpackage() -> None:
    code = "import sys, drivebus; print([m for m in sys.modules if m.startswith('drivebus.')])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError):
        drivebus.nonsense  # noqa: B018


@pytest.mark.parametrize("delay_s", [0.0, 0.02, 0.05])
def test_a_stop_supersedes_the_writes_to_input_terminals_that_were_not_sent_yet(delay_s: float) -> None:
    """An input terminal may be wired to "run": its write after a newer stop would start the motor."""

    async def scenario() -> None:
        async with SimulatedDrives("vc660") as bench:
            drive = bench.drive()
            effects = []

            def record(event: TraceEvent) -> None:
                if event.kind is TraceKind.SENT:
                    effects.append(drive.dialect.station_config.effect_of(event.data))

            bench.bus.trace(record)
            write = asyncio.create_task(drive.write({"2006H": 1, "2002H": 1}, force=True))
            await asyncio.sleep(delay_s)
            assert (await drive.stop()).status is OutcomeStatus.CONFIRMED
            with pytest.raises(DrivebusError):
                await write
            assert Effect.STOP in effects
            assert Effect.MOTION not in effects[effects.index(Effect.STOP) :]

    run_virtual(scenario())


def test_a_calibration_is_repeated_at_the_word_that_is_slow_under_every_step() -> None:
    """A stated step may be wrong: on an E300 that is declared as 0.01 Hz, word 500 would be 50 Hz."""
    dialect = dialect_for("c320", setpoint_step="0.01")
    (step,) = calibration_steps(dialect)
    assert [request.data for request in dict(step.plan(dialect))["start"]] == [50]
