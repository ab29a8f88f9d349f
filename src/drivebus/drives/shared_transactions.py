"""Frames that the concurrent stops of one drive share: waiting stops, and the reads that confirm them.

Ten stops of a drive at once would read it in turns, and most of them would be reported as unconfirmed although the
drive stands; their frames would go before the reads of every other drive that is being stopped. So a frame that waits
to be sent serves every stop that asks for the same frame meanwhile.

Why a shared frame makes no stop less certain:

1. The first frame of a stop is its own (``OWN_FRAME``), or the equal one of the stop before it (``submit_first``) that
   still waits to be sent, where no command was requested between the two: a frame of its own would supersede no other
   command. Only its later steps share other frames, after that frame was answered or has timed out.
2. A step joins an equal request (same bytes and priority) only while that waits to be sent
   (``Bus.is_queued``): the reply to a frame on the wire may report a state from before the stop.
3. Each stop judges the results by itself: two states that agree, each behind a sync probe, all sent after its own
   frame. It takes over no conclusion of another stop.
4. A frame that fails has failed for each stop that shares it.
5. A stop that is cancelled takes no frame from the others; one that it has asked for is still sent.
"""

from __future__ import annotations

import asyncio
from typing import Any

from drivebus.bus import Bus
from drivebus.bus.messages import BusRequest, BusResult
from drivebus.drives.dialects.base import Dialect
from drivebus.drives.operations.steps import OWN_FRAME


class SharedTransactions:
    """Transactions of one drive's stops."""

    def __init__(self, bus: Bus, dialect: Dialect) -> None:
        self._bus, self._dialect = bus, dialect
        self._shared: list[_SharedTransaction] = []
        self._sync_request: Any = None
        self._newest_first: tuple[BusRequest, int, asyncio.Future[BusResult]] | None = None
        """First frame of the newest stop: request, commands requested until then, result."""

    def submit_first(self, request: BusRequest, commands: int) -> asyncio.Future[BusResult]:
        """Queue the first frame of a stop at once and return its result; not to be cancelled, it may be shared.

        ``commands``: number of commands of the drive that were requested so far.
        """
        newest = self._newest_first
        if newest is not None and newest[:2] == (request, commands) and self._bus.is_queued(newest[2]):
            return newest[2]
        result = self._bus.submit(request)
        self._newest_first = request, commands, result
        return result

    def sync_request(self, avoid: Any = None) -> Any:
        """Return the sync probe that waits to be sent, which a stop may join, else the next one of the dialect."""
        waits = any(shared.is_joinable() and shared.request.request == self._sync_request for shared in self._shared)
        if not waits or self._sync_request == avoid:
            self._sync_request = self._dialect.sync_request(avoid)
        return self._sync_request

    async def transact(self, request: BusRequest) -> BusResult:
        """Perform one transaction that is sent after this call, with others that ask for the same frame meanwhile."""
        if request.tag is OWN_FRAME:
            return await self._bus.transact(request)
        transaction = next(
            (shared for shared in self._shared if shared.is_joinable() and shared.request == request), None
        )
        if transaction is None:
            transaction = _SharedTransaction(self._bus, request)
            self._shared.append(transaction)
            transaction.result.add_done_callback(lambda _: self._shared.remove(transaction))
        return await asyncio.shield(transaction.result)


class _SharedTransaction:
    """Shared frame and its result, for each stop that has joined it.

    It is submitted one turn of the event loop later: stops that go on with the same reply ask in the same turn.
    """

    def __init__(self, bus: Bus, request: BusRequest) -> None:
        self.request = request
        self._bus = bus
        self._submitted: asyncio.Future[BusResult] | None = None
        self.result = asyncio.ensure_future(self._perform())

    def is_joinable(self) -> bool:
        """Return whether the frame has not been sent yet, or waits to be sent once more."""
        return self._submitted is None or self._bus.is_queued(self._submitted)

    async def _perform(self) -> BusResult:
        self._submitted = self._bus.submit(self.request)
        return await self._submitted
