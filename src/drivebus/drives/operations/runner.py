"""The asyncio shell of conversations: performs their steps on a Bus. No decision lives here."""

from __future__ import annotations

import asyncio
from typing import Any, TypeVar

from drivebus import clock
from drivebus.bus import Bus
from drivebus.bus.messages import BusRequest, BusResult
from drivebus.drives.operations.steps import BusConditions, DriveOperation, GetBusConditions, Step, UpdateStore, Wait
from drivebus.drives.store import Store

T = TypeVar("T")


def submit_first(operation: DriveOperation[T], bus: Bus, address: int) -> asyncio.Future[BusResult]:
    """Let a conversation ask for its first transaction now: a turn of the loop later a poll may go first (I3)."""
    step = next(operation)
    while isinstance(step, GetBusConditions):
        step = operation.send(bus_conditions(bus, address))
    assert isinstance(step, BusRequest)
    return bus.submit(step)


async def run_operation(
    operation: DriveOperation[T],
    bus: Bus,
    address: int,
    store: Store,
    first_result: asyncio.Future[BusResult] | None = None,
) -> T:
    """Run a conversation to its end. Cancelling it ends it where it stands; nothing more of it is sent.

    A step that fails fails in the conversation: it knows whether something was sent before. ``begun``: by ``begin``.
    """
    try:
        step = next(operation) if first_result is None else operation.send(await first_result)
        while True:
            try:
                found = await _perform(step, bus, address, store)
            except Exception as error:
                step = operation.throw(error)
            else:
                step = operation.send(found)
    except StopIteration as end:
        result: T = end.value
        return result
    finally:
        operation.close()


async def _perform(step: Step, bus: Bus, address: int, store: Store) -> Any:
    if isinstance(step, BusRequest):
        return await bus.transact(step)
    if isinstance(step, Wait):
        await asyncio.sleep(step.seconds)
        return bus.now()
    if isinstance(step, GetBusConditions):
        return bus_conditions(bus, address)
    assert isinstance(step, UpdateStore)
    return await asyncio.to_thread(store.update, step.key, step.change)


def bus_conditions(bus: Bus, address: int) -> BusConditions:
    """What the bus knows of a station now."""
    health = bus.health(address)
    return BusConditions(
        bus.now(),
        _calendar_day(),
        bus.stop_epoch(address),
        bus.start_inhibited(address),
        health.foreign_master,
        health.duplicate_address,
        health.damage_rate,
        health.damaged,
    )


def _calendar_day() -> str:
    """A label for the EEPROM budget: the only wall clock here (F21)."""
    return clock.wall_clock().date().isoformat()
