"""Stops beside many other requests: each has a frame sent after its request, and is confirmed in time.

One series of reads confirms all stops of a drive that are under way at once.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Awaitable, Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import cycle, islice
from typing import Any

import pytest

from drivebus.bus import Poll
from drivebus.bus.messages import BusRequest, BusResult, RequestPriority
from drivebus.bus.trace import TraceEvent, TraceKind
from drivebus.drives import Drive, stop_bus
from drivebus.drives.dialects.base import StopMode
from drivebus.drives.operations.steps import OWN_FRAME, BusConditions, GetBusConditions, run_pure
from drivebus.drives.operations.stop import (
    MAX_FIRST_FRAMES,
    STOP_PROGRESS_TIMEOUT_S,
    StopProgress,
    send_stop,
    timeout_transactions,
)
from drivebus.drives.outcome import Outcome
from drivebus.drives.shared_transactions import SharedTransactions
from drivebus.drives.stop_supervisor import JointStops
from drivebus.errors import DrivebusError, NoReply, StopUnconfirmed, Superseded
from drivebus.protocols.codec import Effect
from drivebus.simulator.motor import Motor
from fixtures.drives import (
    MODELS,
    SAFE_HZ,
    SimulatedDrives,
    dialect_for,
    operation_for,
    repeated,
    run_virtual,
)


@dataclass
class Report:
    """Outcomes of concurrent stops, their duration, and the number of frames by effect."""

    outcomes: list[Outcome] = field(default_factory=list)
    took_s: float = 0.0
    limit_s: float = 0.0  # by the rule of docs/explanation/bus-stop.md, where the test computes it
    frames: Counter[Effect] = field(default_factory=Counter)

    @property
    def keys(self) -> set[str]:
        return {outcome.key for outcome in self.outcomes}

    def check_frames(self, bench: SimulatedDrives, requested_at: float) -> None:
        """Check that each outcome has a stop that was sent after its request, and only reads that were sent after it.

        At most two frames are the first of these stops: one that was sent at once, and one for all that came then.
        """
        effect_of = bench.bus.core.stations[1].config.effect_of
        firsts = []
        for outcome in self.outcomes:
            first = next((e for e in outcome.exchanges if effect_of(e.sent) is Effect.STOP), None)
            assert first is not None or not outcome.succeeded
            if first is not None and first.sent_at is not None:
                assert all(
                    e.sent_at is not None and first.sent_at < e.sent_at for e in outcome.exchanges if e is not first
                )
                assert first.sent_at >= requested_at
                firsts.append(first.sent_at)
        assert len(set(firsts)) <= 2


async def stop_together(
    bench: SimulatedDrives, drive: Drive, count: int, begin: Callable[[], None] = lambda: None
) -> Report:
    """Stop a drive ``count`` times at once, after ``begin``, and check the frames of each outcome."""
    report = Report()
    effect_of = bench.bus.core.stations[1].config.effect_of

    def on_frame(event: TraceEvent) -> None:
        if event.kind is TraceKind.SENT:
            report.frames[effect_of(event.data)] += 1

    begin()
    began = bench.bus.now()
    end_trace = bench.bus.trace(on_frame)
    report.outcomes = await asyncio.gather(*(outcome_of(drive) for _ in range(count)))
    report.took_s = bench.bus.now() - began
    end_trace()
    report.check_frames(bench, began)
    return report


async def outcome_of(drive: Drive, joint: JointStops | None = None) -> Outcome:
    try:
        return await drive.stop(joint=joint)
    except StopUnconfirmed as error:
        outcome: Outcome = error.outcome
        return outcome


async def run_drive(drive: Drive, model: str) -> None:
    await drive.run(SAFE_HZ[model])
    await asyncio.sleep(3)


@pytest.mark.parametrize("count", [1, 10, 50])
@pytest.mark.parametrize("model", MODELS)
def test_every_one_of_many_stops_at_once_is_confirmed(model: str, count: int) -> None:
    """They read the drive in turns: 9 of 10 were reported as unconfirmed, with an alarm, although the motor stood."""

    async def scenario() -> Report:
        async with SimulatedDrives(model) as bench:
            drive = bench.drive()
            await run_drive(drive, model)
            report = await stop_together(bench, drive, count)
            await asyncio.sleep(5)  # DF800 acknowledges the stop while the motor ramps down
            assert not bench.station().running and not drive.stopping
            return report

    report = run_virtual(scenario())
    expected = "drives.stop_acknowledged" if model == "df800" else "drives.stop_confirmed"
    assert report.keys == {expected}
    assert report.frames[Effect.NONE] <= 130  # one stop of a motor that ramps down for 4 s: 100


def test_the_exchanges_of_stops_under_way_have_each_frame_once_and_in_order() -> None:
    """The audit record of a service that ended during four stops of a drive had 116 frames for 47."""

    async def scenario() -> None:
        async with SimulatedDrives("c320") as bench:
            drive = bench.drive()
            await run_drive(drive, "c320")
            sent: list[bytes] = []
            bench.bus.trace(lambda event: sent.append(event.data) if event.kind is TraceKind.SENT else None)
            stops = [asyncio.create_task(outcome_of(drive)) for _ in range(3)]
            await asyncio.sleep(0.5)
            exchanges = drive.stop_exchanges
            assert [exchange.sent for exchange in exchanges] == sent[: len(exchanges)]
            assert len(sent) - len(exchanges) <= 1, "the last frame may have no reply yet"
            assert {outcome.key for outcome in await asyncio.gather(*stops)} == {"drives.stop_confirmed"}

    run_virtual(scenario())


async def stop_on_a_lossy_line(model: str, count: int) -> Report:
    """Stop a drive where every tenth transaction fails; what is not confirmed is repeated until it is."""
    async with SimulatedDrives(model, query="line_quality=loss=0.05&seed=7&ramp=2") as bench:
        drive = bench.drive()
        bench.station().keypad_run(SAFE_HZ[model])
        await asyncio.sleep(3)
        report = await stop_together(bench, drive, count)
        assert drive.stop_pending or all(outcome.succeeded for outcome in report.outcomes)
        await asyncio.sleep(20)
        assert not drive.stopping and not bench.station().running
        return report


@pytest.mark.parametrize("model", ["c320", "vc660"])
def test_ten_stops_at_once_are_confirmed_where_every_tenth_transaction_fails(model: str) -> None:
    assert run_virtual(stop_on_a_lossy_line(model, 10)).keys == {"drives.stop_confirmed"}


@pytest.mark.parametrize("model", MODELS)
def test_fifty_stops_at_once_on_such_a_line_are_repeated_until_the_drive_confirms_one(model: str) -> None:
    """A lost reply makes the replies to the frames behind it untrusted, so that some may be reported as unconfirmed."""
    run_virtual(stop_on_a_lossy_line(model, 50))


@pytest.mark.parametrize("count", [1, 10, 50])
@pytest.mark.parametrize("model", [model for model in MODELS if model != "df800"])
def test_many_stops_at_once_of_a_drive_that_does_not_stop_are_all_unconfirmed_and_repeated(
    model: str, count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def scenario() -> Report:
        async with SimulatedDrives(model) as bench:
            drive = bench.drive()
            await run_drive(drive, model)
            report = await stop_together(
                bench, drive, count, lambda: monkeypatch.setattr(Motor, "stop", lambda *_: None)
            )
            assert bench.station().running and drive.stop_pending
            monkeypatch.undo()
            await asyncio.sleep(10)
            assert not bench.station().running and not drive.stop_pending
            gap_s = drive.dialect.station_config.timing.gap_s(bench.port.settings)
            transactions = timeout_transactions(drive.dialect) + 2  # of at most two first frames, see check_frames
            fastest_s = gap_s + min(
                exchange.received_at - exchange.sent_at
                for outcome in report.outcomes
                for exchange in outcome.exchanges
                if exchange.received_at is not None and exchange.sent_at is not None
            )
            report.limit_s = max(STOP_PROGRESS_TIMEOUT_S, transactions * fastest_s)
            return report

    report = run_virtual(scenario())
    assert report.keys == {"drives.stop_unconfirmed"}
    assert report.took_s < 0.2 + report.limit_s


@pytest.mark.parametrize("count", [1, 50])
@pytest.mark.parametrize("model", MODELS)
def test_many_stops_at_once_of_a_drive_that_is_silent_are_all_unconfirmed(model: str, count: int) -> None:
    async def scenario() -> Report:
        async with SimulatedDrives(model) as bench:
            drive = bench.drive()
            await run_drive(drive, model)
            bench.station().faults.silent = True
            return await stop_together(bench, drive, count)

    report = run_virtual(scenario())
    assert {outcome.succeeded for outcome in report.outcomes} == {False}


@pytest.mark.parametrize("model", [model for model in MODELS if model != "df800"])
@pytest.mark.parametrize("later_s", [0.0, 0.04, 0.08, 0.12, 0.16])
def test_a_stop_is_not_confirmed_by_the_reads_of_a_stop_before_it(
    model: str, later_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A first stop is just being confirmed when the motor is started at the keypad and a second stop is requested.

    The drive does not execute the second one: only reads after its own frame show that the motor runs.
    """

    async def scenario() -> None:
        async with SimulatedDrives(model) as bench:
            drive, station = bench.drive(), bench.station()
            await run_drive(drive, model)
            first = asyncio.ensure_future(outcome_of(drive))
            for _ in range(2000):
                if not station.running:
                    break
                await asyncio.sleep(0.005)
            await asyncio.sleep(later_s)
            monkeypatch.setattr(Motor, "stop", lambda *_: None)
            station.keypad_run(SAFE_HZ[model])
            requested_at = bench.bus.now()
            second = await outcome_of(drive)
            assert second.key == "drives.stop_unconfirmed"
            assert all((exchange.sent_at or 0.0) >= requested_at for exchange in second.exchanges)
            monkeypatch.undo()
            await first

    run_virtual(scenario())


