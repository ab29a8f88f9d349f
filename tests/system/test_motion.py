"""Every command on every drive: the reported outcome compared with the motor (I1, I2)."""

from __future__ import annotations

import asyncio
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from drivebus import profiles
from drivebus.drives import Direction
from drivebus.drives.dialects.base import StopMode
from drivebus.errors import DrivebusError, StartInhibited, TargetNotReached
from drivebus.simulator.motor import Trip
from fixtures.system_bench import (
    DF800,
    SYSTEM_VARIANTS,
    SystemBench,
    SystemVariant,
    every_drive,
    every_reporting_drive,
    outcome_or_error,
    run_virtual,
    system_bench,
    wait_until,
)

RAMP_S = 2.0
FAMILY_TESTS = Path(__file__).parents[1] / "families"


def expected_status(variant: SystemVariant) -> str:
    """Return the status of an executed command: acknowledged where the drive reports no state (DF800)."""
    return "confirmed" if variant.reports_running else "acknowledged"


def output_hz(bench: SystemBench) -> float:
    """Return the output frequency of the motor: negative in reverse, 0 where the output is off."""
    motor = bench.motor
    return motor.output_hz if motor.energised else 0.0


@pytest.mark.parametrize("direction", list(Direction))
@every_drive
def test_a_run_turns_the_motor_in_its_direction_at_its_speed_and_a_stop_ends_it(
    variant: SystemVariant, direction: Direction
) -> None:
    async def scenario() -> None:
        async with system_bench(variant) as bench:
            sign = 1 if direction is Direction.FORWARD else -1
            started = await bench.drive.run(20.0, direction)
            assert started.status == expected_status(variant)
            assert bench.motor.energised and bench.motor.target_hz == pytest.approx(sign * 20.0)
            await asyncio.sleep(RAMP_S)
            assert output_hz(bench) == pytest.approx(sign * 20.0)
            assert bench.motor.starts == 1
            stopped = await bench.drive.stop()
            assert stopped.status == expected_status(variant)
            if variant.reports_running:
                assert not bench.motor.energised, "confirmed while it still turned"
            await asyncio.sleep(RAMP_S)
            assert not bench.motor.energised and bench.motor.starts == 1
            bench.tap.check(variant)

    run_virtual(scenario())


@every_reporting_drive
def test_waiting_returns_when_the_motor_has_reached_the_target_and_not_before(variant: SystemVariant) -> None:
    async def scenario() -> None:
        async with system_bench(variant) as bench:
            reached = await bench.drive.run(30.0, wait=True)
            assert reached.status == "confirmed"
            assert output_hz(bench) == pytest.approx(30.0, rel=0.005)
            ramp = 30.0 / bench.motor.ramp_base_hz * RAMP_S
            assert bench.bus.now() < ramp + 4.0

    run_virtual(scenario())


@every_reporting_drive
def test_waiting_for_a_motor_that_trips_raises_with_the_reported_state(variant: SystemVariant) -> None:
    async def scenario() -> None:
        async with system_bench(variant) as bench:
            waiting = asyncio.ensure_future(bench.drive.run(40.0, wait=True))
            await asyncio.sleep(0.9)
            await wait_until(lambda: bench.motor.energised)
            await asyncio.sleep(0.3)
            bench.station().trip(Trip.OVERCURRENT_ACCELERATING)
            with pytest.raises(TargetNotReached) as caught:
                await waiting
            assert caught.value.outcome.status == "failed"
            assert caught.value.outcome.drive_status.state in ("fault", "stopped", "not_ready")

    run_virtual(scenario())


@every_drive
def test_a_new_frequency_becomes_the_speed_of_the_motor(variant: SystemVariant) -> None:
    async def scenario() -> None:
        async with system_bench(variant) as bench:
            await bench.drive.run(10.0)
            await asyncio.sleep(RAMP_S)
            for hz in (25.0, 5.0, 12.5):
                changed = await outcome_or_error(bench.drive.set_frequency(hz))
                await asyncio.sleep(RAMP_S)
                assert output_hz(bench) == pytest.approx(hz)
                reports_setpoint = "set_frequency" in bench.drive.profile.signals
                assert changed.status == ("confirmed" if reports_setpoint else "acknowledged")
            assert bench.motor.starts == 1

    run_virtual(scenario())


