"""Stops under load: each is the next frame on the wire (I3), never later than its bound, and never lost."""

from __future__ import annotations

import asyncio
import random

import pytest

from drivebus.bus import Poll
from drivebus.bus.messages import BusRequest, Permit, RequestPriority
from drivebus.drives import stop_bus
from drivebus.drives.dialects.base import StopMode
from drivebus.errors import Superseded
from fixtures.system_bench import (
    C320,
    DF800,
    DZB100,
    FAMILIES,
    VC660,
    SystemBench,
    SystemVariant,
    every_drive,
    every_family,
    every_line_quality,
    outcome_or_error,
    run_virtual,
    system_bench,
)
from system.test_polling import request

FOREIGN_TRAFFIC_MAX_CHARACTERS = 64
"""A stop waits at most this many characters for bytes of other senders, such as a late reply."""


def stop_of(bench: SystemBench, address: int) -> BusRequest:
    """Return the plain stop of the family."""
    return BusRequest(
        station=address,
        request=bench.drives[address].dialect.stop(StopMode.STOP)[0],
        priority=RequestPriority.STOP,
    )


def full_load(bench: SystemBench) -> list[asyncio.Task[object]]:
    """Start polls without a pause and parameter reads of every drive that never end."""
    tasks: list[asyncio.Task[object]] = []

    async def reads(address: int, priority: RequestPriority) -> None:
        dialect = bench.drives[address].dialect
        while True:
            await bench.bus.transact(BusRequest(station=address, request=dialect.echo_test_read(), priority=priority))

    for address in bench.drives:
        bench.bus.start_polling(address, [Poll(request(bench.variant, address), 0.0)], lambda result: None)
        tasks += [
            asyncio.ensure_future(reads(address, priority))
            for priority in (RequestPriority.PARAMETER, RequestPriority.COMMAND)
        ]
    return tasks


def bound_s(bench: SystemBench, address: int, line_quality: str) -> float:
    """Return the longest transaction that may be on the wire, plus the gap and the stop frame."""
    line, config = bench.bus.settings, bench.station_config(address)
    requests = [request(bench.variant, address), bench.drives[address].dialect.echo_test_read()]
    sync_requests = [config.sync_request(n) for n in range(8)]
    longest = max(
        line.seconds(len(config.codec.encode_request(sent)))
        + config.timing.timeout_s(line, config.codec.largest_reply(sent))
        for sent in requests + sync_requests
    )
    stop = len(config.codec.encode_request(stop_of(bench, address).request))
    foreign_traffic_s = line.seconds(FOREIGN_TRAFFIC_MAX_CHARACTERS) if "late" in line_quality else 0.0
    return longest + config.timing.gap_s(line) + line.seconds(stop) + foreign_traffic_s


@every_line_quality
@every_family
def test_a_stop_is_the_next_frame_on_a_crowded_wire_at_any_instant(variant: SystemVariant, line_quality: str) -> None:
    async def scenario() -> None:
        rng = random.Random(3)
        async with system_bench(variant, "1-5", line_quality) as bench:
            bench.station(5).faults.silent = True
            tasks = full_load(bench)
            await asyncio.sleep(3.0)
            for _ in range(40):
                await asyncio.sleep(rng.uniform(0.0, 0.4))
                address, requested_at = rng.randrange(1, 6), bench.bus.now()
                stop = stop_of(bench, address)
                data = bench.station_config(address).codec.encode_request(stop.request)
                sent_before = len(bench.tap.requests_sent)
                result = await bench.bus.transact(stop)
                after = [frame for frame in bench.tap.requests_sent[sent_before:] if frame.start >= requested_at]
                assert after[0].data == data, "another frame was sent first"
                assert result.sent == data
                assert after[0].end - requested_at <= bound_s(bench, address, line_quality) + 1e-3
            for task in tasks:
                task.cancel()
            bench.tap.check(variant)

    run_virtual(scenario())


