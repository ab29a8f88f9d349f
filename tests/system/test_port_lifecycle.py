"""The life of a port and of a host: unplugged adapters (I10), dead hosts, reads that move nothing (I11),
and EEPROMs that are not worn."""

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
    command_ending,
    every_drive,
    every_family,
    on_four_lines,
    run_virtual,
    system_bench,
)

COMM_LOSS_ACTION, COMM_LOSS_TIME = 0x903, 0x904
"""C320 F9.3 and F9.4 (0.1 s)."""


@every_drive
def test_a_start_during_which_the_adapter_is_unplugged_is_unknown_and_not_replayed(kind: SystemVariant) -> None:
    """I10, G09: at any moment of it; after the replug only reads leave, and the motor is as the cut left it."""

    async def scenario(after_s: float) -> None:
        async with system_bench(kind) as here:
            starting = asyncio.ensure_future(command_ending(here.drive.run(20.0)))
            await asyncio.sleep(after_s)
            here.bench.unplug()
            outcome = await starting
            if not getattr(outcome, "succeeded", False):
                assert isinstance(outcome, DrivebusError) or outcome.status in ("unknown", "failed")
                assert getattr(outcome, "status", "") != "failed" or here.motor.starts == 0
            starts, energised, asked = here.motor.starts, here.motor.energised, len(here.tap.requests_sent)
            await asyncio.sleep(1.0)
            here.bench.replug()
            await asyncio.sleep(20.0)
            assert len(here.tap.requests_sent) - asked <= 12, "fences at most"
            assert here.motor.starts == starts and here.motor.energised == energised
            effects = {here.link().effect_of(one.data).value for one in here.tap.requests_sent[asked:]}
            assert effects <= {"none"}
            assert (await here.drive.status()).state == (
                "unknown" if not kind.reports_running else "running" if energised else "stopped"
            )

    for step in range(12):
        run_virtual(scenario(0.09 * step + 0.002))


@on_four_lines
@every_family
def test_polling_is_back_within_two_seconds_of_the_replug_every_time(kind: SystemVariant, weather: str) -> None:
    """At random instants; every value then comes from after the replug."""

    async def scenario() -> None:
        chance = random.Random(5)
        async with system_bench(kind, "1-3", weather) as here:
            received: list[float] = []
            for drive in here.drives.values():
                poll = Poll(drive.dialect.echo_test_read(), 0.2)
                here.bus.start_polling(
                    drive.address, [poll], lambda a: received.append(here.bus.now()) if a.error is None else None
                )
            for _ in range(25):
                await asyncio.sleep(chance.uniform(0.5, 3.0))
                here.bench.unplug()
                assert not here.bus.is_open
                count = len(received)
                await asyncio.sleep(chance.uniform(0.0, 5.0))
                assert len(received) == count
                here.bench.replug()
                at = here.bus.now()
                await asyncio.sleep(2.0 if "lossy" not in weather else 10.0)
                assert len(received) > count
                assert "lossy" in weather or received[count] - at <= 2.0, "a lost answer costs a quarantine more"
            here.tap.check(kind)

    run_virtual(scenario())


@every_family
def test_a_request_to_an_unplugged_adapter_is_rejected_at_once(kind: SystemVariant) -> None:
    async def scenario() -> None:
        async with system_bench(kind) as here:
            await here.drive.run(10.0)
            here.bench.unplug()
            for command in (here.drive.set_frequency(5.0), here.drive.run(5.0), here.drive.status()):
                begun = here.bus.now()
                with pytest.raises(DrivebusError) as caught:
                    await command
                assert isinstance(caught.value, PortLost | OutcomeUnknown) or isinstance(
                    caught.value.__cause__, PortLost
                )
                assert here.bus.now() - begun < 0.5
            here.bench.replug()
            await asyncio.sleep(2.0)
            stopped = await command_ending(here.drive.stop())
            assert stopped.succeeded and (not kind.reports_running or not here.motor.energised)

    run_virtual(scenario())


@pytest.mark.parametrize("kind", [C320, C320_HEX], ids=lambda kind: kind.name)
def test_a_c320_trips_by_its_own_timer_when_the_master_goes_silent_and_not_before(kind: SystemVariant) -> None:
    """F9.3/F9.4 (manual 2.2.4): polling feeds the timer, silence trips the drive at its time exactly."""

    async def scenario() -> None:
        async with system_bench(kind) as here:
            station = here.station()
            station.keypad_set(COMM_LOSS_ACTION, 2)
            station.keypad_set(COMM_LOSS_TIME, 20)
            await here.drive.run(20.0)
            with here.drive.monitor():
                await asyncio.sleep(30.0)
                assert here.motor.energised and here.motor.trip is None
            await asyncio.sleep(0.2)
            last = here.tap.requests_sent[-1].end
            await asyncio.sleep(last + 1.99 - here.bus.now())
            assert here.station().motor.energised
            await asyncio.sleep(0.02)
            assert here.station().motor.trip is Trip.COMM_LOSS
            status = await here.drive.status()
            assert status.state == "fault" and status.fault is not None
            report = await command_ending(here.drive.run(20.0))
            assert not getattr(report, "succeeded", False) and here.motor.starts == 1

    run_virtual(scenario())


