"""Base of the simulated stations: address, motor, parameters, time, injected faults and keypad.

A station is a slave: it transmits only replies. ``handle_frame`` takes a request and returns the reply with its delay;
the meaning of a request is the model's own.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

from drivebus.errors import ProtocolError
from drivebus.protocols.codec import Codec
from drivebus.serial_settings import SerialSettings
from drivebus.simulator.framing import FramingRule
from drivebus.simulator.motor import Motor, Trip
from drivebus.simulator.parameter_memory import ParameterMemory, ParameterSpec


@dataclass(slots=True, kw_only=True)
class InjectedFaults:
    """Faults injected into a station by tests, demos and the CLI."""

    silent: bool = False
    """The station receives and sends nothing; its motor goes on."""
    mute: bool = False
    """The station executes requests but its replies are lost (broken transmitter)."""
    added_delay_s: float = 0.0
    """Added to every reply delay, in seconds."""
    next_added_delays_s: list[float] = field(default_factory=list)
    """Added to the delays of the next replies, one each."""
    wrong_address: int | None = None
    """The station replies under this address."""
    frozen_readings: bool = False
    """Monitors keep the values of the moment at which this was set."""
    rebooting_until: float = float("-inf")
    """The station is rebooting until this time."""


@dataclass(slots=True)
class StationReply:
    """Reply and its delay from the last bit of the request to its first bit."""

    data: bytes
    delay_s: float


class SimulatedStation(ABC):
    """Simulated drive. ``frame_count`` counts its requests, ``gap_violations`` those after too little silence."""

    rule: FramingRule
    broadcast: ClassVar[int]
    """Address of all stations."""
    address_is_parameter: ClassVar[bool] = False
    """Whether the drive takes its address from a parameter, at power-up."""
    factory_settings: ClassVar[SerialSettings]
    """Factory serial settings."""
    ramp_keys: ClassVar[tuple[int, int]]
    """Parameters of acceleration and deceleration time, in 0.1 s."""
    codecs: tuple[Codec, ...]

    def __init__(self, address: int, specs: dict[int, ParameterSpec], motor: Motor | None = None) -> None:
        self.address = address
        self.memory = ParameterMemory(specs)
        self.motor = motor or Motor()
        self.faults = InjectedFaults()
        self.now: float | None = None
        self.frame_count = self.reply_count = self.gap_violations = 0
        self.shortest_gap_s = float("inf")
        self.setpoint_hz = 0.0
        self.reverse = False
        self.jogging = False
        self._frozen_motor: Motor | None = None

    # Defined by each model.

    @abstractmethod
    def handle_request(self, message: Any, codec: Codec) -> Any:
        """Execute a request and return the reply message, or None for no reply."""

    def reply_to_error(self, error: ProtocolError, codec: Codec) -> Any:
        """Return the reply to a frame that can't be decoded, or None."""
        return None

    @abstractmethod
    def reply_delay_s(self, settings: SerialSettings) -> float:
        """Return the delay from the last bit of a request to the first of the reply."""

    def elapse(self, dt: float) -> None:
        """Advance motor and timers by ``dt`` seconds."""
        self.motor.step(dt)

    @abstractmethod
    def power_up(self) -> None:
        """Reset the model's state after switching on; memory and motor are reset already."""

    @abstractmethod
    def trip_code(self, trip: Trip) -> int:
        """Return the model's fault code."""

    # Common to all models.

    @property
    def profile_options(self) -> dict[str, str]:
        """Values of profile options that a ``sim://`` port states, where the bus cannot show them."""
        return {}

    @property
    def displayed_motor(self) -> Motor:
        """Motor as the monitors show it."""
        if not self.faults.frozen_readings:
            self._frozen_motor = None
            return self.motor
        if self._frozen_motor is None:
            self._frozen_motor = copy(self.motor)
        return self._frozen_motor

    @property
    def running(self) -> bool:
        return self.motor.energised

    def advance(self, now: float) -> None:
        """Advance to ``now``."""
        if self.now is not None and now > self.now:
            self.elapse(now - self.now)
        if self.now is None or now > self.now:
            self.now = now

    def handle_frame(
        self,
        message: Any,
        codec: Codec,
        settings: SerialSettings,
        now: float,
        *,
        error: ProtocolError | None = None,
        is_broadcast: bool = False,
    ) -> StationReply | None:
        """Handle a request that ended at ``now``. A broadcast is executed without reply."""
        self.advance(now)
        faults = self.faults
        if faults.silent or now < faults.rebooting_until:
            return None
        self.frame_count += 1
        reply = self.reply_to_error(error, codec) if error is not None else self.handle_request(message, codec)
        if reply is None or is_broadcast or faults.mute or self.address == self.broadcast:
            return None
        self.reply_count += 1
        if faults.wrong_address is not None:
            reply = replace(reply, address=faults.wrong_address)
        late_s = faults.next_added_delays_s.pop(0) if faults.next_added_delays_s else 0.0
        return StationReply(codec.encode_reply(reply), self.reply_delay_s(settings) + faults.added_delay_s + late_s)

    def on_foreign_frame(self, now: float) -> None:
        """Handle a frame for another station that ended at ``now``."""
        return  # most models ignore it

    def record_gap(self, silence_s: float, *, short: bool) -> None:
        """Record the silence before a request."""
        if silence_s < self.shortest_gap_s:
            self.shortest_gap_s = silence_s
        self.gap_violations += short

    def trip(self, trip: Trip) -> None:
        """Trip the drive."""
        self.motor.force_trip(trip)

    def power_cycle(self, off_s: float = 2.0) -> None:
        """Switch the drive off and on: RAM is lost, the output is off, no reply for ``off_s``."""
        self.memory.power_cycle()
        self.motor.coast()
        self.motor.reset()
        self.faults.rebooting_until = (self.now or 0.0) + off_s
        self.setpoint_hz, self.reverse, self.jogging = 0.0, False, False
        self.power_up()

    def set_ramps(self, accel_s: float, decel_s: float) -> None:
        """Set both ramp times at the keypad: seconds per maximum frequency."""
        for key, seconds in zip(self.ramp_keys, (accel_s, decel_s), strict=True):
            self.keypad_set(key, max(1, round(seconds * 10)))

    def run_towards(self, frequency_hz: float) -> None:
        """Run towards a frequency in the set direction."""
        self.motor.run(-frequency_hz if self.reverse else frequency_hz)

    def keypad_run(self, frequency_hz: float, *, reverse: bool = False) -> None:
        """Start the drive at its keypad."""
        self.setpoint_hz, self.reverse, self.jogging = frequency_hz, reverse, False
        self.run_towards(frequency_hz)

    def keypad_stop(self) -> None:
        """Stop the drive at its keypad."""
        self.motor.stop()

    def keypad_set(self, key: int, value: int) -> None:
        """Change a parameter at the keypad: saved, without access checks."""
        self.memory.write(key, value, save=True)


@dataclass(frozen=True, kw_only=True)
class SimulatedModel:
    """Drive model that can be simulated: its station, addresses and options."""

    station: Callable[..., SimulatedStation]
    """``(address, motor=…, **options)``."""
    addresses: range
    options: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Option to its values, chosen by the user."""
    fixed: Mapping[str, Any] = field(default_factory=dict)
    """Constructor arguments of this model that a user cannot choose."""
