"""What the steps work with: a link, a drive on it, and perhaps a person."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import AsyncIterator, Awaitable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

from drivebus.cli import connect, output
from drivebus.cli.connect import Target

if TYPE_CHECKING:
    from drivebus.bus import Bus
    from drivebus.cli.signals import ShutdownSignal
    from drivebus.drives import Drive

T = TypeVar("T")


class AcceptanceInterrupted(Exception):
    """The user ended the checklist; what was found so far is kept."""


@dataclass(frozen=True, slots=True)
class AcceptanceSession:
    """``motor``: it may turn, at ``frequency_hz`` at most."""

    target: Target
    shutdown: ShutdownSignal
    motor: bool
    frequency_hz: float

    @asynccontextmanager
    async def drive(self) -> AsyncIterator[tuple[Bus, Drive]]:
        """A bus opened for one step, with the drive on it."""
        async with connect.open_drive(self.target) as found:
            yield found

    async def race(self, work: Awaitable[T]) -> T:
        """``work``'s result. Raises Ended where Ctrl-C or a signal came first."""
        found = await self.shutdown.interruptible(_boxed(work))
        if found is None:
            raise AcceptanceInterrupted
        return found[0]

    async def ask(self, key: str, /, **params: Any) -> str:
        """A line typed after a question, lower case; empty where nobody is there."""
        if not sys.stdin.isatty():
            return ""
        output.print_note(key, **params)
        return (await self.race(_read_line())).strip().lower()

    async def confirm(self, key: str, /, **params: Any) -> bool:
        """Only y is yes."""
        return await self.ask(key, **params) == "y"


async def _boxed(work: Awaitable[T]) -> tuple[T]:
    return (await work,)


async def _read_line() -> str:
    """One line of standard input, while the loop goes on. Where it is not waited for any more it is thrown away."""
    loop = asyncio.get_running_loop()
    ready: asyncio.Future[str] = loop.create_future()

    def readable() -> None:
        loop.remove_reader(sys.stdin)
        if not ready.done():
            ready.set_result(sys.stdin.readline())

    loop.add_reader(sys.stdin, readable)
    try:
        return await ready
    finally:
        loop.remove_reader(sys.stdin)