# --- beside other requests ------------------------------------------------------------------------------------------


async def status_or_error(drive: Drive) -> None:
    with suppress(DrivebusError):
        await drive.status()


async def timed_stop(drive: Drive) -> tuple[str, float]:
    """Return the key of the outcome of a stop and how long it took, in seconds."""
    began = drive.bus.now()
    return (await outcome_of(drive)).key, drive.bus.now() - began


@pytest.mark.parametrize("model", [model for model in MODELS if model != "df800"])
def test_a_hundred_stops_of_a_drive_again_and_again_do_not_delay_the_confirmation_of_another_stop(model: str) -> None:
    """A hundred frames went before the reads of the other drive: its stop was confirmed late or not at all."""

    async def scenario() -> tuple[str, float]:
        async with SimulatedDrives(model, "1-2", query="ramp=0.5") as bench:
            flooded, other = bench.drive(1), bench.drive(2)
            await run_drive(flooded, model)
            await run_drive(other, model)
            async with repeated(outcome_of, [flooded] * 100):
                return await timed_stop(other)

    key, took_s = run_virtual(scenario())
    assert key == "drives.stop_confirmed" and took_s < 1.5


@pytest.mark.parametrize(
    ("model", "request_of"),
    [
        ("c320", lambda drive: drive.write({"F1.10": 1})),
        *((model, Drive.status) for model in ("c320", "dzb100", "vc660")),
    ],
    ids=["writes to c320", "reads of c320", "reads of dzb100", "reads of vc660"],
)
def test_reads_and_writes_of_eight_drives_do_not_delay_the_confirmation_of_a_stop(
    model: str, request_of: Callable[[Drive], Awaitable[object]]
) -> None:
    """The reads that confirm the stop waited for their turn among those requests, until it was reported."""

    async def scenario() -> tuple[str, float]:
        async with SimulatedDrives(model, "1-9", query="ramp=0.5") as bench:
            stopped, *others = (bench.drive(address) for address in range(1, 10))
            await run_drive(stopped, model)
            async with repeated(request_of, others * 3):
                return await timed_stop(stopped)

    key, took_s = run_virtual(scenario())
    assert key == "drives.stop_confirmed" and took_s < 1


