"""Drives, ports and callers that misbehave: no motor keeps turning, and no stop is lost or confirmed by mistake."""

from __future__ import annotations

import asyncio
import contextlib
from typing import Any

import pytest

from drivebus.bus import Bus
from drivebus.drives import Drive, MemoryStore, OutcomeStatus, stop_bus
from drivebus.drives.operations.command_age import CHECKS_TIMEOUT_S
from drivebus.drives.operations.context import OperationContext
from drivebus.drives.operations.start import confirm_start
from drivebus.drives.operations.steps import BusConditions
from drivebus.drives.operations.stop import STOP_PROGRESS_TIMEOUT_S
from drivebus.drives.permissives import (
    CommandKind,
)
from drivebus.drives.state import DriveState
from drivebus.errors import DrivebusError, Expired, StopUnconfirmed, TargetNotReached
from drivebus.ports import open_port
from drivebus.protocols import sunfar
from drivebus.protocols.codec import Effect
from drivebus.simulator.port import simulated_bus_of
from fixtures.drives import (
    MODELS,
    SAFE_HZ,
    FakeC320,
    PureBus,
    ScriptedJog,
    SimulatedDrives,
    dialect_for,
    operation_for,
    run_virtual,
)

PROVED = {"df800": {"direction_calibrated": True}}
JOG_HZ = {"c320": 5.0, "dzb100": 0.5}


async def until_turning(bench: SimulatedDrives, task: asyncio.Future[Any]) -> None:
    for _ in range(20000):
        if not bench.station().motor.energised and not task.done():
            await asyncio.sleep(0.0005)
    assert bench.station().motor.energised


async def calibrating(bench: SimulatedDrives) -> tuple[Drive, asyncio.Future[Any]]:
    """Return a DZB100 and the task of its calibration run, whose motor turns."""
    drive = bench.drive(options={"query_coding": "hex-0.1"})
    task = asyncio.ensure_future(drive.calibrate("setpoint_coding"))
    await until_turning(bench, task)
    return drive, task


async def jogging(drive: Any) -> None:
    async with drive.jog(JOG_HZ.get(drive.profile.model)) as lease:
        while True:
            await asyncio.sleep(0.1)
            lease.renew()


@pytest.mark.parametrize("begun_s", [0.0, 0.3])
@pytest.mark.parametrize("model", MODELS)
def test_a_jog_whose_stop_is_lost_with_the_adapter_ends_when_the_adapter_is_back(model: str, begun_s: float) -> None:
    """At once after the jog frame, and later: the stop is repeated until it is confirmed."""

    async def scenario() -> None:
        async with SimulatedDrives(model) as bench:
            drive = bench.drive(options=PROVED.get(model))
            await drive.status()
            task = asyncio.ensure_future(jogging(drive))
            await until_turning(bench, task)
            await asyncio.sleep(begun_s)
            simulated_bus_of(bench.port).unplug()
            await asyncio.sleep(0.6)
            task.cancel()
            with pytest.raises((DrivebusError, asyncio.CancelledError)):
                await task
            await asyncio.sleep(STOP_PROGRESS_TIMEOUT_S)  # a jog that was to be renewed has begun its stop at the loss
            assert drive.stop_pending
            simulated_bus_of(bench.port).replug()
            await asyncio.sleep(10.0)
            assert not bench.station().motor.energised
            await asyncio.sleep(5.0)
            assert not drive.stop_pending

    run_virtual(scenario())


def test_a_cancelled_calibration_run_is_stopped() -> None:
    async def scenario() -> None:
        async with SimulatedDrives("dzb100") as bench:
            drive, task = await calibrating(bench)
            await asyncio.sleep(1.0)
            task.cancel()
            with pytest.raises(asyncio.CancelledError):
                await task
            await asyncio.sleep(15.0)
            assert not bench.station().motor.energised and not drive.stop_pending

    run_virtual(scenario())