def test_a_c320_without_the_timer_runs_on_and_the_master_reports_it() -> None:
    """What the drive will do is told before anybody leaves."""

    async def scenario() -> None:
        async with system_bench(C320) as here:
            await here.drive.run(20.0)
            assert (await here.drive.comm_loss_behaviour()).stops_on_comm_loss is False
            await asyncio.sleep(3600.0)
            assert here.station().motor.energised

    run_virtual(scenario())


@every_drive
def test_reading_everything_again_and_again_moves_nothing(kind: SystemVariant) -> None:
    """I11, T01: the pretend C320 starts on an operation in any class of frame; no read of this stack carries one."""

    async def scenario() -> None:
        async with system_bench(kind) as here:
            profile = here.drive.profile
            readable = [p.notation for p in profile.parameters.values() if p.readable]
            with here.drive.monitor():
                for _ in range(6):
                    await here.drive.status()
                    await here.drive.read([*profile.signals, *readable])
                    await here.drive.identify()
                    await command_ending(here.drive.preflight())
                    await here.drive.comm_loss_behaviour()
                    await asyncio.sleep(5.0)
            station = here.station()
            assert station.motor.starts == 0 and station.motor.output_hz == 0.0
            assert not station.memory.eeprom_writes and not station.memory.ram_writes
            for one in here.tap.requests_sent:
                assert moves_nothing(kind, one.data), one.data

    run_virtual(scenario())


def moves_nothing(kind: SystemVariant, frame: bytes) -> bool:
    """By the manuals' tables, with no codec: C320 class 0-2 and no operation, DZB100 R or Q, Modbus 03 or 08."""
    if kind.encoding == "hex":
        return frame[:1] == b"Z" and frame[3] in (0, 1, 2) and frame[4:6] == bytes(2)
    if kind.model == "dzb100":
        return frame[:1] in (b"R", b"Q")
    if kind.model == "df800" and kind.encoding == "ascii":
        return frame[3:5] == b"03"
    if kind.encoding == "rtu":
        return frame[1] in (3, 8)
    return frame[:1] == b"*" and frame[3:4] in (b"0", b"1", b"2") and frame[4:6] == b"00"


@every_drive
def test_a_thousand_new_frequencies_wear_no_eeprom(kind: SystemVariant) -> None:
    """Setpoints go where nothing is saved."""

    async def scenario() -> None:
        async with system_bench(kind) as here:
            await here.drive.run(10.0)
            await asyncio.sleep(2.0)
            for step in range(150):
                await command_ending(here.drive.set_frequency(10.0 + step % 10))
            assert not here.station().memory.eeprom_writes

    run_virtual(scenario())


@pytest.mark.parametrize(
    "kind", [k for k in SYSTEM_VARIANTS if k.model in ("c320", "vc660", "df800", "dzb100")], ids=lambda k: k.name
)
def test_the_budget_of_saved_writes_ends_at_twenty_a_day(kind: SystemVariant) -> None:
    """The twenty-first different value is refused before it is sent."""

    async def scenario() -> None:
        async with system_bench(kind) as here:
            notation = {"c320": "F1.10", "vc660": "F00.11", "df800": "F1.07", "dzb100": "10"}[kind.model]
            parameter = next((p for p in here.drive.profile.parameters.values() if p.notation == notation), None)
            if parameter is None or not parameter.writable:
                parameter = next(
                    p for p in here.drive.profile.parameters.values() if p.writable and p.readable and not p.choices
                )
            key = parameter.locator[1]
            low = parameter.minimum or 0.0
            step = parameter.scale.factor
            with pytest.raises(EepromBudgetExceeded):
                for number in range(30):
                    await here.drive.write({parameter.notation: low + step * (2 + number)}, save=True)
            assert here.station().memory.eeprom_writes[key] == 20
            same = await command_ending(here.drive.write({parameter.notation: low + step * 21}, save=True))
            assert getattr(same, "succeeded", False), "the value it holds already is no write"
            assert here.station().memory.eeprom_writes[key] == 20

    run_virtual(scenario())


def test_every_drive_of_a_bus_with_two_families_is_stopped() -> None:
    """T18 allowed on purpose: C320 and VC660 on one pair of wires, 9600 8N1, each family told in its own words."""

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
            tap.bench.advance()
            assert report.confirmed and not any(s.motor.energised for s in tap.bench.stations)
            assert len(report.outcomes) == 6 and all(o.exchanges for _, o in report.outcomes)
            assert [s.motor.starts for s in tap.bench.stations] == [1] * 6

    run_virtual(scenario())


def test_the_c320_station_does_start_on_a_read_that_carries_an_operation() -> None:
    """T01: without this the story above proves nothing."""

    async def scenario() -> None:
        async with system_bench(C320) as here:
            frame = bytearray(sunfar.SunfarCodec().encode_request(sunfar.ReadMonitor(1, 0)))
            frame[4:6] = b"01"
            check = sum(frame[1:9]) & 0xFFFF
            frame[9:13] = f"{check:04X}".encode()
            here.bus.port.write(bytes(frame))
            await asyncio.sleep(1.0)
            assert here.station().motor.starts == 1

    run_virtual(scenario())


def test_the_request_kinds_cover_each_family() -> None:
    assert {k.model for k in (C320, DZB100, VC660, DF800)} == {"c320", "dzb100", "vc660", "df800"}
