"""Stops against everything else: next on the wire (I3), never later than the bound, never lost."""

from __future__ import annotations

import asyncio
import random

import pytest

from drivebus.bus import Poll
from drivebus.bus.messages import BusRequest, Permit, RequestPriority, RetryPolicy
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
    command_ending,
    every_drive,
    every_family,
    on_four_lines,
    run_virtual,
    system_bench,
)
from system.test_polling import request

FOREIGN_TRAFFIC_MAX_CHARACTERS = 64
"""A stop waits no longer than this for a line that babbles (a late answer may be on it)."""


def stop_of(here: SystemBench, address: int) -> BusRequest:
    """The family's plain stop."""
    return BusRequest(
        address, here.drives[address].dialect.stop(StopMode.STOP)[0], RequestPriority.STOP, RetryPolicy.IDEMPOTENT
    )


def full_load(here: SystemBench) -> list[asyncio.Task[object]]:
    """Polls as fast as they go, and queues that never empty: parameter reads of every drive."""
    tasks: list[asyncio.Task[object]] = []

    async def reads(address: int, lane: RequestPriority) -> None:
        dialect = here.drives[address].dialect
        while True:
            await here.bus.transact(BusRequest(address, dialect.echo_test_read(), lane))

    for address in here.drives:
        here.bus.start_polling(address, [Poll(request(here.kind, address), 0.0)], lambda answer: None)
        tasks += [
            asyncio.ensure_future(reads(address, lane)) for lane in (RequestPriority.PARAMETER, RequestPriority.COMMAND)
        ]
    return tasks


def bound_s(here: SystemBench, address: int, weather: str) -> float:
    """The rest of what is on the wire, its whole time to answer, the gap, the stop frame."""
    line, link = here.bus.settings, here.link(address)
    asks = [request(here.kind, address), here.drives[address].dialect.echo_test_read()]
    fences = [link.sync_request(n) for n in range(8)]
    longest = max(
        line.seconds(len(link.codec.encode_request(ask))) + link.timing.timeout_s(line, link.codec.largest_reply(ask))
        for ask in asks + fences
    )
    stop = len(link.codec.encode_request(stop_of(here, address).request))
    babble = line.seconds(FOREIGN_TRAFFIC_MAX_CHARACTERS) if "late" in weather else 0.0
    return longest + link.timing.gap_s(line) + line.seconds(stop) + babble


@on_four_lines
@every_family
def test_a_stop_is_the_next_frame_on_a_crowded_wire_at_any_instant(kind: SystemVariant, weather: str) -> None:
    async def scenario() -> None:
        chance = random.Random(3)
        async with system_bench(kind, "1-5", weather) as here:
            here.station(5).faults.silent = True
            tasks = full_load(here)
            await asyncio.sleep(3.0)
            for _ in range(40):
                await asyncio.sleep(chance.uniform(0.0, 0.4))
                address, wished_at = chance.randrange(1, 6), here.bus.now()
                ask = stop_of(here, address)
                data = here.link(address).codec.encode_request(ask.request)
                text = len(here.tap.requests_sent)
                answer = await here.bus.transact(ask)
                after = [one for one in here.tap.requests_sent[text:] if one.start >= wished_at]
                assert after[0].data == data, "something else left first"
                assert answer.sent == data
                assert after[0].end - wished_at <= bound_s(here, address, weather) + 1e-3
            for task in tasks:
                task.cancel()
            here.tap.check(kind)

    run_virtual(scenario())


@on_four_lines
@every_family
def test_a_stop_deletes_what_was_queued_for_its_drive_and_nothing_else(kind: SystemVariant, weather: str) -> None:
    async def scenario() -> None:
        async with system_bench(kind, "1-2", weather) as here:
            for address in here.drives:
                await command_ending(here.drives[address].status())
            dialects = {address: drive.dialect for address, drive in here.drives.items()}
            word = dialects[1].setpoint_word(10.0)
            await here.bus.transact(BusRequest(1, dialects[1].echo_test_read(), RequestPriority.COMMAND))
            busy = asyncio.ensure_future(
                here.bus.transact(BusRequest(2, dialects[2].echo_test_read(), RequestPriority.COMMAND))
            )
            await asyncio.sleep(0)
            commands = {
                address: asyncio.ensure_future(here.bus.transact(start_of(here, address, word))) for address in dialects
            }
            await asyncio.sleep(0)
            stopped = await here.bus.transact(stop_of(here, 1))
            assert stopped.sent
            first, second = await commands[1], await commands[2]
            assert isinstance(first.error, Superseded) and not first.sent
            assert not isinstance(second.error, Superseded) and here.station(1).motor.starts == 0
            if weather in ("clean", "bytes"):
                assert stopped.error is None and (await busy).error is None and second.error is None
                assert here.station(2).motor.starts == 1
            await busy
            await here.bus.transact(stop_of(here, 2))

    run_virtual(scenario())


