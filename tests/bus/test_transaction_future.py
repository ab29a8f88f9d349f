"""The task of a transaction goes on at once when its result is there, and does not disturb the bus."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from drivebus.bus import Bus
from drivebus.bus.messages import BusResult
from drivebus.bus.transaction_future import TransactionFuture
from drivebus.errors import PortLost
from drivebus.testing.bus_script import ScriptedPort
from drivebus.testing.virtual_time import run
from fixtures.bus import FakeStation, read_request, station_config, wire_to

RESULT = BusResult(bus_request=read_request())


def one_station_bus() -> tuple[Bus, ScriptedPort]:
    port = ScriptedPort(wire_to(FakeStation()))
    bus = Bus(port)
    bus.add_station(station_config(1))
    return bus, port


def test_the_task_goes_on_within_the_call_that_sets_the_result() -> None:
    async def main() -> None:
        loop, order = asyncio.get_running_loop(), list[str]()
        future = TransactionFuture(loop=loop)

        async def waiter() -> None:
            assert await future is RESULT
            order.append("task")

        def set_result() -> None:
            future.set_result(RESULT)
            order.append("after set_result")

        task = asyncio.create_task(waiter())
        await asyncio.sleep(0)
        loop.call_soon(set_result)
        await task
        assert order == ["task", "after set_result"]

    asyncio.run(main())


def test_a_result_that_another_task_causes_is_delivered_in_the_next_turn() -> None:
    async def main() -> None:
        order, future = list[str](), TransactionFuture(loop=asyncio.get_running_loop())

        async def waiter() -> None:
            assert await future is RESULT
            order.append("task")

        task = asyncio.create_task(waiter())
        await asyncio.sleep(0)
        future.set_result(RESULT)
        order.append("after set_result")
        await task
        assert order == ["after set_result", "task"]

    asyncio.run(main())


def test_a_failed_transaction_is_reported_in_the_next_turn() -> None:
    """A stop repeated within the loss of its port would find the port closed instead of waiting for its reopening."""

    async def main() -> None:
        loop, order = asyncio.get_running_loop(), list[str]()
        future = TransactionFuture(loop=loop)

        async def waiter() -> None:
            assert (await future).error is not None
            order.append("task")

        def fail() -> None:
            future.set_result(BusResult(bus_request=read_request(), error=PortLost("bus.closed")))
            order.append("after set_result")

        task = asyncio.create_task(waiter())
        await asyncio.sleep(0)
        loop.call_soon(fail)
        await task
        assert order == ["after set_result", "task"]

    asyncio.run(main())


def test_a_cancelled_task_ends_while_its_frame_is_on_the_wire() -> None:
    async def main() -> None:
        bus, _ = one_station_bus()
        async with bus:
            reading = asyncio.create_task(bus.transact(read_request()))
            await asyncio.sleep(0)
            reading.cancel()
            with pytest.raises(asyncio.CancelledError):
                await reading
            assert (await bus.transact(read_request())).error is None

    run(main())


def test_a_task_that_ends_the_program_takes_no_result_from_another() -> None:
    """``sys.exit`` in one task ends the loop only after every other result has been delivered."""

    async def main() -> None:
        loop = asyncio.get_running_loop()
        first, second = TransactionFuture(loop=loop), TransactionFuture(loop=loop)

        async def leave() -> None:
            await first
            raise SystemExit(3)

        async def other() -> None:
            await second
            delivered.append("other")

        tasks = [asyncio.create_task(leave()), asyncio.create_task(other())]
        await asyncio.sleep(0)
        loop.call_soon(lambda: (first.set_result(RESULT), second.set_result(RESULT)))
        await asyncio.gather(*tasks)

    delivered: list[str] = []
    with pytest.raises(SystemExit):
        asyncio.run(main())
    assert delivered == ["other"]


def test_a_task_may_close_the_bus_when_its_port_is_lost() -> None:
    async def main() -> None:
        bus, port = one_station_bus()
        reports: list[dict[str, Any]] = []
        asyncio.get_running_loop().set_exception_handler(lambda loop, context: reports.append(context))

        async def read_once() -> BusResult:
            result = await bus.transact(read_request())
            await bus.close()
            return result

        await bus.open()
        reading = asyncio.create_task(read_once())
        await asyncio.sleep(0)
        asyncio.get_running_loop().call_soon(port.unplug)  # outside of a task, as the loop reports it
        assert isinstance((await reading).error, PortLost)
        await asyncio.sleep(5)
        assert bus.is_closed and not bus.is_open and not reports

    run(main())