@pytest.mark.parametrize("model", [model for model in MODELS if model != "df800"])
def test_reads_of_eight_silent_drives_do_not_delay_the_confirmation_of_a_stop(model: str) -> None:
    """Their sync probes, due again and again, took the turns of the reads that confirm the stop, for ever."""

    async def scenario() -> tuple[str, float]:
        async with SimulatedDrives(model, "1-9", query="ramp=0.5") as bench:
            stopped, *others = (bench.drive(address) for address in range(1, 10))
            for drive in others:
                await drive.status()
                bench.station(drive.address).faults.silent = True
            await run_drive(stopped, model)
            async with repeated(status_or_error, others):
                await asyncio.sleep(10)
                return await timed_stop(stopped)

    key, took_s = run_virtual(scenario())
    assert key == "drives.stop_confirmed" and took_s < STOP_PROGRESS_TIMEOUT_S


@pytest.mark.parametrize(
    ("model", "stopped_count", "read_count"),
    [*((model, 8, 30) for model in ("c320", "dzb100", "vc660")), ("md500_plus", 20, 1)],
)
def test_a_bus_stop_is_confirmed_while_other_drives_are_read_and_all_are_polled_without_a_pause(
    model: str, stopped_count: int, read_count: int
) -> None:
    """An MD500-Plus has the most reads: had parameter requests every other turn, its stops would be reported."""

    async def scenario() -> set[str]:
        async with SimulatedDrives(model, "1-30", query="ramp=0.5") as bench:
            drives = [bench.drive(address) for address in range(1, 31)]
            stopped, others = drives[:stopped_count], drives[stopped_count:]
            for drive in stopped:
                await drive.run(SAFE_HZ.get(model, 20.0))
            for drive in drives:
                polls = [Poll(request, 0.0) for request in drive.dialect.state_reads()]
                bench.bus.start_polling(drive.address, polls, lambda _: None)
            async with repeated(Drive.status, islice(cycle(others), read_count)):
                report = await stop_bus(bench.bus, stopped)
            return {outcome.key for _, outcome in report.outcomes}

    assert run_virtual(scenario()) == {"drives.stop_confirmed"}


