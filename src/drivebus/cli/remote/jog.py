"""A jog over a service: renewed as long as the key repeats; the service stops it half a second after the last."""

from __future__ import annotations

import asyncio
from types import TracebackType
from typing import TYPE_CHECKING

from drivebus.cli.remote.convert import parse_outcome
from drivebus.errors import NotFound

if TYPE_CHECKING:
    from drivebus.cli.remote.drive import RemoteDrive
    from drivebus.drives.state import Direction, Outcome


class RemoteJog:
    """``async with``; the face of ``drives.JogSession``."""

    def __init__(self, drive: RemoteDrive, frequency_hz: float | None, direction: Direction) -> None:
        self._drive, self._frequency_hz, self._direction = drive, frequency_hz, direction
        self._jog_id = ""
        self._renewal_due = asyncio.Event()
        self._renewal: asyncio.Task[None] | None = None
        self.start_outcome: Outcome | None = None
        self.stop_outcome: Outcome | None = None

    async def __aenter__(self) -> RemoteJog:
        given = {"direction": str(self._direction), **await self._drive.arm()}
        given |= {} if self._frequency_hz is None else {"frequency_hz": self._frequency_hz}
        found = await self._drive.call("drive.jog", **given)
        self._jog_id, self.start_outcome = found["jog"], parse_outcome(found)
        self._renewal = asyncio.create_task(self._renew(), name="jog")
        return self

    def renew(self) -> None:
        """The hand is still on the key. Raises StartInhibited once the service has ended the jog."""
        if self._renewal is not None and self._renewal.done():
            self._renewal.result()
        self._renewal_due.set()

    async def _renew(self) -> None:
        """Each press is told once; two presses while one is under way are one."""
        while True:
            await self._renewal_due.wait()
            self._renewal_due.clear()
            await self._drive.call("drive.jog_renew", jog=self._jog_id)

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._renewal is not None:
            self._renewal.cancel()
            await asyncio.gather(self._renewal, return_exceptions=True)
        try:
            self.stop_outcome = parse_outcome(await self._drive.call("drive.jog_end", jog=self._jog_id))
        except NotFound:
            self.stop_outcome = await self._drive.stop()
