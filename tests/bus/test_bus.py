"""``Bus`` in virtual time: life of the port, cancelled waits, sinks; and the real timer."""

from __future__ import annotations

import asyncio
import sys
import time
from typing import Any

import pytest

from drivebus.bus import Bus, Poll, Presence
from drivebus.bus import timer as timers
from drivebus.bus.messages import BusResult
from drivebus.errors import PortLost, PortUnavailable
from drivebus.serial_settings import SerialSettings
from drivebus.testing.bus_script import ScriptedPort
from drivebus.testing.virtual_time import run
from fixtures.bus import (
    CHARACTER_S,
    FakeStation,
    byte_by_byte,
    read,
    read_request,
    start_request,
    station_config,
    stop_request,
    wire_to,
)


def bus_with(*stations: FakeStation, **options: Any) -> tuple[Bus, ScriptedPort]:
    port = ScriptedPort(wire_to(*stations, deliver=byte_by_byte), **options)
    bus = Bus(port)
    for station in stations:
        bus.add_station(station_config(station.address))
    return bus, port


def test_a_transaction_in_virtual_time_takes_exactly_its_time() -> None:
    async def main() -> None:
        bus, _ = bus_with(FakeStation(delay_s=0.005))
        async with bus:
            await asyncio.sleep(1)
            result = await bus.transact(read_request())
            assert result.sent_at == 1.0
            assert result.received_at == pytest.approx(1.0 + 8 * CHARACTER_S + 0.005 + 13 * CHARACTER_S)
            assert bus.now() == pytest.approx(1.0 + 8 * CHARACTER_S + 0.005 + 16.5 * CHARACTER_S)

    run(main())


def test_polls_are_delivered_until_they_are_cancelled() -> None:
    async def main() -> None:
        bus, _ = bus_with(FakeStation())
        results: list[BusResult] = []
        async with bus:
            watch = bus.start_polling(1, [Poll(read(), 0.5, phase_s=0.0, tag="status")], results.append)
            await asyncio.sleep(2.1)
            watch.cancel()
            watch.cancel()
            await asyncio.sleep(5)
        assert len(results) == 5 and {result.bus_request.tag for result in results} == {"status"}
        assert [round(result.sent_at or 0, 3) for result in results[1:]] == [0.5, 1.0, 1.5, 2.0]

    run(main())


def test_a_callback_that_fails_does_not_stop_the_bus() -> None:
    async def main() -> None:
        reports: list[dict[str, Any]] = []
        asyncio.get_running_loop().set_exception_handler(lambda loop, context: reports.append(context))
        bus, _ = bus_with(FakeStation())
        async with bus:
            bus.start_polling(1, [Poll(read(), 0.5)], lambda result: 1 / 0)
            await asyncio.sleep(1.2)
            assert (await bus.transact(read_request())).error is None
        assert len(reports) >= 2

    run(main())


def test_a_callback_may_submit_requests() -> None:
    async def main() -> None:
        bus, _ = bus_with(FakeStation())
        tasks: list[asyncio.Task[BusResult]] = []
        async with bus:
            bus.start_polling(
                1, [Poll(read(), 1.0)], lambda a: tasks.append(asyncio.create_task(bus.transact(read_request())))
            )
            await asyncio.sleep(3.5)
            assert len(tasks) >= 3 and all([(await task).error is None for task in tasks])

    run(main())


def test_a_cancelled_command_is_never_sent() -> None:
    """A cancelled start in the queue must not move the motor later."""

    async def main() -> None:
        station = FakeStation()
        bus, _ = bus_with(station)
        async with bus:
            await bus.transact(read_request())
            reading = asyncio.create_task(bus.transact(read_request()))
            starting = asyncio.create_task(bus.transact(start_request(bus.core)))
            await asyncio.sleep(0)
            starting.cancel()
            await reading
            await asyncio.sleep(1)
        assert station.start_count == 0

    run(main())