# --- first frames ---------------------------------------------------------------------------------------------------


async def request_behind_a_read(bench: SimulatedDrives, drive: Drive, *commands: str) -> list[Any]:
    """Request stops and commands in this order while a read of the drive is on the wire; return their tasks."""
    await run_drive(drive, bench.model)
    asyncio.ensure_future(drive.status())  # noqa: RUF006
    await settle()
    assert bench.bus.core.transaction is not None
    tasks: list[asyncio.Task[Any]] = []
    for command in commands:
        requested = drive.run(SAFE_HZ[bench.model]) if command == "run" else drive.stop(wait=False)
        tasks.append(asyncio.ensure_future(requested))
        await settle()
    return tasks


def sent_at(outcome: Outcome) -> float | None:
    """Return when the only frame of a stop was sent."""
    (exchange,) = outcome.exchanges
    return exchange.sent_at


def test_stops_requested_while_an_equal_one_waits_are_served_by_its_frame() -> None:
    async def scenario() -> None:
        async with SimulatedDrives("dzb100") as bench:
            tasks = await request_behind_a_read(bench, bench.drive(), "stop", "stop", "stop")
            assert len({sent_at(await task) for task in tasks}) == 1

    run_virtual(scenario())


def test_a_stop_requested_after_a_start_has_a_frame_of_its_own_and_supersedes_the_start() -> None:
    """The frame of the stop before the start waits still, but it would not supersede the start."""

    async def scenario() -> None:
        async with SimulatedDrives("dzb100") as bench:
            drive = bench.drive()
            first, start, second = await request_behind_a_read(bench, drive, "stop", "run", "stop")
            moves = bench.bus.motions_sent(1)
            assert sent_at(await first) != sent_at(await second)
            with pytest.raises(Superseded):
                await start
            assert bench.bus.motions_sent(1) == moves
            await asyncio.sleep(10)
            assert not bench.station().running

    run_virtual(scenario())


