"""Layout of the virtual plant: buses, drives, loads."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class DemoDrive:
    """One drive; its name is the catalogue text ``demo.role.<role>`` with its number."""

    role: str
    number: int
    address: int

    @property
    def key(self) -> str:
        return f"{self.role}-{self.number}"


@dataclass(frozen=True, slots=True)
class DemoBus:
    """One bus: its drives have the same model, baud rate and format."""

    name: str
    model: str
    baud: int
    format: str
    load: str
    ramp_s: float
    drives: tuple[DemoDrive, ...]
    options: Mapping[str, str] = field(default_factory=dict)
    """Values of the profile options, for the simulated drives and for the service."""

    @property
    def target(self) -> str:
        """Return ``c320@1,2,3``, the drives of a ``sim://`` URL."""
        return f"{self.model}@{','.join(str(drive.address) for drive in self.drives)}"


def _drives(role: str, *addresses: int) -> tuple[DemoDrive, ...]:
    return tuple(DemoDrive(role, number, address) for number, address in enumerate(addresses, 1))


DZB_CODING = dict.fromkeys(("setpoint_coding", "query_coding", "parameter_coding"), "hex-0.1")

BUSES = (
    DemoBus("A", "c320", 9600, "8E1", "fan", 6.0, _drives("fan", 1, 2, 3)),
    DemoBus("B", "dzb100", 4800, "8E1", "constant", 5.0, _drives("conveyor", 1, 2, 3), DZB_CODING),
    DemoBus("C", "vc660", 19200, "8N1", "constant", 4.0, _drives("spindle", 1, 2, 3)),
    DemoBus("D", "df800", 9600, "8N1", "fan", 6.0, _drives("pump", 1, 2, 3)),
)
"""Twelve drives of four models on four buses, each at a baud rate of its model."""
