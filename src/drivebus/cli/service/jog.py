"""A jog over a service: renewed as long as the key repeats; the service stops it half a second after the last."""

from __future__ import annotations

import asyncio
from types import TracebackType
from typing import TYPE_CHECKING

from drivebus.cli.service.said import outcome_of
from drivebus.errors import NotFound

if TYPE_CHECKING:
    from drivebus.cli.service.drive import ServedDrive
    from drivebus.drives.state import Direction, Outcome


class ServedJog:
    """``async with``; the face of ``drives.JogLease``."""

    def __init__(self, drive: ServedDrive, frequency_hz: float | None, direction: Direction) -> None:
        self._drive, self._frequency_hz, self._direction = drive, frequency_hz, direction
        self._word = ""
        self._pressed = asyncio.Event()
        self._renewing: asyncio.Task[None] | None = None
        self.begun: Outcome | None = None
        self.ended: Outcome | None = None

    async def __aenter__(self) -> ServedJog:
        given = {"direction": str(self._direction), **await self._drive.armed()}
        given |= {} if self._frequency_hz is None else {"frequency_hz": self._frequency_hz}
        found = await self._drive.ask("drive.jog", **given)
        self._word, self.begun = found["jog"], outcome_of(found)
        self._renewing = asyncio.create_task(self._renew(), name="jog")
        return self

    def renew(self) -> None:
        """The hand is still on the key. Raises GateError once the service has ended the jog."""
        if self._renewing is not None and self._renewing.done():
            self._renewing.result()
        self._pressed.set()

    async def _renew(self) -> None:
        """Each press is told once; two presses while one is under way are one."""
        while True:
            await self._pressed.wait()
            self._pressed.clear()
            await self._drive.ask("drive.jog_renew", jog=self._word)

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._renewing is not None:
            self._renewing.cancel()
            await asyncio.gather(self._renewing, return_exceptions=True)
        try:
            self.ended = outcome_of(await self._drive.ask("drive.jog_end", jog=self._word))
        except NotFound:
            self.ended = await self._drive.stop()
