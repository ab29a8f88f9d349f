"""From an outcome to what a caller sees: done is returned, everything else is raised with the outcome on it. Pure."""

from __future__ import annotations

from drivebus.drives.state import Outcome, OutcomeWord
from drivebus.errors import DriveError, NotReached, OutcomeUnknown, Refused, StopUnconfirmed

_ERRORS: dict[OutcomeWord, type[DriveError]] = {
    OutcomeWord.REFUSED: Refused,
    OutcomeWord.FAILED: NotReached,
    OutcomeWord.UNKNOWN: OutcomeUnknown,
}


def settled(outcome: Outcome, *, stop: bool = False) -> Outcome:
    """The outcome where it is confirmed or acknowledged. Raises Refused, NotReached, OutcomeUnknown, StopUnconfirmed.

    Nobody who ignores a return value may believe that a motor did what it did not.
    """
    if outcome.done:
        return outcome
    kind = StopUnconfirmed if stop else _ERRORS[outcome.word]
    error = kind(outcome.key, **dict(outcome.params))
    error.outcome = outcome
    raise error
