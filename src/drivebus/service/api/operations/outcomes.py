"""Results of commands in an answer: the outcome with its frames, an error, and one of them for each drive."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field

from drivebus.service.api.operations.operation import ApiObject, LocalizedText
from drivebus.types import Json


class ExchangeObject(ApiObject):
    """Frame of a command and its reply, as hex with blanks; seconds of the service's monotonic clock.

    ``error`` is the key of a sentence, ``params`` its parameters.
    """

    sent: str
    received: str
    sent_at_s: float | None
    received_at_s: float | None
    error: str | None
    params: dict[str, Any] = {}


class NoteObject(ApiObject):
    """An additional sentence."""

    key: str
    text: LocalizedText


class OutcomeObject(ApiObject):
    """Result of a command. ``confirmed``: a later read shows the effect; ``acknowledged``: the drive accepted it and no
    read can show it; ``unknown``: sent, and whether it was done cannot be known. ``command``: id in the audit trail.
    """

    status: Literal["confirmed", "acknowledged", "refused", "failed", "unknown"]
    key: str
    text: LocalizedText
    params: dict[str, Any]
    notes: list[NoteObject]
    frames: list[ExchangeObject]
    command: str | None = None


class OutcomeResponse(ApiObject):
    """Result of one command."""

    outcome: OutcomeObject


class ErrorObject(ApiObject):
    """An error. ``code`` never changes; ``text`` may be worded better.

    ``may_be_running`` false: the motor can't be running by the command; true: it may be; null: not known.
    """

    code: str = Field(examples=["drives.above_maximum"])
    kind: str = Field(examples=["LimitError"])
    text: LocalizedText
    params: Json
    outcome: OutcomeObject | None
    may_be_running: bool | None


class ErrorResponse(ApiObject):
    """The one shape of every error."""

    error: ErrorObject


class ChangeObject(ApiObject):
    """Result of a change that sends nothing; ``unchanged``: it was so before."""

    status: Literal["done", "unchanged"]


class OutcomesResponse(ApiObject):
    """An outcome or an error for each drive."""

    outcomes: dict[str, OutcomeObject | ErrorObject]


class ChangesResponse(ApiObject):
    """``done``, ``unchanged`` or an error for each: another user may have been faster."""

    outcomes: dict[str, ChangeObject | ErrorObject]
