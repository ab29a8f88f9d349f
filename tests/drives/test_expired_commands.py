"""Commands after the host was suspended (SIGSTOP, standby): an expired command never moves a motor."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from drivebus.bus.messages import BusRequest
from drivebus.bus.trace import TraceEvent, TraceKind
from drivebus.drives import Drive, stop_supervisor
from drivebus.drives.operations.calibration_run import run_at_word
from drivebus.drives.operations.command_age import CHECKS_TIMEOUT_S
from drivebus.drives.operations.context import OperationContext
from drivebus.drives.operations.direction_calibration import calibration_jog
from drivebus.drives.operations.jog import begin_jog
from drivebus.drives.operations.parameters import write_values
from drivebus.drives.operations.reset import reset_fault
from drivebus.drives.operations.setpoint import set_frequency
from drivebus.drives.operations.start import run
from drivebus.drives.operations.steps import DriveOperation, wait
from drivebus.drives.operations.stop import STOP_PROGRESS_TIMEOUT_S
from drivebus.drives.outcome import OutcomeStatus
from drivebus.drives.permissives import COMMAND_TTL_S, CommandKind
from drivebus.drives.runner import bus_conditions
from drivebus.drives.state import Direction
from drivebus.errors import DrivebusError, Expired, StartInhibited, StopUnconfirmed, Superseded
from drivebus.protocols import sunfar
from drivebus.protocols.codec import Effect
from drivebus.testing.virtual_time import VirtualLoop, running
from fixtures.drives import FakeC320, FakeModbus, PureBus, SimulatedDrives, context_for, dialect_for, run_virtual
from verification.fault_injection.clocks import suspend_host

HOUR_S = 3600.0


def world_of(model: str) -> PureBus:
    standing = {0x3000: 1, 0x0100: 2, 0x0001: 4, 101: 5, 102: 2}
    faulty = FakeC320(state=sunfar.SunfarState.FAULT, fault_code=5)
    return PureBus(dialect=dialect_for(model), station=faulty if model == "c320" else FakeModbus(standing))


def command_context(bus: PureBus, checks_started_at: float, requested_at: float | None = None) -> OperationContext:
    drive = context_for(bus.dialect)
    return OperationContext(drive, stop_epoch=0, checks_started_at=checks_started_at, requested_at=requested_at)


def asleep_over(bus: PureBus, of_this: Callable[[BusRequest], bool]) -> None:
    """Suspend the host for an hour during this transaction."""

    def sleeps(ask: BusRequest) -> None:
        if of_this(ask):
            bus.pass_time(HOUR_S)

    bus.on_request = sleeps


COMMANDS: dict[str, Any] = {
    "vc660": lambda op: run(op, 20.0, None),
    "c320": reset_fault,
    "df800": lambda op: set_frequency(op, 20.0),
}


@pytest.mark.parametrize("model", COMMANDS)
def test_no_frame_of_a_command_is_sent_an_hour_after_its_request(model: str) -> None:
    """Neither the frequency of a run nor a fault reset: the first frame follows the request within CHECKS_TIMEOUT_S."""
    bus = world_of(model)
    op = command_context(bus, bus.now)
    asleep_over(bus, lambda ask: len(bus.requests) == 2)
    with pytest.raises(Expired) as caught:
        bus.run(COMMANDS[model](op))
    assert caught.value.key == "drives.checks_timeout"
    assert caught.value.params["age_s"] > HOUR_S and caught.value.params["limit_s"] >= CHECKS_TIMEOUT_S
    assert len(bus.requests) >= 2 and not bus.effects()


@pytest.mark.parametrize("save", [False, True])
def test_a_write_is_not_sent_an_hour_after_its_request(save: bool) -> None:
    bus = PureBus(dialect=dialect_for("c320"), station=FakeC320())
    op = command_context(bus, bus.now - HOUR_S)
    with pytest.raises(Expired):
        bus.run(write_values(op, {"F0.2": 30.0}, save=save))
    assert not bus.sent(sunfar.SunfarWriteParameter)


def test_the_rest_of_a_list_of_writes_is_not_sent_after_a_sleep_and_this_is_no_error_of_nothing_sent() -> None:
    bus = PureBus(dialect=dialect_for("c320"), station=FakeC320())
    asleep_over(bus, lambda ask: ask.request == sunfar.SunfarReadParameter(1, 1, 10))
    outcome = bus.run(write_values(command_context(bus, bus.now), {"F0.2": 30.0, "F1.10": 2.0}, save=True))
    assert (outcome.status, outcome.key) == (OutcomeStatus.FAILED, "drives.not_written")
    assert isinstance(outcome.params["why"], Expired) and outcome.params["notation"] == "F1.10"
    assert [note[1]["notation"] for note in outcome.notes] == ["F0.2"]
    assert len(bus.sent(sunfar.SunfarWriteParameter)) == 1


def test_a_list_of_writes_that_a_stop_supersedes_names_what_was_written() -> None:
    """The first values stay in the drive; the error named the stop only."""
    bus = PureBus(dialect=dialect_for("c320"), station=FakeC320())

    def stop(ask: BusRequest) -> None:
        if ask.request == sunfar.SunfarReadParameter(1, 1, 10):
            bus.conditions = replace(bus.conditions, stop_epoch=1)

    bus.on_request = stop
    values = {"F0.2": 30.0, "F1.10": 2.0, "F6.12": 3.0}
    outcome = bus.run(write_values(command_context(bus, bus.now), values, save=True))
    assert (outcome.status, outcome.key) == (OutcomeStatus.FAILED, "drives.not_written")
    assert isinstance(outcome.params["why"], Superseded) and outcome.params["notation"] == "F1.10"
    assert [(key, params["notation"]) for key, params in outcome.notes] == [
        ("drives.write_confirmed", "F0.2"),
        ("drives.write_unsent", "F6.12"),
    ]
    assert len(bus.sent(sunfar.SunfarWriteParameter)) == 1
    with pytest.raises(Superseded):
        bus.run(write_values(command_context(bus, bus.now), {"F0.2": 31.0}, save=True))


def test_a_list_of_writes_may_take_longer_than_one_of_them() -> None:
    """Each write has CHECKS_TIMEOUT_S of its own: a long list on a slow bus does not expire."""
    bus = PureBus(dialect=dialect_for("c320"), station=FakeC320(), transaction_s=0.9)
    values = {"F0.2": 30.0, "F1.10": 2.0, "F6.12": 3.0}
    assert bus.run(write_values(command_context(bus, bus.now), values, save=True)).succeeded
    assert bus.now > 2 * CHECKS_TIMEOUT_S and len(bus.sent(sunfar.SunfarWriteParameter)) == 3


MOTIONS: dict[str, tuple[str, Any]] = {
    "c320": ("c320", lambda op: run(op, 20.0, None)),
    "vc660": ("vc660", lambda op: run(op, 20.0, None)),
    "df800": ("df800", lambda op: run(op, 20.0, None)),
    "jog": ("c320", lambda op: begin_jog(op, 5.0, Direction.FORWARD)),
}


def last_motion_s(name: str, transaction_s: float, requested_at: float | None) -> float | None:
    """Return the seconds from the request to the last frame that moves, on a bus of this pace; None without one."""
    model, operation = MOTIONS[name]
    bus = PureBus(dialect=dialect_for(model), station=FakeC320() if model == "c320" else world_of(model).station)
    bus.conditions, bus.transaction_s = replace(bus.conditions, now=100.0), transaction_s
    sent: list[float] = []
    bus.on_request = lambda ask: sent.append(bus.now) if ask.permit and ask.permit.effect is Effect.MOTION else None
    with contextlib.suppress(Expired):
        bus.run(operation(command_context(bus, 100.0, requested_at)))
    return sent[-1] - 100.0 if sent else None


@pytest.mark.parametrize("name", MOTIONS)
def test_with_a_known_request_time_no_frame_that_moves_is_older_than_its_limit(name: str) -> None:
    """The limit holds for checks and command together on every bus; without a request time they add up."""
    paces = [pace / 200 for pace in range(1, 120)]
    known = [last_motion_s(name, pace, 100.0) for pace in paces]
    assert known[0] is not None and known[-1] is None
    assert max(age for age in known if age is not None) <= CHECKS_TIMEOUT_S
    apart = [last_motion_s(name, pace, None) for pace in paces]
    assert max(age for age in apart if age is not None) > CHECKS_TIMEOUT_S


def test_a_request_time_by_another_clock_counts_as_now() -> None:
    """By the seconds of a wall clock it would never expire."""

    async def aged() -> float:
        async with SimulatedDrives("c320") as bench:
            drive = bench.drive()
            with drive._runner.command(1.8e9) as op:
                pass
            assert op.age.requested_at == op.age.checks_started_at == bench.bus.now()
            with drive._runner.command(bench.bus.now() - HOUR_S) as early:
                pass
            with pytest.raises(Expired):
                await drive.run(20.0, requested_at=early.age.requested_at)
            await asyncio.sleep(CHECKS_TIMEOUT_S)
            return bench.bus.now() - op.create_command(CommandKind.START, bus_conditions(bench.bus, 1)).created_at

    assert run_virtual(aged()) >= COMMAND_TTL_S[CommandKind.START]


def test_a_jog_lease_expires_while_the_machine_is_suspended() -> None:
    """The loop's clock stands still then, the bus's goes on, as the motor does: the program may not just renew."""

    async def jogged() -> None:
        async with SimulatedDrives("c320", query="echo=off") as bench:
            drive, slept_s = bench.drive(), 0.0
            plain = bench.bus.now
            bench.bus.now = lambda: plain() + slept_s  # type: ignore[method-assign]
            async with drive.jog(5.0) as lease:
                lease.renew()
                slept_s = HOUR_S
                with pytest.raises(StartInhibited):
                    lease.renew()
                slept_s = 0.0  # this clock was set for the lease alone, the bus has another
            assert lease.expired and not bench.station().motor.energised

    run_virtual(jogged())


def run_once(op: OperationContext) -> DriveOperation[bool]:
    """Run at a low word as a calibration does, and measure nothing."""

    def measure() -> DriveOperation[bool | None]:
        yield from wait(0.1)
        return True

    return (yield from run_at_word(op, 50, None, measure))


def run_twice(op: OperationContext) -> DriveOperation[bool]:
    """Run once more after the first run, as the calibration of a DZB100 does."""
    yield from run_once(op)
    return (yield from run_once(op))


def c320_that_obeys() -> FakeC320:
    def obeys(fake: FakeC320, request: sunfar.SunfarControl) -> Any:
        runs = request.operation is sunfar.SunfarOperation.RUN_FORWARD_AT
        fake.state = sunfar.SunfarState.RUNNING_FORWARD if runs else sunfar.SunfarState.STOPPED
        return fake.ok()

    return FakeC320(on_command=obeys)


def motions_asleep_over(model: str, operation: Any, nth: int) -> list[int]:
    """Return the places of the frames that move, with the host suspended for an hour during transaction ``nth``."""
    bus = world_of(model)
    if model == "c320":
        bus.station = c320_that_obeys()
    moved: list[int] = []

    def watch(ask: BusRequest) -> None:
        if ask.permit is not None and ask.permit.effect is Effect.MOTION:
            moved.append(len(bus.requests))
        if len(bus.requests) == nth:
            bus.pass_time(HOUR_S)

    bus.on_request = watch
    with contextlib.suppress(DrivebusError):
        bus.run(operation(command_context(bus, bus.now)))
    return moved


@pytest.mark.parametrize("model", ["c320", "vc660", "df800"])
def test_no_calibration_turns_the_motor_an_hour_after_it_was_requested(model: str) -> None:
    """The person beside the drive has left meanwhile. Each transaction before the motion is tried."""
    operation = calibration_jog if model == "df800" else run_once
    first = motions_asleep_over(model, operation, nth=0)[0]
    assert first > 2
    assert [motions_asleep_over(model, operation, nth) for nth in range(1, first)] == [[]] * (first - 1)


def test_the_second_run_of_a_calibration_follows_the_first_but_not_an_hour_later() -> None:
    """Whether the host sleeps during the first run, its stop, or the checks of the second run."""
    first, second = motions_asleep_over("c320", run_twice, nth=0)
    assert [motions_asleep_over("c320", run_twice, nth) for nth in range(first, second)] == [[first]] * (second - first)


@pytest.mark.parametrize("suspended", [False, True], ids=["frozen process", "standby"])
@pytest.mark.parametrize("seconds", [3.0, 30.0, 600.0])
@pytest.mark.parametrize("ignores_stops", [False, True])
def test_a_stop_begins_again_where_the_machine_slept_meanwhile(
    seconds: float, suspended: bool, ignores_stops: bool
) -> None:
    """It ended as "the drive still reported running", which only the reads before the standby had shown."""
    loop = VirtualLoop()
    bench = SimulatedDrives("c320", query="echo=off&ramp=1")

    async def begin() -> Drive:
        await bench.bus.open()
        drive = bench.drive()
        await drive.run(20.0)
        await asyncio.sleep(1)
        return drive

    drive = loop.run_until_complete(begin())
    frames: list[TraceEvent] = []
    with running(loop):
        bench.bus.trace(lambda event: frames.append(event) if event.kind is TraceKind.SENT else None)
        station = bench.station()
        if ignores_stops:
            station._stop = lambda jog_only: None
        stopping = loop.create_task(drive.stop())
    loop.run_until(loop.time() + 0.3)
    suspend_host(SimpleNamespace(port=bench.port, loop=loop), seconds, suspended=suspended, reader_first=True)
    woke_at = loop.time()
    if ignores_stops:
        with pytest.raises(StopUnconfirmed):
            loop.run_until_complete(stopping)
        assert loop.time() - woke_at > STOP_PROGRESS_TIMEOUT_S - 0.01 and drive.stop_pending
    else:
        assert loop.run_until_complete(stopping).status is OutcomeStatus.CONFIRMED
        assert not drive.stop_pending and not station.motor.energised
    stops = [event.time for event in frames if drive.dialect.station_config.effect_of(event.data) is Effect.STOP]
    waits_s = [at - woke_at for at in stops if at >= woke_at]
    assert suspended or waits_s[0] < 0.06, "one read may go before it"
    with running(loop):
        drive.close()


def test_a_stop_on_a_host_that_is_always_late_ends_as_unconfirmed(monkeypatch: pytest.MonkeyPatch) -> None:
    """It began again for ever, and its caller never learned that the drive had not stopped."""
    monkeypatch.setattr(stop_supervisor, "MIN_SUSPENSION_S", -10.0)

    async def scenario() -> None:
        async with SimulatedDrives("c320", query="echo=off&ramp=1") as bench:
            drive = bench.drive()
            await drive.run(20.0)
            bench.station()._stop = lambda jog_only: None
            with pytest.raises(StopUnconfirmed):
                await asyncio.wait_for(drive.stop(), 60.0)
            assert drive.stop_pending

    run_virtual(scenario())
