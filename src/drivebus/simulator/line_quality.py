"""Line quality of a simulated bus: impairments and their probabilities, read from a short text.

``clean`` · ``bytes`` · ``lossy`` · ``late`` · ``echo`` · ``batches`` · ``noisy``, or
``loss=0.05,flip=0.001,late=0.1:0.4,batch=16``; names and keys may be mixed, the last one wins.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from drivebus.errors import ConfigurationError
from drivebus.values import parse_decimal

NAMED_QUALITIES = {
    "clean": "",
    "bytes": "",
    "echo": "",
    "lossy": "loss=0.05,flip=0.001",
    "late": "late=0.1:0.4",
    "batches": "batch=16",
    "noisy": "loss=0.02,flip=0.002,junk=0.05,cut_first=0.01,cut_last=0.01",
}
"""Named qualities; ``bytes`` and ``echo`` are switches of their own."""

_PROBABILITY_KEYS = ("loss", "flip", "duplicate", "cut_first", "cut_last", "junk")


@dataclass(frozen=True, slots=True, kw_only=True)
class LineQuality:
    """Impairments of a line; probabilities are 0…1."""

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
    """Probability that a frame loses its first byte (driver enabled late)."""
    cut_last: float = 0.0
    """Probability that a frame loses its last byte (driver disabled early)."""
    junk: float = 0.0
    """Probability that a stray byte precedes a reply (driver-enable glitch)."""
    late: float = 0.0
    """Probability that a reply is late, by up to ``late_s``."""
    late_s: float = 0.0
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
    name, separator, _ = word.partition("=")
    if not separator and name in NAMED_QUALITIES:
        if name == "clean":
            return LineQuality()
        if name in ("bytes", "echo"):
            return replace(quality, **{"per_byte" if name == "bytes" else "echo": True})
        return replace(quality, **_parse_pairs(NAMED_QUALITIES[name]))
    if not separator or name not in (*_PROBABILITY_KEYS, "late", "batch"):
        expected = (*NAMED_QUALITIES, *(f"{key}=" for key in (*_PROBABILITY_KEYS, "late", "batch")))
        raise ConfigurationError("sim.line_quality_word", found=word, expected=expected)
    return replace(quality, **_parse_pairs(word))


def _parse_pairs(text: str) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for item in text.split(","):
        name, _, value = item.partition("=")
        if name == "late":
            share, _, seconds = value.partition(":")
            found |= {"late": _parse_number(item, share, 1.0), "late_s": _parse_number(item, seconds or "0.4", 60.0)}
        elif name == "batch":
            found["batch_s"] = _parse_number(item, value, 1000.0) / 1000.0
        else:
            found[name] = _parse_number(item, value, 1.0)
    return found


def _parse_number(item: str, text: str, highest: float) -> float:
    try:
        value = parse_decimal(text)
    except ValueError:
        value = -1.0
    if not 0.0 <= value <= highest:
        raise ConfigurationError("sim.line_quality_number", found=item, expected=f"0 … {highest:g}")
    return value