@every_drive
def test_a_run_at_another_frequency_does_not_start_again(variant: SystemVariant) -> None:
    async def scenario() -> None:
        async with system_bench(variant) as bench:
            await bench.drive.run(10.0)
            await asyncio.sleep(RAMP_S)
            again = await outcome_or_error(bench.drive.run(20.0))
            await asyncio.sleep(RAMP_S)
            assert again.succeeded and output_hz(bench) == pytest.approx(20.0)
            assert bench.motor.starts == 1

    run_virtual(scenario())


@every_reporting_drive
def test_a_reverse_while_it_runs_forward_is_rejected_before_anything_is_sent(variant: SystemVariant) -> None:
    async def scenario() -> None:
        async with system_bench(variant) as bench:
            await bench.drive.run(10.0, Direction.FORWARD)
            await asyncio.sleep(RAMP_S)
            with pytest.raises(StartInhibited):
                await bench.drive.run(10.0, Direction.REVERSE)
            await asyncio.sleep(RAMP_S)
            assert output_hz(bench) == pytest.approx(10.0)

    run_virtual(scenario())


def jog_hz(variant: SystemVariant) -> float | None:
    """Return the requested jog frequency; Modbus models jog at the frequency set in the drive, 5 Hz."""
    return None if variant.encoding == "rtu" or variant.model == "df800" else 5.0


@every_drive
def test_a_jog_lasts_as_long_as_its_lease_is_renewed_and_no_longer(variant: SystemVariant) -> None:
    """Both the end of the jog and a missing renewal stop it (T13)."""

    async def scenario() -> None:
        async with system_bench(variant) as bench:
            for direction, sign in ((Direction.FORWARD, 1), (Direction.REVERSE, -1)):
                async with bench.drive.jog(jog_hz(variant), direction) as lease:
                    for _ in range(12):
                        await asyncio.sleep(0.2)
                        lease.renew()
                    assert output_hz(bench) == pytest.approx(sign * 5.0)
                assert lease.stop_outcome is not None and lease.stop_outcome.status == expected_status(variant)
                await asyncio.sleep(RAMP_S)
                assert not bench.motor.energised
            async with bench.drive.jog(jog_hz(variant)) as lease:
                started_at = bench.bus.now()
                await asyncio.sleep(0.7)
                assert lease.expired
                stops = [frame for frame in bench.tap.requests_sent if started_at + 0.5 <= frame.start]
                assert stops and stops[0].start - started_at <= 0.5 + 0.1, "the stop is sent when the lease ends"
                await asyncio.sleep(RAMP_S)
                assert not bench.motor.energised
                with pytest.raises(StartInhibited):
                    lease.renew()

    run_virtual(scenario())


@every_drive
def test_a_tripped_drive_is_reported_reset_and_started_again(variant: SystemVariant) -> None:
    async def scenario() -> None:
        async with system_bench(variant) as bench:
            await bench.drive.run(20.0)
            await asyncio.sleep(RAMP_S)
            bench.station().trip(Trip.OVERLOAD)
            status = await bench.drive.status()
            if variant.reports_running:
                assert status.state == "fault" and status.fault is not None
                assert status.fault.code == bench.station().trip_code(Trip.OVERLOAD)
                rejected = await outcome_or_error(bench.drive.run(20.0))
                assert not getattr(rejected, "succeeded", False)
            else:
                assert status.state == "unknown" and status.fault is None
            assert bench.motor.starts == 1 and bench.motor.trip is Trip.OVERLOAD
            reset = await outcome_or_error(bench.drive.reset_fault())
            assert reset.status == expected_status(variant)
            assert bench.motor.trip is None
            await asyncio.sleep(1.0)
            assert not bench.motor.energised, "a reset is not a start"
            assert (await outcome_or_error(bench.drive.run(20.0))).succeeded
            assert bench.motor.energised and bench.motor.starts == 2

    run_virtual(scenario())


@every_drive
def test_a_reset_without_a_fault_moves_nothing(variant: SystemVariant) -> None:
    async def scenario() -> None:
        async with system_bench(variant) as bench:
            assert (await outcome_or_error(bench.drive.reset_fault())).status == expected_status(variant)
            await asyncio.sleep(1.0)
            assert bench.motor.starts == 0

    run_virtual(scenario())


