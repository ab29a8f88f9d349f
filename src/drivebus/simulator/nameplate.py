"""What a motor is, carries and does, as values: rating plate, load, phases of its output, reasons to trip."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class Trip(Enum):
    """Why a drive switched its output off."""

    OVERCURRENT_ACCELERATING = "over-current accelerating"
    OVERCURRENT_DECELERATING = "over-current decelerating"
    OVERCURRENT_RUNNING = "over-current running"
    OVERVOLTAGE = "over-voltage"
    UNDERVOLTAGE = "under-voltage"
    OVERLOAD = "overload"
    OVERHEAT = "over-heat"
    EXTERNAL = "external fault"
    COMM_LOSS = "host silent"
    OTHER = "other"


class OutputPhase(Enum):
    """What the output is doing."""

    OFF = "off"
    ACCELERATING = "accelerating"
    AT_SPEED = "at speed"
    DECELERATING = "decelerating"
    DC_BRAKING = "dc braking"


@dataclass(frozen=True, slots=True)
class Nameplate:
    """The rating plate. ``inertia_s`` is the time that rated torque needs from standstill to rated speed."""

    power_kw: float = 2.2
    voltage_v: float = 380.0
    frequency_hz: float = 50.0
    current_a: float = 5.1
    pole_pairs: int = 2
    slip_hz: float = 1.5
    inertia_s: float = 0.4


@dataclass(frozen=True, slots=True)
class MotorLoad:
    """Torque per unit of rated torque: against the motion, with the square of speed, and in gravity's own direction."""

    constant: float = 0.3
    quadratic: float = 0.0
    gravity: float = 0.0

    @classmethod
    def fan(cls, torque: float = 0.8) -> MotorLoad:
        """A fan or pump that needs ``torque`` at rated speed."""
        return cls(0.0, torque, 0.0)

    @classmethod
    def hoist(cls, torque: float = 0.6) -> MotorLoad:
        """A hanging load: brakes forward (lifting), overhauls in reverse (lowering)."""
        return cls(0.0, 0.0, torque)
