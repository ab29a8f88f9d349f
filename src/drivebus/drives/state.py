"""What a drive reports and what became of a command: values only, no decision, no clock."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from drivebus import i18n
from drivebus.profiles.model import Text
from drivebus.values import Reading


class LocalizedEnum(StrEnum):
    """A word that shows itself in the reader's language (``i18n`` asks for ``en`` and ``zh``)."""

    @property
    def en(self) -> str:
        """The word in English."""
        return i18n.text(self._key, "en")

    @property
    def zh(self) -> str:
        """The word in Chinese."""
        return i18n.text(self._key, "zh")

    @property
    def _key(self) -> str:
        return f"drives.{_KEY_PREFIXES[type(self).__name__]}_{self.value}"


_KEY_PREFIXES = {"DriveState": "state", "Direction": "way", "CommandKind": "kind"}


class DriveState(LocalizedEnum):
    """What the drive itself reports. UNKNOWN is a state; it is never replaced by a guess (ruling 4)."""

    STOPPED = "stopped"
    RUNNING = "running"
    ACCELERATING = "accelerating"
    DECELERATING = "decelerating"
    JOGGING = "jogging"
    BRAKING = "braking"
    PAUSED = "paused"
    RESTARTING = "restarting"
    NOT_READY = "not_ready"
    FAULT = "fault"
    EMERGENCY_STOPPED = "emergency_stopped"
    UNKNOWN = "unknown"

    @property
    def turning(self) -> bool:
        """The drive drives, brakes or will drive the motor by itself: never "not executed" (ruling 6)."""
        return self in _TURNING_STATES

    @property
    def driven(self) -> bool:
        """The drive obeys a run command."""
        return self in _DRIVEN_STATES

    @property
    def output_off(self) -> bool:
        """A stop is finished; FAULT and NOT_READY finish it too, and are said so (ruling 5)."""
        return self in _OUTPUT_OFF_STATES


_DRIVEN_STATES = frozenset({DriveState.RUNNING, DriveState.ACCELERATING, DriveState.RESTARTING})
_TURNING_STATES = _DRIVEN_STATES | {DriveState.DECELERATING, DriveState.JOGGING, DriveState.BRAKING, DriveState.PAUSED}
_OUTPUT_OFF_STATES = frozenset(
    {DriveState.STOPPED, DriveState.EMERGENCY_STOPPED, DriveState.FAULT, DriveState.NOT_READY},
)


class Direction(LocalizedEnum):
    """Which way round, as the drive counts it."""

    FORWARD = "forward"
    REVERSE = "reverse"


@dataclass(frozen=True, slots=True)
class Fault:
    """A fault that the drive reports: its own code, the keypad's label, and the maker's words where published."""

    code: int
    label: str
    text: Text
    cause: Text | None = None
    remedy: Text | None = None


@dataclass(frozen=True, slots=True)
class DerivedState:
    """What a dialect makes of the newest replies."""

    state: DriveState
    direction: Direction | None = None
    fault_code: int | None = None
    reason: str | None = None
    """Why the state is UNKNOWN (an i18n key)."""


STATE_NOT_READ = DerivedState(DriveState.UNKNOWN, reason="drives.not_read")


@dataclass(frozen=True, slots=True)
class DriveStatus:
    """A drive at one moment: state, direction, fault and readings by signal name; what is not known has a reason."""

    state: DriveState
    direction: Direction | None = None
    fault: Fault | None = None
    readings: Mapping[str, Reading] = field(default_factory=dict)
    reason: str | None = None
    """Why the state is unknown (an i18n key), else None."""
    at: float | None = None
    """Monotonic second of the oldest reply that the state rests on."""


class OutcomeStatus(StrEnum):
    """Ruling 1: how a command ended."""

    CONFIRMED = "confirmed"
    """A later read behind a fence shows the effect."""
    ACKNOWLEDGED = "acknowledged"
    """The drive said yes and nothing readable can show the effect."""
    REFUSED = "refused"
    """The drive said no."""
    FAILED = "failed"
    """Not executed, and that is known."""
    UNKNOWN = "unknown"
    """Sent, and nothing tells whether it was done."""


@dataclass(frozen=True, slots=True)
class FrameExchange:
    """One frame of a command and what came back: the evidence of an outcome."""

    sent: bytes
    received: bytes
    sent_at: float | None
    received_at: float | None
    error: str | None = None
    """i18n key of what went wrong."""
    params: Mapping[str, Any] = field(default_factory=dict)
    """Of that sentence."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a command ended, in one word, one sentence (``key`` and ``params``) and its frames."""

    status: OutcomeStatus
    key: str
    params: Mapping[str, Any] = field(default_factory=dict)
    exchanges: tuple[FrameExchange, ...] = ()
    drive_status: DriveStatus | None = None
    notes: tuple[tuple[str, Mapping[str, Any]], ...] = ()
    """Further sentences: what could not be checked, and how the user can."""

    @property
    def succeeded(self) -> bool:
        """Confirmed, or acknowledged where nothing more can be known."""
        return self.status in (OutcomeStatus.CONFIRMED, OutcomeStatus.ACKNOWLEDGED)

    def text(self, language: str = "en") -> str:
        """The sentence in ``language`` ("en" or "zh")."""
        return i18n.text(self.key, language, **self.params)

    def __str__(self) -> str:
        return f"{self.status}: {self.text()}"