@pytest.mark.parametrize("obeys", [True, False])
def test_a_calibration_run_whose_replies_are_lost_ends_with_a_stop_and_says_how_that_ended(obeys: bool) -> None:
    """The motor turns while Q00 and Q01 are read: their error alone would say nothing of it."""

    async def scenario() -> None:
        async with SimulatedDrives("dzb100") as bench:
            drive, task = await calibrating(bench)
            await asyncio.sleep(2.5)
            bench.station().faults.mute, bench.station().faults.silent = obeys, not obeys
            with pytest.raises(TargetNotReached) as caught:
                await task
            assert bench.station().motor.energised is not obeys
            assert caught.value.key == "drives.calibration_run_failed"
            assert "station 1 is offline" in caught.value.text("en") and "STOP NOT CONFIRMED" in caught.value.text("en")
            assert "停机未确认" in caught.value.text("zh") and "STOP" not in caught.value.text("zh")
            assert caught.value.outcome.status is OutcomeStatus.UNKNOWN and drive.stop_pending

    run_virtual(scenario())


@pytest.mark.parametrize("keypad_hz", [0.0, 0.5, 5.0])
def test_a_calibration_during_which_the_drive_loses_its_power_for_a_moment_determines_nothing(keypad_hz: float) -> None:
    """It runs again by itself at its keypad's frequency. That passed for another coding: later ten times too fast."""

    async def scenario() -> None:
        async with SimulatedDrives("dzb100") as bench:
            drive, task = await calibrating(bench)
            await asyncio.sleep(1.5)
            station = bench.station()
            assert station.motor.energised
            station.power_cycle(0.6)
            if keypad_hz:
                station.keypad_run(keypad_hz)
            with pytest.raises(TargetNotReached) as caught:
                await task
            assert caught.value.key == "drives.calibration_run_failed"
            await asyncio.sleep(10.0)
            assert not station.motor.energised and not drive.stop_pending
            assert [step.name for step in drive.open_calibrations()] == ["setpoint_coding"]

    run_virtual(scenario())


@pytest.mark.parametrize("patience_s", [0.0005, 0.02, 0.2])
@pytest.mark.parametrize("model", MODELS)
def test_a_stop_whose_caller_gave_up_waiting_goes_on(model: str, patience_s: float) -> None:
    """``wait_for(drive.stop(), …)``: the motor is stopped although the caller gave up."""

    async def scenario() -> None:
        async with SimulatedDrives(model) as bench:
            drive = bench.drive()
            await drive.run(SAFE_HZ[model])
            await asyncio.sleep(1.0)
            busy = asyncio.ensure_future(drive.status())
            await asyncio.sleep(0.001)
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(drive.stop(), patience_s)
            busy.cancel()
            simulated_bus_of(bench.port).unplug()
            await asyncio.sleep(0.01)
            simulated_bus_of(bench.port).replug()
            await asyncio.sleep(40.0)
            assert not bench.station().motor.energised

    run_virtual(scenario())


def test_an_unconfirmed_stop_is_not_repeated_on_a_bus_that_was_closed() -> None:
    async def scenario() -> set[asyncio.Task[Any]]:
        async with SimulatedDrives("c320") as bench:
            drive = bench.drive()
            await drive.status()
            simulated_bus_of(bench.port).unplug()
            with pytest.raises(StopUnconfirmed):
                await drive.stop()
            assert drive.stop_pending
        await asyncio.sleep(10.0)
        return asyncio.all_tasks() - {asyncio.current_task()}  # type: ignore[arg-type]

    assert not run_virtual(scenario())


def test_a_bus_stop_with_a_drive_that_left_the_bus_stops_the_others_and_says_so() -> None:
    async def scenario() -> None:
        async with SimulatedDrives("c320", "1-3") as bench:
            drives = [bench.drive(address) for address in (1, 2, 3)]
            for drive in drives:
                await drive.run(20.0)
            bench.bus.remove_station(2)
            report = await stop_bus(bench.bus, drives)
            assert report.unconfirmed == (2,) and not report.confirmed
            assert not any(bench.station(address).motor.energised for address in (1, 3))

    run_virtual(scenario())


