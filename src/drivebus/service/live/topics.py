"""Values of the hub's topics, and how they are told at one moment."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from drivebus.service.api.errors import localized

Json = dict[str, Any]


@dataclass(frozen=True, slots=True)
class AgeingValue:
    """JSON with a number of seconds in it that goes on by itself: no change to tell anybody."""

    fields: Json
    name: str
    moment: float | None
    """Monotonic second from which (or to which, where ``left``) it counts."""
    left: bool = False

    def json(self, now: float) -> Json:
        if self.moment is None:
            return {**self.fields, self.name: None}
        seconds = self.moment - now if self.left else now - self.moment
        return {**self.fields, self.name: round(max(0.0, seconds), 3)}


def value_json(value: Any, now: float) -> Any:
    """A value as it is told at this moment."""
    return value.json(now) if hasattr(value, "json") else value


def closed_message(reason: str) -> Json:
    """The last message to a listener."""
    return {"type": "closed", "reason": reason, "text": localized(f"plant.closed_{reason}")}
