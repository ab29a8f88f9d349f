"""Reaction of a misbehaving station to a request, and what its reply reports.

The stations (``verification.families``) share the codecs with the product and nothing else; the simulated drives of the
product are not used.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from verification.statements.drive_physics import DrivePhysics


@dataclass(frozen=True, slots=True)
class Report:
    """Content of one reply about the drive; None: it does not show it."""

    state: str | None = None
    hz: float | None = None
    setpoint_hz: float | None = None
    direction: str | None = None
    fault: int | None = None


@dataclass(slots=True, kw_only=True)
class Reaction:
    """Reaction of a station to a request."""

    effect: str
    """read, set, start, stop or reset."""
    reply: Any = None
    rejected: bool = False
    reports: Report = field(default_factory=Report)


class StationModel(Protocol):
    """Station of one model: which reply a request gets."""

    @property
    def preset(self) -> Mapping[int, int]:
        """Parameters by their cell."""

    def react(self, physics: DrivePhysics, message: Any, refuses: frozenset[str]) -> Reaction:
        """Execute a request and return the reply."""
