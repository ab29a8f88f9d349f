"""Every drive, every command: the outcome's word against what the motor really does (I1, I2)."""

from __future__ import annotations

import asyncio
import random
from collections.abc import Callable
from typing import Any

import pytest

from drivebus.drives import Direction
from drivebus.drives.dialects.base import StopMode
from drivebus.errors import DrivebusError, StartInhibited, TargetNotReached
from drivebus.simulator.motor import Trip
from fixtures.system_bench import (
    DF800,
    SYSTEM_VARIANTS,
    SystemBench,
    SystemVariant,
    command_ending,
    every_drive,
    every_reporting_drive,
    run_virtual,
    system_bench,
    wait_until,
)

RAMP_S = 2.0


def expected_word(kind: SystemVariant) -> str:
    """How a command that was carried out ends: confirmed, or acknowledged where nothing can show it (DF800)."""
    return "confirmed" if kind.reports_running else "acknowledged"


def turning(here: SystemBench) -> float:
    """Output frequency of the motor, negative in reverse, 0 where the output is off."""
    motor = here.motor
    return motor.output_hz if motor.energised else 0.0


@pytest.mark.parametrize("direction", list(Direction))
@every_drive
def test_a_run_turns_the_motor_in_its_direction_at_its_speed_and_a_stop_ends_it(
    kind: SystemVariant, direction: Direction
) -> None:
    async def scenario() -> None:
        async with system_bench(kind) as here:
            sign = 1 if direction is Direction.FORWARD else -1
            started = await here.drive.run(20.0, direction)
            assert started.status == expected_word(kind)
            assert here.motor.energised and here.motor.target_hz == pytest.approx(sign * 20.0)
            await asyncio.sleep(RAMP_S)
            assert turning(here) == pytest.approx(sign * 20.0)
            assert here.motor.starts == 1
            stopped = await here.drive.stop()
            assert stopped.status == expected_word(kind)
            if kind.reports_running:
                assert not here.motor.energised, "confirmed while it still turned"
            await asyncio.sleep(RAMP_S)
            assert not here.motor.energised and here.motor.starts == 1
            here.tap.check(kind)

    run_virtual(scenario())


@every_reporting_drive
def test_waiting_returns_when_the_motor_has_reached_the_target_and_not_before(kind: SystemVariant) -> None:
    async def scenario() -> None:
        async with system_bench(kind) as here:
            reached = await here.drive.run(30.0, wait=True)
            assert reached.status == "confirmed"
            assert turning(here) == pytest.approx(30.0, rel=0.005)
            ramp = 30.0 / here.motor.ramp_base_hz * RAMP_S
            assert here.bus.now() < ramp + 4.0

    run_virtual(scenario())


@every_reporting_drive
def test_waiting_for_a_motor_that_trips_raises_with_the_reported_state(kind: SystemVariant) -> None:
    async def scenario() -> None:
        async with system_bench(kind) as here:
            waiting = asyncio.ensure_future(here.drive.run(40.0, wait=True))
            await asyncio.sleep(0.9)
            await wait_until(lambda: here.motor.energised)
            await asyncio.sleep(0.3)
            here.station().trip(Trip.OVERCURRENT_ACCELERATING)
            with pytest.raises(TargetNotReached) as caught:
                await waiting
            assert caught.value.outcome.status == "failed"
            assert caught.value.outcome.drive_status.state in ("fault", "stopped", "not_ready")

    run_virtual(scenario())


@every_drive
def test_a_new_frequency_becomes_the_speed_of_the_motor(kind: SystemVariant) -> None:
    async def scenario() -> None:
        async with system_bench(kind) as here:
            await here.drive.run(10.0)
            await asyncio.sleep(RAMP_S)
            for wanted in (25.0, 5.0, 12.5):
                changed = await command_ending(here.drive.set_frequency(wanted))
                await asyncio.sleep(RAMP_S)
                assert turning(here) == pytest.approx(wanted)
                shows = "set_frequency" in here.drive.profile.signals
                assert changed.status == ("confirmed" if shows else "acknowledged")
            assert here.motor.starts == 1

    run_virtual(scenario())


