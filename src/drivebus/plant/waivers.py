"""A waiver: somebody allows starts of a drive that may run on when the host dies. It is for that drive alone: of this
model, on this link, at this address. Another that gets its name has none.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass

from drivebus.plant.model import BusSetting, DriveSetting


@dataclass(frozen=True, slots=True)
class Waiver:
    """``text``: the reason, and who recorded it; the rest is what the plant's file said of the drive then."""

    text: str
    model: str = "?"
    link: str = "?"
    address: int | None = None

    @classmethod
    def of(cls, text: str, drive: DriveSetting, bus: BusSetting) -> Waiver:
        return cls(text, drive.model, bus.link, drive.address)

    @classmethod
    def kept(cls, found: str | None) -> Waiver | None:
        """As ``to_keep`` gave it; None where there is none. A text alone, as older versions kept it, fits no drive."""
        read = json.loads(found) if found else None
        return None if read is None else cls(**read) if isinstance(read, Mapping) else cls(str(read))

    def to_keep(self) -> str:
        return json.dumps(asdict(self))

    def fits(self, drive: DriveSetting, bus: BusSetting) -> bool:
        """Was it recorded for this drive?"""
        return self == Waiver.of(self.text, drive, bus)

    @property
    def whose(self) -> dict[str, str]:
        """The drive that it was recorded for, as the numbers of a sentence."""
        return {"model": self.model, "link": self.link, "address": "?" if self.address is None else str(self.address)}
