"""What a drive does by itself when its host dies, read from the drive where its manual tells how (F18). Pure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from drivebus import i18n
from drivebus.drives.operations.context import OperationContext
from drivebus.drives.operations.parameters import read_values
from drivebus.drives.operations.steps import DriveOperation
from drivebus.values import Quality, Reading


@dataclass(frozen=True, slots=True)
class CommLossReport:
    """``trips`` True: it stops by itself after ``time``; False: it runs on; None: nobody published what it does."""

    stops_on_comm_loss: bool | None
    key: str
    params: Mapping[str, Any] = field(default_factory=dict)
    time: Reading | None = None
    action: Reading | None = None

    def text(self, language: str = "en") -> str:
        """One sentence for the person who is about to leave."""
        return i18n.text(self.key, language, **self.params)


def comm_loss_behaviour(talk: OperationContext) -> DriveOperation[CommLossReport]:
    """Read the timer and its action. An unknown answer is to be treated as "it keeps running"."""
    rule, model = talk.dialect.profile.comm_loss, talk.dialect.profile.model
    notations = tuple(n for n in (rule.time_notation, rule.action_notation) if n is not None)
    if not notations:
        return CommLossReport(None, "drives.host_dies_unpublished", {"model": model})
    found = yield from read_values(talk, notations)
    time = found.get(rule.time_notation) if rule.time_notation else None
    action = found.get(rule.action_notation) if rule.action_notation else None
    if any(r is not None and (r.raw is None or r.quality is Quality.BAD) for r in (time, action)):
        return CommLossReport(None, "drives.host_dies_unread", {"model": model}, time, action)
    said: dict[str, Any] = {"time": _value_text(time), "notation": rule.time_notation, "action": rule.action_notation}
    said["value"] = None if action is None else action.raw
    if time is not None and time.raw == 0:
        return CommLossReport(False, "drives.host_dies_off", said, time, action)
    if action is None or not rule.trips_values:
        return CommLossReport(None, "drives.host_dies_unknown", said, time, action)
    trips = action.raw in rule.trips_values
    return CommLossReport(trips, "drives.host_dies_stops" if trips else "drives.host_dies_runs_on", said, time, action)


def _value_text(reading: Reading | None) -> str:
    if reading is None or not isinstance(reading.value, int | float):
        return "?"
    return f"{reading.value:g} {reading.unit}".strip()