@every_family
def test_i3_a_stop_is_on_the_wire_in_the_loop_iteration_that_requests_it(kind: SystemVariant) -> None:
    """A turn later a poll that is due may have gone first."""

    async def scenario() -> None:
        async with system_bench(kind) as here:
            await command_ending(here.drive.status())
            await asyncio.sleep(1.0)
            before = len(here.tap.requests_sent)
            stopping = asyncio.ensure_future(here.drive.stop())
            await asyncio.sleep(0)
            assert [one.data for one in here.tap.requests_sent[before:]] == [
                here.drive.dialect.codec.encode_request(stop_of(here, 1).request)
            ]
            await command_ending(stopping)

    run_virtual(scenario())


def start_of(here: SystemBench, address: int, word: int) -> BusRequest:
    """A start with a good permit, as the gate would give it."""
    link, dialect = here.link(address), here.drives[address].dialect
    frame = dialect.start(None, word)[0]
    effect = link.effect_of(link.codec.encode_request(frame.request))
    until = here.bus.now() + 2.0
    permit = Permit(
        station=address,
        effect=effect,
        retry_policy=frame.retry_policy,
        expires_at=until,
        stop_epoch=here.bus.stop_epoch(address),
        command_id="story",
    )
    return BusRequest(address, frame.request, RequestPriority.COMMAND, frame.retry_policy, permit, until)


@every_drive
def test_a_stop_at_any_moment_of_a_start_overrides_it(kind: SystemVariant) -> None:
    """Whatever the start was waiting for, after the stop the motor stands and nothing starts it again."""

    async def scenario(after_s: float) -> None:
        async with system_bench(kind) as here:
            starting = asyncio.ensure_future(command_ending(here.drive.run(20.0)))
            await asyncio.sleep(after_s)
            stopped = await command_ending(here.drive.stop())
            asked = len(here.tap.requests_sent)
            started = await starting
            await asyncio.sleep(10.0)
            assert not here.motor.energised and here.motor.output_hz == 0.0
            assert here.motor.starts <= 1
            assert stopped.status == ("confirmed" if kind.reports_running else "acknowledged")
            late = [one.data for one in here.tap.requests_sent[asked:]]
            start = here.link().codec.encode_request(
                here.drive.dialect.start(None, here.drive.dialect.setpoint_word(20.0))[0].request
            )
            assert start not in late
            if isinstance(started, Exception):
                assert isinstance(started, Superseded)
            else:
                assert started.status in ("confirmed", "acknowledged", "unknown", "failed")

    for step in range(14):
        run_virtual(scenario(0.07 * step + 0.003))


@every_drive
def test_a_stop_removes_every_queued_command(kind: SystemVariant) -> None:
    """Commands of one drive wait for each other, and each was wished for before the stop."""

    async def scenario(after_s: float) -> None:
        async with system_bench(kind) as here:
            commands = [asyncio.ensure_future(command_ending(here.drive.run(hz))) for hz in (20.0, 15.0)]
            commands.append(asyncio.ensure_future(command_ending(here.drive.set_frequency(10.0))))
            await asyncio.sleep(after_s)
            await command_ending(here.drive.stop())
            stopped_at = here.bus.now()
            await asyncio.gather(*commands)
            await asyncio.sleep(10.0)
            assert not here.motor.energised and here.motor.starts <= 1
            late = [one.data for one in here.tap.requests_sent if one.start > stopped_at]
            assert {here.link().effect_of(data).value for data in late} <= {"none", "stop"}

    for step in range(8):
        run_virtual(scenario(0.15 * step + 0.003))