@every_line_quality
@every_family
def test_a_stop_removes_the_queued_commands_of_its_drive_only(variant: SystemVariant, line_quality: str) -> None:
    async def scenario() -> None:
        async with system_bench(variant, "1-2", line_quality) as bench:
            for address in bench.drives:
                await outcome_or_error(bench.drives[address].status())
            dialects = {address: drive.dialect for address, drive in bench.drives.items()}
            word = dialects[1].setpoint_word(10.0)
            await bench.bus.transact(
                BusRequest(station=1, request=dialects[1].echo_test_read(), priority=RequestPriority.COMMAND)
            )
            busy = asyncio.ensure_future(
                bench.bus.transact(
                    BusRequest(station=2, request=dialects[2].echo_test_read(), priority=RequestPriority.COMMAND)
                )
            )
            await asyncio.sleep(0)
            commands = {
                address: asyncio.ensure_future(bench.bus.transact(start_of(bench, address, word)))
                for address in dialects
            }
            await asyncio.sleep(0)
            stopped = await bench.bus.transact(stop_of(bench, 1))
            assert stopped.sent
            first, second = await commands[1], await commands[2]
            assert isinstance(first.error, Superseded) and not first.sent
            assert not isinstance(second.error, Superseded) and bench.station(1).motor.starts == 0
            if line_quality in ("clean", "bytes"):
                assert stopped.error is None and (await busy).error is None and second.error is None
                assert bench.station(2).motor.starts == 1
            await busy
            await bench.bus.transact(stop_of(bench, 2))

    run_virtual(scenario())


@every_family
def test_i3_a_stop_is_on_the_wire_in_the_loop_iteration_that_requests_it(variant: SystemVariant) -> None:
    """A loop iteration later a due poll might be sent first."""

    async def scenario() -> None:
        async with system_bench(variant) as bench:
            await outcome_or_error(bench.drive.status())
            await asyncio.sleep(1.0)
            before = len(bench.tap.requests_sent)
            stopping = asyncio.ensure_future(bench.drive.stop())
            await asyncio.sleep(0)
            assert [frame.data for frame in bench.tap.requests_sent[before:]] == [
                bench.drive.dialect.codec.encode_request(stop_of(bench, 1).request)
            ]
            await outcome_or_error(stopping)

    run_virtual(scenario())


def start_of(bench: SystemBench, address: int, word: int) -> BusRequest:
    """Return a start with a valid permit."""
    config, dialect = bench.station_config(address), bench.drives[address].dialect
    frame = dialect.start(None, word)[0]
    effect = config.effect_of(config.codec.encode_request(frame.request))
    until = bench.bus.now() + 2.0
    permit = Permit(
        station=address,
        effect=effect,
        retry_policy=frame.retry_policy,
        expires_at=until,
        stop_epoch=bench.bus.stop_epoch(address),
        command_id="test",
    )
    return BusRequest(
        station=address,
        request=frame.request,
        priority=RequestPriority.COMMAND,
        permit=permit,
        expires_at=until,
    )


@every_drive
def test_a_stop_at_any_moment_of_a_start_overrides_it(variant: SystemVariant) -> None:
    """Whatever the start waits for, after the stop the motor is stopped and not started again."""

    async def scenario(after_s: float) -> None:
        async with system_bench(variant) as bench:
            starting = asyncio.ensure_future(outcome_or_error(bench.drive.run(20.0)))
            await asyncio.sleep(after_s)
            stopped = await outcome_or_error(bench.drive.stop())
            sent_before = len(bench.tap.requests_sent)
            started = await starting
            await asyncio.sleep(10.0)
            assert not bench.motor.energised and bench.motor.output_hz == 0.0
            assert bench.motor.starts <= 1
            assert stopped.status == ("confirmed" if variant.reports_running else "acknowledged")
            late = [frame.data for frame in bench.tap.requests_sent[sent_before:]]
            start = bench.station_config().codec.encode_request(
                bench.drive.dialect.start(None, bench.drive.dialect.setpoint_word(20.0))[0].request
            )
            assert start not in late
            if isinstance(started, Exception):
                assert isinstance(started, Superseded)
            else:
                assert started.status in ("confirmed", "acknowledged", "unknown", "failed")

    for step in range(14):
        run_virtual(scenario(0.07 * step + 0.003))


@every_drive
def test_a_stop_removes_every_queued_command(variant: SystemVariant) -> None:
    """Commands of one drive wait for each other, and all were requested before the stop."""

    async def scenario(after_s: float) -> None:
        async with system_bench(variant) as bench:
            commands = [asyncio.ensure_future(outcome_or_error(bench.drive.run(hz))) for hz in (20.0, 15.0)]
            commands.append(asyncio.ensure_future(outcome_or_error(bench.drive.set_frequency(10.0))))
            await asyncio.sleep(after_s)
            await outcome_or_error(bench.drive.stop())
            stopped_at = bench.bus.now()
            await asyncio.gather(*commands)
            await asyncio.sleep(10.0)
            assert not bench.motor.energised and bench.motor.starts <= 1
            late = [frame.data for frame in bench.tap.requests_sent if frame.start > stopped_at]
            assert {bench.station_config().effect_of(data).value for data in late} <= {"none", "stop"}

    for step in range(8):
        run_virtual(scenario(0.15 * step + 0.003))