@every_drive
def test_a_run_at_another_frequency_does_not_start_again(kind: SystemVariant) -> None:
    async def scenario() -> None:
        async with system_bench(kind) as here:
            await here.drive.run(10.0)
            await asyncio.sleep(RAMP_S)
            again = await command_ending(here.drive.run(20.0))
            await asyncio.sleep(RAMP_S)
            assert again.succeeded and turning(here) == pytest.approx(20.0)
            assert here.motor.starts == 1

    run_virtual(scenario())


@every_reporting_drive
def test_a_reverse_while_it_runs_forward_is_rejected_before_anything_is_sent(kind: SystemVariant) -> None:
    async def scenario() -> None:
        async with system_bench(kind) as here:
            await here.drive.run(10.0, Direction.FORWARD)
            await asyncio.sleep(RAMP_S)
            with pytest.raises(StartInhibited):
                await here.drive.run(10.0, Direction.REVERSE)
            await asyncio.sleep(RAMP_S)
            assert turning(here) == pytest.approx(10.0)

    run_virtual(scenario())


def jog_hz(kind: SystemVariant) -> float | None:
    """Modbus models jog at the drive's own frequency, 5 Hz here."""
    return None if kind.encoding == "rtu" or kind.model == "df800" else 5.0


@every_drive
def test_a_jog_lasts_as_long_as_its_lease_is_renewed_and_no_longer(kind: SystemVariant) -> None:
    """T13: letting go stops it, and so does hanging."""

    async def scenario() -> None:
        async with system_bench(kind) as here:
            for direction, sign in ((Direction.FORWARD, 1), (Direction.REVERSE, -1)):
                async with here.drive.jog(jog_hz(kind), direction) as lease:
                    for _ in range(12):
                        await asyncio.sleep(0.2)
                        lease.renew()
                    assert turning(here) == pytest.approx(sign * 5.0)
                assert lease.stop_outcome is not None and lease.stop_outcome.status == expected_word(kind)
                await asyncio.sleep(RAMP_S)
                assert not here.motor.energised
            async with here.drive.jog(jog_hz(kind)) as lease:
                begun = here.bus.now()
                await asyncio.sleep(0.7)
                assert lease.expired
                asked = [one for one in here.tap.requests_sent if begun + 0.5 <= one.start]
                assert asked and asked[0].start - begun <= 0.5 + 0.1, "the stop leaves when the lease ends"
                await asyncio.sleep(RAMP_S)
                assert not here.motor.energised
                with pytest.raises(StartInhibited):
                    lease.renew()

    run_virtual(scenario())


@every_drive
def test_a_tripped_drive_is_reported_reset_and_started_again(kind: SystemVariant) -> None:
    async def scenario() -> None:
        async with system_bench(kind) as here:
            await here.drive.run(20.0)
            await asyncio.sleep(RAMP_S)
            here.station().trip(Trip.OVERLOAD)
            status = await here.drive.status()
            if kind.reports_running:
                assert status.state == "fault" and status.fault is not None
                assert status.fault.code == here.station().trip_code(Trip.OVERLOAD)
                refused = await command_ending(here.drive.run(20.0))
                assert not getattr(refused, "succeeded", False)
            else:
                assert status.state == "unknown" and status.fault is None
            assert here.motor.starts == 1 and here.motor.trip is Trip.OVERLOAD
            reset = await command_ending(here.drive.reset_fault())
            assert reset.status == expected_word(kind)
            assert here.motor.trip is None
            await asyncio.sleep(1.0)
            assert not here.motor.energised, "a reset is not a start"
            assert (await command_ending(here.drive.run(20.0))).succeeded
            assert here.motor.energised and here.motor.starts == 2

    run_virtual(scenario())


