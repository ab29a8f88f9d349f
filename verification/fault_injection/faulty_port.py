"""A port around another one whose n-th call fails: open, write, delivery or close, counted in one row."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from typing import Any

from drivebus.errors import PortLost, PortUnavailable
from drivebus.testing.virtual_time import VirtualLoop

PORT_ERRORS: dict[str, Callable[[], Exception]] = {
    **{
        name: (lambda code: lambda: OSError(code, os.strerror(code)))(getattr(errno, name))
        for name in ("EIO", "ENODEV", "EACCES", "ENOSPC")
    },
    "PortLost": lambda: PortLost("ports.lost", port="faulty", reason="injected"),
    "PortUnavailable": lambda: PortUnavailable("sim.unplugged", port="faulty"),
    "RuntimeError": lambda: RuntimeError("nobody foresaw this"),
}


def failure_modes(what: str) -> tuple[tuple[str, bool], ...]:
    """How a call of this name may fail: the error, and (True) whether its bytes have left nevertheless."""
    plain = tuple((name, False) for name in PORT_ERRORS)
    return {"write": (*plain, ("EIO", True), ("RuntimeError", True)), "read": plain[:1]}.get(what, plain)


class FaultyPort:
    """``nth`` 0: nothing fails. A delivery that fails loses its bytes, and the port, as real ports tell it."""

    def __init__(self, port: Any, loop: ErrorTolerantLoop) -> None:
        self._port, self._loop, self._receiver = port, loop, None
        self.nth = self.calls = 0
        self.error, self.late = "", False
        self.failed = ""
        self.calls_made: list[str] = []
        """What was called, one after another."""
        self.lost: Callable[[], None] = lambda: None

    def __getattr__(self, name: str) -> Any:
        return getattr(self._port, name)

    def arm(self, nth: int, error: str, late: bool) -> None:
        """Count from now on."""
        self.nth, self.error, self.late, self.calls, self.failed = nth, error, late, 0, ""
        self.calls_made.clear()

    def _fails(self, what: str) -> Exception | None:
        self.calls += 1
        self.calls_made.append(what)
        if self.calls != self.nth:
            return None
        self.failed = what
        self._loop.injected = PORT_ERRORS[self.error]()
        self.lost()
        return self._loop.injected

    async def open(self, receiver: Any) -> None:
        if (error := self._fails("open")) is not None:
            raise error
        self._receiver = receiver
        await self._port.open(self)

    def write(self, data: bytes, /) -> None:
        if self.late or self.calls + 1 != self.nth:
            self._port.write(data)
        if (error := self._fails("write")) is not None:
            raise error

    async def close(self) -> None:
        await self._port.close()
        if (error := self._fails("close")) is not None:
            raise error

    def data_received(self, data: bytes, marks: int = 0) -> None:
        receiver: Any = self._receiver
        if self._fails("read") is None:
            receiver.data_received(data, marks)
        else:
            self._port._receiver = None
            self._port.simulated_bus.detach(self._port)
            receiver.port_lost(PortLost("ports.lost", port="faulty", reason=self.error))

    def port_lost(self, error: PortLost) -> None:
        receiver: Any = self._receiver
        receiver.port_lost(error)


class ErrorTolerantLoop(VirtualLoop):
    """What the bus says of the injected error is no finding; that it says it is counted."""

    injected: Exception | None = None
    reported_count = 0

    def call_exception_handler(self, context: dict[str, Any]) -> None:
        if context.get("exception") is self.injected is not None:
            self.reported_count += 1
        else:
            super().call_exception_handler(context)