@every_drive
def test_a_stop_at_any_moment_of_a_jog_overrides_it(variant: SystemVariant) -> None:
    async def scenario(after_s: float) -> None:
        async with system_bench(variant) as bench:

            async def jog() -> None:
                hz = None if variant.encoding == "rtu" or variant.model == "df800" else 5.0
                async with bench.drive.jog(hz) as lease:
                    for _ in range(10):
                        await asyncio.sleep(0.2)
                        if not lease.expired:
                            lease.renew()

            jogging = asyncio.ensure_future(outcome_or_error(jog()))
            await asyncio.sleep(after_s)
            await outcome_or_error(bench.drive.stop())
            stopped_at = bench.bus.now()
            await jogging
            await asyncio.sleep(5.0)
            assert not bench.motor.energised and bench.motor.starts <= 1
            late = [frame.data for frame in bench.tap.requests_sent if frame.start > stopped_at]
            assert {bench.station_config().effect_of(data).value for data in late} <= {"none", "stop"}

    for step in range(8):
        run_virtual(scenario(0.11 * step + 0.003))


@every_drive
def test_a_stop_through_loss_and_lateness_is_confirmed_only_by_a_stopped_motor(variant: SystemVariant) -> None:
    async def scenario(line_quality: str, seed: int) -> None:
        async with system_bench(variant, "1", "clean", seed=seed) as bench:
            assert (await outcome_or_error(bench.drive.run(20.0))).succeeded
            await asyncio.sleep(1.0)
            bench.simulated_bus.line_quality = line_quality
            stopped = await outcome_or_error(bench.drive.stop())
            if stopped.status == "confirmed":
                assert not bench.motor.energised
            bench.simulated_bus.line_quality = "clean"
            await asyncio.sleep(5.0)
            assert not bench.motor.energised, "an unconfirmed stop is repeated until it is confirmed"
            await asyncio.sleep(20.0)
            assert not variant.reports_running or not bench.drive.stop_pending

    for seed in range(4):
        for line_quality in ("loss=0.3,flip=0.002,bytes", "late=0.3:0.15,bytes"):
            run_virtual(scenario(line_quality, seed))


async def confirmed_or_alarmed(bench: SystemBench, address: int) -> None:
    requested_at, motor = bench.bus.now(), bench.station(address).motor
    ramp_s = motor.output_hz / motor.ramp_base_hz * motor.decel_s
    outcome = await outcome_or_error(bench.drives[address].stop())
    limit_s = bound_s(bench, address, "clean") + 2.0 + (ramp_s if outcome.succeeded else 0.0)
    assert bench.bus.now() - requested_at <= limit_s
    if not outcome.succeeded:
        assert outcome.status == "unknown" and bench.drives[address].stop_pending
        stop = bench.station_config(address).codec.encode_request(stop_of(bench, address).request)
        count = bench.tap.requests(stop)
        await asyncio.sleep(40.0)
        assert bench.tap.requests(stop) > count, "the stop is repeated"
        assert (
            not bench.variant.reports_running
            or bench.drives[address].stop_pending is bench.station(address).faults.silent
        )


@every_family
def test_a_stop_is_confirmed_or_alarmed_in_time_on_a_bus_that_is_never_idle(variant: SystemVariant) -> None:
    """The limit is the stop bound + 2 s + the ramp of a motor that has stopped, whatever is queued before its reads."""

    async def scenario() -> None:
        async with system_bench(variant, "1-5") as bench:
            bench.station(2).faults.silent = True
            bench.station(1).keypad_run(20.0)
            tasks = full_load(bench)
            try:
                await asyncio.sleep(3.0)
                for address in (1, 2):
                    await confirmed_or_alarmed(bench, address)
                assert not bench.station(1).motor.energised
            finally:
                for task in tasks:
                    task.cancel()

    run_virtual(scenario())


