"""A jog with a lease: letting go of the key, or hanging, stops the motor (T13). The asyncio part of ``jogging``."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from types import TracebackType

from drivebus.drives.operations.jog import check_jog_lease
from drivebus.drives.state import Outcome
from drivebus.errors import StartInhibited


class JogSession:
    """``async with drive.jog(hz, direction) as lease: ... lease.renew()``. The jog ends with the block or the lease."""

    def __init__(
        self,
        begin: Callable[[], Awaitable[Outcome]],
        end: Callable[[], Awaitable[Outcome]],
        lease_s: float,
        turning_s: Callable[[], float] = lambda: 0.0,
        now: Callable[[], float] | None = None,
        may_turn: Callable[[], bool] = lambda: True,
    ) -> None:
        """``turning_s``: for how long the motor may have been turning when ``begin`` has returned.

        ``may_turn``: whether a frame that moves may have left when ``begin`` is cancelled. A jog of which nothing left
        needs no end: its stop would be somebody else's.

        ``now``: a clock that goes on while the machine is suspended, as the motor does; None: the loop's.
        """
        self.lease_s = check_jog_lease(lease_s)
        self._begin, self._end, self._turning_s = begin, end, turning_s
        self._may_turn = may_turn
        self._now, self._until = now or (lambda: asyncio.get_running_loop().time()), 0.0
        self._timer: asyncio.TimerHandle | None = None
        self._ending: asyncio.Task[Outcome] | None = None
        self.expired = False
        """The lease ran out and the jog was stopped."""
        self.start_outcome: Outcome | None = None
        self.stop_outcome: Outcome | None = None

    async def __aenter__(self) -> JogSession:
        try:
            self.start_outcome = await self._begin()
        except asyncio.CancelledError:
            if self._may_turn():
                await asyncio.shield(self._stop())
            raise
        self._arm(self.lease_s - self._turning_s())
        return self

    def renew(self) -> None:
        """Extend the lease. Raises StartInhibited once it was lost: only a new jog may begin then."""
        if self._timer is not None and self._now() > self._until:
            self._run_out()  # loop or machine was held up: the lease is over although its timer has not run yet
        if self.expired or self._timer is None:
            raise StartInhibited("drives.lease_lost", lease_s=self.lease_s)
        self._arm(self.lease_s)

    def _arm(self, left_s: float) -> None:
        if self._timer is not None:
            self._timer.cancel()
        self._until = self._now() + left_s
        self._timer = asyncio.get_running_loop().call_later(left_s, self._run_out)

    def _run_out(self) -> None:
        """Nobody renewed: stop now, whether or not the block goes on."""
        self.expired, self._timer = True, None
        self._stop()

    def _stop(self) -> asyncio.Task[Outcome]:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if self._ending is None:
            self._ending = asyncio.ensure_future(_awaited(self._end))
        return self._ending

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop_outcome = await asyncio.shield(self._stop())


async def _awaited(end: Callable[[], Awaitable[Outcome]]) -> Outcome:
    return await end()
