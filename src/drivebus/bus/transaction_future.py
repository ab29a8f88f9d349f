"""Future of one awaited transaction, whose task goes on within the delivery of the reply.

The next turn of the event loop would cost a system call and a tenth of the processor time of the whole transaction.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextvars import Context
from typing import Any

from drivebus.bus.messages import BusResult


class TransactionFuture(asyncio.Future[BusResult]):
    """Future that one task awaits; it takes no other callback. A reply runs the task up to its next ``await``.

    Where another task is running, or the transaction failed, the task goes on in the next turn: no task can run within
    another, and a request after a lost port belongs after its reopening.
    """

    _wake_up: Callable[[TransactionFuture], object] | None = None
    """Wake-up of the task, to be called in ``_context``."""
    _context: Context

    def add_done_callback(
        self, fn: Callable[[TransactionFuture], object], /, *, context: Context | None = None
    ) -> None:
        """Remember the wake-up of the task that awaits this future."""
        assert context is not None and self._wake_up is None
        self._wake_up, self._context = fn, context

    def set_result(self, result: BusResult, /) -> None:
        super().set_result(result)
        if self._wake_up is None:
            return
        loop = self.get_loop()
        if result.error is not None or asyncio.current_task(loop) is not None:
            self._wake_up_later()
            return
        try:
            self._context.run(self._wake_up, self)
        except BaseException as error:  # sys.exit() in the task: the loop ends once the bus has delivered other results
            loop.call_soon(_raise, error)

    def cancel(self, msg: Any | None = None) -> bool:
        cancelled = super().cancel(msg)
        if cancelled:
            self._wake_up_later()
        return cancelled

    def _wake_up_later(self) -> None:
        if self._wake_up is not None:
            self.get_loop().call_soon(self._wake_up, self, context=self._context)


def _raise(error: BaseException) -> None:
    raise error
