"""Model of a motor and its power stage: ramps, slip, load, current, DC bus, heat, overload.

``torque``, ``load`` and ``mains`` are per unit, other values SI. The output follows its ramp exactly, the rotor the
output less its slip (quasi-static, so that any ``dt`` is stable); load torque is evaluated at synchronous speed, which
errs by at most twice the slip.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from math import atan, copysign, exp, hypot, sqrt, tan


class Trip(Enum):
    """Reason why a drive switched its output off."""

    OVERCURRENT_ACCELERATING = "over-current accelerating"
    OVERCURRENT_DECELERATING = "over-current decelerating"
    OVERCURRENT_RUNNING = "over-current running"
    OVERVOLTAGE = "over-voltage"
    UNDERVOLTAGE = "under-voltage"
    OVERLOAD = "overload"
    OVERHEAT = "over-heat"
    EXTERNAL = "external fault"
    COMM_LOSS = "communication loss"
    OTHER = "other"


class OutputPhase(Enum):
    """Phase of the output frequency, which follows the ramp."""

    OFF = "off"
    ACCELERATING = "accelerating"
    AT_SPEED = "at speed"
    DECELERATING = "decelerating"
    DC_BRAKING = "dc braking"


@dataclass(frozen=True, slots=True, kw_only=True)
class Nameplate:
    """Nameplate of a motor. ``inertia_s`` is the time from standstill to rated speed at rated torque."""

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
        """Return a fan or pump that needs ``torque`` at rated speed."""
        return cls(0.0, torque, 0.0)

    @classmethod
    def hoist(cls, torque: float = 0.6) -> MotorLoad:
        """Return a hanging load: it opposes forward motion (lifting) and drives reverse motion (lowering)."""
        return cls(0.0, 0.0, torque)


_MAGNETISING_CURRENT = 0.4
"""Magnetising share of the rated current; the rest produces the rated torque."""
_TORQUE_CURRENT = sqrt(1.0 - _MAGNETISING_CURRENT**2)
_LOSS_SHARE = 0.12
"""Losses at rated load per rated power; a quarter of them is there without load."""
_STANDBY_POWER_W = 15.0
"""Consumption of the drive's electronics."""
_CONTINUOUS_CURRENT = 1.05
_OVERLOAD_RESERVE = (1.5**2 - _CONTINUOUS_CURRENT**2) * 60.0
"""I²t reserve: the customary 150 % for 60 s."""
_OVERCURRENT_LIMIT = 2.0
_THERMAL_TIME_CONSTANT_S = 300.0
_HEAT_RISE_C = 40.0
_FRICTION_TORQUE = 0.02
_HOIST_BRAKE_TORQUE = 2.0
"""Torque of a hoist's own brake, closed whenever the drive's output is off."""
_MAX_STEP_S = 0.05
"""Longest step of a rising ramp (or a fiftieth of its rest)."""
_MAX_BRAKING_STEP_S = 0.005
"""Longest step of a falling ramp, during which the DC bus may rise quickly."""


