"""Line quality of a simulated bus: impairments and their probabilities, read from a short text.

A text is a list of names (``NAMED_QUALITIES``) and values, such as ``lossy,late=0.1:0.4,batch=16``; the last one wins,
``clean`` undoes all before it. ``late`` is probability and seconds, ``batch`` milliseconds, the others probabilities.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from drivebus.errors import ConfigurationError
from drivebus.user_input import parse_decimal

NAMED_QUALITIES: Mapping[str, Mapping[str, Any]] = {
    "clean": {},
    "bytes": {"per_byte": True},
    "echo": {"echo": True},
    "lossy": {"loss": 0.05, "flip": 0.001},
    "late": {"late": 0.1, "late_s": 0.4},
    "batches": {"batch_s": 0.016},
    "noisy": {"loss": 0.02, "flip": 0.002, "junk": 0.05, "cut_first": 0.01, "cut_last": 0.01},
}
"""Name to the fields of ``LineQuality`` that it sets."""

_PROBABILITY_KEYS = ("loss", "flip", "duplicate", "cut_first", "cut_last", "junk")


@dataclass(frozen=True, slots=True, kw_only=True)
class LineQuality:
    """Impairments of the wires and the adapters of a bus; probabilities are 0…1."""

    per_byte: bool = False
    """A master receives each byte when its last bit ends, otherwise each frame as one piece."""
    echo: bool = False
    """The adapter returns the master's own bytes."""
    loss: float = 0.0
    """Probability that a frame is lost, in either direction."""
    flip: float = 0.0
    """Probability that a character has one wrong bit."""
    duplicate: float = 0.0
    """Probability that a reply is sent twice."""
    cut_first: float = 0.0
    """Probability that a frame loses its first byte (transmitter enabled late)."""
    cut_last: float = 0.0
    """Probability that a frame loses its last byte (transmitter disabled early)."""
    junk: float = 0.0
    """Probability that a stray byte precedes a reply (a glitch as the transmitter is enabled)."""
    late: float = 0.0
    """Probability that a reply is late, by up to ``late_s``."""
    late_s: float = 0.0
    """Longest lateness in seconds."""
    batch_s: float = 0.0
    """Interval at which the adapter delivers bytes in seconds (FTDI: 16 ms), 0 for immediately."""


def parse_line_quality(text: str) -> LineQuality:
    """Parse a line quality. Raises ConfigurationError with what was found and expected."""
    quality = LineQuality()
    for item in text.split(","):
        word = item.strip().lower()
        if word:
            quality = _apply_word(quality, word)
    return quality


def _apply_word(quality: LineQuality, word: str) -> LineQuality:
    name, separator, value = word.partition("=")
    if not separator and name in NAMED_QUALITIES:
        return LineQuality() if name == "clean" else replace(quality, **NAMED_QUALITIES[name])
    if not separator or name not in (*_PROBABILITY_KEYS, "late", "batch"):
        expected = (*NAMED_QUALITIES, *(f"{key}=" for key in (*_PROBABILITY_KEYS, "late", "batch")))
        raise ConfigurationError("sim.line_quality_word", found=word, expected=expected)
    if name == "late":
        share, _, seconds = value.partition(":")
        late_s = _parse_number(word, seconds, 60.0) if seconds else NAMED_QUALITIES["late"]["late_s"]
        return replace(quality, late=_parse_number(word, share, 1.0), late_s=late_s)
    if name == "batch":
        return replace(quality, batch_s=_parse_number(word, value, 1000.0) / 1000.0)
    probability: dict[str, Any] = {name: _parse_number(word, value, 1.0)}
    return replace(quality, **probability)


def _parse_number(item: str, text: str, highest: float) -> float:
    try:
        value = parse_decimal(text)
    except ValueError:
        value = -1.0
    if not 0.0 <= value <= highest:
        raise ConfigurationError("sim.line_quality_number", found=item, expected=f"0 … {highest:g}")
    return value
