"""The scripted story: what happens when. Values only; ``stage`` plays them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Action = Literal["run", "set", "stop", "trip", "reset", "unplug", "plug", "stop_all", "say"]


@dataclass(frozen=True, slots=True)
class ScriptStep:
    """At ``at_s`` seconds something happens to ``who`` (a drive's key, or a line's name)."""

    at_s: float
    action: Action
    who: str = ""
    frequency_hz: float = 0.0


STORY = (
    ScriptStep(1.0, "say", "welcome"),
    ScriptStep(2.0, "run", "fan-1", 30.0),
    ScriptStep(3.0, "run", "spindle-1", 50.0),
    ScriptStep(4.0, "run", "conveyor-1", 20.0),
    ScriptStep(5.0, "run", "pump-1", 35.0),
    ScriptStep(6.0, "run", "fan-2", 40.0),
    ScriptStep(8.0, "run", "fan-3", 45.0),
    ScriptStep(10.0, "set", "fan-1", 50.0),
    ScriptStep(12.0, "run", "conveyor-2", 15.0),
    ScriptStep(14.0, "trip", "fan-3"),
    ScriptStep(18.0, "reset", "fan-3"),
    ScriptStep(20.5, "run", "fan-3", 30.0),
    ScriptStep(22.0, "unplug", "C"),
    ScriptStep(26.0, "plug", "C"),
    ScriptStep(29.0, "set", "conveyor-1", 10.0),
    ScriptStep(31.0, "stop", "fan-2"),
    ScriptStep(34.0, "stop_all"),
)
END_S = 42.0
"""After the last ramp has come down."""