def test_a_stop_that_is_cancelled_takes_its_frame_from_no_stop_that_it_serves() -> None:
    async def scenario() -> None:
        async with SimulatedDrives("dzb100") as bench:
            drive = bench.drive()
            tasks = await request_behind_a_read(bench, drive, "stop", "stop")
            next(iter(drive._stops._running)).cancel()
            results = await asyncio.gather(*tasks, return_exceptions=True)
            kept = [result for result in results if isinstance(result, Outcome)]
            assert [result.key for result in kept] == ["drives.stop_answered"]

    run_virtual(scenario())


def test_the_newest_of_different_stops_is_sent_last() -> None:
    async def scenario() -> None:
        bus = QueueBus()
        shared = shared_on(bus)
        for request in ("stop", "coast", "stop", "stop"):
            shared.submit_first(read(request, priority=RequestPriority.STOP), 0)
        assert bus.requests == ["stop", "coast", "stop"]

    run_virtual(scenario())


# --- quarantines ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("answers_stop", [False, True])
def test_a_drive_that_falls_silent_is_reported_in_time_although_the_bus_holds_back_its_reads(
    answers_stop: bool,
) -> None:
    """A report that waited for the reads of a quarantine came 7 s later."""

    async def scenario() -> tuple[Outcome, float]:
        async with SimulatedDrives("gs2", query="ramp=20") as bench:
            drive, station = bench.drive(), bench.station()
            drive.assume_model()
            station.keypad_run(20.0)
            await asyncio.sleep(20)
            began = bench.bus.now()

            def on_frame(event: TraceEvent) -> None:
                station.faults.silent = station.faults.silent or event.kind is TraceKind.REPLY

            bench.bus.trace(on_frame)
            station.faults.silent = not answers_stop
            outcome = await outcome_of(drive)
            return outcome, bench.bus.now() - began

    outcome, duration_s = run_virtual(scenario())
    assert not outcome.succeeded and duration_s < STOP_PROGRESS_TIMEOUT_S + 0.6


# --- the frames that stops share ------------------------------------------------------------------------------------


class QueueBus:
    """Bus whose queued requests a test sends one by one."""

    def __init__(self) -> None:
        self.submitted: list[tuple[BusRequest, asyncio.Future[BusResult]]] = []
        self.sent = 0

    def submit(self, request: BusRequest) -> asyncio.Future[BusResult]:
        future: asyncio.Future[BusResult] = asyncio.get_running_loop().create_future()
        self.submitted.append((request, future))
        return future

    async def transact(self, request: BusRequest) -> BusResult:
        return await self.submit(request)

    def is_queued(self, future: asyncio.Future[BusResult]) -> bool:
        return any(future is queued for _, queued in self.submitted[self.sent :])

    def send_next(self) -> None:
        self.sent += 1

    def reply(self, error: Exception | None = None) -> BusResult:
        request, future = self.submitted[self.sent - 1]
        result = BusResult(bus_request=request, reply=None if error else "reply", error=error)
        future.set_result(result)
        return result

    @property
    def requests(self) -> list[Any]:
        return [request.request for request, _ in self.submitted]


