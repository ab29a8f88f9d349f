"""Outcome of a command: how it ended and the frames that show it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from drivebus import i18n
from drivebus.drives.state import DriveStatus
from drivebus.errors import DriveError, DriveRejected, OutcomeUnknown, StopUnconfirmed, TargetNotReached


class OutcomeStatus(StrEnum):
    """Status of an outcome: confirmed, acknowledged, refused, failed or unknown."""

    CONFIRMED = "confirmed"
    """A later verified read shows the effect."""
    ACKNOWLEDGED = "acknowledged"
    """The drive accepted the command and no read can show the effect."""
    REFUSED = "refused"
    """The drive rejected the command."""
    FAILED = "failed"
    """The command was not executed."""
    UNKNOWN = "unknown"
    """The command was sent, and nothing shows whether it was executed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameExchange:
    """Frame of an operation and its reply: the evidence of an outcome. Times are seconds by ``Bus.now``."""

    sent: bytes
    received: bytes
    sent_at: float | None
    received_at: float | None
    error: str | None = None  # i18n key
    params: Mapping[str, Any] = field(default_factory=dict)  # parameters of the error's sentence


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """Outcome of a command: status, sentence (``key`` and ``params``), frames and drive status."""

    status: OutcomeStatus
    key: str
    params: Mapping[str, Any] = field(default_factory=dict)
    exchanges: tuple[FrameExchange, ...] = ()
    drive_status: DriveStatus | None = None
    notes: tuple[tuple[str, Mapping[str, Any]], ...] = ()  # further sentences: key and parameters

    @property
    def succeeded(self) -> bool:
        """Whether the command is confirmed, or acknowledged where no more can be known."""
        return self.status in (OutcomeStatus.CONFIRMED, OutcomeStatus.ACKNOWLEDGED)

    def text(self, language: str = "en") -> str:
        """Return the sentence in ``language`` ("en" or "zh")."""
        return i18n.text(self.key, language, **self.params)

    def note_texts(self, language: str = "en") -> list[str]:
        """Return the sentences of ``notes`` in ``language``."""
        return [i18n.text(key, language, **params) for key, params in self.notes]

    def __str__(self) -> str:
        return f"{self.status}: {self.text()}"


_ERROR_CLASSES: dict[OutcomeStatus, type[DriveError]] = {
    OutcomeStatus.REFUSED: DriveRejected,
    OutcomeStatus.FAILED: TargetNotReached,
    OutcomeStatus.UNKNOWN: OutcomeUnknown,
}


def raise_for_status(outcome: Outcome, *, stop: bool = False) -> Outcome:
    """Return a confirmed or acknowledged outcome.

    Raises DriveRejected, TargetNotReached, OutcomeUnknown or StopUnconfirmed, so that a caller who ignores the return
    value can't take a failed command for an executed one.
    """
    if outcome.succeeded:
        return outcome
    kind = StopUnconfirmed if stop else _ERROR_CLASSES[outcome.status]
    error = kind(outcome.key, **dict(outcome.params))
    error.outcome = outcome
    raise error