@every_drive
def test_a_stop_at_any_moment_of_a_jog_overrides_it(kind: SystemVariant) -> None:
    async def scenario(after_s: float) -> None:
        async with system_bench(kind) as here:

            async def jog() -> None:
                hz = None if kind.encoding == "rtu" or kind.model == "df800" else 5.0
                async with here.drive.jog(hz) as lease:
                    for _ in range(10):
                        await asyncio.sleep(0.2)
                        if not lease.expired:
                            lease.renew()

            jogging = asyncio.ensure_future(command_ending(jog()))
            await asyncio.sleep(after_s)
            await command_ending(here.drive.stop())
            stopped_at = here.bus.now()
            await jogging
            await asyncio.sleep(5.0)
            assert not here.motor.energised and here.motor.starts <= 1
            late = [one.data for one in here.tap.requests_sent if one.start > stopped_at]
            assert {here.link().effect_of(data).value for data in late} <= {"none", "stop"}

    for step in range(8):
        run_virtual(scenario(0.11 * step + 0.003))


@every_drive
def test_a_stop_through_loss_and_lateness_is_confirmed_only_by_a_stopped_motor(kind: SystemVariant) -> None:
    async def scenario(weather: str, seed: int) -> None:
        async with system_bench(kind, "1", "clean", seed=seed) as here:
            assert (await command_ending(here.drive.run(20.0))).succeeded
            await asyncio.sleep(1.0)
            here.bench.line_quality = weather
            stopped = await command_ending(here.drive.stop())
            if stopped.status == "confirmed":
                assert not here.motor.energised
            here.bench.line_quality = "clean"
            await asyncio.sleep(5.0)
            assert not here.motor.energised, "an unconfirmed stop is repeated until it is confirmed"
            await asyncio.sleep(20.0)
            assert not kind.reports_running or not here.drive.stop_pending

    for seed in range(4):
        for weather in ("loss=0.3,flip=0.002,bytes", "late=0.3:0.15,bytes"):
            run_virtual(scenario(weather, seed))


async def confirmed_or_alarmed(here: SystemBench, address: int) -> None:
    wished_at = here.bus.now()
    outcome = await command_ending(here.drives[address].stop())
    assert here.bus.now() - wished_at <= bound_s(here, address, "clean") + 2.0
    if not outcome.succeeded:
        assert outcome.key == "drives.stop_unconfirmed" and here.drives[address].stop_pending
        stop = here.link(address).codec.encode_request(stop_of(here, address).request)
        count = here.tap.requests(stop)
        await asyncio.sleep(40.0)
        assert here.tap.requests(stop) > count, "it is repeated"
        assert not here.kind.reports_running or here.drives[address].stop_pending is here.station(address).faults.silent


@every_family
def test_a_stop_is_confirmed_or_alarmed_in_time_on_a_bus_that_is_never_idle(kind: SystemVariant) -> None:
    """T_stop + 2 s, whatever waits in front of the reads that would confirm it; then it is repeated."""

    async def scenario() -> None:
        async with system_bench(kind, "1-5") as here:
            here.station(2).faults.silent = True
            here.station(1).keypad_run(20.0)
            tasks = full_load(here)
            try:
                await asyncio.sleep(3.0)
                for address in (1, 2):
                    await confirmed_or_alarmed(here, address)
                assert not here.station(1).motor.energised
            finally:
                for task in tasks:
                    task.cancel()

    run_virtual(scenario())


