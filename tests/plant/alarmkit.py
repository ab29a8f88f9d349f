"""Views of a drive, as the hub would make them, and a log that only listens."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from drivebus.plant.alarms import Alarm
from drivebus.plant.model import DriveSetting
from drivebus.plant.view import DriveView, HostDies, SignalView
from drivebus.profiles.model import Text
from drivebus.reading import Quality

FAN = DriveSetting("fan-1", "line-1", 1, "c320", Text("Fan", "风机"))
OVERCURRENT = {"code": 4, "label": "Er.04", "text": {"en": "overcurrent", "zh": "过电流"}}


class Kept:
    """Every change that was given to the log."""

    def __init__(self) -> None:
        self.alarms: list[Alarm] = []

    def put(self, alarm: Alarm) -> None:
        self.alarms.append(alarm)


def signal(value: Any, quality: Quality = Quality.GOOD, unit: str = "A", age_s: float | None = 0.1) -> SignalView:
    return SignalView(value, unit, quality, None if quality is Quality.GOOD else "drives.stale", age_s)


def view(
    signals: Mapping[str, SignalView] | None = None,
    *,
    drive: str = "fan-1",
    presence: str = "online",
    state: str = "running",
    fault: Mapping[str, Any] | None = None,
) -> DriveView:
    return DriveView(
        drive, Text("Fan", "风机"), "line-1", 1, "c320", "bench", (), (), presence, state, None, "forward",
        None if fault is None else dict(fault), 25.0, 0.0, 50.0, HostDies("unknown", None, Text("", "")),
        signals=signals or {},
    )  # fmt: skip


def current(value: Any, quality: Quality = Quality.GOOD, **more: Any) -> DriveView:
    return view({"output_current": signal(value, quality)}, **more)
