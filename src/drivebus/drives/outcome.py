"""From an outcome to what a caller sees: done is returned, everything else is raised with the outcome on it. Pure."""

from __future__ import annotations

from drivebus.drives.state import Outcome, OutcomeStatus
from drivebus.errors import DriveError, DriveRejected, OutcomeUnknown, StopUnconfirmed, TargetNotReached

_ERROR_CLASSES: dict[OutcomeStatus, type[DriveError]] = {
    OutcomeStatus.REFUSED: DriveRejected,
    OutcomeStatus.FAILED: TargetNotReached,
    OutcomeStatus.UNKNOWN: OutcomeUnknown,
}


def raise_for_status(outcome: Outcome, *, stop: bool = False) -> Outcome:
    """The outcome where it is confirmed or acknowledged. Raises Refused, TargetNotReached, OutcomeUnknown, StopUnconfirmed.

    Nobody who ignores a return value may believe that a motor did what it did not.
    """
    if outcome.done:
        return outcome
    kind = StopUnconfirmed if stop else _ERROR_CLASSES[outcome.word]
    error = kind(outcome.key, **dict(outcome.params))
    error.outcome = outcome
    raise error