def lose_first_reply(
    station: Any, matches: Callable[[], bool], action: Callable[[], None], *, executed: bool
) -> list[int]:
    """Lose the reply to the first request that ``matches`` and call ``action``; the request is executed or lost too.

    The returned list is empty until then.
    """
    handle_request = station.handle_request
    lost: list[int] = []

    def handle_first(message: Any, codec: Any) -> Any:
        if lost or not matches():
            return handle_request(message, codec)
        lost.append(1)
        if executed:
            handle_request(message, codec)
        action()
        return None

    station.handle_request = handle_first
    return lost


def start_frames(bench: SystemBench, hz: float = 20.0) -> set[bytes]:
    """Return the bytes of a forward start at this frequency."""
    dialect = bench.drive.dialect
    return {dialect.codec.encode_request(dialect.start(None, dialect.setpoint_word(hz))[0].request)}


def is_start(bench: SystemBench, hz: float = 20.0) -> Callable[[], bool]:
    """Return a check whether the last request on the wire is a forward start at this frequency."""
    frames = start_frames(bench, hz)
    return lambda: bench.tap.requests_sent[-1].data in frames


def starts_sent(bench: SystemBench) -> int:
    return sum(bench.tap.requests(frame) for frame in start_frames(bench))


@every_drive
def test_a_lost_reply_to_a_start_never_starts_twice(variant: SystemVariant) -> None:
    """The reported state then decides; DF800 reports none, so its start is unknown and not resent (I2)."""

    async def scenario() -> None:
        async with system_bench(variant) as bench:
            lost = lose_first_reply(bench.station(), is_start(bench), lambda: None, executed=True)
            outcome = await outcome_or_error(bench.drive.run(20.0))
            await asyncio.sleep(3.0)
            assert lost and bench.motor.starts == 1 and starts_sent(bench) == 1
            assert outcome.status == ("confirmed" if variant.reports_running else "unknown")

    run_virtual(scenario())


@every_drive
def test_a_lost_start_is_sent_again_only_where_the_drive_reports_stopped(variant: SystemVariant) -> None:
    """A DF800 reports no state, so its start is never resent."""

    async def scenario() -> None:
        async with system_bench(variant) as bench:
            lost = lose_first_reply(bench.station(), is_start(bench), lambda: None, executed=False)
            outcome = await outcome_or_error(bench.drive.run(20.0))
            await asyncio.sleep(3.0)
            assert lost
            assert bench.motor.starts == (1 if variant.reports_running else 0)
            assert starts_sent(bench) == (2 if variant.reports_running else 1)
            assert outcome.status == ("confirmed" if variant.reports_running else "unknown")

    run_virtual(scenario())


@pytest.mark.parametrize("after_s", [0.45, 0.6, 0.8, 1.2, 1.8])
@every_drive
def test_a_stop_at_the_keypad_is_not_undone_by_the_master(variant: SystemVariant, after_s: float) -> None:
    """The start is executed and its reply lost; once the drive has reported running, it is not sent again."""

    async def scenario() -> None:
        async with system_bench(variant, ramp=6) as bench:
            loop = asyncio.get_running_loop()
            station = bench.station()
            lost = lose_first_reply(
                station, is_start(bench), lambda: discard(loop.call_later(after_s, station.keypad_stop)), executed=True
            )
            await outcome_or_error(bench.drive.run(20.0))
            await asyncio.sleep(8.0)
            assert lost and bench.motor.starts == 1 and starts_sent(bench) == 1
            assert not bench.motor.energised

    run_virtual(scenario())


def discard(_: object) -> None:
    """Accept any value and return None."""


@every_drive
def test_a_start_whose_drive_goes_silent_is_unknown_and_not_repeated(variant: SystemVariant) -> None:
    async def scenario() -> None:
        async with system_bench(variant) as bench:
            station = bench.station()
            lose_first_reply(station, is_start(bench), lambda: setattr(station.faults, "mute", True), executed=True)
            outcome = await outcome_or_error(bench.drive.run(20.0))
            assert outcome.status == "unknown"
            assert bench.motor.starts == 1
            frames = starts_sent(bench)
            station.faults.mute = False
            await asyncio.sleep(90.0)
            assert bench.motor.starts == 1 and starts_sent(bench) == frames == 1, "nothing is sent later"

    run_virtual(scenario())


