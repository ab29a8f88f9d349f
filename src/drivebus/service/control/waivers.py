"""A waiver: somebody allows starts of a drive that may run on when the host dies. It is for that drive alone: of this
model, on this link, at this address. Another that gets its name has none.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass

from drivebus.service.config.model import BusConfig, DriveConfig


@dataclass(frozen=True, slots=True)
class CommLossWaiver:
    """``text``: the reason, and who recorded it; the rest is what the plant's file said of the drive then."""

    text: str
    model: str = "?"
    link: str = "?"
    address: int | None = None

    @classmethod
    def for_drive(cls, text: str, drive: DriveConfig, bus: BusConfig) -> CommLossWaiver:
        return cls(text, drive.model, bus.link, drive.address)

    @classmethod
    def from_json(cls, found: str | None) -> CommLossWaiver | None:
        """As ``to_keep`` gave it; None where there is none. A text alone, as older versions kept it, fits no drive."""
        read = json.loads(found) if found else None
        return None if read is None else cls(**read) if isinstance(read, Mapping) else cls(str(read))

    def to_json(self) -> str:
        return json.dumps(asdict(self))

    def applies_to(self, drive: DriveConfig, bus: BusConfig) -> bool:
        """Was it recorded for this drive?"""
        return self == CommLossWaiver.for_drive(self.text, drive, bus)

    @property
    def recorded_for(self) -> dict[str, str]:
        """The drive that it was recorded for, as the numbers of a sentence."""
        return {"model": self.model, "link": self.link, "address": "?" if self.address is None else str(self.address)}
