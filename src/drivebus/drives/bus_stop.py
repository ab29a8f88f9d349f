"""``bus_stop``: every drive of a line, broadcast where the family has one, then one by one until each reports stopped.

Not an emergency stop: only a hard-wired STO or SS1 is (RELIABILITY 3).
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass

from drivebus.bus import Bus
from drivebus.bus.messages import BusRequest, RequestPriority, RetryPolicy
from drivebus.drives.drive import Drive
from drivebus.drives.operations.context import frame_exchange
from drivebus.drives.state import FrameExchange, Outcome, OutcomeStatus
from drivebus.errors import DrivebusError, StopUnconfirmed

BROADCAST_COUNT = 2
"""Repeated on purpose (F10): nobody answers, and one may be lost."""


@dataclass(frozen=True, slots=True)
class StopReport:
    """What a bus stop did: the broadcasts, and how each drive ended."""

    started_at: float
    ended_at: float
    broadcasts: tuple[FrameExchange, ...]
    outcomes: tuple[tuple[int, Outcome], ...]
    """Address and outcome, confirmed, acknowledged or unknown, with its frames and times."""

    @property
    def unconfirmed(self) -> tuple[int, ...]:
        """Addresses that did not report stopped: go and look."""
        return tuple(address for address, outcome in self.outcomes if outcome.status != "confirmed")

    @property
    def confirmed(self) -> bool:
        """Every drive reported stopped."""
        return not self.unconfirmed


async def stop_bus(bus: Bus, drives: Sequence[Drive]) -> StopReport:
    """Stop everything on a bus. All drives stay latched until ``bus.release()``: no start leaves before. Never raises
    for what the bus or a drive does; see ``unconfirmed``."""
    begun = bus.now()
    bus.inhibit_start(None)
    broadcasts = await _broadcast(bus, drives)
    outcomes = await asyncio.gather(*(_stop(drive, len(drives)) for drive in drives))
    addresses = tuple(drive.address for drive in drives)
    return StopReport(begun, bus.now(), broadcasts, tuple(zip(addresses, outcomes, strict=True)))


async def _broadcast(bus: Bus, drives: Sequence[Drive]) -> tuple[FrameExchange, ...]:
    """One broadcast per different frame; the bus refuses one that is no stop to everybody who hears it."""
    asks: dict[bytes, BusRequest] = {}
    for drive in drives:
        if "broadcast_stop" not in drive.profile.capabilities:
            continue
        for place, request in enumerate(drive.dialect.broadcast_stop()):
            lane = (
                RequestPriority.COMMAND if place else RequestPriority.STOP
            )  # what follows a stop lets other stops go first (I3)
            ask = BusRequest(drive.address, request, lane, RetryPolicy.BROADCAST)
            asks.setdefault(drive.dialect.codec.encode_request(request), ask)
    sent: list[FrameExchange] = []
    for _ in range(BROADCAST_COUNT if asks else 0):
        for ask in asks.values():
            answer = await bus.transact(ask)
            if answer.sent:
                sent.append(frame_exchange(answer))
    return tuple(sent)


async def _stop(drive: Drive, drives: int) -> Outcome:
    """However it ends, the other drives' outcomes are not lost."""
    try:
        return await drive.stop_concurrently(drives)
    except StopUnconfirmed as error:
        outcome: Outcome = error.outcome
        return outcome
    except DrivebusError as error:
        return Outcome(OutcomeStatus.UNKNOWN, error.key, error.params)
    except KeyError:
        return Outcome(OutcomeStatus.UNKNOWN, "bus.unregistered", {"station": drive.address})
