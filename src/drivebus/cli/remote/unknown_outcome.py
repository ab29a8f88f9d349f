"""A service that is gone between the question and the answer: whether it was done, nobody knows."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from drivebus.errors import OutcomeUnknown, ServiceUnavailable


@contextmanager
def outcome_unknown_on_loss(operation: str, *keys: str) -> Iterator[None]:
    """Turn these ways to be unavailable into OutcomeUnknown, where ``operation`` acts."""
    from drivebus.service.api.operations import OPERATIONS

    try:
        yield
    except ServiceUnavailable as error:
        if error.key in keys and OPERATIONS[operation].mutates:
            raise OutcomeUnknown("service.lost", operation=operation) from error
        raise
