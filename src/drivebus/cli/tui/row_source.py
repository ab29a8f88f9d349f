"""Where the live view gets its rows from, and whom its keys command: the two seams of the view."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from drivebus.cli.tui.rows import BusRow, DriveRow


class RowSource(Protocol):
    """A source of rows: real buses, a capture, or a test."""

    title: str

    async def start(self) -> None: ...

    async def close(self) -> None: ...

    def now(self) -> float:
        """Monotonic second, for ages."""
        ...

    def drives(self) -> Sequence[DriveRow]: ...

    def lines(self) -> Sequence[BusRow]: ...

    def news(self) -> Sequence[str]:
        """What happened, oldest first."""
        ...

    @property
    def over(self) -> bool:
        """Nothing more will come."""
        ...


class KeyCommands(Protocol):
    """What the keys of the view may do. A view without one is read-only."""

    def run(self, key: str) -> None: ...

    def stop(self, key: str) -> None: ...

    def change(self, key: str, by_hz: float) -> None: ...

    def reset(self, key: str) -> None: ...

    def stop_all(self) -> None: ...