@pytest.mark.parametrize("kind", FAMILIES, ids=lambda kind: kind.name)
def test_a_bus_stop_stops_every_drive_and_shows_its_evidence(kind: SystemVariant) -> None:
    """Broadcast first where the family has one (never DF800), then one by one, latched until released."""

    async def scenario() -> None:
        async with system_bench(kind, "1-6") as here:
            for drive in here.drives.values():
                assert (await command_ending(drive.run(15.0))).succeeded
            await asyncio.sleep(1.0)
            assert all(station.motor.energised for station in here.bench.stations)
            begun, asked = here.bus.now(), len(here.tap.requests_sent)
            report = await stop_bus(here.bus, list(here.drives.values()))
            reported_at = here.bus.now()
            if not kind.reports_running:
                await asyncio.sleep(2.0)
            here.bench.advance()
            assert not any(station.motor.energised for station in here.bench.stations)
            text = here.tap.requests_sent[asked:]
            assert len(report.broadcasts) == {"df800": 0, "vc660": 4}.get(kind.model, 2), "VC660: a pulse and its end"
            for place, sent in enumerate(report.broadcasts):
                assert text[place].data == sent.sent and text[place].start == sent.sent_at
                assert sent.received == b""
            words = {outcome.status for _, outcome in report.outcomes}
            assert words == {"confirmed"} if kind.reports_running else words == {"acknowledged"}
            assert report.confirmed is kind.reports_running and (report.unconfirmed == ()) is kind.reports_running
            assert report.started_at == begun and report.ended_at == reported_at
            for address, outcome in report.outcomes:
                stop = here.link(address).codec.encode_request(stop_of(here, address).request)
                assert stop in [exchange.sent for exchange in outcome.exchanges]
                assert all(exchange.sent_at is not None and exchange.sent_at >= begun for exchange in outcome.exchanges)
            starts = sum(station.motor.starts for station in here.bench.stations)
            refused = await command_ending(here.drive.run(10.0))
            assert refused.key in ("drives.latched", "bus.start_inhibited")
            assert sum(station.motor.starts for station in here.bench.stations) == starts
            here.bus.release_start()
            assert (await command_ending(here.drive.run(10.0))).succeeded
            await command_ending(here.drive.stop())

    run_virtual(scenario())


@pytest.mark.parametrize("kind", [C320, DZB100, VC660], ids=lambda kind: kind.name)
def test_a_broadcast_stop_has_stopped_the_bus_before_any_single_drive_is_addressed(kind: SystemVariant) -> None:
    async def scenario() -> None:
        async with system_bench(kind, "1-8") as here:
            for drive in here.drives.values():
                assert (await command_ending(drive.run(10.0))).succeeded
            stopping = asyncio.ensure_future(stop_bus(here.bus, list(here.drives.values())))
            await asyncio.sleep(0.06 if kind is not DZB100 else 0.12)
            here.bench.advance()
            assert all(s.motor.stopping or not s.motor.energised for s in here.bench.stations)
            assert (await stopping).confirmed

    run_virtual(scenario())


def test_i3_the_levels_after_a_broadcast_pulse_let_stops_go_first() -> None:
    """VC660: somebody stops one drive while the broadcast's turnaround passes, and another one while that is sent."""

    async def scenario() -> None:
        async with system_bench(VC660, "1-3") as here:
            stopping = asyncio.ensure_future(stop_bus(here.bus, list(here.drives.values())))
            await asyncio.sleep(0.05)
            alone = [asyncio.ensure_future(here.bus.transact(stop_of(here, 2)))]
            await asyncio.sleep(0.065)
            alone.append(asyncio.ensure_future(here.bus.transact(stop_of(here, 3))))
            await asyncio.gather(stopping, *alone)
            assert [one.data[0] for one in here.tap.requests_sent[:4]] == [0, 2, 3, 0]

    run_virtual(scenario())


def test_a_bus_stop_names_the_drive_that_does_not_reply() -> None:
    """Unconfirmed and said so in bounded time; the others are stopped and confirmed."""

    async def scenario() -> None:
        async with system_bench(C320, "1-4") as here:
            for drive in here.drives.values():
                assert (await command_ending(drive.run(15.0))).succeeded
            here.station(3).faults.silent = True
            report = await stop_bus(here.bus, list(here.drives.values()))
            assert report.unconfirmed == (3,) and not report.confirmed
            assert report.ended_at - report.started_at <= 6.0
            assert here.station(3).motor.energised, "it never heard the stop"
            assert not any(here.station(n).motor.energised for n in (1, 2, 4))
            here.station(3).faults.silent = False
            await asyncio.sleep(40.0)
            assert not here.station(3).motor.energised, "the stop goes on being repeated"

    run_virtual(scenario())


def test_a_drive_without_a_status_is_never_reported_stopped() -> None:
    """T17: DF800 is told three times and acknowledged, not confirmed."""

    async def scenario() -> None:
        async with system_bench(DF800) as here:
            await here.drive.run(10.0)
            outcome = await here.drive.stop()
            stop = here.link().codec.encode_request(stop_of(here, 1).request)
            assert outcome.status == "acknowledged" and here.tap.requests(stop) == 3

    run_virtual(scenario())
