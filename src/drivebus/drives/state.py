"""State of a drive as it reports it: state, direction, fault and readings."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass, field
from enum import StrEnum

from drivebus import i18n
from drivebus.values import Reading, Text, bilingual_text


class LocalizedEnum(StrEnum):
    """Enumeration whose members have a text in every language of the catalogue."""

    def in_language(self, language: str) -> str:
        """Return the text of the member in a language."""
        return i18n.text(f"drives.{_KEY_PREFIXES[type(self).__name__]}_{self.value}", language)


_KEY_PREFIXES = {"DriveState": "state", "Direction": "direction", "CommandKind": "kind"}


class DriveState(LocalizedEnum):
    """State that the drive itself reports; UNKNOWN is never replaced by a guess."""

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
        """Whether the drive turns, brakes or will turn the motor by itself."""
        return self in _TURNING_STATES

    @property
    def driven(self) -> bool:
        """Whether the drive executes a run command."""
        return self in _DRIVEN_STATES

    @property
    def output_off(self) -> bool:
        """Whether a stop is finished; FAULT and NOT_READY finish it too."""
        return self in _OUTPUT_OFF_STATES


_DRIVEN_STATES = frozenset({DriveState.RUNNING, DriveState.ACCELERATING, DriveState.RESTARTING})
_TURNING_STATES = _DRIVEN_STATES | {DriveState.DECELERATING, DriveState.JOGGING, DriveState.BRAKING, DriveState.PAUSED}
_OUTPUT_OFF_STATES = frozenset(
    {DriveState.STOPPED, DriveState.EMERGENCY_STOPPED, DriveState.FAULT, DriveState.NOT_READY},
)


class Direction(LocalizedEnum):
    """Direction of rotation as the drive counts it."""

    FORWARD = "forward"
    REVERSE = "reverse"


FAULT_LABEL_SEPARATOR = " + "  # between the labels of several faults at once; reads alike in every language


def names_fault_label(text: str, label: str) -> bool:
    """Return whether the text of a fault has its label, or that of several faults each of theirs."""
    return all(part in text for part in label.split(FAULT_LABEL_SEPARATOR))


def join_fault(label: str, text: str) -> str:
    """Join the label and the text of a fault, each of which may be empty; a text that names its label stands alone."""
    return text if names_fault_label(text, label) else f"{label} {text}".strip()


def join_fault_after_word(label: str, text: str) -> str:
    """Join the label and the text of a fault to stand behind the word fault, which the text does not repeat."""
    first = re.escape(label.partition(FAULT_LABEL_SEPARATOR)[0]) or "\\d"
    return re.sub(rf"^(?:fault|故障)\s*(?={first})", "", join_fault(label, text), flags=re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Fault:
    """Fault that the drive reports: its code, the keypad's label, and the maker's text where published."""

    code: int
    label: str
    text: Text
    cause: Text | None = None
    remedy: Text | None = None

    @property
    def name(self) -> Text:
        """Label and text of the fault; a text that has the label stands alone."""
        texts = self.text.by_language()
        return Text.from_mapping({language: join_fault(self.label, text) for language, text in texts.items()})


@dataclass(frozen=True, slots=True)
class DerivedState:
    """State that a dialect derives from the newest replies."""

    state: DriveState
    direction: Direction | None = None
    fault_code: int | None = None
    reason: str | None = None  # i18n key of why the state is UNKNOWN
    _: KW_ONLY
    further_fault_codes: tuple[int, ...] = ()  # where a drive reports several faults at once
    by_frequency: bool = False  # decelerating by the output frequency alone: the status word shows no motion

    @property
    def unknown_reason(self) -> Text:
        """Reason why the state is unknown."""
        return bilingual_text(self.reason or "drives.disagree")


STATE_NOT_READ = DerivedState(DriveState.UNKNOWN, reason="drives.not_read")


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveStatus:
    """Status of a drive at one moment; what is not known has a reason."""

    state: DriveState
    direction: Direction | None = None
    fault: Fault | None = None
    readings: Mapping[str, Reading] = field(default_factory=dict)
    reason: str | None = None  # i18n key of why the state is unknown
    at: float | None = None  # monotonic time of the oldest reply that the state was derived from
    unusable_reply: Exception | None = None  # names what an offline drive sends in place of a reply; None: silence
