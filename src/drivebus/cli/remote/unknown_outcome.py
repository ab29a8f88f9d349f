"""Unknown outcome of an operation whose service was lost before it responded."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from drivebus.errors import OutcomeUnknown, ServiceUnavailable


@contextmanager
def outcome_unknown_on_loss(operation: str, *keys: str) -> Iterator[None]:
    """Raise OutcomeUnknown for a ServiceUnavailable with one of these keys, if ``operation`` mutates."""
    from drivebus.service.api.operations import OPERATIONS

    try:
        yield
    except ServiceUnavailable as error:
        if error.key in keys and OPERATIONS[operation].mutates:
            raise OutcomeUnknown("service.lost", operation=operation) from error
        raise