@every_reporting_drive
def test_a_drive_that_ignores_commands_of_the_bus_is_never_reported_started(variant: SystemVariant) -> None:
    """The preflight reports it where the parameter can be read; otherwise the stopped motor shows it."""

    async def scenario() -> None:
        async with system_bench(variant) as bench:
            key = {"dzb100": 1, "vc660": 0x0100}.get(variant.model, 0x003)
            for candidate in ("COMMAND_SOURCE", "COMMAND_CHANNEL"):
                key = getattr(__import__(type(bench.station()).__module__, fromlist=["x"]), candidate, key)
            bench.station().keypad_set(key, 0)
            outcome = await outcome_or_error(bench.drive.run(20.0))
            await asyncio.sleep(2.0)
            assert bench.motor.starts == 0
            assert isinstance(outcome, DrivebusError) or outcome.status == "failed"

    run_virtual(scenario())


STATUSES = {"confirmed", "acknowledged", "refused", "failed", "unknown"}


@pytest.mark.parametrize("line_quality", ["loss=0.1,flip=0.001,bytes", "late=0.15:0.12,bytes", "noisy,bytes"])
@every_drive
def test_on_a_bad_line_every_reported_outcome_matches_the_motor(variant: SystemVariant, line_quality: str) -> None:
    """In a hundred commands a drive every confirmed outcome is true, and no start is executed twice."""

    async def scenario(seed: int) -> None:
        rng = random.Random(seed)
        async with system_bench(variant, "1", line_quality, seed=seed) as bench:
            statuses: set[str] = set()
            for _ in range(25):
                starts, was_running = bench.motor.starts, bench.motor.energised
                command = rng.choice(("run", "run", "stop", "set"))
                hz = rng.choice((5.0, 12.0, 20.0))
                if command == "run":
                    outcome = await outcome_or_error(bench.drive.run(hz))
                elif command == "stop":
                    outcome = await outcome_or_error(bench.drive.stop())
                else:
                    outcome = await outcome_or_error(bench.drive.set_frequency(hz))
                motor = bench.motor
                assert motor.starts - starts <= (0 if was_running or command != "run" else 1)
                if isinstance(outcome, Exception):
                    assert isinstance(outcome, DrivebusError)
                    continue
                statuses.add(outcome.status)
                if outcome.status == "confirmed" and command == "stop":
                    assert not motor.energised
                elif outcome.status == "confirmed" and command == "run":
                    assert motor.energised and not motor.stopping
                if (
                    outcome.status == "confirmed"
                    and "set_frequency" in bench.drive.profile.signals
                    and command != "stop"
                ):
                    station = bench.station()
                    assert getattr(station, "reference_hz", station.setpoint_hz) == pytest.approx(hz)
                await asyncio.sleep(rng.uniform(0.0, 2.0))
            assert statuses <= STATUSES and (variant.reports_running or "confirmed" not in statuses)
            bench.tap.check(variant)

    for seed in range(4):
        run_virtual(scenario(seed))


def test_a_df800_outcome_is_acknowledged_without_confirmation() -> None:
    """The acknowledgement of a DF800 does not prove that the motor moves (T17)."""

    async def scenario() -> None:
        async with system_bench(DF800) as bench:
            for command in (bench.drive.run(10.0), bench.drive.set_frequency(12.0), bench.drive.stop()):
                assert (await command).status == "acknowledged"
            assert (await bench.drive.status()).state == "unknown"
            assert StopMode.COAST.value not in bench.drive.profile.capabilities

    run_virtual(scenario())


def test_every_simulated_model_is_tested() -> None:
    """The families of ``drivebus.families`` have a story of their own in ``tests/families``."""
    from drivebus.simulator.models.catalog import simulated_models

    families = {model: profiles.load(model).family for model in simulated_models()}
    own = {model for model, family in families.items() if (FAMILY_TESTS / f"test_{family}.py").exists()}
    assert own >= {"huanyang_hy", "fr_e500"}
    assert {variant.model for variant in SYSTEM_VARIANTS} == set(simulated_models()) - own
