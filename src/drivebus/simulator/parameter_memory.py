"""Parameters of a simulated drive: RAM and EEPROM, access rules and write counts."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum


class Access(Enum):
    """Access to a parameter from the bus."""

    OPEN = "open"
    LOCKED_WHILE_RUNNING = "not while running"
    READ_ONLY = "read only"
    HIDDEN = "hidden"


class RejectReason(Enum):
    """Reason why a read or write is rejected."""

    UNKNOWN = "no such parameter"
    HIDDEN = "hidden or reserved"
    READ_ONLY = "read only"
    PASSWORD = "locked by password"
    RUNNING = "not while running"
    RANGE = "out of range"


@dataclass(frozen=True, slots=True)
class ParameterSpec:
    """Specification of one parameter in raw words."""

    factory: int = 0
    minimum: int = 0
    maximum: int = 0xFFFF
    access: Access = Access.OPEN


class ParameterMemory:
    """RAM and EEPROM words by key; ``eeprom_writes`` counts the wear of the EEPROM."""

    def __init__(self, specs: Mapping[int, ParameterSpec]) -> None:
        self.specs = specs
        self.eeprom = {key: spec.factory for key, spec in specs.items()}
        self.ram = dict(self.eeprom)
        self.eeprom_writes: Counter[int] = Counter()
        self.ram_writes: Counter[int] = Counter()
        self.locked = False
        """Whether a password forbids every write from the bus."""

    def read_rejection(self, key: int) -> RejectReason | None:
        spec = self.specs.get(key)
        if spec is None:
            return RejectReason.UNKNOWN
        return RejectReason.HIDDEN if spec.access is Access.HIDDEN else None

    def write_rejection(self, key: int, value: int, *, running: bool) -> RejectReason | None:
        """Return the first reason to reject a write, or None."""
        unreadable = self.read_rejection(key)
        if unreadable is not None:
            return unreadable
        spec = self.specs[key]
        if spec.access is Access.READ_ONLY:
            return RejectReason.READ_ONLY
        if self.locked:
            return RejectReason.PASSWORD
        if running and spec.access is Access.LOCKED_WHILE_RUNNING:
            return RejectReason.RUNNING
        return None if spec.minimum <= value <= spec.maximum else RejectReason.RANGE

    def write(self, key: int, value: int, *, save: bool) -> None:
        """Write without access checks to RAM, with ``save`` also to EEPROM."""
        self.ram[key] = value
        self.ram_writes[key] += 1
        if save:
            self.eeprom[key] = value
            self.eeprom_writes[key] += 1

    def __getitem__(self, key: int) -> int:
        """Return the value in RAM."""
        return self.ram[key]

    def power_cycle(self) -> None:
        """Load RAM from EEPROM."""
        self.ram = dict(self.eeprom)