def shared_on(bus: QueueBus) -> SharedTransactions:
    return SharedTransactions(bus, dialect_for("vc660"))  # type: ignore[arg-type]


def read(request: Any = "read", **more: Any) -> BusRequest:
    return BusRequest(station=1, request=request, **more)


async def settle() -> None:
    for _ in range(5):
        await asyncio.sleep(0)


def tasks_of(shared: SharedTransactions, requests: Iterable[BusRequest]) -> list[asyncio.Task[BusResult]]:
    return [asyncio.ensure_future(shared.transact(request)) for request in requests]


def test_stops_that_ask_for_the_same_read_before_it_is_sent_share_it() -> None:
    async def scenario() -> None:
        bus = QueueBus()
        shared = shared_on(bus)
        tasks = tasks_of(shared, [read(), read()])
        await settle()
        tasks += tasks_of(shared, [read()])
        await settle()
        assert bus.requests == ["read"]
        bus.send_next()
        result = bus.reply()
        assert await asyncio.gather(*tasks) == [result] * 3

    run_virtual(scenario())


def test_no_stop_joins_a_read_that_is_on_the_wire() -> None:
    """The reply to that read may show the drive as it was before the stop."""

    async def scenario() -> None:
        bus = QueueBus()
        shared = shared_on(bus)
        early = tasks_of(shared, [read()])
        await settle()
        bus.send_next()
        late = tasks_of(shared, [read()])
        await settle()
        assert bus.requests == ["read", "read"]
        first = bus.reply()
        await settle()
        assert early[0].result() is first and not late[0].done()
        bus.send_next()
        assert bus.reply() is await late[0]

    run_virtual(scenario())


@pytest.mark.parametrize(
    "other",
    [
        {"request": "another read"},
        {"priority": RequestPriority.STOP},
        {"waits_in_quarantine": False},
        {"tag": OWN_FRAME},
    ],
)
def test_another_frame_or_the_same_under_other_terms_is_not_shared(other: dict[str, Any]) -> None:
    async def scenario() -> None:
        bus = QueueBus()
        shared = shared_on(bus)
        tasks = tasks_of(shared, [read(), read(**other), read(**other)])
        await settle()
        assert len(bus.submitted) == (3 if other == {"tag": OWN_FRAME} else 2)
        for _ in bus.submitted:
            bus.send_next()
            bus.reply()
        await asyncio.gather(*tasks)

    run_virtual(scenario())


def test_a_stop_that_is_cancelled_takes_the_shared_read_from_no_other() -> None:
    async def scenario() -> None:
        bus = QueueBus()
        first, second = tasks_of(shared_on(bus), [read(), read()])
        await settle()
        first.cancel()
        await settle()
        bus.send_next()
        assert bus.reply() is await second and first.cancelled()

    run_virtual(scenario())


def test_a_shared_read_that_fails_fails_for_each_stop_and_is_not_shared_any_more() -> None:
    async def scenario() -> None:
        bus = QueueBus()
        shared = shared_on(bus)
        tasks = tasks_of(shared, [read(), read()])
        await settle()
        bus.send_next()
        bus.reply(NoReply("bus.no_reply", station=1))
        assert [(await task).error is None for task in tasks] == [False, False]
        again = tasks_of(shared, [read()])
        await settle()
        bus.send_next()
        assert bus.reply() is await again[0] and len(bus.submitted) == 2

    run_virtual(scenario())


def test_stops_share_a_sync_probe_while_it_waits_and_each_probe_on_the_wire_is_another_one() -> None:
    async def scenario() -> None:
        bus = QueueBus()
        shared = shared_on(bus)
        sent: list[Any] = []
        for _ in range(4):
            tasks = []
            for _ in range(9):
                tasks += tasks_of(shared, [read(shared.sync_request())])
                await settle()
            assert len(bus.submitted) == len(sent) + 1
            waiting = bus.requests[-1]
            assert shared.sync_request(avoid=waiting) != waiting
            sent.append(waiting)
            bus.send_next()
            bus.reply()
            await asyncio.gather(*tasks)
        assert len(set(sent)) == len(sent)

    run_virtual(scenario())


