"""Waiver of the communication-loss check: it allows starts of a drive that may run on when this host fails.

It holds for one drive only: of this model, on this port, at this address.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass

from drivebus.service.config.model import BusConfig, DriveConfig


@dataclass(frozen=True, slots=True)
class CommLossWaiver:
    """Reason and author of a waiver, and the drive it was recorded for."""

    text: str
    model: str = "?"
    port: str = "?"
    address: int | None = None

    @classmethod
    def for_drive(cls, text: str, drive: DriveConfig, bus: BusConfig) -> CommLossWaiver:
        return cls(text, drive.model, bus.port, drive.address)

    @classmethod
    def from_json(cls, text: str | None) -> CommLossWaiver | None:
        """Return a stored waiver, None where there is none. A bare text applies to no drive."""
        read = json.loads(text) if text else None
        return None if read is None else cls(**read) if isinstance(read, Mapping) else cls(str(read))

    def to_json(self) -> str:
        return json.dumps(asdict(self))

    def applies_to(self, drive: DriveConfig, bus: BusConfig) -> bool:
        """Return whether it was recorded for this drive."""
        return self == CommLossWaiver.for_drive(self.text, drive, bus)

    @property
    def recorded_for(self) -> dict[str, str]:
        """Model, port and address of the drive that it was recorded for, as message parameters."""
        return {"model": self.model, "port": self.port, "address": "?" if self.address is None else str(self.address)}


def waiver_key(drive: str) -> str:
    """Return the key of a drive's waiver in the settings."""
    return f"waiver/{drive}"