@pytest.mark.parametrize("variant", FAMILIES, ids=lambda variant: variant.name)
def test_a_bus_stop_stops_every_drive_and_shows_its_evidence(variant: SystemVariant) -> None:
    """The broadcast is first where the family has one (never DF800), then each drive; starts are inhibited after it."""

    async def scenario() -> None:
        async with system_bench(variant, "1-6") as bench:
            for drive in bench.drives.values():
                assert (await outcome_or_error(drive.run(15.0))).succeeded
            await asyncio.sleep(1.0)
            assert all(station.motor.energised for station in bench.simulated_bus.stations)
            started_at, sent_before = bench.bus.now(), len(bench.tap.requests_sent)
            report = await stop_bus(bench.bus, list(bench.drives.values()))
            reported_at = bench.bus.now()
            if not variant.reports_running:
                await asyncio.sleep(2.0)
            bench.simulated_bus.advance()
            assert not any(station.motor.energised for station in bench.simulated_bus.stations)
            frames = bench.tap.requests_sent[sent_before:]
            assert len(report.broadcasts) == (0 if variant.model == "df800" else 2)
            for index, sent in enumerate(report.broadcasts):
                assert frames[index].data == sent.sent and frames[index].start == sent.sent_at
                assert sent.received == b""
            statuses = {outcome.status for _, outcome in report.outcomes}
            assert statuses == {"confirmed"} if variant.reports_running else statuses == {"acknowledged"}
            assert report.confirmed is variant.reports_running and report.unconfirmed == ()
            assert (report.acknowledged == ()) is variant.reports_running
            assert report.started_at == started_at and report.ended_at == reported_at
            for address, outcome in report.outcomes:
                stop = bench.station_config(address).codec.encode_request(stop_of(bench, address).request)
                assert stop in [exchange.sent for exchange in outcome.exchanges]
                assert all(
                    exchange.sent_at is not None and exchange.sent_at >= started_at for exchange in outcome.exchanges
                )
            starts = sum(station.motor.starts for station in bench.simulated_bus.stations)
            rejected = await outcome_or_error(bench.drive.run(10.0))
            assert rejected.key in ("drives.start_inhibited", "bus.start_inhibited")
            assert sum(station.motor.starts for station in bench.simulated_bus.stations) == starts
            bench.bus.release_start()
            assert (await outcome_or_error(bench.drive.run(10.0))).succeeded
            await outcome_or_error(bench.drive.stop())

    run_virtual(scenario())


@pytest.mark.parametrize("variant", [C320, DZB100, VC660], ids=lambda variant: variant.name)
def test_a_broadcast_stop_has_stopped_the_bus_before_any_single_drive_is_addressed(variant: SystemVariant) -> None:
    async def scenario() -> None:
        async with system_bench(variant, "1-8") as bench:
            for drive in bench.drives.values():
                assert (await outcome_or_error(drive.run(10.0))).succeeded
            stopping = asyncio.ensure_future(stop_bus(bench.bus, list(bench.drives.values())))
            await asyncio.sleep(0.06 if variant is not DZB100 else 0.12)
            bench.simulated_bus.advance()
            assert all(s.motor.stopping or not s.motor.energised for s in bench.simulated_bus.stations)
            assert (await stopping).confirmed

    run_virtual(scenario())


def test_a_bus_stop_names_the_drive_that_does_not_reply() -> None:
    """It is reported unconfirmed in bounded time; the others are stopped and confirmed."""

    async def scenario() -> None:
        async with system_bench(C320, "1-4") as bench:
            for drive in bench.drives.values():
                assert (await outcome_or_error(drive.run(15.0))).succeeded
            bench.station(3).faults.silent = True
            report = await stop_bus(bench.bus, list(bench.drives.values()))
            assert report.unconfirmed == (3,) and not report.confirmed
            assert report.ended_at - report.started_at <= 6.0
            assert bench.station(3).motor.energised, "it did not receive the stop"
            assert not any(bench.station(n).motor.energised for n in (1, 2, 4))
            bench.station(3).faults.silent = False
            await asyncio.sleep(40.0)
            assert not bench.station(3).motor.energised, "the stop is repeated"

    run_virtual(scenario())


def test_a_drive_without_a_status_is_never_reported_stopped() -> None:
    """DF800 gets its stop three times, and the outcome is acknowledged, not confirmed (T17)."""

    async def scenario() -> None:
        async with system_bench(DF800) as bench:
            await bench.drive.run(10.0)
            outcome = await bench.drive.stop()
            stop = bench.station_config().codec.encode_request(stop_of(bench, 1).request)
            assert outcome.status == "acknowledged" and bench.tap.requests(stop) == 3

    run_virtual(scenario())
