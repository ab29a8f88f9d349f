"""What users of a test stand wished for, when, and what they were told."""

from __future__ import annotations

import asyncio
from contextvars import ContextVar
from dataclasses import dataclass, field
from datetime import date
from typing import Any

from drivebus.errors import DrivebusError

CURRENT: ContextVar[Wish | None] = ContextVar("wish", default=None)
"""Whose wish this task fulfils; tasks that it starts inherit it."""
STOPS = frozenset({"stop", "coast", "quick_stop"})
MOVES = frozenset({"run", "jog"})


@dataclass(slots=True, eq=False)
class Wish:
    """One command of a user."""

    number: int
    address: int
    what: str
    """The drive's method: "run", "stop", "set_frequency", "reset_fault", "write"."""
    arguments: tuple[Any, ...]
    at: float
    day: date
    """On the wall clock: saves are counted by days (G16)."""
    ended_at: float | None = None
    sent: int = 0
    """Frames of this wish that left, but for stops."""
    heard: int = 0
    """Those that the drive heard …"""
    moves_heard: int = 0
    """… and of those the ones that start or jog."""
    executions: int = 0
    """How often a frame of this wish switched the motor on (I2)."""
    outcome: Any = None
    error: Exception | None = None
    task: asyncio.Task[None] | None = field(default=None, repr=False)

    @property
    def over(self) -> bool:
        return self.ended_at is not None

    @property
    def stops(self) -> bool:
        return self.what in STOPS

    @property
    def moves(self) -> bool:
        return self.what in MOVES

    @property
    def word(self) -> str:
        """What the user was told: the outcome's word, else the error's name."""
        if self.outcome is not None:
            return str(self.outcome.word)
        return type(self.error).__name__ if self.error is not None else "nothing"

    def __str__(self) -> str:
        shown = " ".join(str(argument) for argument in self.arguments)
        return f"#{self.number} {self.what} {shown}".strip() + f" @{self.address}"


def bare(error: DrivebusError) -> DrivebusError:
    """The error without the frames that it came through: the witness remembers wishes for hours, and they with it."""
    error.__context__ = error.__cause__ = None
    return error.with_traceback(None)
