"""Layout of the virtual plant: buses, drives, loads."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class DemoDrive:
    """Drive of the demo; its name is the catalogue text ``demo.role.<role>`` with its number."""

    role: str
    number: int
    address: int

    @property
    def key(self) -> str:
        return f"{self.role}-{self.number}"


@dataclass(frozen=True, slots=True, kw_only=True)
class DemoBus:
    """Bus of the demo; its drives have the same model, baud rate and format."""

    name: str
    model: str
    baud: int
    format: str
    load: str
    ramp_s: float
    drives: tuple[DemoDrive, ...]
    options: Mapping[str, str] = field(default_factory=dict)
    """Values of the profile options, for the simulated drives and for the service."""
    stated_options: Mapping[str, str] = field(default_factory=dict)
    """Values of further profile options, for the service: what a person reads on the name plate."""

    @property
    def target(self) -> str:
        """Return ``c320@1,2,3``, the drives of a ``sim://`` URL."""
        return f"{self.model}@{','.join(str(drive.address) for drive in self.drives)}"


def _drives(role: str, *addresses: int) -> tuple[DemoDrive, ...]:
    return tuple(DemoDrive(role, number, address) for number, address in enumerate(addresses, 1))


DZB_CODING = dict.fromkeys(("setpoint_coding", "query_coding", "parameter_coding"), "hex-0.1")

BUSES = (
    DemoBus(
        name="A",
        model="c320",
        baud=9600,
        format="8E1",
        load="fan",
        ramp_s=6.0,
        drives=_drives("fan", 1, 2, 3),
        stated_options={"setpoint_step": "0.01"},
    ),
    DemoBus(
        name="B",
        model="dzb100",
        baud=4800,
        format="8E1",
        load="constant",
        ramp_s=5.0,
        drives=_drives("conveyor", 1, 2, 3),
        options=DZB_CODING,
    ),
    DemoBus(
        name="C",
        model="vc660",
        baud=19200,
        format="8N1",
        load="constant",
        ramp_s=4.0,
        drives=_drives("spindle", 1, 2, 3),
    ),
    DemoBus(name="D", model="df800", baud=9600, format="8N1", load="fan", ramp_s=6.0, drives=_drives("pump", 1, 2, 3)),
)
"""Twelve drives of four models on four buses, each at a baud rate of its model."""