class Motor:
    """Motor with its power stage; negative frequencies are reverse, and time passes only in ``step``.

    A start finds a rotor that still turns (flying start). ``decel_s`` too short for the inertia trips on over-voltage.
    """

    __slots__ = (
        "_brake_left_s",
        "_bus_j",
        "_capacity_f",
        "_decel_now_s",
        "_nominal_v",
        "_overload",
        "_stopping",
        "accel_s",
        "ambient_c",
        "brake_j",
        "brake_resistor_w",
        "bus_v",
        "current_a",
        "dc_brake_s",
        "decel_s",
        "energised",
        "energy_j",
        "hold",
        "load",
        "loss_j",
        "mains",
        "output_hz",
        "power_kw",
        "ramp_base_hz",
        "rating",
        "speed_hz",
        "starts",
        "target_hz",
        "temperature_c",
        "torque",
        "trip",
        "trip_temperature_c",
    )

    def __init__(self, rating: Nameplate | None = None, load: MotorLoad | None = None) -> None:
        self.rating = rating or Nameplate()
        self.load = load or MotorLoad()
        self.accel_s = self.decel_s = self._decel_now_s = 10.0
        """Seconds per ``ramp_base_hz``, the drive's maximum frequency."""
        self.ramp_base_hz = 50.0
        self.dc_brake_s = self._brake_left_s = 0.0
        self.brake_resistor_w = 0.0
        self.ambient_c = self.temperature_c = 25.0
        self.mains = 1.0
        """Mains voltage per unit; 0 is a power cut."""
        self.hold = False
        """Whether the ramp is held."""
        self.energised = self._stopping = False
        self.trip: Trip | None = None
        self.trip_temperature_c = 0.0
        """Temperature at the last trip; 0 before the first one."""
        self.starts = 0
        """Number of times the output was switched on: counts executed starts."""
        self.output_hz = self.target_hz = self.speed_hz = 0.0
        self.torque = self.current_a = self.power_kw = 0.0
        self.energy_j = self.loss_j = self.brake_j = self._overload = 0.0
        self._nominal_v = self.rating.voltage_v * sqrt(2.0)
        self._capacity_f = 150e-6 * self.rating.power_kw * (380.0 / self.rating.voltage_v) ** 2
        self.bus_v = self._nominal_v
        self._bus_j = 0.5 * self._capacity_f * self.bus_v**2

    def run(self, target_hz: float) -> None:
        """Run, or go on running, towards a signed frequency. A tripped or unpowered drive does not start."""
        if self.trip is not None or not self.ready:
            return
        if not self.energised:
            self.starts += 1
            self.energised, self.output_hz = True, self.speed_hz
        self.target_hz, self._stopping, self._brake_left_s = target_hz, False, 0.0
        self._decel_now_s = self.decel_s

    def stop(self, decel_s: float | None = None) -> None:
        """Ramp down (in ``decel_s`` per ramp base, else the motor's own), then switch off."""
        self._stopping, self.hold = True, False
        self._decel_now_s = self.decel_s if decel_s is None else decel_s

    def coast(self) -> None:
        """Switch off at once; the rotor coasts."""
        self.energised = self._stopping = self.hold = False
        self.output_hz = self._brake_left_s = 0.0
        self.torque = self.current_a = self.power_kw = 0.0

    def force_trip(self, trip: Trip) -> None:
        """Switch off with a trip; the first trip stays."""
        if self.trip is None:
            self.trip_temperature_c = self.temperature_c
        self.trip = self.trip or trip
        self.coast()

    def reset(self) -> None:
        """Reset the trip. A cause that persists (heat, no mains) trips again at the next start."""
        self.trip, self._overload = None, 0.0

    @property
    def ready(self) -> bool:
        """Whether the DC bus is charged."""
        return self.bus_v > 0.65 * self._nominal_v

    @property
    def stopping(self) -> bool:
        """Whether the output ramps down to switch off."""
        return self.energised and self._stopping

    @property
    def phase(self) -> OutputPhase:
        if not self.energised:
            return OutputPhase.OFF
        if self._brake_left_s > 0.0:
            return OutputPhase.DC_BRAKING
        goal = 0.0 if self._stopping else self.target_hz
        if self.output_hz == goal or self.hold:
            return OutputPhase.AT_SPEED
        rising = self.output_hz * goal >= 0.0 and abs(goal) > abs(self.output_hz)
        return OutputPhase.ACCELERATING if rising else OutputPhase.DECELERATING

    @property
    def voltage_v(self) -> float:
        """Output voltage by V/f with 3 % boost."""
        if not self.energised:
            return 0.0
        share = 0.03 + 0.97 * abs(self.output_hz) / self.rating.frequency_hz
        return self.rating.voltage_v * min(1.0, share)

    @property
    def speed_rpm(self) -> float:
        return self.speed_hz * 60.0 / self.rating.pole_pairs

    @property
    def energy_kwh(self) -> float:
        """Energy taken from the mains since power-up."""
        return self.energy_j / 3.6e6

    def step(self, dt: float) -> None:
        """Advance by ``dt`` seconds. Ramp corners are met exactly, whatever the size of ``dt``."""
        while dt > 1e-12:
            dt -= self._step_energised(dt) if self.energised else self._step_coasting(dt)

    def _step_energised(self, dt: float) -> float:
        start = self.output_hz
        goal = 0.0 if self._stopping else start if self.hold else self.target_hz
        if start == goal:
            return self._step_at_speed(dt)
        corner = goal if start * goal >= 0.0 else 0.0
        seconds = self.accel_s if abs(corner) > abs(start) else self._decel_now_s
        slope = self.ramp_base_hz / max(seconds, 1e-3)
        need = abs(corner - start) / slope
        piece = min(dt, max(_MAX_STEP_S if abs(corner) > abs(start) else _MAX_BRAKING_STEP_S, need / 50.0))
        if piece >= need - 1e-9:
            piece, end = need, corner
        else:
            end = start + copysign(slope * piece, corner - start)
        self.output_hz = end
        self._update_electrical(0.5 * (start + end), (end - start) / piece if piece > 0.0 else 0.0, piece)
        return piece

    def _step_at_speed(self, dt: float) -> float:
        if self._stopping:
            if self._brake_left_s <= 0.0:
                self._brake_left_s = self.dc_brake_s
            dt = min(dt, self._brake_left_s)
            self._brake_left_s -= dt
            self.current_a = 0.5 * self.rating.current_a
            if self._brake_left_s <= 1e-12:
                self.coast()
                self.speed_hz = 0.0
                return dt
        elif self._overload > 0.0 or self.mains < 1.0 or self.current_a > self.rating.current_a:
            dt = min(dt, 0.5 if self.mains > 0.0 else 0.01)
        self._update_electrical(self.output_hz, 0.0, dt)
        return dt

    def _update_electrical(self, frequency_hz: float, slope_hz_s: float, dt: float) -> None:
        rating, load = self.rating, self.load
        speed = frequency_hz / rating.frequency_hz
        against = load.constant + _FRICTION_TORQUE + load.quadratic * speed * speed if speed else 0.0
        torque = load.gravity + copysign(against, speed) + rating.inertia_s * slope_hz_s / rating.frequency_hz
        flux = 1.0 if -1.0 <= speed <= 1.0 else 1.0 / abs(speed)
        current = hypot(_MAGNETISING_CURRENT * flux, _TORQUE_CURRENT * torque / flux)
        loss_w = rating.power_kw * 1e3 * _LOSS_SHARE * (0.25 + 0.75 * current * current)
        power_w = rating.power_kw * 1e3 * torque * speed + loss_w
        self.torque, self.current_a, self.power_kw = torque, current * rating.current_a, power_w / 1e3
        self.speed_hz = self.output_hz - rating.slip_hz * torque if self.output_hz else 0.0
        self.loss_j += loss_w * dt
        self._update_dc_bus(power_w, dt)
        self._update_thermal(current, dt)
        if current > _OVERCURRENT_LIMIT:
            self.force_trip(_overcurrent_trip(frequency_hz, slope_hz_s))

    def _update_dc_bus(self, power_w: float, dt: float) -> None:
        """Update the DC bus voltage from its energy: regenerated energy stays in the capacitor."""
        stored = self._bus_j - (power_w + _STANDBY_POWER_W) * dt
        supply_v = self._nominal_v * self.mains
        supplied = 0.5 * self._capacity_f * supply_v * supply_v
        if stored < supplied:
            self.energy_j += supplied - stored
            stored = supplied
        elif self.brake_resistor_w > 0.0:
            stored = self._after_brake_chopper(stored, dt)
        if stored != self._bus_j:
            self._bus_j = stored = max(stored, 0.0)
            self.bus_v = sqrt(2.0 * stored / self._capacity_f)
        if self.bus_v > 1.48 * self._nominal_v:
            self.force_trip(Trip.OVERVOLTAGE)
        elif self.energised and not self.ready:
            self.force_trip(Trip.UNDERVOLTAGE)

    def _after_brake_chopper(self, stored: float, dt: float) -> float:
        above = stored - 0.5 * self._capacity_f * (1.3 * self._nominal_v) ** 2
        burnt = min(max(above, 0.0), self.brake_resistor_w * dt)
        self.brake_j += burnt
        return stored - burnt

    def _update_thermal(self, current: float, dt: float) -> None:
        goal = self.ambient_c + _HEAT_RISE_C * current * current
        if self.temperature_c != goal:
            self.temperature_c += (goal - self.temperature_c) * (1.0 - exp(-dt / _THERMAL_TIME_CONSTANT_S))
        self._overload = max(0.0, self._overload + (current * current - _CONTINUOUS_CURRENT**2) * dt)
        if self._overload >= _OVERLOAD_RESERVE:
            self.force_trip(Trip.OVERLOAD)
        elif self.temperature_c > 90.0 and self.energised:
            self.force_trip(Trip.OVERHEAT)

    def _step_coasting(self, dt: float) -> float:
        """Advance a coasting rotor by the closed solution of dw/dt = -(c + k w²) / M."""
        speed = abs(self.speed_hz) / self.rating.frequency_hz
        if speed > 0.0:
            rest = _coasting_speed(speed, self.load, dt / self.rating.inertia_s)
            self.speed_hz = copysign(rest * self.rating.frequency_hz, self.speed_hz)
        self._update_dc_bus(0.0, dt)
        if self.temperature_c != self.ambient_c or self._overload > 0.0:
            self._update_thermal(0.0, dt)
        return dt


def _coasting_speed(speed: float, load: MotorLoad, time: float) -> float:
    braking = load.constant + _FRICTION_TORQUE + (_HOIST_BRAKE_TORQUE if load.gravity else 0.0)
    if load.quadratic < 1e-9:
        return max(0.0, speed - braking * time)
    scale = sqrt(braking / load.quadratic)
    angle = atan(speed / scale) - sqrt(braking * load.quadratic) * time
    return scale * tan(angle) if angle > 0.0 else 0.0


def _overcurrent_trip(frequency_hz: float, slope_hz_s: float) -> Trip:
    if slope_hz_s == 0.0:
        return Trip.OVERCURRENT_RUNNING
    rising = frequency_hz * slope_hz_s > 0.0
    return Trip.OVERCURRENT_ACCELERATING if rising else Trip.OVERCURRENT_DECELERATING
