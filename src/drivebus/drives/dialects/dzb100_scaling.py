"""The tenfold trap (T08): which codings of a DZB100's setpoint are still possible, and what may be sent. Pure."""

from __future__ import annotations

from typing import Any

from drivebus.protocols.dzb100 import FREQUENCY_CODINGS, FrequencyCoding, decode_frequency

CODINGS = FREQUENCY_CODINGS
DEFAULT_CODING = CODINGS[0]
MAX_SETPOINT_WORD = 4000
"""Manual 2 (5): setpoints are 0000 to 4000."""
UNCALIBRATED_CAP_HZ = 5.0
"""Until one coding is left, no coding that is left may make more of a raw word than this."""


def possible_codings(settings: dict[str, Any]) -> tuple[FrequencyCoding, ...]:
    """Setpoint codings that are not excluded: one where it is settled."""
    coding = settings.get("setpoint_coding", "unknown")
    return (coding,) if coding in CODINGS else CODINGS


def is_within_cap(word: int, codings: tuple[FrequencyCoding, ...]) -> bool:
    """Every coding reads this word as at most 5 Hz, and as a number at all."""
    try:
        return all(decode_frequency(word, coding) <= UNCALIBRATED_CAP_HZ for coding in codings)
    except ValueError:
        return False


def decode_or_none(word: int, coding: str) -> float | None:
    """Hertz of a word under a coding; None where it is no number of it."""
    known = next((c for c in CODINGS if c == coding), None)
    try:
        return None if known is None else decode_frequency(word, known)
    except ValueError:
        return None


def highest_safe_word(codings: tuple[FrequencyCoding, ...]) -> int:
    """The largest raw word that every one of these codings reads as at most 5 Hz."""
    return max(word for word in range(MAX_SETPOINT_WORD + 1) if is_within_cap(word, codings))
