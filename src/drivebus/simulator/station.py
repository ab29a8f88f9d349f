"""What every pretend drive has: an address, a motor, parameters, time, faults to inject and a keypad. Pure.

A station is a slave: it never speaks by itself. ``heard`` takes a request at a second and gives the reply to send, with
its delay. What a request means is the family's own module; nothing of the host's side is used.
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


@dataclass(slots=True)
class InjectedFaults:
    """What is wrong with a station. Set and cleared by tests, demos and the CLI."""

    silent: bool = False
    """Hears nothing and says nothing; its motor goes on."""
    mute: bool = False
    """Obeys, but its replies never leave (a broken driver)."""
    added_delay_s: float = 0.0
    """Added to every reply delay."""
    next_added_delays_s: list[float] = field(default_factory=list)
    """Added to the next replies, one each."""
    wrong_address: int | None = None
    """Answers under this address."""
    frozen_readings: bool = False
    """Monitors show what they showed when this was set."""
    rebooting_until: float = float("-inf")
    """Rebooting."""


@dataclass(frozen=True, slots=True)
class StationReply:
    """A reply: its bytes, and the seconds from the request's last bit to its first."""

    data: bytes
    delay_s: float


class Station(ABC):
    """One drive on a bus. ``frames`` counts the requests that it heard, ``gap_violations`` those that came too soon."""

    family: ClassVar[str]
    rule: FramingRule
    broadcast: ClassVar[int]
    factory_settings: ClassVar[SerialSettings]
    """Factory line settings."""
    ramp_keys: ClassVar[tuple[int, int]]
    """Parameters of acceleration and deceleration time, in 0.1 s."""
    codecs: tuple[Codec, ...]

    def __init__(self, address: int, cells: dict[int, ParameterSpec], motor: Motor | None = None) -> None:
        self.address = address
        self.memory = ParameterMemory(cells)
        self.motor = motor or Motor()
        self.faults = InjectedFaults()
        self.now: float | None = None
        self.frame_count = self.reply_count = self.gap_violations = 0
        self.shortest_gap_s = float("inf")
        self.setpoint_hz = 0.0
        self.reverse = False
        self.jogging = False
        self._frozen_motor: Motor | None = None

    # What families say.

    @abstractmethod
    def handle_request(self, message: Any, codec: Codec) -> Any:
        """Obey a request and give the reply message, or None for silence."""

    def reply_to_error(self, error: ProtocolError, codec: Codec) -> Any:
        """The reply to a frame that could not be understood; None for silence."""
        return None

    @abstractmethod
    def reply_delay_s(self, line: SerialSettings) -> float:
        """From the last bit of a request to the first of the reply."""

    def elapse(self, dt: float) -> None:
        """Time passes: families add their timers."""
        self.motor.step(dt)

    @abstractmethod
    def power_up(self) -> None:
        """Family state as after switching on; memory and motor are done already."""

    @abstractmethod
    def trip_code(self, trip: Trip) -> int:
        """The family's fault code."""

    # What all do alike.

    @property
    def displayed_motor(self) -> Motor:
        """The motor as its monitors show it."""
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
        """Let time pass until ``now``."""
        if self.now is not None and now > self.now:
            self.elapse(now - self.now)
        if self.now is None or now > self.now:
            self.now = now

    def handle_frame(
        self,
        message: Any,
        codec: Codec,
        line: SerialSettings,
        now: float,
        *,
        error: ProtocolError | None = None,
        is_broadcast: bool = False,
    ) -> StationReply | None:
        """A frame for this station ended at ``now``. ``everybody``: a broadcast, obeyed in silence."""
        self.advance(now)
        if self.faults.silent or now < self.faults.rebooting_until:
            return None
        self.frame_count += 1
        reply = self.reply_to_error(error, codec) if error is not None else self.handle_request(message, codec)
        if reply is None or is_broadcast or self.faults.mute or self.address == self.broadcast:
            return None
        self.reply_count += 1
        if self.faults.wrong_address is not None:
            reply = replace(reply, address=self.faults.wrong_address)
        late_s = self.faults.next_added_delays_s.pop(0) if self.faults.next_added_delays_s else 0.0
        return StationReply(codec.encode_reply(reply), self.reply_delay_s(line) + self.faults.added_delay_s + late_s)

    def on_foreign_frame(self, now: float) -> None:
        """A frame for another station ended at ``now``."""
        return  # most families take no notice

    def record_gap(self, quiet_s: float, short: bool) -> None:
        """A frame for this station came after so much silence."""
        self.shortest_gap_s = min(self.shortest_gap_s, quiet_s)
        self.gap_violations += short

    def trip(self, trip: Trip) -> None:
        """Make the drive trip."""
        self.motor.force_trip(trip)

    def power_cycle(self, off_s: float = 2.0) -> None:
        """Switch off and on: RAM is lost, the output is off, nothing is answered for ``off_s``."""
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

    def keypad_run(self, frequency_hz: float, reverse: bool = False) -> None:
        """A person starts the drive at the keypad."""
        self.setpoint_hz, self.reverse, self.jogging = frequency_hz, reverse, False
        self.run_towards(frequency_hz)

    def keypad_stop(self) -> None:
        """A person stops the drive at the keypad."""
        self.motor.stop()

    def keypad_set(self, key: int, value: int) -> None:
        """A person changes a parameter at the keypad: saved, and asked nobody."""
        self.memory.write(key, value, save=True)


@dataclass(frozen=True, kw_only=True)
class SimulatedModel:
    """Drive model that can be simulated: its station, addresses and options."""

    station: Callable[..., Station]
    """``(address, motor=…, **options)``."""
    addresses: range
    options: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Option to its values, chosen by the user."""
    fixed: Mapping[str, Any] = field(default_factory=dict)
    """Constructor arguments of this model."""
