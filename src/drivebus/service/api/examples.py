"""A value that works for each parameter, as the reference shows it."""

from __future__ import annotations

from typing import Any

PARAM_EXAMPLES: dict[str, Any] = {
    "drive": "fan-1",
    "group": "fans",
    "bus": "line-1",
    "alarm": "fault:fan-1:3",
    "case": "case-17",
    "frequency_hz": 25.0,
    "direction": "forward",
    "arm": "5b1f0c52d1",
    "how": "stop",
    "jog": "jog-4",
    "minimum_hz": 5.0,
    "maximum_hz": 50.0,
    "forward": True,
    "reverse": False,
    "names": ["F0.1", "F1.07"],
    "values": {"F1.07": 12.5},
    "save": False,
    "minutes": 60,
    "reason": "bearing is being changed",
    "after": 0,
    "station": 3,
    "limit": 100,
    "tags": ["fan-1.output_frequency"],
    "from_ms": 1_700_000_000_000,
    "to_ms": 1_700_003_600_000,
    "points": 500,
    "resolution": "1s",
    "format": "csv",
    "text": '[plant]\nid = "hall-2"\n',
}
"""Cursors are opaque and have no example."""
