"""Life of a port: unplugged adapters (I10), a silent master, reads that move nothing (I11), EEPROM wear."""

from __future__ import annotations

import asyncio
import random

import pytest

from drivebus.bus import Poll
from drivebus.drives import stop_bus
from drivebus.errors import DrivebusError, EepromBudgetExceeded, OutcomeUnknown, PortLost
from drivebus.protocols import sunfar
from drivebus.simulator.motor import Trip
from drivebus.simulator.port import simulated_bus_of
from fixtures.system_bench import (
    C320,
    C320_HEX,
    DF800,
    DZB100,
    SYSTEM_VARIANTS,
    VC660,
    SystemVariant,
    every_drive,
    every_family,
    every_line_quality,
    outcome_or_error,
    run_virtual,
    system_bench,
)

COMM_LOSS_ACTION, COMM_LOSS_TIME = 0x903, 0x904
"""C320 F9.3 and F9.4 (0.1 s)."""


@every_drive
def test_a_start_during_which_the_adapter_is_unplugged_is_unknown_and_not_replayed(variant: SystemVariant) -> None:
    """At any moment of the start; after the replug only reads are sent, and the motor is unchanged (I10)."""

    async def scenario(after_s: float) -> None:
        async with system_bench(variant) as bench:
            starting = asyncio.ensure_future(outcome_or_error(bench.drive.run(20.0)))
            await asyncio.sleep(after_s)
            bench.simulated_bus.unplug()
            outcome = await starting
            if not getattr(outcome, "succeeded", False):
                assert isinstance(outcome, DrivebusError) or outcome.status in ("unknown", "failed")
                assert getattr(outcome, "status", "") != "failed" or bench.motor.starts == 0
            starts, energised, sent_before = bench.motor.starts, bench.motor.energised, len(bench.tap.requests_sent)
            await asyncio.sleep(1.0)
            bench.simulated_bus.replug()
            await asyncio.sleep(20.0)
            assert len(bench.tap.requests_sent) - sent_before <= 12, "sync probes at most"
            assert bench.motor.starts == starts and bench.motor.energised == energised
            effects = {
                bench.station_config().effect_of(frame.data).value for frame in bench.tap.requests_sent[sent_before:]
            }
            assert effects <= {"none"}
            assert (await bench.drive.status()).state == (
                "unknown" if not variant.reports_running else "running" if energised else "stopped"
            )

    for step in range(12):
        run_virtual(scenario(0.09 * step + 0.002))


@every_line_quality
@every_family
def test_polling_is_back_within_two_seconds_of_the_replug_every_time(variant: SystemVariant, line_quality: str) -> None:
    """The adapter is unplugged at random instants; every later value is from after the replug."""

    async def scenario() -> None:
        rng = random.Random(5)
        async with system_bench(variant, "1-3", line_quality) as bench:
            received: list[float] = []
            for drive in bench.drives.values():
                poll = Poll(drive.dialect.echo_test_read(), 0.2)
                bench.bus.start_polling(
                    drive.address,
                    [poll],
                    lambda result: received.append(bench.bus.now()) if result.error is None else None,
                )
            for _ in range(25):
                await asyncio.sleep(rng.uniform(0.5, 3.0))
                bench.simulated_bus.unplug()
                assert not bench.bus.is_open
                count = len(received)
                await asyncio.sleep(rng.uniform(0.0, 5.0))
                assert len(received) == count
                bench.simulated_bus.replug()
                at = bench.bus.now()
                await asyncio.sleep(2.0 if "lossy" not in line_quality else 10.0)
                assert len(received) > count
                assert "lossy" in line_quality or received[count] - at <= 2.0, "a lost reply costs another quarantine"
            bench.tap.check(variant)

    run_virtual(scenario())