def test_unplugging_fails_pending_requests_and_replays_none() -> None:
    """All requests fail with PortLost, polls resume within 2 s of the return, no command is repeated."""

    async def main() -> None:
        station = FakeStation()
        bus, port = bus_with(station)
        results: list[BusResult] = []
        async with bus:
            bus.start_polling(1, [Poll(read(), 0.2)], results.append)
            await asyncio.sleep(1)
            waiting = [asyncio.create_task(bus.transact(start_request(bus.core))) for _ in range(3)]
            await asyncio.sleep(0.02)
            port.unplug()
            answers = [await task for task in waiting]
            assert all(isinstance(result.error, PortLost) for result in answers)
            assert len({id(result.error) for result in answers}) == 3, "each command marks an error of its own"
            assert bus.presence(1) is Presence.OFFLINE and not bus.is_open
            assert isinstance((await bus.transact(read_request())).error, PortLost)
            count, started = len(results), station.start_count
            await asyncio.sleep(30)
            port.plugged = True
            back = bus.now()
            while not results[count:] or results[-1].error is not None:  # noqa: ASYNC110
                await asyncio.sleep(0.01)
            assert bus.now() - back < 2.0
            await asyncio.sleep(5)
            assert station.start_count == started <= 1
            assert bus.presence(1) is Presence.ONLINE
            assert bus.stop_epoch(1) == 1, "earlier permits are void"

    run(main())


def test_a_port_lost_again_at_its_first_frame_is_opened_again() -> None:
    """The device comes back, is lost at the first write, and comes back again."""

    async def main() -> None:
        station = FakeStation()
        bus, port = bus_with(station)
        deaths = [0]
        write = port.write

        def dying(data: bytes, /) -> None:
            if deaths[0] > 0:
                deaths[0] -= 1
                port._receiver = None
                raise PortLost("ports.lost", port="scripted", reason="again")
            write(data)

        port.write = dying  # type: ignore[method-assign]
        results: list[BusResult] = []
        async with bus:
            bus.start_polling(1, [Poll(read(), 0.1)], results.append)
            await asyncio.sleep(1)
            deaths[0] = 3
            port.unplug()
            port.plugged = True
            await asyncio.sleep(6)
            assert bus.is_open and deaths[0] == 0
            assert results[-1].error is None and (results[-1].sent_at or 0) > 6

    run(main())


def test_a_port_that_cannot_be_opened_reports_the_reason() -> None:
    async def main() -> None:
        bus, port = bus_with(FakeStation())
        port.plugged = False
        with pytest.raises(PortUnavailable):
            await bus.open()
        assert isinstance((await bus.transact(read_request())).error, PortLost)

    run(main())


def test_closing_fails_pending_requests() -> None:
    async def main() -> None:
        bus, _ = bus_with(FakeStation())
        await bus.open()
        task = asyncio.create_task(bus.transact(read_request()))
        await asyncio.sleep(0.001)
        await bus.close()
        await bus.close()
        assert isinstance((await task).error, PortLost)

    run(main())


def test_the_trace_has_every_frame_until_it_is_closed() -> None:
    async def main() -> None:
        bus, _ = bus_with(FakeStation())
        lines: list[str] = []
        async with bus:
            end = bus.trace(lambda event: lines.append(event.text(1)))
            await bus.transact(read_request())
            end()
            await bus.transact(stop_request())
        assert [line.split()[1] for line in lines] == ["sent", "reply"]
        assert lines[0].endswith("01 03 30 00 00 04 4B 09")

    run(main())


# --- the real timer --------------------------------------------------------------------------------------------


@pytest.mark.skipif(sys.platform != "linux", reason="timerfd is Linux only")
@pytest.mark.parametrize("hides_wake_up", [False, True])
async def test_the_precise_timer_never_fires_early(hides_wake_up: bool) -> None:
    loop = asyncio.get_running_loop()
    timer = timers.acquire(loop)
    try:
        assert timer.precise
        fired: list[float] = []
        done = asyncio.Event()
        due = [timer.now() + 0.0013 * (1 + number) for number in range(30)]

        def on_timer() -> None:
            fired.append(timer.now())
            if len(fired) == len(due):
                done.set()
            else:
                bus_timer.set(due[len(fired)])

        bus_timer = timer.create_timer(on_timer, hides_wake_up=hides_wake_up)
        bus_timer.set(due[0])
        await asyncio.wait_for(done.wait(), 60)
        assert all(at >= when for at, when in zip(fired, due, strict=True))
    finally:
        timers.release(loop)