# --- the deadline ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("model", "count", "timeout_s"),
    [("c320", 1, 2.0), ("c320", 10, 3.4), ("c320", 50, 11.4), ("c320", 1000, 14.2), ("df800", 50, 2.0)],
)
def test_the_deadline_grows_with_the_frames_of_concurrent_stops_but_not_without_bound(
    model: str, count: int, timeout_s: float
) -> None:
    """A stop whose frame still waits takes the speed of the bus from the others; a DF800 reports no standstill."""
    ops = [operation_for(dialect_for(model)) for _ in range(count)]
    ops[-1].age.fastest_transaction_s = 0.1
    progress = StopProgress(ops[0], 100.0, concurrent=ops)
    assert progress.deadline == pytest.approx(100.0 + timeout_s)
    del ops[1:]
    assert progress.deadline == pytest.approx(100.0 + timeout_s)  # the host was not asleep where the others ended first
    assert MAX_FIRST_FRAMES == 64


def test_stops_that_share_their_first_frame_prolong_the_deadline_by_one_frame() -> None:
    ops = [operation_for(dialect_for("c320")) for _ in range(50)]
    ops[-1].age.fastest_transaction_s = 0.1
    for op in ops[:40]:
        op.first_frame = "frame"
    assert StopProgress(ops[0], 100.0, concurrent=ops).deadline == pytest.approx(100.0 + 0.1 * (16 + 2 * 10))


