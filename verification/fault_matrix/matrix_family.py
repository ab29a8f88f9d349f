"""Requests and replies of one protocol family for the fault matrix."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from random import Random
from typing import Any, Protocol

from verification.drive_variants import DriveVariant

ErrorReply = tuple[int | None, Callable[[Any], Any]]
"""Code that the outcome names, and the reply of station 1 with it to a request."""


def _no_requests(variant: DriveVariant) -> tuple[Any, ...]:
    return ()


def _same_reply(variant: DriveVariant, data: bytes, *, stopped: bool) -> bytes:
    return data


class StateFalsifier(Protocol):
    """Return a reply with another state and a correct check: of a stopped drive, or of one that runs."""

    def __call__(self, variant: DriveVariant, data: bytes, *, stopped: bool) -> bytes: ...


@dataclass(frozen=True, kw_only=True)
class MatrixFamily:
    """Requests and replies of one family for the cells of the matrix; all for or of station 1."""

    error_replies: Callable[[DriveVariant], tuple[ErrorReply, ...]]
    """Each error reply to a write."""
    short_error: Callable[[DriveVariant, Random], tuple[Any, int] | None]
    """An error reply to a read that is shorter than the normal one, and its size; None where there is none."""
    forbidden_broadcasts: Callable[[DriveVariant], Iterable[Any]] = _no_requests
    """Starts, jogs, setpoints, resets and parameter writes to the broadcast address."""
    undocumented_commands: Callable[[DriveVariant], Iterable[Any]] = _no_requests
    """Commands that no document explains."""
    falsify_state: StateFalsifier = _same_reply
    ram_parameters: frozenset[str] = frozenset()
    """Parameters that can be written without saving them."""
