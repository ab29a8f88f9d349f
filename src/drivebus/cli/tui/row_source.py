"""Interfaces of the live view: the source of its rows, and the commands of its keys."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from drivebus.cli.tui.rows import BusRow, DriveRow


class RowSource(Protocol):
    """Source of rows: a bus, a capture, a service or a test."""

    title: str

    async def start(self) -> None: ...

    async def close(self) -> None: ...

    def now(self) -> float:
        """Return the monotonic second that ages refer to."""
        ...

    def drives(self) -> Sequence[DriveRow]: ...

    def buses(self) -> Sequence[BusRow]: ...

    def messages(self) -> Sequence[str]:
        """Return the messages so far, oldest first."""
        ...

    @property
    def finished(self) -> bool:
        """Whether no further rows will come."""
        ...


class KeyCommands(Protocol):
    """Commands of the keys; a view without them is read-only."""

    def run(self, key: str) -> None: ...

    def stop(self, key: str) -> None: ...

    def change_frequency(self, key: str, by_hz: float) -> None: ...

    def reset(self, key: str) -> None: ...

    def stop_all(self) -> None: ...