@every_drive
def test_a_reset_without_a_fault_moves_nothing(kind: SystemVariant) -> None:
    async def scenario() -> None:
        async with system_bench(kind) as here:
            assert (await command_ending(here.drive.reset_fault())).status == expected_word(kind)
            await asyncio.sleep(1.0)
            assert here.motor.starts == 0

    run_virtual(scenario())


def first_request_fate(
    station: Any, acts: Callable[[Any], bool], deed: Callable[[], None], *, hears: bool
) -> list[int]:
    """The first request that ``acts``: it is heard or not, its reply is lost, and ``deed`` is done."""
    answer, lost = station.handle_request, []

    def instead(message: Any, codec: Any) -> Any:
        if lost or not acts(message):
            return answer(message, codec)
        lost.append(1)
        if hears:
            answer(message, codec)
        deed()
        return None

    station.handle_request = instead
    return lost


def start_frames(here: SystemBench, hz: float = 20.0) -> set[bytes]:
    """The bytes of a forward start at this frequency."""
    dialect = here.drive.dialect
    return {dialect.codec.encode_request(dialect.start(None, dialect.setpoint_word(hz))[0].request)}


def is_start(here: SystemBench, hz: float = 20.0) -> Callable[[Any], bool]:
    frames = start_frames(here, hz)

    def acts(message: Any) -> bool:
        last = here.tap.requests_sent[-1].data
        return last in frames

    return acts


def starts_sent(here: SystemBench) -> int:
    return sum(here.tap.requests(frame) for frame in start_frames(here))


@every_drive
def test_a_lost_reply_to_a_start_never_starts_twice(kind: SystemVariant) -> None:
    """I2: the drive runs, its yes was lost; what it then shows decides; DF800 shows nothing: unknown, not resent."""

    async def scenario() -> None:
        async with system_bench(kind) as here:
            lost = first_request_fate(here.station(), is_start(here), lambda: None, hears=True)
            outcome = await command_ending(here.drive.run(20.0))
            await asyncio.sleep(3.0)
            assert lost and here.motor.starts == 1 and starts_sent(here) == 1
            assert outcome.status == ("confirmed" if kind.reports_running else "unknown")

    run_virtual(scenario())


@every_drive
def test_a_lost_start_is_sent_again_only_where_the_drive_reports_stopped(kind: SystemVariant) -> None:
    """Ruling 6; never for DF800, which shows nothing."""

    async def scenario() -> None:
        async with system_bench(kind) as here:
            lost = first_request_fate(here.station(), is_start(here), lambda: None, hears=False)
            outcome = await command_ending(here.drive.run(20.0))
            await asyncio.sleep(3.0)
            assert lost
            assert here.motor.starts == (1 if kind.reports_running else 0)
            assert starts_sent(here) == (2 if kind.reports_running else 1)
            assert outcome.status == ("confirmed" if kind.reports_running else "unknown")

    run_virtual(scenario())


@pytest.mark.parametrize("after_s", [0.45, 0.6, 0.8, 1.2, 1.8])
@every_drive
def test_a_stop_at_the_keypad_is_not_undone_by_the_master(kind: SystemVariant, after_s: float) -> None:
    """The start was executed and its reply lost; once running was seen nobody sends it again."""

    async def scenario() -> None:
        async with system_bench(kind, ramp=6) as here:
            loop = asyncio.get_running_loop()
            station = here.station()
            lost = first_request_fate(
                station, is_start(here), lambda: discard(loop.call_later(after_s, station.keypad_stop)), hears=True
            )
            await command_ending(here.drive.run(20.0))
            await asyncio.sleep(8.0)
            assert lost and here.motor.starts == 1 and starts_sent(here) == 1
            assert not here.motor.energised

    run_virtual(scenario())


def discard(_: object) -> None:
    """Takes a value and gives none."""


