"""The asyncio shell of conversations: performs their steps on a Bus. No decision lives here."""

from __future__ import annotations

import asyncio
from typing import Any, TypeVar

from drivebus import seams
from drivebus.bus import Bus
from drivebus.drives.talk import Conversation, Keep, Look, Step, Surroundings, Wait
from drivebus.message import Answer, Ask

T = TypeVar("T")


def begin(conversation: Conversation[T], bus: Bus, address: int) -> asyncio.Future[Answer]:
    """Let a conversation ask for its first transaction now: a turn of the loop later a poll may go first (I3)."""
    step = next(conversation)
    while isinstance(step, Look):
        step = conversation.send(surroundings(bus, address))
    assert isinstance(step, Ask)
    return bus.submit(step)


async def converse(
    conversation: Conversation[T],
    bus: Bus,
    address: int,
    store: seams.Store,
    begun: asyncio.Future[Answer] | None = None,
) -> T:
    """Run a conversation to its end. Cancelling it ends it where it stands; nothing more of it is sent.

    A step that fails fails in the conversation: it knows whether something was sent before. ``begun``: by ``begin``.
    """
    try:
        step = next(conversation) if begun is None else conversation.send(await begun)
        while True:
            try:
                found = await _perform(step, bus, address, store)
            except Exception as error:
                step = conversation.throw(error)
            else:
                step = conversation.send(found)
    except StopIteration as end:
        result: T = end.value
        return result
    finally:
        conversation.close()


async def _perform(step: Step, bus: Bus, address: int, store: seams.Store) -> Any:
    if isinstance(step, Ask):
        return await bus.transact(step)
    if isinstance(step, Wait):
        await asyncio.sleep(step.seconds)
        return bus.now()
    if isinstance(step, Look):
        return surroundings(bus, address)
    assert isinstance(step, Keep)
    return await asyncio.to_thread(store.update, step.key, step.change)


def surroundings(bus: Bus, address: int) -> Surroundings:
    """What the bus knows of a station now."""
    health = bus.health(address)
    return Surroundings(
        bus.now(),
        _today(),
        bus.generation(address),
        bus.latched(address),
        health.foreign_master,
        health.duplicate,
        health.damage_rate,
        health.damaged,
    )


def _today() -> str:
    """A label for the EEPROM budget: the only wall clock here (F21)."""
    return seams.wall_clock().date().isoformat()