@every_family
def test_a_request_to_an_unplugged_adapter_is_rejected_at_once(variant: SystemVariant) -> None:
    async def scenario() -> None:
        async with system_bench(variant) as bench:
            await bench.drive.run(10.0)
            bench.simulated_bus.unplug()
            for command in (bench.drive.set_frequency(5.0), bench.drive.run(5.0), bench.drive.status()):
                started_at = bench.bus.now()
                with pytest.raises(DrivebusError) as caught:
                    await command
                assert isinstance(caught.value, PortLost | OutcomeUnknown) or isinstance(
                    caught.value.__cause__, PortLost
                )
                assert bench.bus.now() - started_at < 0.5
            bench.simulated_bus.replug()
            await asyncio.sleep(2.0)
            stopped = await outcome_or_error(bench.drive.stop())
            assert stopped.succeeded and (not variant.reports_running or not bench.motor.energised)

    run_virtual(scenario())


@pytest.mark.parametrize("variant", [C320, C320_HEX], ids=lambda variant: variant.name)
def test_a_c320_trips_by_its_own_timer_when_the_master_goes_silent_and_not_before(variant: SystemVariant) -> None:
    """Polling restarts the timer of F9.4; silence trips the drive exactly at its time (manual 2.2.4)."""

    async def scenario() -> None:
        async with system_bench(variant) as bench:
            station = bench.station()
            station.keypad_set(COMM_LOSS_ACTION, 2)
            station.keypad_set(COMM_LOSS_TIME, 20)
            await bench.drive.run(20.0)
            with bench.drive.monitor():
                await asyncio.sleep(30.0)
                assert bench.motor.energised and bench.motor.trip is None
            await asyncio.sleep(0.2)
            last = bench.tap.requests_sent[-1].end
            await asyncio.sleep(last + 1.99 - bench.bus.now())
            assert bench.station().motor.energised
            await asyncio.sleep(0.02)
            assert bench.station().motor.trip is Trip.COMM_LOSS
            status = await bench.drive.status()
            assert status.state == "fault" and status.fault is not None
            rejected = await outcome_or_error(bench.drive.run(20.0))
            assert not getattr(rejected, "succeeded", False) and bench.motor.starts == 1

    run_virtual(scenario())


def test_a_c320_without_the_timer_runs_on_and_the_master_reports_it() -> None:
    """The reaction of the drive to communication loss is known beforehand."""

    async def scenario() -> None:
        async with system_bench(C320) as bench:
            await bench.drive.run(20.0)
            assert (await bench.drive.comm_loss_behaviour()).stops_on_comm_loss is False
            await asyncio.sleep(3600.0)
            assert bench.station().motor.energised

    run_virtual(scenario())


@every_drive
def test_reading_everything_again_and_again_moves_nothing(variant: SystemVariant) -> None:
    """The simulated C320 starts on an operation in any class of frame; no read of drivebus has one (I11, T01)."""

    async def scenario() -> None:
        async with system_bench(variant) as bench:
            profile = bench.drive.profile
            readable = [p.notation for p in profile.parameters.values() if p.readable]
            with bench.drive.monitor():
                for _ in range(6):
                    await bench.drive.status()
                    await bench.drive.read([*profile.signals, *readable])
                    await bench.drive.identify()
                    await outcome_or_error(bench.drive.preflight())
                    await bench.drive.comm_loss_behaviour()
                    await asyncio.sleep(5.0)
            station = bench.station()
            assert station.motor.starts == 0 and station.motor.output_hz == 0.0
            assert not station.memory.eeprom_writes and not station.memory.ram_writes
            for frame in bench.tap.requests_sent:
                assert moves_nothing(variant, frame.data), frame.data

    run_virtual(scenario())


def moves_nothing(variant: SystemVariant, frame: bytes) -> bool:
    """Classify a frame by the tables of the manuals, without a codec.

    C320 class 0-2 without an operation, DZB100 R or Q, Modbus 03 or 08.
    """
    if variant.encoding == "hex":
        return frame[:1] == b"Z" and frame[3] in (0, 1, 2) and frame[4:6] == bytes(2)
    if variant.model == "dzb100":
        return frame[:1] in (b"R", b"Q")
    if variant.model == "df800" and variant.encoding == "ascii":
        return frame[3:5] == b"03"
    if variant.encoding == "rtu":
        return frame[1] in (3, 8)
    return frame[:1] == b"*" and frame[3:4] in (b"0", b"1", b"2") and frame[4:6] == b"00"


