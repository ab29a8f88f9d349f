"""Every operation on every simulated drive, in virtual time, and what the drive itself then does."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import replace
from typing import Any

import pytest

from drivebus import profiles
from drivebus.bus.messages import BusRequest
from drivebus.drives import Drive, DriveLimits, DriveState, MemoryStore, stop_bus
from drivebus.drives.operations.command_age import CommandAge
from drivebus.drives.outcome import Outcome
from drivebus.drives.state import Direction, DriveStatus
from drivebus.errors import (
    CapabilityError,
    DrivebusError,
    DriveError,
    LimitError,
    NoReply,
    OutcomeUnknown,
    PreflightError,
    StartInhibited,
    StopUnconfirmed,
    Superseded,
    TargetNotReached,
)
from drivebus.protocols import dzb100
from drivebus.simulator.motor import Trip
from drivebus.simulator.port import simulated_bus_of
from drivebus.values import Quality
from fixtures.drives import MODELS, SAFE_HZ, SimulatedDrives, run_virtual

TELLING = ("c320", "vc660", "dzb100")
LINES = ("clean", "bytes", "batches", "late", "lossy")


@pytest.mark.parametrize("model", MODELS)
def test_a_drive_runs_and_stops(model: str) -> None:
    async def scenario() -> None:
        async with SimulatedDrives(model) as bench:
            drive, station = bench.drive(), bench.station()
            started = await drive.run(SAFE_HZ[model])
            assert started.status == ("acknowledged" if model == "df800" else "confirmed")
            await asyncio.sleep(20)
            assert bench.station().motor.output_hz == pytest.approx(SAFE_HZ[model])
            stopped = await drive.stop()
            assert stopped.status == ("acknowledged" if model == "df800" else "confirmed")
            await asyncio.sleep(20 if model == "df800" else 0)
            assert bench.station().motor.output_hz == 0.0
            assert station.gap_violations == 0 or model == "dzb100"  # its manual gives no gap: sim and profile differ

    run_virtual(scenario())


async def again(command: Callable[[], Awaitable[Outcome]], times: int) -> Outcome:
    """Repeat a command: on a bad bus it may be refused, but its outcome must never be wrong."""
    for left in reversed(range(times)):
        try:
            return await command()
        except DrivebusError:
            if not left:
                raise
    raise AssertionError("no try left")


@pytest.mark.parametrize("weather", LINES)
@pytest.mark.parametrize("model", MODELS)
def test_a_drive_runs_and_stops_on_every_line(model: str, weather: str) -> None:
    async def scenario() -> None:
        async with SimulatedDrives(model, query=f"line_quality={weather}&seed=7") as bench:
            drive, clean = bench.drive(), weather not in ("late", "lossy")
            ran = await again(lambda: drive.run(SAFE_HZ[model]), 1 if clean else 8)
            assert ran.succeeded and bench.station().running
            await again(drive.stop, 1 if clean else 8)
            await asyncio.sleep(20 if model == "df800" else 0)
            assert not bench.station().running

    run_virtual(scenario())


@pytest.mark.parametrize("model", ["c320", "vc660"])
def test_reverse_is_what_the_motor_does(model: str) -> None:
    async def scenario() -> None:
        async with SimulatedDrives(model) as bench:
            drive = bench.drive()
            await drive.run(10.0, Direction.REVERSE, wait=True)
            assert bench.station().motor.output_hz == pytest.approx(-10.0, abs=0.06)
            assert (await drive.status()).direction is Direction.REVERSE
            with pytest.raises(StartInhibited):
                await drive.run(10.0, Direction.FORWARD)

    run_virtual(scenario())


@pytest.mark.parametrize("model", ["c320", "vc660"])
def test_waiting_ends_when_the_drive_reports_the_frequency(model: str) -> None:
    async def scenario() -> None:
        async with SimulatedDrives(model) as bench:
            drive = bench.drive()
            outcome = await drive.run(25.0, wait=True)
            assert outcome.key == "drives.running_at"
            assert bench.station().motor.output_hz == pytest.approx(25.0, abs=0.15)

    run_virtual(scenario())


def test_waiting_for_a_frequency_that_is_not_reached_says_what_was_reported() -> None:
    async def scenario() -> None:
        async with SimulatedDrives("c320") as bench:
            drive = bench.drive()
            with pytest.raises(TargetNotReached) as caught:
                await drive.run(40.0, wait=True, timeout_s=1.0)
            assert 0.0 < caught.value.params["found_hz"] < 40.0
            assert caught.value.params["state"] == "accelerating"
            assert caught.value.outcome.status == "failed"

    run_virtual(scenario())


def test_a_trip_while_waiting_ends_the_waiting() -> None:
    async def scenario() -> None:
        async with SimulatedDrives("vc660") as bench:
            drive = bench.drive()

            async def trips() -> None:
                await asyncio.sleep(2.5)
                bench.station().trip(Trip.OVERVOLTAGE)

            task = asyncio.ensure_future(trips())
            with pytest.raises(TargetNotReached) as caught:
                await drive.run(40.0, wait=True)
            await task
            assert caught.value.params["state"] == "fault"
            assert 1.0 < caught.value.params["waited_s"] < 4.0 < caught.value.params["limit_s"]
            text = str(caught.value)
            assert f"after {caught.value.params['waited_s']} s of waiting the drive reports" in text
            assert "within" not in text, "it was known long before the end of the waiting time"

    run_virtual(scenario())


@pytest.mark.parametrize("model", MODELS)
def test_status_names_everything_and_gives_reasons_for_what_is_missing(model: str) -> None:
    async def scenario() -> None:
        async with SimulatedDrives(model) as bench:
            drive = bench.drive()
            status = await drive.status()
            assert status.state is (DriveState.UNKNOWN if model == "df800" else DriveState.STOPPED)
            assert {"set_frequency", "output_frequency", "output_current", "dc_bus_voltage"} <= set(status.readings)
            for reading in status.readings.values():
                assert reading.value is not None or reading.reason
                assert reading.quality is Quality.GOOD or reading.reason
            assert (status.reason == "drives.no_run_status") is (model == "df800")

    run_virtual(scenario())


@pytest.mark.parametrize("model", ["c320", "vc660", "dzb100"])
def test_a_fault_is_named_and_reset(model: str) -> None:
    async def scenario() -> None:
        async with SimulatedDrives(model) as bench:
            drive = bench.drive()
            bench.station().trip(Trip.OVERVOLTAGE)
            status = await drive.status()
            assert status.state is DriveState.FAULT
            assert status.fault is not None and status.fault.code == bench.station().trip_code(Trip.OVERVOLTAGE)
            with pytest.raises(StartInhibited):
                await drive.run(SAFE_HZ[model])
            assert (await drive.reset_fault()).key == "drives.reset_confirmed"
            assert (await drive.status()).fault is None
            assert (await drive.reset_fault()).key == "drives.no_fault"

    run_virtual(scenario())


@pytest.mark.parametrize("model", ["c320", "vc660"])
def test_a_set_frequency_changes_the_run(model: str) -> None:
    async def scenario() -> None:
        async with SimulatedDrives(model) as bench:
            drive = bench.drive()
            await drive.run(20.0, wait=True)
            outcome = await drive.set_frequency(10.0)
            assert outcome.status == ("confirmed" if model == "vc660" else "acknowledged")
            await asyncio.sleep(10)
            assert bench.station().motor.output_hz == pytest.approx(10.0, abs=0.05)

    run_virtual(scenario())


@pytest.mark.parametrize("shown", [True, False])
def test_a_confirmed_start_has_a_note_where_its_frequency_was_not_read_back(shown: bool) -> None:
    async def scenario() -> None:
        async with SimulatedDrives("dzb100") as bench:
            station, answer = bench.station(), bench.station().handle_request

            def handle_request(message: Any, codec: Any) -> Any:
                is_hidden = isinstance(message, dzb100.Dzb100Query) and message.item == 0 and not shown
                return None if is_hidden and station.running else answer(message, codec)

            station.handle_request = handle_request
            outcome = await bench.drive().run(SAFE_HZ["dzb100"])
            assert outcome.status == "confirmed" and station.running
            assert ("drives.setpoint_not_shown" in dict(outcome.notes)) is not shown

    run_virtual(scenario())


def test_dzb100_takes_a_frequency_only_while_it_runs() -> None:
    async def scenario() -> None:
        async with SimulatedDrives("dzb100") as bench:
            drive = bench.drive()
            with pytest.raises(StartInhibited) as caught:
                await drive.set_frequency(0.3)
            assert caught.value.key == "drives.frequency_with_run"
            await drive.run(0.5)
            await drive.set_frequency(0.3)
            assert (await drive.status()).readings["set_frequency"].value == 0.3

    run_virtual(scenario())


@pytest.mark.parametrize(
    ("model", "keys"), [("c320", {(0, 1): 0}), ("vc660", {1: 0}), ("dzb100", {1: 1}), ("df800", {102: 0})]
)
def test_a_drive_that_does_not_accept_bus_commands_is_named(model: str, keys: dict[Any, int]) -> None:
    async def scenario() -> None:
        async with SimulatedDrives(model) as bench:
            for key, value in keys.items():
                bench.station().keypad_set(key[0] << 8 | key[1] if isinstance(key, tuple) else key, value)
            with pytest.raises(PreflightError) as caught:
                await bench.drive().run(SAFE_HZ[model])
            assert caught.value.params["parameters"]
            assert not bench.station().running

    run_virtual(scenario())


@pytest.mark.parametrize("model", MODELS)
def test_a_silent_drive_is_not_started_and_its_stop_is_reported_unconfirmed(model: str) -> None:
    async def scenario() -> None:
        async with SimulatedDrives(model) as bench:
            drive = bench.drive()
            await drive.status()
            bench.station().faults.silent = True
            with pytest.raises(PreflightError if model == "df800" else NoReply) as silent:
                await drive.run(SAFE_HZ[model])
            assert silent.value.outcome is None and bench.station().motor.starts == 0
            with pytest.raises(StopUnconfirmed) as caught:
                await drive.stop()
            assert caught.value.outcome.status == "unknown"
            assert drive.stop_pending

    run_virtual(scenario())


@pytest.mark.parametrize("model", TELLING)
def test_an_unconfirmed_stop_is_repeated_until_the_drive_comes_back(model: str) -> None:
    """The stop is resent without end."""

    async def scenario() -> None:
        async with SimulatedDrives(model) as bench:
            drive = bench.drive()
            await drive.run(SAFE_HZ[model])
            bench.station().faults.silent = True
            with pytest.raises(StopUnconfirmed):
                await drive.stop()
            await asyncio.sleep(30)
            assert bench.station().running
            bench.station().faults.silent = False
            await asyncio.sleep(30)
            assert not bench.station().running
            assert not drive.stop_pending

    run_virtual(scenario())


@pytest.mark.parametrize("model", TELLING)
def test_a_drive_that_obeys_and_can_not_answer_is_not_started_twice(model: str) -> None:
    """The reply is lost, the motor runs; the outcome is never "failed" and no second start leaves."""

    async def scenario() -> None:
        async with SimulatedDrives(model) as bench:
            drive = bench.drive()
            await drive.status()
            message = watch(bench)
            task = asyncio.ensure_future(drive.run(SAFE_HZ[model]))
            await until(lambda: bench.station().running or task.done())
            bench.station().faults.mute = True
            with pytest.raises((OutcomeUnknown, DriveError)) as caught:
                await task
            assert caught.value.outcome.status == "unknown"
            assert len(message) == 1

    run_virtual(scenario())


async def until(true: Callable[[], bool], every_s: float = 0.002) -> None:
    """Wait in virtual time until a condition holds."""
    for _ in range(100_000):
        if true():
            return
        await asyncio.sleep(every_s)
    raise AssertionError("never came true")


def watch(bench: SimulatedDrives) -> list[float]:
    """Return a list that records every frequency commanded to the motor from now on."""
    motor = bench.station().motor
    message: list[float] = []

    class Watched(type(motor)):  # type: ignore[misc]
        __slots__ = ()

        def run(self, target_hz: float) -> None:
            message.append(target_hz)
            super().run(target_hz)

    motor.__class__ = Watched
    return message


@pytest.mark.parametrize("seed", range(1, 7))
@pytest.mark.parametrize("model", TELLING)
def test_on_a_lossy_line_no_command_acts_twice_and_no_stop_is_lost(model: str, seed: int) -> None:
    """10 % of all frames are lost each way."""

    async def scenario() -> None:
        async with SimulatedDrives(model, query=f"line_quality=loss=0.1&seed={seed}") as bench:
            drive = bench.drive()
            for _ in range(4):
                message = watch(bench)
                try:
                    await drive.run(SAFE_HZ[model])
                except DrivebusError:
                    pass
                else:
                    assert bench.station().running
                assert len([hz for hz in message if hz]) <= 1
                try:
                    await drive.stop()
                except StopUnconfirmed:
                    await until(lambda: not drive.stop_pending, 1.0)
                assert not bench.station().running

    run_virtual(scenario())


@pytest.mark.parametrize("model", TELLING)
def test_a_stop_supersedes_a_start_that_waits_for_confirmation(model: str) -> None:
    async def scenario() -> None:
        async with SimulatedDrives(model) as bench:
            drive = bench.drive()
            await drive.status()
            bench.station().faults.added_delay_s = 0.0
            task = asyncio.ensure_future(drive.run(SAFE_HZ[model]))
            await until(lambda: bench.station().running or task.done())
            outcome = await drive.stop()
            assert outcome.status == "confirmed"
            with pytest.raises(Superseded):
                await task
            await asyncio.sleep(5)
            assert not bench.station().running

    run_virtual(scenario())


def test_a_cancelled_run_sends_nothing_more() -> None:
    async def scenario() -> None:
        async with SimulatedDrives("c320") as bench:
            drive = bench.drive()
            task = asyncio.ensure_future(drive.run(20.0))
            await asyncio.sleep(0.05)
            task.cancel()
            await asyncio.sleep(1)
            frames = bench.station().frame_count
            await asyncio.sleep(5)
            assert bench.station().frame_count == frames
            assert not bench.station().running

    run_virtual(scenario())


# --- jog ----------------------------------------------------------------------------------------------------------

JOG_HZ = {"c320": 5.0, "vc660": None, "dzb100": 0.5}


@pytest.mark.parametrize("model", TELLING)
def test_a_jog_lasts_as_long_as_its_lease_is_renewed(model: str) -> None:
    async def scenario() -> None:
        async with SimulatedDrives(model) as bench:
            drive = bench.drive()
            async with drive.jog(JOG_HZ[model]) as lease:
                for _ in range(10):
                    await asyncio.sleep(0.2)
                    lease.renew()
                assert bench.station().running
            assert not bench.station().running
            assert lease.stop_outcome is not None and lease.stop_outcome.status == "confirmed"
            assert not lease.expired

    run_virtual(scenario())


@pytest.mark.parametrize("model", TELLING)
def test_a_jog_whose_lease_is_lost_is_stopped_within_it(model: str) -> None:
    async def scenario() -> None:
        async with SimulatedDrives(model) as bench:
            drive = bench.drive()
            async with drive.jog(JOG_HZ[model], lease_s=0.3) as lease:
                await asyncio.sleep(0.25)
                assert bench.station().running
                await asyncio.sleep(0.25)
                assert lease.expired
                assert bench.station().motor.stopping or not bench.station().running
                with pytest.raises(StartInhibited):
                    lease.renew()
                await asyncio.sleep(3)
            assert not bench.station().running

    run_virtual(scenario())


@pytest.mark.parametrize("expires", [False, True])
@pytest.mark.parametrize("model", TELLING)
def test_a_drive_is_stopping_from_the_end_of_its_jog_until_the_stop_is_confirmed(model: str, expires: bool) -> None:
    """The stop stays registered until then, so that a tripped interlock sends no second one."""

    async def scenario() -> None:
        async with SimulatedDrives(model) as bench:
            drive = bench.drive()
            jog = drive.jog(JOG_HZ[model], lease_s=0.3)
            await jog.start()
            await asyncio.sleep(0.2)
            assert not drive.stopping
            await asyncio.sleep(0.11 if expires else 0.0)
            ending = asyncio.create_task(jog.stop())
            await asyncio.sleep(0.02)
            assert jog.expired is expires
            assert drive.stopping and not drive.stop_pending
            assert (await ending).status == "confirmed"
            assert not drive.stopping

    run_virtual(scenario())


def test_a_lease_longer_than_half_a_second_is_refused() -> None:
    async def scenario() -> None:
        async with SimulatedDrives("c320") as bench:
            with pytest.raises(LimitError):
                bench.drive().jog(5.0, lease_s=0.6)

    run_virtual(scenario())


def test_a_jog_frequency_that_the_bus_can_not_set_is_refused() -> None:
    async def scenario() -> None:
        async with SimulatedDrives("vc660") as bench:
            with pytest.raises(CapabilityError):
                async with bench.drive().jog(5.0):
                    pass

    run_virtual(scenario())


# --- parameters ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("model", "name", "value", "save"),
    [
        ("c320", "F0.2", 30.0, False),
        ("c320", "F0.2", 30.0, True),
        ("vc660", "F00.02", 30.0, False),
        ("vc660", "F00.02", 30.0, True),
        ("dzb100", "10", 15.0, True),
        ("df800", "F1.07", 20.0, True),
    ],
)
def test_parameters_are_written_where_they_were_meant_to_go(model: str, name: str, value: float, save: bool) -> None:
    async def scenario() -> None:
        async with SimulatedDrives(model) as bench:
            drive, memory = bench.drive(), bench.station().memory
            before = sum(memory.eeprom_writes.values())
            outcome = await drive.write({name: value}, save=save)
            assert outcome.key == "drives.write_confirmed"
            assert (await drive.read([name]))[name].value == value
            assert sum(memory.eeprom_writes.values()) - before == save
            again = await drive.write({name: value}, save=True)
            assert (again.key == "drives.write_skipped") is save

    run_virtual(scenario())


@pytest.mark.parametrize("model", ["c320", "vc660"])
def test_changing_the_set_frequency_never_wears_the_eeprom(model: str) -> None:
    async def scenario() -> None:
        async with SimulatedDrives(model) as bench:
            drive = bench.drive()
            await drive.run(20.0)
            for step in range(50):
                await drive.set_frequency(20.0 + step / 10)
            assert not bench.station().memory.eeprom_writes

    run_virtual(scenario())


# --- bus stop -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("model", MODELS)
def test_a_bus_stop_stops_every_drive_and_inhibits_starts(model: str) -> None:
    async def scenario() -> None:
        async with SimulatedDrives(model, "1-3") as bench:
            drives = [bench.drive(address) for address in (1, 2, 3)]
            for drive in drives:
                await drive.run(SAFE_HZ[model])
            report = await stop_bus(bench.bus, drives)
            if model == "df800":
                assert report.acknowledged == (1, 2, 3) and report.unconfirmed == ()
                assert not report.broadcasts
                await asyncio.sleep(30)
            else:
                assert report.confirmed
                assert len(report.broadcasts) >= 2
            assert not any(bench.station(address).running for address in (1, 2, 3))
            with pytest.raises(StartInhibited) as caught:
                await drives[0].run(SAFE_HZ[model])
            assert caught.value.key == "drives.start_inhibited" and not bench.station(1).running
            bench.bus.release_start()
            await drives[0].run(SAFE_HZ[model])
            assert bench.station(1).running

    run_virtual(scenario())


def test_a_bus_stop_names_the_drive_that_did_not_report() -> None:
    async def scenario() -> None:
        async with SimulatedDrives("c320", "1-3") as bench:
            drives = [bench.drive(address) for address in (1, 2, 3)]
            for drive in drives:
                await drive.run(20.0)
            bench.station(2).faults.silent = True
            report = await stop_bus(bench.bus, drives)
            assert report.unconfirmed == (2,)
            assert not bench.station(1).running and not bench.station(3).running
            assert all(exchange.sent for exchange in report.broadcasts)
            assert report.ended_at > report.started_at

    run_virtual(scenario())


def test_a_bus_stop_confirms_drives_whose_state_takes_four_reads_on_a_line_that_loses_a_reply_in_fifty() -> None:
    """The deadline had the time of two verified states of two or three reads: 2 of these 31 were reported."""

    async def scenario() -> None:
        async with SimulatedDrives("md500_plus", "1-31", query="line_quality=loss=0.02&seed=1") as bench:
            drives = [bench.drive(address) for address in range(1, 32)]
            for drive in drives:
                await drive.status()
            assert (await stop_bus(bench.bus, drives)).unconfirmed == ()

    run_virtual(scenario())


def test_the_time_of_so_many_transactions_is_that_of_a_full_bus_with_the_gap_before_each_frame() -> None:
    """Without the gaps it was a tenth short, and a stop on a line that loses replies was reported too soon."""

    async def scenario() -> None:
        async with SimulatedDrives("gs2") as bench:
            drive = bench.drive()
            await drive.status()
            age = CommandAge(requested_at=None, checks_started_at=None)
            request = BusRequest(station=1, request=drive.dialect.state_reads()[0])
            first, *others = await asyncio.gather(*(bench.bus.transact(request) for _ in range(11)))
            for result in (first, *others):
                age.add(result)
            took_s = others[-1].received_at - first.received_at
            assert 10 * age.fastest_transaction_s == pytest.approx(took_s, rel=0.01)

    run_virtual(scenario())


# --- monitor ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("model", TELLING)
def test_a_monitored_value_is_good_until_three_periods_and_then_never(model: str) -> None:
    async def scenario() -> None:
        async with SimulatedDrives(model) as bench:
            drive = bench.drive()
            with drive.monitor(["output_frequency"]) as monitor:
                await asyncio.sleep(5)
                assert monitor.status().state is DriveState.STOPPED
                bench.station().faults.silent = True
                await asyncio.sleep(2.2)
                status = monitor.status()
                assert status.readings["output_frequency"].quality is Quality.BAD
                assert status.readings["output_frequency"].reason == "drives.stale"
                assert (status.state, status.reason) == (DriveState.UNKNOWN, "drives.stale")
                bench.station().faults.silent = False
                await asyncio.sleep(60)
                assert monitor.status().state is DriveState.STOPPED

    run_virtual(scenario())


@pytest.mark.parametrize("model", TELLING)
def test_a_value_polled_ten_times_a_second_is_valid_for_one_second_and_a_timeout(model: str) -> None:
    """By its periods alone it would be valid for 0.3 s."""
    profile = profiles.load(model)
    signal = replace(profile.signals["output_frequency"], period_s=0.1)
    profile = replace(profile, signals=profile.signals | {"output_frequency": signal})

    async def scenario() -> None:
        async with SimulatedDrives(model) as bench:
            drive = Drive(bench.bus, profile, 1)
            request, _ = drive.dialect.polls(("output_frequency",))[0]
            timing, codec = drive.dialect.station_config.timing, drive.dialect.codec
            timeout = timing.timeout_s(bench.bus.settings, codec.largest_reply(request))
            with drive.monitor(["output_frequency"]) as monitor:
                await asyncio.sleep(5)
                bench.station().faults.silent = True
                await asyncio.sleep(0.5)
                read_at = monitor.status().readings["output_frequency"].source_time
                assert read_at is not None
                await asyncio.sleep(read_at + 1.0 + timeout - 0.01 - bench.bus.now())
                assert monitor.status().readings["output_frequency"].quality is not Quality.BAD
                await asyncio.sleep(0.02)
                assert monitor.status().readings["output_frequency"].reason == "drives.stale"

    run_virtual(scenario())


@pytest.mark.parametrize("model", TELLING)
def test_what_was_read_before_the_port_was_lost_is_bad_at_once_and_until_it_is_read_again(model: str) -> None:
    async def scenario() -> None:
        async with SimulatedDrives(model) as bench:
            with bench.drive().monitor(["output_frequency"]) as monitor:
                await asyncio.sleep(5)
                assert monitor.status().state is DriveState.STOPPED
                simulated_bus_of(bench.port).unplug()
                await asyncio.sleep(0)
                assert_port_lost(monitor.status())
                await asyncio.sleep(0.05)
                simulated_bus_of(bench.port).replug()
                for _ in range(1000):
                    if bench.bus.is_open:
                        break
                    await asyncio.sleep(0.001)
                assert bench.bus.is_open
                assert_port_lost(monitor.status())
                await asyncio.sleep(5)
                status = monitor.status()
                assert status.state is DriveState.STOPPED
                assert status.readings["output_frequency"].quality is not Quality.BAD

    run_virtual(scenario())


def test_a_value_whose_first_poll_is_not_due_yet_is_not_read_yet_and_no_missing_reply() -> None:
    """Regression: for up to a minute "no usable reply from the drive" stood beside a drive that answered everything."""

    async def scenario() -> None:
        async with SimulatedDrives("c320") as bench:
            with bench.drive().monitor() as monitor:
                await asyncio.sleep(3)
                status = monitor.status()
                assert status.state is DriveState.STOPPED
                assert status.readings["last_fault_temperature"].reason == "drives.not_read"
                await asyncio.sleep(62)
                assert monitor.status().readings["last_fault_temperature"].value is not None
        async with SimulatedDrives("c320") as bench:
            bench.station().faults.silent = True
            with bench.drive().monitor() as monitor:
                await asyncio.sleep(3)
                assert monitor.status().readings["last_fault_temperature"].reason == "drives.no_answer"

    run_virtual(scenario())


def test_a_value_hidden_by_a_fault_is_read_as_soon_as_the_fault_is_over() -> None:
    """The C320 does not repeat the item in a fault; its module temperature is polled only once a minute."""

    async def scenario() -> None:
        async with SimulatedDrives("c320") as bench:
            bench.station().trip(Trip.OVERHEAT)
            with bench.drive().monitor() as monitor:
                await asyncio.sleep(65)
                status = monitor.status()
                assert status.state is DriveState.FAULT
                assert status.readings["last_fault_temperature"].reason == "drives.item_not_echoed"
                bench.station().motor.reset()
                await asyncio.sleep(2)
                status = monitor.status()
                assert status.state is DriveState.STOPPED
                assert status.readings["last_fault_temperature"].reason != "drives.item_not_echoed"

    run_virtual(scenario())


def test_a_polled_state_that_is_unknown_has_the_reason_of_its_word(monkeypatch: pytest.MonkeyPatch) -> None:
    async def scenario() -> None:
        async with SimulatedDrives("vc660") as bench:
            monkeypatch.setattr(type(bench.station()), "_monitor", lambda station, index, motor: 0x1000)
            with bench.drive().monitor(["output_frequency"]) as monitor:
                await asyncio.sleep(5)
                assert monitor.status().reason == "drives.reserved_bits"

    run_virtual(scenario())


def assert_port_lost(status: DriveStatus) -> None:
    reading = status.readings["output_frequency"]
    assert (reading.value, reading.quality, reading.reason) == (0.0, Quality.BAD, "drives.port_lost")
    assert (status.state, status.direction, status.reason) == (DriveState.UNKNOWN, None, "drives.port_lost")


@pytest.mark.parametrize("model", TELLING)
def test_a_monitor_follows_the_drive(model: str) -> None:
    async def scenario() -> None:
        async with SimulatedDrives(model) as bench:
            drive = bench.drive()
            seen: set[str] = set()
            with drive.monitor(on_change=lambda status: seen.add(str(status.state))) as monitor:
                await asyncio.sleep(3)
                await drive.run(SAFE_HZ[model])
                await asyncio.sleep(10)
                assert monitor.status().state.turning
                bench.station().trip(Trip.OVERVOLTAGE)
                await asyncio.sleep(5)
                fault = monitor.status().fault
                assert fault is not None and fault.code == bench.station().trip_code(Trip.OVERVOLTAGE)
            assert {"stopped", "fault"} <= seen

    run_virtual(scenario())


@pytest.mark.parametrize("model", TELLING)
def test_a_trip_on_a_slow_bus_is_shown_when_it_is_read_and_not_one_period_later(model: str) -> None:
    """A word counts when two reads agree, and a bus of 30 drives read each only every 15 s."""

    async def scenario() -> None:
        async with SimulatedDrives(model) as bench:
            with bench.drive().monitor(period_s=15.0) as monitor:
                await asyncio.sleep(50)
                bench.station().trip(Trip.OVERVOLTAGE)
                await asyncio.sleep(16)
                fault = monitor.status().fault
                assert fault is not None and fault.code == bench.station().trip_code(Trip.OVERVOLTAGE)

    run_virtual(scenario())


@pytest.mark.parametrize("model", TELLING)
def test_a_monitor_shows_the_reads_of_a_command(model: str) -> None:
    """Outcome and status agree although the polls come every minute."""

    async def scenario() -> None:
        async with SimulatedDrives(model) as bench:
            drive, seen = bench.drive(), list[str]()
            with drive.monitor(on_change=lambda status: seen.append(str(status.state)), period_s=60.0) as monitor:
                await asyncio.sleep(125)
                assert monitor.status().state is DriveState.STOPPED
                await drive.run(SAFE_HZ[model])
                await asyncio.sleep(0)
                assert monitor.status().state.turning and seen[-1] == monitor.status().state
                assert (await drive.stop()).status == "confirmed"
                await asyncio.sleep(0)
                assert monitor.status().state is DriveState.STOPPED and seen[-1] == "stopped"
                message = len(seen)
            await drive.run(SAFE_HZ[model])
            await asyncio.sleep(0)
            assert len(seen) == message, "a closed monitor hears nothing"
            assert not drive._read_listeners, "and nobody holds it"

    run_virtual(scenario())


def test_a_monitor_calls_its_listener_after_a_poll_without_a_reply() -> None:
    """Its description named replies only."""

    async def scenario() -> None:
        async with SimulatedDrives("c320") as bench:
            bench.station().faults.silent = True
            drive, statuses = bench.drive(), list[DriveStatus]()
            with drive.monitor(on_change=statuses.append):
                await asyncio.sleep(5)
            assert statuses and statuses[-1].at is None and statuses[-1].state is DriveState.UNKNOWN

    run_virtual(scenario())


def test_a_command_does_not_end_with_a_monitor_whose_watcher_fails() -> None:
    async def scenario() -> None:
        async with SimulatedDrives("c320") as bench:
            drive, reports = bench.drive(), list[object]()
            asyncio.get_running_loop().set_exception_handler(lambda _loop, context: reports.append(context))
            with drive.monitor(on_change=lambda _status: 1 / 0, period_s=60.0):
                await asyncio.sleep(125)
                polls = len(reports)
                await drive.run(20.0)
                assert (await drive.stop()).status == "confirmed"
            assert len(reports) > polls

    run_virtual(scenario())


def test_a_monitor_takes_only_polled_values_from_a_command() -> None:
    """Otherwise a value read once would stay for ever, and an older read could replace a newer poll."""

    async def scenario() -> None:
        async with SimulatedDrives("c320") as bench:
            drive = bench.drive()
            with drive.monitor(["output_frequency"], period_s=60.0) as monitor:
                await asyncio.sleep(65)
                await drive.read(("dc_bus_voltage", "output_frequency"))
                await asyncio.sleep(0)
                readings = monitor.status().readings
                assert {name for name, reading in readings.items() if reading.value is not None} == {"output_frequency"}
                age_s = readings["output_frequency"].age_s(drive.bus.now())
                assert age_s is not None and age_s < 1.0

    run_virtual(scenario())


@pytest.mark.parametrize(("model", "other"), [("c320", "dc_bus_voltage"), ("vc660", "output_current")])
def test_only_what_was_never_read_is_called_not_read_yet(model: str, other: str) -> None:
    async def scenario() -> None:
        async with SimulatedDrives(model) as bench:
            drive = bench.drive()
            with drive.monitor(["output_frequency"]) as monitor:
                assert monitor.status().reason == "drives.not_read"
                await asyncio.sleep(5)
                polled = monitor.status()
            read = await drive.status(["output_frequency"])
            for status in (polled, read):
                assert status.state is DriveState.STOPPED and status.reason is None
                assert status.readings["output_frequency"].reason != "drives.not_read"
                assert status.readings[other].reason == "drives.not_read"

    run_virtual(scenario())


# --- calibration ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("setpoint", ["hex-0.1", "hex-0.01", "decimal-0.1", "hex-1"])
@pytest.mark.parametrize("query", ["hex-0.1", "hex-0.01", "decimal-0.1"])
def test_the_codings_of_a_dzb100_are_calibrated_at_five_hertz_or_less(query: str, setpoint: str) -> None:
    async def scenario() -> None:
        store = MemoryStore()
        async with SimulatedDrives(
            "dzb100", query=f"query_coding={query}&setpoint_coding={setpoint}", store=store
        ) as bench:
            drive = bench.drive()
            bench.station().setpoint_hz = 12.3
            message = watch(bench)
            assert (await drive.calibrate("query_coding")).options == {"query_coding": query}
            if setpoint == "hex-0.01" and query != "hex-0.01":
                await check_undetermined(drive)
                return
            found = await drive.calibrate("setpoint_coding")
            assert found.options == {"setpoint_coding": setpoint}
            assert max(message) <= 5.0
            assert not bench.station().running
            await drive.run(20.0)
            await asyncio.sleep(30)
            assert bench.station().motor.output_hz == pytest.approx(20.0, abs=0.1)
            drive.close()
            assert bench.drive().dialect.options["setpoint_coding"] == setpoint

    run_virtual(scenario())


async def check_undetermined(drive: Drive) -> None:
    """0005H is 0.05 Hz; in steps of 0.1 Hz that looks like a drive that ignores its start: nothing is determined."""
    with pytest.raises(TargetNotReached) as caught:
        await drive.calibrate("setpoint_coding")
    assert caught.value.key == "drives.calibration_run_failed"
    assert drive.dialect.options["setpoint_coding"] == "unknown"
    with pytest.raises(LimitError):
        await drive.run(1.0)


def test_a_calibration_run_at_a_frequency_that_no_coding_gives_determines_nothing() -> None:
    """The drive runs at a frequency that the bus did not set."""

    async def scenario() -> None:
        coding = {"query_coding": "hex-0.01"}
        async with SimulatedDrives("dzb100", options=coding, query="query_coding=hex-0.01") as bench:
            station, drive = bench.station(), bench.drive()
            station._take_setpoint = lambda word: setattr(station, "setpoint_hz", 3.3)
            with pytest.raises(TargetNotReached) as caught:
                await drive.calibrate("setpoint_coding")
            assert caught.value.key == "drives.setpoint_coding_no_match"
            assert drive.dialect.options["setpoint_coding"] == "unknown" and not station.running
            del station._take_setpoint
            assert (await drive.calibrate("setpoint_coding")).options == {"setpoint_coding": "hex-0.1"}

    run_virtual(scenario())


def test_a_calibration_never_runs_faster_than_the_user_allows() -> None:
    async def scenario() -> None:
        async with SimulatedDrives(
            "dzb100", limits=DriveLimits(maximum_hz=3.0), options={"query_coding": "hex-0.1"}
        ) as bench:
            with pytest.raises(LimitError):
                await bench.drive().calibrate("setpoint_coding")
            assert not bench.station().running

    run_virtual(scenario())


def test_the_setpoint_coding_is_not_calibrated_before_the_query_coding() -> None:
    async def scenario() -> None:
        async with SimulatedDrives("dzb100") as bench:
            with pytest.raises(StartInhibited) as caught:
                await bench.drive().calibrate("setpoint_coding")
            assert caught.value.key == "drives.query_coding_first"
            assert not bench.station().running

    run_virtual(scenario())


@pytest.mark.parametrize("field", ["b3b2", "b2b3"])
def test_one_observed_jog_calibrates_the_direction_field_of_df800(field: str) -> None:
    async def scenario() -> None:
        store = MemoryStore()
        async with SimulatedDrives("df800", query=f"direction_field={field}", store=store) as bench:
            drive = bench.drive()
            seen = watch(bench)

            async def person() -> Direction:
                return Direction.FORWARD if seen[-1] > 0 else Direction.REVERSE

            with pytest.raises(StartInhibited):
                await drive.run(10.0, Direction.FORWARD)
            for hz in (0.0, 5.01):
                with pytest.raises(LimitError):
                    await drive.calibrate("direction", person, frequency_hz=hz)
            assert not seen
            await drive.calibrate("direction", person)
            assert drive.dialect.options["direction_field"] == field
            assert all(abs(hz) <= 5.0 for hz in seen)
            await asyncio.sleep(10)
            for way, sign in ((Direction.FORWARD, 1), (Direction.REVERSE, -1)):
                await drive.run(10.0, way)
                await asyncio.sleep(20)
                assert bench.station().motor.output_hz == pytest.approx(10.0 * sign, abs=0.1)
                await drive.stop()
                await asyncio.sleep(20)

    run_virtual(scenario())


# --- who is it ----------------------------------------------------------------------------------------------------


def test_only_c320_reports_an_identity() -> None:
    async def scenario() -> None:
        async with SimulatedDrives("c320") as bench:
            found = await bench.drive().identify()
            assert (found.voltage_class_v, found.power_kw, found.reported) == (380, 2.2, True)
        async with SimulatedDrives("vc660") as bench:
            assert not (await bench.drive().identify()).reported

    run_virtual(scenario())


@pytest.mark.parametrize("model", MODELS)
def test_an_unpublished_communication_loss_behaviour_is_never_reported_as_a_stop(model: str) -> None:
    async def scenario() -> None:
        async with SimulatedDrives(model) as bench:
            report = await bench.drive().comm_loss_behaviour()
            assert report.stops_on_comm_loss is not True
            assert report.text("zh") != report.text("en")
            published = profiles.load(model).comm_loss.time_notation is not None
            assert (report.key == "drives.comm_loss_unpublished") is not published

    run_virtual(scenario())
