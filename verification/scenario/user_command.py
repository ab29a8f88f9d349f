"""What users of a test stand wished for, when, and what they were told."""

from __future__ import annotations

import asyncio
from contextvars import ContextVar
from dataclasses import dataclass, field
from datetime import date
from typing import Any

from drivebus.errors import DrivebusError

CURRENT_COMMAND: ContextVar[UserCommand | None] = ContextVar("wish", default=None)
"""Whose wish this task fulfils; tasks that it starts inherit it."""
STOP_METHODS = frozenset({"stop", "coast", "quick_stop"})
MOTION_METHODS = frozenset({"run", "jog"})


@dataclass(slots=True, eq=False)
class UserCommand:
    """One command of a user."""

    number: int
    address: int
    method: str
    """The drive's method: "run", "stop", "set_frequency", "reset_fault", "write"."""
    arguments: tuple[Any, ...]
    at: float
    day: date
    """On the wall clock: saves are counted by days."""
    ended_at: float | None = None
    frames_sent: int = 0
    """Frames of this wish that left, but for stops."""
    frames_received: int = 0
    """Those that the drive heard …"""
    motion_frames_received: int = 0
    """… and of those the ones that start or jog."""
    executions: int = 0
    """How often a frame of this wish switched the motor on (I2)."""
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
        """What the user was told: the outcome's word, else the error's name."""
        if self.outcome is not None:
            return str(self.outcome.status)
        return type(self.error).__name__ if self.error is not None else "nothing"

    def __str__(self) -> str:
        shown = " ".join(str(argument) for argument in self.arguments)
        return f"#{self.number} {self.method} {shown}".strip() + f" @{self.address}"


def without_traceback(error: DrivebusError) -> DrivebusError:
    """The error without the frames that it came through: the witness remembers wishes for hours, and they with it."""
    error.__context__ = error.__cause__ = None
    return error.with_traceback(None)