@every_drive
def test_a_thousand_new_frequencies_wear_no_eeprom(variant: SystemVariant) -> None:
    """Setpoints are written to RAM only."""

    async def scenario() -> None:
        async with system_bench(variant) as bench:
            await bench.drive.run(10.0)
            await asyncio.sleep(2.0)
            for step in range(150):
                await outcome_or_error(bench.drive.set_frequency(10.0 + step % 10))
            assert not bench.station().memory.eeprom_writes

    run_virtual(scenario())


@pytest.mark.parametrize(
    "variant", [k for k in SYSTEM_VARIANTS if k.model in ("c320", "vc660", "df800", "dzb100")], ids=lambda k: k.name
)
def test_the_budget_of_saved_writes_ends_at_twenty_a_day(variant: SystemVariant) -> None:
    """The twenty-first different value is rejected before it is sent."""

    async def scenario() -> None:
        async with system_bench(variant) as bench:
            notation = {"c320": "F1.10", "vc660": "F00.11", "df800": "F1.07", "dzb100": "10"}[variant.model]
            parameter = next((p for p in bench.drive.profile.parameters.values() if p.notation == notation), None)
            if parameter is None or not parameter.writable:
                parameter = next(
                    p for p in bench.drive.profile.parameters.values() if p.writable and p.readable and not p.choices
                )
            key = parameter.locator[1]
            low = parameter.minimum or 0.0
            step = parameter.scale.factor
            with pytest.raises(EepromBudgetExceeded):
                for number in range(30):
                    await bench.drive.write({parameter.notation: low + step * (2 + number)}, save=True)
            assert bench.station().memory.eeprom_writes[key] == 20
            same = await outcome_or_error(bench.drive.write({parameter.notation: low + step * 21}, save=True))
            assert getattr(same, "succeeded", False), "a value that the drive has already is not written"
            assert bench.station().memory.eeprom_writes[key] == 20

    run_virtual(scenario())


def test_every_drive_of_a_bus_with_two_families_is_stopped() -> None:
    """C320 and VC660 share a bus at 9600 8N1 on purpose; each family gets its own stop frames (T18)."""

    async def scenario() -> None:
        from drivebus.bus import Bus
        from drivebus.drives import Drive, MemoryStore
        from drivebus.ports import open_port
        from fixtures.system_bench import WireTap

        port = open_port("sim://c320@1-3+vc660@14-16?baud=9600&format=8N1&ramp=2&line_quality=bytes")
        tap = WireTap(simulated_bus_of(port))
        bus = Bus(port, allow_mixed=True)
        drives = [Drive(bus, "c320", n, store=MemoryStore()) for n in (1, 2, 3)]
        drives += [Drive(bus, "vc660", n, store=MemoryStore()) for n in (14, 15, 16)]
        async with bus:
            for drive in drives:
                assert (await drive.run(15.0)).status == "confirmed"
            report = await stop_bus(bus, drives)
            tap.simulated_bus.advance()
            assert report.confirmed and not any(s.motor.energised for s in tap.simulated_bus.stations)
            assert len(report.outcomes) == 6 and all(o.exchanges for _, o in report.outcomes)
            assert [s.motor.starts for s in tap.simulated_bus.stations] == [1] * 6

    run_virtual(scenario())


def test_the_c320_station_does_start_on_a_read_that_carries_an_operation() -> None:
    """Without it the test of reads above proves nothing (T01)."""

    async def scenario() -> None:
        async with system_bench(C320) as bench:
            frame = bytearray(sunfar.SunfarCodec().encode_request(sunfar.ReadMonitor(1, 0)))
            frame[4:6] = b"01"
            check = sum(frame[1:9]) & 0xFFFF
            frame[9:13] = f"{check:04X}".encode()
            bench.bus.port.write(bytes(frame))
            await asyncio.sleep(1.0)
            assert bench.station().motor.starts == 1

    run_virtual(scenario())


def test_the_request_kinds_cover_each_family() -> None:
    assert {k.model for k in (C320, DZB100, VC660, DF800)} == {"c320", "dzb100", "vc660", "df800"}
