"""Record of a communication-loss test: what one drive did when no request reached it any more.

It holds for one drive only (model, port, address), and while the parameters that decide its behaviour read as they did
then. ``comm_loss_test`` makes it.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from enum import StrEnum
from typing import Any

from drivebus.clock import MAX_TIME_MS
from drivebus.service.config.model import BusConfig, DriveConfig


class CommLossResult(StrEnum):
    """Behaviour of the drive during the silence."""

    TRIPS = "trips"
    """It tripped: a fault was read at its next reply."""
    STOPS = "stops"
    """It stopped without a fault."""
    RUNS_ON = "runs_on"
    """The motor still turned at the end of the silence."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CommLossRecord:
    """Result of one test, the drive it was made on, and the parameter values at that time."""

    result: CommLossResult
    silence_s: float
    """Seconds between the drive's last reply before the silence and its first one after it."""
    time_ms: int
    """UTC time of the first reply after the silence."""
    user: str
    model: str
    port: str
    address: int
    parameters: Mapping[str, int]
    """Raw values of the communication-loss parameters by notation; empty where the manual publishes none."""
    fault: str | None
    """Label of the fault that was read, else its code; empty where the drive names neither, None: no fault."""

    @classmethod
    def from_json(cls, text: str | None) -> CommLossRecord | None:
        """Return a stored record, None where there is none. Raises ValueError, TypeError or KeyError for other data."""
        if not text:
            return None
        stored = json.loads(text)
        record = cls(**{**stored, "result": CommLossResult(stored["result"])})
        parameters = record.parameters
        if not isinstance(parameters, Mapping) or not all(type(raw) is int for raw in parameters.values()):
            raise TypeError("a parameter is not a number")
        if type(record.silence_s) not in (int, float) or not math.isfinite(record.silence_s):
            raise TypeError("the silence is not a finite number")
        if type(record.time_ms) is not int or not 0 <= record.time_ms <= MAX_TIME_MS:
            raise ValueError("the time is no date")
        if type(record.user) is not str:
            raise TypeError("the user is missing")
        return record

    def to_json(self) -> str:
        return json.dumps(self.as_json())

    def as_json(self) -> dict[str, Any]:
        return {**asdict(self), "parameters": dict(self.parameters)}

    def is_of(self, drive: DriveConfig, bus: BusConfig) -> bool:
        """Return whether it was made on a drive of this model, on this port, at this address."""
        return (self.model, self.port, self.address) == (drive.model, bus.port, drive.address)

    def holds_for(self, parameters: Mapping[str, int] | None) -> bool:
        """Return whether the communication-loss parameters read as they did at the test; None: not known now."""
        return parameters is not None and dict(parameters) == dict(self.parameters)

    @property
    def message_key(self) -> str:
        return f"plant.comm_loss_tested_{self.result}"

    @property
    def message_params(self) -> dict[str, Any]:
        date = datetime.fromtimestamp(self.time_ms / 1000, UTC).strftime("%Y-%m-%d")
        return {"after_s": self.after_s, "user": self.user, "date": date, "fault": self.fault or "-"}

    @property
    def after_s(self) -> int:
        """Whole seconds after which the drive had certainly stopped, or during which it certainly ran on."""
        return math.floor(self.silence_s) if self.result is CommLossResult.RUNS_ON else math.ceil(self.silence_s)


def record_key(drive: str) -> str:
    """Return the key of a drive's record in the settings."""
    return f"comm-loss/{drive}"