@every_drive
def test_a_start_whose_drive_goes_silent_is_unknown_and_not_repeated(kind: SystemVariant) -> None:
    async def scenario() -> None:
        async with system_bench(kind) as here:
            station = here.station()
            first_request_fate(station, is_start(here), lambda: setattr(station.faults, "mute", True), hears=True)
            outcome = await command_ending(here.drive.run(20.0))
            assert outcome.status == "unknown"
            assert here.motor.starts == 1
            frames = starts_sent(here)
            station.faults.mute = False
            await asyncio.sleep(90.0)
            assert here.motor.starts == 1 and starts_sent(here) == frames == 1, "nothing is sent by itself later"

    run_virtual(scenario())


@every_reporting_drive
def test_a_drive_that_ignores_commands_of_the_bus_is_never_reported_started(kind: SystemVariant) -> None:
    """The pre-flight names it where the parameter can be read; else the motor that stands tells."""

    async def scenario() -> None:
        async with system_bench(kind) as here:
            key = {"dzb100": 1, "vc660": 0x0100}.get(kind.model, 0x003)
            for candidate in ("COMMAND_SOURCE", "COMMAND_CHANNEL"):
                key = getattr(__import__(type(here.station()).__module__, fromlist=["x"]), candidate, key)
            here.station().keypad_set(key, 0)
            outcome = await command_ending(here.drive.run(20.0))
            await asyncio.sleep(2.0)
            assert here.motor.starts == 0
            assert isinstance(outcome, DrivebusError) or outcome.status == "failed"

    run_virtual(scenario())


WORDS = {"confirmed", "acknowledged", "refused", "failed", "unknown"}


@pytest.mark.parametrize("weather", ["loss=0.1,flip=0.001,bytes", "late=0.15:0.12,bytes", "noisy,bytes"])
@every_drive
def test_on_a_bad_line_every_reported_outcome_matches_the_motor(kind: SystemVariant, weather: str) -> None:
    """G05 in the small: a hundred commands a drive; what is called confirmed is so, and no start is executed twice."""

    async def scenario(seed: int) -> None:
        chance = random.Random(seed)
        async with system_bench(kind, "1", weather, seed=seed) as here:
            words: set[str] = set()
            for _ in range(25):
                starts, was_running = here.motor.starts, here.motor.energised
                command = chance.choice(("run", "run", "stop", "set"))
                hz = chance.choice((5.0, 12.0, 20.0))
                if command == "run":
                    outcome = await command_ending(here.drive.run(hz))
                elif command == "stop":
                    outcome = await command_ending(here.drive.stop())
                else:
                    outcome = await command_ending(here.drive.set_frequency(hz))
                motor = here.motor
                assert motor.starts - starts <= (0 if was_running or command != "run" else 1)
                if isinstance(outcome, Exception):
                    assert isinstance(outcome, DrivebusError)
                    continue
                words.add(outcome.status)
                if outcome.status == "confirmed" and command == "stop":
                    assert not motor.energised
                elif outcome.status == "confirmed" and command == "run":
                    assert motor.energised and not motor.stopping
                if (
                    outcome.status == "confirmed"
                    and "set_frequency" in here.drive.profile.signals
                    and command != "stop"
                ):
                    station = here.station()
                    assert getattr(station, "reference_hz", station.setpoint_hz) == pytest.approx(hz)
                await asyncio.sleep(chance.uniform(0.0, 2.0))
            assert words <= WORDS and (kind.reports_running or "confirmed" not in words)
            here.tap.check(kind)

    for seed in range(4):
        run_virtual(scenario(seed))


def test_a_df800_outcome_is_acknowledged_without_confirmation() -> None:
    """T17, ruling 1: its yes is acknowledged and no more."""

    async def scenario() -> None:
        async with system_bench(DF800) as here:
            for command in (here.drive.run(10.0), here.drive.set_frequency(12.0), here.drive.stop()):
                assert (await command).status == "acknowledged"
            assert (await here.drive.status()).state == "unknown"
            assert StopMode.COAST.value not in here.drive.profile.capabilities

    run_virtual(scenario())


def test_every_simulated_model_is_tested() -> None:
    from drivebus.simulator.models.catalog import simulated_models

    assert {kind.model for kind in SYSTEM_VARIANTS} == set(simulated_models())
