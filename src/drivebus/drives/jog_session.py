"""Jog with a dead-man keep-alive: the motor stops when the session is no longer renewed."""

from __future__ import annotations

import asyncio
from types import TracebackType

from drivebus.drives.dialects.base import StopMode
from drivebus.drives.operations.context import OperationContext
from drivebus.drives.operations.jog import begin_jog, check_jog_lease, end_jog
from drivebus.drives.outcome import Outcome, raise_for_status
from drivebus.drives.runner import OperationRunner
from drivebus.drives.state import Direction
from drivebus.drives.stop_supervisor import StopSupervisor
from drivebus.errors import StartInhibited


class JogSession:
    """Jog of a drive: ``async with drive.jog(5.0) as session: ... session.renew()``, or ``start`` and ``stop``.

    The jog ends with the session or ``lease_s`` after the last renewal. The lease is measured by ``Bus.now``, which
    goes on while the machine is suspended, as the motor does.
    """

    def __init__(
        self,
        runner: OperationRunner,
        stops: StopSupervisor,
        *,
        frequency_hz: float | None,
        direction: Direction,
        lease_s: float,
        requested_at: float | None = None,
    ) -> None:
        """Raises LimitError for a lease above 0.5 s."""
        self.lease_s = check_jog_lease(lease_s)
        self._runner, self._stops = runner, stops
        self._frequency_hz, self._direction, self._requested_at = frequency_hz, direction, requested_at
        self._op: OperationContext | None = None
        self._expires_at = 0.0
        self._timer: asyncio.TimerHandle | None = None
        self._ending: asyncio.Task[Outcome] | None = None
        self.expired = False  # the lease ran out and the jog was stopped
        self.start_outcome: Outcome | None = None
        self.stop_outcome: Outcome | None = None

    async def start(self) -> Outcome:
        """Begin to jog. The lease runs from the moment at which the motor may have started to turn."""
        try:
            self.start_outcome = await self._begin()
        except asyncio.CancelledError:
            if self._may_be_running():
                await self._end_and_wait()
            raise
        self._arm(self.lease_s - self._motion_age_s())
        return self.start_outcome

    def renew(self) -> None:
        """Extend the lease from now. Raises StartInhibited where it has run out: only a new jog may begin then.

        A lost port ends it likewise, within the lease: no stop could be sent when it is released.
        """
        if self._timer is not None and self._runner.bus.now() > self._expires_at:
            self.expire()  # the event loop or the machine was held up and the timer has not run yet
        if self.expired or self._timer is None:
            raise StartInhibited("drives.jog_lease_expired", lease_s=self.lease_s)
        if not self._runner.bus.is_open:
            raise StartInhibited("drives.jog_port_lost")
        self._arm(self.lease_s)

    async def stop(self) -> Outcome:
        """End the jog and return how it ended; cancelling the caller does not cancel it. Raises StopUnconfirmed."""
        self.stop_outcome = await self._end_and_wait()
        return self.stop_outcome

    async def __aenter__(self) -> JogSession:
        await self.start()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.stop()

    def _arm(self, left_s: float) -> None:
        if self._timer is not None:
            self._timer.cancel()
        self._expires_at = self._runner.bus.now() + left_s
        self._timer = asyncio.get_running_loop().call_later(left_s, self.expire)

    def expire(self) -> None:
        """End the jog now, as the end of its lease does: queue its stop."""
        self.expired, self._timer = True, None
        self._end()

    def _end(self) -> asyncio.Task[Outcome]:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if self._ending is None:
            operation = end_jog(OperationContext(self._runner.drive))
            self._ending = self._stops.start_stop(operation, StopMode.STOP)
        return self._ending

    async def _end_and_wait(self) -> Outcome:
        """End the jog and wait for its outcome, also where the caller is cancelled. Raises StopUnconfirmed."""
        return raise_for_status(await asyncio.shield(self._end()), stop=True)

    async def _begin(self) -> Outcome:
        with self._runner.command(self._requested_at) as op, self._stops.stop_on_failure(op):
            self._op = op
            return await self._stops.run_motion(begin_jog(op, self._frequency_hz, self._direction))

    def _may_be_running(self) -> bool:
        """Return whether a frame that moves may have left: otherwise a stop would be that of another command."""
        return self._op is not None and self._op.may_be_running

    def _motion_age_s(self) -> float:
        """Return the seconds since the last bit of the frame that moves."""
        result = None if self._op is None else self._op.last_motion_result
        if result is None or result.sent_at is None:
            return 0.0
        bus = self._runner.bus
        return max(0.0, bus.now() - result.sent_at - bus.settings.seconds(len(result.sent)))