@pytest.mark.skipif(sys.platform != "linux", reason="timerfd is Linux only")
@pytest.mark.parametrize("hides_wake_up", [False, True])
async def test_the_kernel_wakes_earlier_only_for_a_timer_that_hides_the_wake_up(
    hides_wake_up: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    armed: list[float] = []
    monkeypatch.setattr(timers.TimerFd, "set_at", lambda self, when: armed.append(when))
    loop = asyncio.get_running_loop()
    timer = timers.acquire(loop)
    try:
        when = timer.now() + 0.005
        timer.create_timer(lambda: None, hides_wake_up=hides_wake_up).set(when)
        assert armed == [when - timers.WAKE_UP_S if hides_wake_up else when]
    finally:
        timers.release(loop)


@pytest.mark.parametrize(("baud", "hides"), [(57600, False), (115200, True), (230400, True)])
async def test_a_bus_hides_the_wake_up_of_its_timer_from_115200_baud_on(baud: int, hides: bool) -> None:
    found: list[bool] = []
    create = timers.TimerQueue.create_timer

    def create_timer(self: timers.TimerQueue, callback: Any, *, hides_wake_up: bool = False) -> timers.BusTimer:
        found.append(hides_wake_up)
        return create(self, callback, hides_wake_up=hides_wake_up)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(timers.TimerQueue, "create_timer", create_timer)
        async with Bus(ScriptedPort(wire_to(FakeStation()), SerialSettings(baud, 8, "E"))):
            assert found == [hides]


async def test_one_queue_serves_many_timers_and_a_moved_timer_fires_once() -> None:
    loop = asyncio.get_running_loop()
    first, second = timers.acquire(loop), timers.acquire(loop)
    assert first is second
    fired: list[int] = []
    timers_set = [first.create_timer(lambda number=number: fired.append(number)) for number in range(20)]  # type: ignore[misc]
    begun = first.now()
    for number, bus_timer in enumerate(timers_set):
        bus_timer.set(begun + 10)
        bus_timer.set(begun + 0.04 - number * 0.001)
    timers_set[3].set(None)
    await asyncio.sleep(0.1)
    timers.release(loop)
    timers.release(loop)
    assert fired == [number for number in range(19, -1, -1) if number != 3]


@pytest.mark.skipif(sys.platform != "linux", reason="ptys and timerfd")
async def test_on_a_real_loop_no_gap_is_ever_short() -> None:
    """In real time on a socket pair the station measures the silence before each frame."""
    import socket

    ours, theirs = socket.socketpair()
    for end in (ours, theirs):
        end.setblocking(False)
    loop = asyncio.get_running_loop()
    station = FakeStation()
    gaps: list[float] = []
    reply_end = [0.0]

    class SocketPort(ScriptedPort):
        async def open(self, receiver: Any) -> None:
            loop.add_reader(ours, lambda: receiver.data_received(ours.recv(256)))

        def write(self, data: bytes, /) -> None:
            ours.send(data)

        async def close(self) -> None:
            loop.remove_reader(ours)

    def serve() -> None:
        frame = theirs.recv(256)
        if reply_end[0]:
            gaps.append(time.monotonic() - reply_end[0])
        reply = station.reply_to(frame, 0.0)
        assert reply is not None
        theirs.send(reply)
        reply_end[0] = time.monotonic()

    loop.add_reader(theirs, serve)
    bus = Bus(SocketPort(lambda f, t: (), has_line_timing=False))
    bus.add_station(station_config())
    async with bus:
        for _ in range(40):
            assert (await bus.transact(read_request())).error is None
    loop.remove_reader(theirs)
    ours.close()
    theirs.close()
    assert len(gaps) == 39 and min(gaps) >= 3.5 * CHARACTER_S
