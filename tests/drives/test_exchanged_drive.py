"""A drive that was without power: when it answers again it may be another one, or have other settings."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import pytest

from drivebus.bus import Bus, Presence
from drivebus.drives import Drive, stop_bus
from drivebus.drives.outcome import OutcomeStatus
from drivebus.drives.store import MemoryStore
from drivebus.errors import DrivebusError, PreflightError, StopUnconfirmed
from drivebus.ports import open_port
from drivebus.testing.virtual_time import run


@asynccontextmanager
async def polled_drive(model: str, others: str = "") -> AsyncIterator[tuple[Drive, Any]]:
    """Yield a drive of ``model`` at address 3 that is polled, and its port. ``others``: silent stations beside it."""
    port: Any = open_port(f"sim://{model}@3{others}?line_quality=clean")
    for other in port.simulated_bus.stations[1:]:
        other.faults.silent = True
    async with Bus(port) as bus:
        drive = Drive(bus, model, 3, encoding="rtu" if others else None, store=MemoryStore())
        with drive.monitor():
            yield drive, port


async def wait_until_offline(bus: Bus) -> None:
    await asyncio.sleep(20)
    assert bus.presence(3) is Presence.OFFLINE


async def wait_until_online(bus: Bus) -> None:
    await asyncio.sleep(60)
    assert bus.presence(3) is Presence.ONLINE


async def exchange(drive: Drive, port: Any, station: Any) -> None:
    """Switch the drive off for 20 s, then let ``station`` answer at its address."""
    port.simulated_bus.stations[0].faults.silent = True
    await wait_until_offline(drive.bus)
    station.faults.silent = False
    await wait_until_online(drive.bus)


def test_a_drive_set_at_its_keypad_while_it_was_offline_is_checked_again_before_a_start() -> None:
    """F0.1 = 0 takes the frequency from the keypad: the motor would have run, at the speed that was set there."""

    async def scenario() -> None:
        async with polled_drive("c320") as (drive, port):
            station = port.simulated_bus.stations[0]
            assert (await drive.run(10.0)).status is OutcomeStatus.CONFIRMED
            await drive.stop()
            station.memory.ram[0x0001] = 0
            await exchange(drive, port, station)
            with pytest.raises(PreflightError):
                await drive.run(10.0)
            assert not station.motor.energised

    run(scenario())


def test_a_drive_that_was_not_read_for_long_is_checked_again_before_a_start() -> None:
    """Without polls nothing tells that it was off: a program that was suspended, or that only sends commands."""

    async def scenario() -> None:
        port: Any = open_port("sim://c320@3?line_quality=clean")
        async with Bus(port) as bus:
            drive, station = Drive(bus, "c320", 3, store=MemoryStore()), port.simulated_bus.stations[0]
            await drive.run(10.0)
            await drive.stop()
            await asyncio.sleep(600)
            station.memory.ram[0x0001] = 0
            with pytest.raises(PreflightError):
                await drive.run(10.0)
            assert not station.motor.energised

    run(scenario())


def test_a_running_drive_that_was_not_read_for_long_is_checked_again_before_its_ramp_is_held_or_it_is_paused() -> None:
    """The hold was refused for want of the pre-flight check, which the next attempt had then done."""

    async def scenario() -> None:
        port: Any = open_port("sim://vc660@3?line_quality=clean")
        async with Bus(port) as bus:
            drive = Drive(bus, "vc660", 3, store=MemoryStore())
            await drive.run(20.0, wait=True)
            await asyncio.sleep(600)
            assert (await drive.hold_ramp(1.0)).succeeded
            await asyncio.sleep(600)
            assert (await drive.pause()).succeeded

    run(scenario())


def test_a_calibration_after_a_long_time_checks_the_drive_again_and_goes_on() -> None:
    """A user who had gone to the keypad was refused the step: the pre-flight check had not been done."""

    async def scenario() -> None:
        port: Any = open_port("sim://smd@3?line_quality=clean")
        async with Bus(port) as bus:
            drive = Drive(bus, "smd", 3, store=MemoryStore())
            await drive.preflight()
            await asyncio.sleep(600)
            assert (await drive.calibrate("setpoint_step")).words == (50,)

    run(scenario())


def test_a_drive_that_is_polled_each_minute_on_a_slow_bus_is_not_called_lost() -> None:
    """With each poll its model was in doubt again: stops waited for a read, and that of all was not broadcast."""

    async def scenario() -> None:
        port: Any = open_port("sim://gd10@3?line_quality=clean")
        async with Bus(port) as bus:
            drive = Drive(bus, "gd10", 3, store=MemoryStore())
            with drive.monitor(period_s=60.0):
                await drive.run(10.0)
                for _ in range(300):
                    await asyncio.sleep(1)
                    assert drive.is_model_known
            assert bus.contact_losses(3) == 0

    run(scenario())


def test_a_stop_does_not_start_the_drive_of_another_make_that_took_the_place_of_ours() -> None:
    """Word 5 stops a Goodrive and runs an ENC: the stop of the evening started the motor."""

    async def scenario() -> None:
        async with polled_drive("gd10", "+eds800@3") as (drive, port):
            _, other = port.simulated_bus.stations
            await drive.run(10.0)
            await drive.stop()
            await exchange(drive, port, other)
            with pytest.raises(DrivebusError):
                await drive.reset_fault()
            with pytest.raises(StopUnconfirmed) as caught:
                await drive.stop()
            assert caught.value.outcome.key == "drives.stop_withheld"
            assert (await stop_bus(drive.bus, [drive])).broadcasts == ()
            assert other.command == 0 and not other.motor.energised

    run(scenario())


def test_a_lost_drive_gets_the_stop_at_once_and_no_broadcast_goes_out_until_it_answers_as_its_model() -> None:
    """A motor may run behind a broken receiver: its stop waits for no reply. A poll is answer enough."""

    async def scenario() -> None:
        async with polled_drive("gd10") as (drive, port):
            station = port.simulated_bus.stations[0]
            await drive.run(10.0)
            station.faults.mute = True
            await wait_until_offline(drive.bus)
            stopping = asyncio.create_task(drive.stop())
            await asyncio.sleep(0.2)
            assert station.command == 5
            with pytest.raises(StopUnconfirmed):
                await stopping
            assert (await stop_bus(drive.bus, [drive])).broadcasts == ()
            station.faults.mute = False
            await wait_until_online(drive.bus)
            assert len((await stop_bus(drive.bus, [drive])).broadcasts) == 2

    run(scenario())


def test_after_a_pulled_adapter_is_back_a_poll_shows_the_model_again() -> None:
    """Else a stop of all would go to one drive after another on every bus whose adapter was pulled once."""

    async def scenario() -> None:
        async with polled_drive("gd10") as (drive, port):
            await drive.run(10.0)
            port.simulated_bus.unplug()
            await asyncio.sleep(1)
            assert not drive.is_model_known
            port.simulated_bus.replug()
            await asyncio.sleep(5)
            assert len((await stop_bus(drive.bus, [drive])).broadcasts) == 2

    run(scenario())


def test_a_drive_set_at_its_keypad_while_the_adapter_was_pulled_is_checked_again_before_a_start() -> None:
    """A person who pulls an adapter may work at the drive too, in less than 10 s."""

    async def scenario() -> None:
        async with polled_drive("c320") as (drive, port):
            station = port.simulated_bus.stations[0]
            await drive.run(10.0)
            await drive.stop()
            port.simulated_bus.unplug()
            station.memory.ram[0x0001] = 0
            await asyncio.sleep(1)
            port.simulated_bus.replug()
            await asyncio.sleep(5)
            with pytest.raises(PreflightError):
                await drive.run(10.0)
            assert not station.motor.energised

    run(scenario())