@pytest.mark.parametrize(("model", "query"), [("c320", "baud=1200"), ("dzb100", "baud=1200"), ("vc660", "baud=1200")])
def test_a_lease_counts_from_the_moment_at_which_the_motor_may_turn(model: str, query: str) -> None:
    """Not from the drive's answer, which takes a quarter of a second at 1,200 baud."""

    async def scenario() -> None:
        async with SimulatedDrives(model, query=query) as bench:
            drive = bench.drive()
            await drive.preflight()
            frames: list[tuple[float, Effect]] = []
            bench.bus.trace(
                lambda event: (
                    frames.append((event.time, drive.dialect.station_config.effect_of(event.data)))
                    if event.direction == "sent"
                    else None
                )
            )
            lease = drive.jog(JOG_HZ.get(model))
            async with lease:
                await asyncio.sleep(5.0)
            assert lease.expired
            moved = next(at for at, effect in frames if effect is Effect.MOTION)
            stopped = next(at for at, effect in frames if effect is Effect.STOP)
            longest_frame_s = 14 * 11 / 1200
            assert 0.5 <= stopped - moved <= 0.5 + 2 * longest_frame_s

    run_virtual(scenario())


class Renumbered:
    """Serial port whose identity is that of the adapter only once it is open."""

    def __init__(self, port: Any) -> None:
        self._port = port
        self.identity = "device:/dev/ttyUSB0"
        self.url = "/dev/ttyUSB0"

    def __getattr__(self, name: str) -> Any:
        return getattr(self._port, name)

    async def open(self, receiver: Any) -> None:
        await self._port.open(receiver)
        self.identity = "usb:0403:6001:B"


def test_a_calibration_stored_for_one_adapter_is_not_used_for_another() -> None:
    """A drive created before its bus is opened uses the calibrations and write counts of the adapter then opened."""

    async def scenario() -> None:
        store = MemoryStore()
        store.put("calibration/device:/dev/ttyUSB0/1/dzb100/setpoint_coding", '"hex-1"')
        store.put("calibration/usb:0403:6001:B/1/dzb100/query_coding", '"hex-0.1"')
        port: Any = Renumbered(open_port("sim://dzb100@1"))
        bus = Bus(port)
        drive = Drive(bus, "dzb100", 1, store=store)
        assert "hex-1" not in drive.dialect.options.values()
        await bus.open()
        await drive.status()
        assert drive.dialect.options["setpoint_coding"] == "unknown"
        assert drive.dialect.options["query_coding"] == "hex-0.1"
        await drive.write({"10": 12.0}, save=True)
        assert store.get("eeprom/usb:0403:6001:B/1/10") and not store.get("eeprom/device:/dev/ttyUSB0/1/10")
        await bus.close()

    run_virtual(scenario())


def test_a_lease_that_is_over_before_the_answer_came_is_lost_at_once() -> None:
    class SlowlyAnsweredJog(ScriptedJog):
        def _motion_age_s(self) -> float:
            return 0.7

    async def scenario() -> None:
        async with SlowlyAnsweredJog(0.5) as lease:
            await asyncio.sleep(0)
            await asyncio.sleep(0)
            assert lease.expired

    run_virtual(scenario())