def test_of_many_drives_that_are_stopped_at_once_one_that_runs_on_is_reported_once_it_had_its_own_transactions(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It had the time of all twenty, 15 s, although the bus was its own when the others stood."""

    async def scenario() -> tuple[dict[int, bool], float]:
        async with SimulatedDrives("c320", "1-20") as bench:
            drives = [bench.drive(address) for address in range(1, 21)]
            for address in range(1, 21):
                bench.station(address).motor.run(SAFE_HZ["c320"])
            running, stop_motor = bench.station(1).motor, Motor.stop
            monkeypatch.setattr(
                Motor, "stop", lambda motor, *args: None if motor is running else stop_motor(motor, *args)
            )
            began, joint = bench.bus.now(), JointStops()
            reported = {}

            async def stop_one(drive: Drive) -> None:
                outcome = await outcome_of(drive, joint)
                reported[drive.address] = outcome.succeeded, bench.bus.now() - began

            await asyncio.gather(*map(stop_one, drives))
            return {address: succeeded for address, (succeeded, _) in reported.items()}, reported[1][1]

    succeeded, took_s = run_virtual(scenario())
    assert [address for address, confirmed in succeeded.items() if not confirmed] == [1]
    assert 5.0 < took_s < 11.0


def test_a_stop_whose_frame_still_waits_for_those_of_other_drives_is_not_reported() -> None:
    """31 stops of DZB100 take 2.1 s: the last three were reported as unconfirmed before they were sent."""

    async def scenario() -> list[Outcome]:
        async with SimulatedDrives("dzb100", "1-31") as bench:
            drives = [bench.drive(address) for address in range(1, 32)]
            joint = JointStops()
            return await asyncio.gather(*(outcome_of(drive, joint) for drive in drives))

    assert all(outcome.succeeded for outcome in run_virtual(scenario()))


def test_a_drive_that_never_replied_is_reported_as_early_among_many_as_alone() -> None:
    async def scenario() -> tuple[Outcome, float]:
        async with SimulatedDrives("c320", "1-20") as bench:
            drives = [bench.drive(address) for address in range(1, 21)]
            bench.station(1).faults.silent = True
            began, joint = bench.bus.now(), JointStops()
            others = [asyncio.create_task(outcome_of(drive, joint)) for drive in drives[1:]]
            outcome = await outcome_of(drives[0], joint)
            took_s = bench.bus.now() - began
            await asyncio.gather(*others)
            return outcome, took_s

    outcome, took_s = run_virtual(scenario())
    assert not outcome.succeeded and took_s == pytest.approx(STOP_PROGRESS_TIMEOUT_S, abs=0.1)


@pytest.mark.parametrize("model", ["c320", "dzb100"])
def test_a_drive_that_falls_silent_is_reported_as_early_for_64_equal_stops_as_for_one(model: str) -> None:
    """They share one first frame, and the deadline counted 64: the report came after 6 to 10 s."""

    async def scenario() -> float:
        async with SimulatedDrives(model) as bench:
            drive, station = bench.drive(), bench.station()
            await run_drive(drive, model)
            asyncio.get_running_loop().call_later(0.12, setattr, station.faults, "silent", True)
            return (await stop_together(bench, drive, 64)).took_s

    assert run_virtual(scenario()) == pytest.approx(STOP_PROGRESS_TIMEOUT_S, abs=0.1)


def test_stops_that_wait_for_the_model_have_a_first_frame_each() -> None:
    """Only the read of the model is shared."""

    async def scenario() -> None:
        async with SimulatedDrives("gd10") as bench:
            drive = bench.drive()
            stops = [asyncio.create_task(outcome_of(drive)) for _ in range(3)]
            await asyncio.sleep(0)
            assert [op.first_frame for op in drive._stops._concurrent] == [None] * 3
            (request,) = drive.dialect.stop(StopMode.STOP)
            stop_frame = drive.dialect.codec.encode_request(request)
            outcomes = await asyncio.gather(*stops)
            firsts = {next(e.sent_at for e in outcome.exchanges if e.sent == stop_frame) for outcome in outcomes}
            assert len(firsts) == 3

    run_virtual(scenario())


def test_a_stop_whose_first_frame_was_not_sent_shares_no_first_frame_any_more() -> None:
    op = operation_for(dialect_for("c320"))
    op.first_frame = "frame"

    def fail(step: Any) -> Any:
        if isinstance(step, GetBusConditions):
            return BusConditions(now=0.0)
        return BusResult(bus_request=step, error=NoReply("bus.removed", station=1))

    assert run_pure(send_stop(op, StopMode.STOP), fail) is False
    assert op.first_frame is None


def test_a_drive_that_answers_faster_than_before_does_not_pass_for_a_suspended_host_whose_stop_is_sent_again() -> None:
    """The deadline came nearer while the stop waited for it: the stop began again and was reported 2 s later."""

    async def scenario() -> tuple[Outcome, float]:
        async with SimulatedDrives("dzb100", "1-2") as bench:
            drive, other = bench.drive(1), bench.drive(2)
            await run_drive(drive, "dzb100")
            bench.station(1).faults.added_delay_s = 0.09
            began = bench.bus.now()
            stops = [asyncio.ensure_future(outcome_of(drive)) for _ in range(3)]
            while not stops[0].done():  # stops of the other drive go before the reads that would confirm this one
                stops.append(asyncio.ensure_future(outcome_of(other)))
                await asyncio.sleep(0.05)
                if bench.bus.now() - began > 2.1 and bench.station(1).faults.added_delay_s:
                    bench.station(1).faults.added_delay_s = 0.0
                    stops.append(asyncio.ensure_future(outcome_of(drive)))
            took_s = bench.bus.now() - began
            await asyncio.gather(*stops)
            return stops[0].result(), took_s

    outcome, took_s = run_virtual(scenario())
    assert not outcome.succeeded
    assert took_s == pytest.approx(2.9, abs=0.1)  # 18 transactions of the slow drive
