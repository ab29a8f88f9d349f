"""User commands of a scenario, their times and their results."""

from __future__ import annotations

import asyncio
from contextvars import ContextVar
from dataclasses import dataclass, field
from datetime import date
from typing import Any

from drivebus.errors import DrivebusError

CURRENT_COMMAND: ContextVar[UserCommand | None] = ContextVar("command", default=None)
"""Command that the current task executes; tasks that it starts inherit it."""
STOP_METHODS = frozenset({"stop", "coast", "quick_stop"})
MOTION_METHODS = frozenset({"run", "jog"})
SUCCESS_WORDS = frozenset({"confirmed", "acknowledged"})
"""Statuses of the outcome of a command that succeeded."""


@dataclass(slots=True, eq=False, kw_only=True)
class UserCommand:
    """Command of a user, with its result."""

    number: int
    address: int
    method: str
    """Method of the drive: "run", "stop", "set_frequency", "reset_fault", "write"."""
    arguments: tuple[Any, ...]
    at: float
    day: date
    """Day of the wall clock, by which saves are counted."""
    ended_at: float | None = None
    frames_sent: int = 0
    """Frames sent for this command, without stops."""
    frames_received: int = 0
    """Frames of this command that the drive received."""
    motion_frames_received: int = 0
    """Received frames of this command that start or jog."""
    executions: int = 0
    """Number of times that a frame of this command started the motor (I2)."""
    outcome: Any = None
    error: Exception | None = None
    task: asyncio.Task[None] | None = field(default=None, repr=False)

    @property
    def is_ended(self) -> bool:
        return self.ended_at is not None

    @property
    def is_stop(self) -> bool:
        return self.method in STOP_METHODS

    @property
    def is_motion(self) -> bool:
        return self.method in MOTION_METHODS

    @property
    def result_word(self) -> str:
        """Status of the outcome, else the name of the error."""
        if self.outcome is not None:
            return str(self.outcome.status)
        return type(self.error).__name__ if self.error is not None else "nothing"

    @property
    def succeeded(self) -> bool:
        return self.result_word in SUCCESS_WORDS

    def __str__(self) -> str:
        shown = " ".join(str(argument) for argument in self.arguments)
        return f"#{self.number} {self.method} {shown}".strip() + f" @{self.address}"


def without_traceback(error: DrivebusError) -> DrivebusError:
    """Return the error without its traceback, which would stay in memory as long as the command."""
    error.__context__ = error.__cause__ = None
    return error.with_traceback(None)