@pytest.mark.parametrize(
    "state",
    [sunfar.SunfarState.JOGGING_FORWARD, sunfar.SunfarState.DC_BRAKING, sunfar.SunfarState.DECELERATING_FORWARD],
)
def test_a_start_is_not_confirmed_by_a_drive_that_does_something_else(state: sunfar.SunfarState) -> None:
    """A drive that jogs from its keypad, brakes or ramps down must not be reported as started."""
    bus = PureBus(dialect=dialect_for("c320"), station=FakeC320(state=state))
    op = operation_for(bus.dialect)
    command = op.drive.create_command(CommandKind.START, BusConditions(now=0.0))
    outcome = bus.run(confirm_start(op, command, bus.dialect.start(None, 2000), None, answered=True))
    assert (outcome.status, outcome.key) == (OutcomeStatus.UNKNOWN, "drives.start_unknown")
    assert outcome.drive_status is not None and outcome.drive_status.state in {
        DriveState.JOGGING,
        DriveState.BRAKING,
        DriveState.DECELERATING,
    }
    assert not bus.effects()


@pytest.mark.parametrize(("age_s", "fits"), [(CHECKS_TIMEOUT_S, True), (CHECKS_TIMEOUT_S + 0.01, False)])
def test_a_command_expires_when_its_checks_take_too_long(age_s: float, fits: bool) -> None:
    """The command's own two seconds begin only after them."""
    bus = PureBus(dialect=dialect_for("c320"), station=FakeC320(), conditions=BusConditions(now=100.0 + age_s))
    op = OperationContext(operation_for(bus.dialect).drive, stop_epoch=0, checks_started_at=100.0)
    with contextlib.nullcontext() if fits else pytest.raises(Expired):
        bus.run(op.check_deadline())


def test_a_stop_since_the_request_supersedes_the_command_before_it_is_created() -> None:
    """The request came before the stop, whenever its turn came."""
    bus = PureBus(dialect=dialect_for("c320"), station=FakeC320())
    memory = operation_for(bus.dialect).drive
    stopped = BusConditions(now=1.0, stop_epoch=4)
    assert OperationContext(memory, stop_epoch=3).create_command(CommandKind.START, stopped).stop_epoch == 3
    assert OperationContext(memory).create_command(CommandKind.START, stopped).stop_epoch == 4


def word_of(dialect: Any, *names: str) -> int:
    bits = dialect.command_word.map.bits
    return int(sum(bits[name].value for name in names))


def test_a_reset_that_also_turns_the_direction_level_may_move() -> None:
    """VC660: a reset that does not repeat the levels of the drive may move the motor."""
    dialect: Any = dialect_for("vc660")
    assert dialect.command_word.effect(word_of(dialect, "reset")) is Effect.SETTING
    assert dialect.command_word.effect(word_of(dialect, "reset", "reverse")) is Effect.MOTION
    dialect.command_word.on_sent(word_of(dialect, "start", "reverse"))
    assert dialect.command_word.effect(word_of(dialect, "reset", "reverse")) is Effect.SETTING
    assert dialect.command_word.effect(word_of(dialect, "reset")) is Effect.MOTION


def test_a_stop_of_df800_with_a_direction_in_it_is_no_stop() -> None:
    """DF800 has no levels: a direction is a command of its own and needs a permit."""
    dialect: Any = dialect_for("df800", direction_calibrated=True)
    assert dialect.command_word.effect(word_of(dialect, "stop")) is Effect.STOP
    assert dialect.command_word.effect(word_of(dialect, "stop", "reverse")) is Effect.MOTION


@pytest.mark.parametrize("command", ["reset_fault", "write"])
def test_a_command_that_waited_too_long_for_its_turn_expires(command: str) -> None:
    async def scenario() -> None:
        async with SimulatedDrives("c320") as bench:
            drive = bench.drive()
            async with drive._runner._command_lock:
                user_command = drive.reset_fault() if command == "reset_fault" else drive.write({"F0.2": 20.0})
                waiting = asyncio.ensure_future(user_command)
                await asyncio.sleep(CHECKS_TIMEOUT_S + 0.01)
            with pytest.raises(Expired) as caught:
                await waiting
            assert caught.value.key == "drives.queue_timeout"

    run_virtual(scenario())
