"""Messages of a WebSocket client: strict parsing, size and rate limits."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field

from drivebus.service.api.strict_json import parse_json
from drivebus.service.ids import ID_PATTERN

MAX_MESSAGE_CHARS = 16_384
MAX_PATTERNS = 100
MAX_RENEWALS = 200  # drives of one message; with the longest ids it is shorter than MAX_MESSAGE_CHARS
ITEMS_PER_MESSAGE = 20  # drives or topics of the rate limit: 200 count as ten; the page renews 300 drives every 3 s
DEFAULT_PATTERNS: tuple[str, ...] = ("drives/*", "groups/*", "alarms", "plant", "events")
DEFAULT_INTERVAL_S, MIN_INTERVAL_S, MAX_INTERVAL_S = 0.25, 0.1, 10.0

_PATTERN = re.compile(r"\*|(drives|buses|groups|frames)/[a-z0-9_*-]{1,64}|alarms|plant|events")
_ID = re.compile(ID_PATTERN)
_NUMBER = re.compile(r"[0-9]{1,3}(\.[0-9]{1,6})?")


@dataclass(frozen=True, slots=True)
class ClientMessage:
    """Message of a client on a live connection."""

    subscribe: tuple[str, ...] | None = None
    """Patterns of the topics that it receives from now on; None: as before."""
    renew: tuple[str, ...] = ()
    """Drives whose control lease it renews."""

    @property
    def cost(self) -> float:
        """Messages that it counts as: each renewal is a request to the service, each pattern a search in all topics."""
        return max(1.0, len(self.renew) / ITEMS_PER_MESSAGE, len(self.subscribe or ()) / ITEMS_PER_MESSAGE)


def parse_message(text: str) -> ClientMessage:
    """Parse ``{"subscribe": [patterns]}``, ``{"renew": [drives]}`` or both. Raises ValueError."""
    if len(text) > MAX_MESSAGE_CHARS:
        raise ValueError("too long")
    message = parse_json(text)
    if not isinstance(message, dict) or not message or message.keys() - {"subscribe", "renew"}:
        raise ValueError(text[:100])
    topics = parse_patterns(message["subscribe"]) if "subscribe" in message else None
    return ClientMessage(topics, _all_matching(_ID, _limited_list(message.get("renew", []), MAX_RENEWALS)))


def parse_patterns(words: object) -> tuple[str, ...]:
    """Return topic patterns sorted, each once: equal requests share one group.

    Raises ValueError, also for more than ``MAX_PATTERNS``.
    """
    return tuple(sorted(set(_all_matching(_PATTERN, _limited_list(words, MAX_PATTERNS)))))


def parse_interval(text: str | None) -> float:
    """Return the seconds between two deltas, rounded to a twentieth of a second. Raises ValueError."""
    if text is None:
        return DEFAULT_INTERVAL_S
    if not (_NUMBER.fullmatch(text) and MIN_INTERVAL_S <= float(text) <= MAX_INTERVAL_S):
        raise ValueError(text)
    return max(MIN_INTERVAL_S, round(float(text) * 20) / 20)


def _limited_list(value: object, max_items: int) -> list[str]:
    if not isinstance(value, list) or len(value) > max_items:
        raise ValueError("a list")
    return value


def _all_matching(pattern: re.Pattern[str], words: Iterable[object]) -> tuple[str, ...]:
    texts = tuple(words)
    if not all(isinstance(word, str) and pattern.fullmatch(word) for word in texts):
        raise ValueError(str(texts)[:100])
    return texts  # type: ignore[return-value]


@dataclass(slots=True)
class MessageRateLimit:
    """Rate limit of a client's messages: ``burst`` at once, then ``per_s``."""

    per_s: float = 10.0
    burst: float = 30.0
    _left: float = field(default=-1.0)
    _at: float = 0.0

    def spend(self, now: float, cost: float = 1.0) -> bool:
        """Count a message as ``cost`` of them; returns False beyond the limit."""
        full = self._left < 0.0
        self._left = self.burst if full else min(self.burst, self._left + (now - self._at) * self.per_s)
        self._at = now
        if self._left < cost:
            return False
        self._left -= cost
        return True
