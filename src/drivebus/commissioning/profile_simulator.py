"""Simulated Modbus drive from its profile alone, for models without a simulated drive written from their manual.

It shows that a profile is whole and consistent, and lets its users practise. It is no evidence that the profile is
right: a misread register is misread at both ends.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from itertools import islice
from typing import Any, ClassVar

from drivebus.drives.dialects.modbus_reads import (
    ReadRequest,
    Span,
    join_words,
    request_span,
    span_of,
    split_words,
    status_span,
)
from drivebus.drives.dialects.modbus_writes import (
    CommandWrite,
    ModbusWrites,
    ParameterWrite,
    RecognizedWrite,
    ResetWrite,
    SetpointWrite,
    UnlockWrite,
)
from drivebus.errors import ProtocolError
from drivebus.profiles.load import load, model_name, models
from drivebus.profiles.model import SETPOINT_STEP, DriveProfile, Parameter, Signal
from drivebus.profiles.words import CommandMap, StatusMap
from drivebus.protocols import modbus
from drivebus.protocols.codec import Codec
from drivebus.protocols.family import Locator
from drivebus.protocols.modbus.messages import ILLEGAL_ADDRESS, ILLEGAL_FUNCTION, ILLEGAL_VALUE
from drivebus.serial_settings import SerialSettings
from drivebus.simulator.framing import MODBUS_ASCII_FRAMING, MODBUS_RTU_FRAMING
from drivebus.simulator.motor import Motor, OutputPhase, Trip
from drivebus.simulator.parameter_memory import ParameterSpec
from drivebus.simulator.station import SimulatedModel, SimulatedStation, StationReply
from drivebus.values import Scale

MODBUS = "modbus"
ACCEL_TIME = 0x10000
DECEL_TIME = 0x10001
"""Memory keys of the ramp times of a profile without such parameters, beyond all registers; unit 0.1 s."""
TENTH_SECONDS = Scale(0.1, decimals=1)
DEFAULT_RAMP_S = 10.0
DEFAULT_MAXIMUM_HZ = 50.0
JOG_HZ = 5.0
REPLY_DELAY_S = 0.005
SPACE_KEYS = {"holding": 0, "input": 0x20000, "coil": 0x40000, "discrete": 0x60000}
"""First memory key of each space."""
WRITE_FUNCTIONS = (5, 6, 15, 16)
FAULT_NUMBERS = {trip: number for number, trip in enumerate(Trip, 1)}
"""Number, and bit plus 1, of each trip: the simulator's own."""
SIGNAL_SOURCES: dict[str, Callable[[Motor], float]] = {
    "output_frequency": lambda motor: abs(motor.output_hz),
    "output_current": lambda motor: motor.current_a,
    "output_voltage": lambda motor: motor.voltage_v,
    "output_power": lambda motor: max(0.0, motor.power_kw),
    "dc_bus_voltage": lambda motor: motor.bus_v,
    "temperature": lambda motor: motor.temperature_c,
    "output_speed": lambda motor: abs(motor.speed_rpm),
}
"""Signal → its value; any other signal reads 0."""


def simulated_model(model: str) -> SimulatedModel | None:
    """Return a Modbus model of this name, in any case, simulated from its profile; None where there is none.

    Raises ProfileError for a faulty file.
    """
    name = model_name(model)
    if name not in models():
        return None
    profile = load(name)
    if profile.family != MODBUS or profile.commands is None:
        return None
    low, high = profile.addresses
    return SimulatedModel(station=partial(ProfileStation, profile=profile), addresses=range(low, high + 1))


class ProfileStation(SimulatedStation):
    """Simulated drive that does what its profile describes."""

    broadcast: ClassVar[int] = modbus.BROADCAST

    def __init__(self, address: int, *, profile: DriveProfile, motor: Motor | None = None) -> None:
        assert profile.commands is not None
        self.profile = profile
        self.commands: CommandMap = profile.commands.resolved(profile.options)
        super().__init__(address, _parameter_specs(profile), motor)
        self.is_ascii = profile.encodings[0] == "ascii"
        self.rule = MODBUS_ASCII_FRAMING if self.is_ascii else MODBUS_RTU_FRAMING
        self.features = profile.modbus_features
        rtu_codec = modbus.ModbusRtuCodec(count_bytes=self.features.reply_count_bytes)
        self.codecs: tuple[Codec, ...] = (modbus.ModbusAsciiCodec() if self.is_ascii else rtu_codec,)
        self.factory_settings = SerialSettings.parse(profile.serial.baud, profile.serial.format)  # type: ignore[misc]
        self.setpoint_word = self.command = 0
        self.is_locked = self.commands.unlock is not None
        """Whether every command is rejected until the unlocking write."""
        self.steps_taken = 0
        """Words before a start that were taken, in their order."""
        self._writes = ModbusWrites(address, profile, self.commands)
        self._signals = {signal.locator: signal for signal in profile.signals.values()}
        self._places = _number_places(profile)
        ramps = [profile.parameters[notation] for notation in profile.ramp_notations or ()]
        self._ramps = {_memory_key(ramp.locator): ramp.scale for ramp in ramps} or {
            ACCEL_TIME: TENTH_SECONDS,
            DECEL_TIME: TENTH_SECONDS,
        }
        """Memory key and scale of the acceleration and of the deceleration time."""

    def power_up(self) -> None:
        self.setpoint_word = self.command = 0
        self.is_locked = self.commands.unlock is not None
        self.steps_taken = 0

    @property
    def profile_options(self) -> dict[str, str]:
        """Option with the step of the profile, which the drive has also where it is only assumed."""
        step = f"{self.profile.setpoint_scale.factor:g}"
        return {SETPOINT_STEP: step} if SETPOINT_STEP in self.profile.options else {}

    def reply_delay_s(self, settings: SerialSettings) -> float:
        return max(REPLY_DELAY_S, settings.seconds(3.5))

    def elapse(self, dt: float) -> None:
        self.motor.accel_s, self.motor.decel_s = (scale.value(self.memory[key]) for key, scale in self._ramps.items())
        super().elapse(dt)

    def set_ramps(self, accel_s: float, decel_s: float) -> None:
        """Set both ramp times at the keypad: seconds per maximum frequency."""
        for (key, scale), seconds in zip(self._ramps.items(), (accel_s, decel_s), strict=True):
            self.keypad_set(key, max(1, scale.raw(seconds)))

    @property
    def setpoint_scale(self) -> Scale:
        """Hz of a setpoint word, by the maximum frequency that its own parameter holds."""
        share = self.profile.setpoint_share
        if self.profile.setpoint_rpm is not None:
            return Scale(self.profile.setpoint_rpm * self.motor.rating.pole_pairs / 60)
        if share is None:
            return self.profile.setpoint_scale
        maximum_hz = share.maximum_hz or DEFAULT_MAXIMUM_HZ
        if share.maximum is not None:
            parameter = self.profile.parameters[share.maximum]
            maximum_hz = parameter.scale.value(self.memory[_memory_key(parameter.locator)])
        return Scale(maximum_hz / share.full_scale)

    def handle_frame(self, message: Any, codec: Codec, *frame: Any, **details: Any) -> StationReply | None:
        """Reply in the form of this model: the codec that decoded the request may be that of another one."""
        return super().handle_frame(message, self.codecs[0], *frame, **details)

    def handle_request(self, message: Any, codec: Codec) -> Any:
        function = message.function
        if function not in self.features.functions and function != modbus.Diagnostics.function:
            return modbus.ExceptionReply(message.address, function, ILLEGAL_FUNCTION)
        match message:
            case modbus.Diagnostics() if self.features.loopback:
                return modbus.DiagnosticsReply(message.address, message.data)
            case modbus.ReadRegisters() | modbus.ReadBits():
                return self._read(message)
            case _ if function not in WRITE_FUNCTIONS:
                return modbus.ExceptionReply(message.address, function, ILLEGAL_FUNCTION)
        code = self._store(modbus.request_writes(message))
        if code:
            return modbus.ExceptionReply(message.address, function, code)
        return modbus.WriteAck(message.address, function, message.register, _acknowledged(message))

    def reply_to_error(self, error: ProtocolError, codec: Codec) -> Any:
        if not isinstance(error, modbus.IllegalRequest):
            return None
        return modbus.ExceptionReply(error.address, error.function, error.code)

    def trip_code(self, trip: Trip) -> int:
        number = FAULT_NUMBERS[trip]
        status = self.profile.status
        return number if status is not None and status.numbers_fault else number - 1

    # Reading.

    def _read(self, request: ReadRequest) -> Any:
        span = request_span(request)
        if span == Span("input", *(self.features.sync_block or (0, 0))):
            span = span._replace(space="holding")  # function 04 reads this block as 03 does
        limit = self.features.max_read if isinstance(request, modbus.ReadRegisters) else modbus.MAX_READ_BITS
        if span.length > limit:
            return modbus.ExceptionReply(request.address, request.function, ILLEGAL_VALUE)
        blocks = [Span("holding", first, count) for first, count in self.features.blocks]
        if span not in blocks and any(
            block.covers(span._replace(start=n, length=1)) for block in blocks for n in range(span.start, span.end)
        ):
            return modbus.ExceptionReply(request.address, request.function, ILLEGAL_ADDRESS)
        values = [self._value((span.space, place)) for place in range(span.start, span.end)]
        if isinstance(request, modbus.ReadBits) and any(value is not None for value in values):
            return modbus.BitValues(request.address, request.function, tuple(bool(value) for value in values))
        if None in values and span not in blocks:
            return modbus.ExceptionReply(request.address, request.function, ILLEGAL_ADDRESS)
        return modbus.RegisterValues(request.address, request.function, tuple(value or 0 for value in values))

    def _value(self, locator: Locator) -> int | None:
        """Return a register or a coil; None where the profile names none there."""
        status = self.profile.status
        if status is not None and locator[0] == status.space:
            span = status_span(status)
            place = locator[1] - span.start
            if 0 <= place < span.length:
                word = self._status_word(status)
                return (word | self._fault_word(status, locator[1])) if span.length == 1 else word >> place & 1
        if status is not None and locator in [("holding", register) for register in status.fault_registers]:
            return self._fault_word(status, locator[1])
        codes = self.profile.identity_codes
        if codes is not None and locator == ("holding", codes.register):
            return next((code for code, models in codes.models.items() if self.profile.model in models), None)
        first, place, words = self._places.get(locator, (locator, 0, 1))
        number = self._number(first)
        return None if number is None else split_words(number, words, self.features)[place]

    def _number(self, locator: Locator) -> int | None:
        if locator in self._signals:
            return self._signal_word(self._signals[locator])
        if locator == ("holding", self.commands.setpoint_register):
            return self.setpoint_word
        key = _memory_key(locator)
        return None if self.memory.read_rejection(key) else self.memory[key]

    def _signal_word(self, signal: Signal) -> int:
        if signal.name == "set_frequency":
            return _clipped(signal.scale, self.setpoint_scale.value(self.setpoint_word))
        source = SIGNAL_SOURCES.get(signal.name)
        return 0 if source is None else _clipped(signal.scale, source(self.displayed_motor))

    def _fault_word(self, status: StatusMap, register: int) -> int:
        trip = self.motor.trip
        if trip is None or register not in status.fault_registers[:1]:
            return 0
        code = self.trip_code(trip)
        return code * (status.fault_mask & -status.fault_mask) if status.numbers_fault else 1 << code

    def _status_word(self, status: StatusMap) -> int:
        motor = self.displayed_motor
        if self.commands.status_steps and not self._shows_motion(status) and motor.trip is None:
            return self._prepared_status()
        if status.values:
            by_name = {name: value for value, name in reversed(list(status.values.items()))}
            return int(next(by_name[name] for name in self._state_names(status) if name in by_name))
        on = {
            "ready": motor.ready and motor.trip is None,
            "fault": motor.trip is not None,
            "under_voltage": not motor.ready,
            "running": self._shows_motion(status),
            "jogging": self.jogging and motor.energised,
            "dc_braking": motor.phase is OutputPhase.DC_BRAKING,
            "set_reverse": self.reverse,
            "output_reverse": motor.output_hz < 0.0 or (motor.output_hz == 0.0 and self.reverse),
        }
        return sum(mask for name, mask in status.bits.items() if on.get(name))

    def _shows_motion(self, status: StatusMap) -> bool:
        """Return whether the word shows motion; where it does not show standstill, a ramp down is without."""
        motor = self.displayed_motor
        return motor.energised and not (motor.stopping and status.standstill_signal is not None)

    def _prepared_status(self) -> int:
        """Return the status of a drive that stands, after the words before a start that it has taken."""
        steps = self.commands.status_steps
        match = steps[self.steps_taken - 1].until if self.steps_taken else steps[0].when
        return match.value if match is not None else 0

    def _state_names(self, status: StatusMap) -> Iterable[str]:
        """Return the names of the state from the most exact to the one that every status word has."""
        motor = self.displayed_motor
        if motor.trip is not None:
            yield "fault"
        if self._shows_motion(status):
            direction = "reverse" if motor.output_hz < 0.0 or (motor.output_hz == 0.0 and self.reverse) else "forward"
            if self.jogging:
                yield from (f"jogging_{direction}", "jogging")
            yield from (f"running_{direction}", "running")
        yield "stopped"

    # Writing.

    def _store(self, changes: Sequence[modbus.RegisterWrite]) -> int:
        """Execute a write. Return 0 or the code of the exception."""
        writes = self._writes.recognize(changes)
        if writes is None:
            return ILLEGAL_ADDRESS
        places = iter(changes)
        for write in writes:
            part = list(islice(places, write.width))
            code = self._store_one(write, part)
            if code:
                return code
        return 0

    def _store_one(self, write: RecognizedWrite, changes: Sequence[modbus.RegisterWrite]) -> int:
        match write:
            case CommandWrite() | SetpointWrite() if self.is_locked:
                return ILLEGAL_FUNCTION
            case UnlockWrite():
                self.is_locked = False
                return 0
            case CommandWrite(word=word):
                return self._execute(word)
            case SetpointWrite(word=word):
                self.setpoint_word = word
                if self.running and not self.jogging and not self.motor.stopping:
                    self.run_towards(self.setpoint_scale.value(word))
                return 0
            case ResetWrite():
                self.motor.reset()
                return 0
            case ParameterWrite(parameter=parameter):
                number = join_words((value for _, _, value in changes), self.features)
                return self._store_parameter(parameter, number, changes[0][1])
        return ILLEGAL_ADDRESS

    def _store_parameter(self, parameter: Parameter, number: int, written: int) -> int:
        key = _memory_key(parameter.locator)
        if key not in self.memory.specs:
            return ILLEGAL_ADDRESS
        if self.memory.write_rejection(key, number, running=self.running) is not None:
            return ILLEGAL_VALUE
        self.memory.write(key, number, save=self.profile.write_support.saves(parameter.locator[1], written))
        return 0

    def _execute(self, word: int) -> int:
        names = self._command_names(word)
        self.command = word
        if not names and self.commands.values and not self.commands.prepares(word):
            return ILLEGAL_VALUE
        self._take_step(word, names)
        if names & {"start", "start_forward", "start_reverse"} and self.steps_taken < len(self.commands.status_steps):
            return 0  # a drive that is not prepared acknowledges a start and stands
        if "reset" in names:
            self.motor.reset()
        self._apply_direction(names)
        if names & {"coast", "quick_stop", "stop", "jog_stop"}:
            self._stop(names)
        elif names & {"jog_forward", "jog_reverse"}:
            self.jogging, self.reverse = True, "jog_reverse" in names
            self.run_towards(JOG_HZ)
        elif names & {"start", "start_forward", "start_reverse"}:
            self.jogging = False
            self.run_towards(self.setpoint_scale.value(self.setpoint_word))
        return 0

    def _take_step(self, word: int, names: set[str]) -> None:
        """Advance or fall back in the words before a start: a stop leaves the drive where its word leads at rest."""
        steps = self.commands.status_steps
        if self.motor.trip is not None or "coast" in names:
            self.steps_taken = 0
        elif self.motor.energised and "stop" in names:
            led_to = [place for place, step in enumerate(steps, 1) if step.word == word]
            self.steps_taken = led_to[-1] if led_to else len(steps)
        else:  # one word may be the answer to several states that stand in a row, such as two that inhibit a start
            while self.steps_taken < len(steps) and steps[self.steps_taken].word == word:
                self.steps_taken += 1

    def _command_names(self, word: int) -> set[str]:
        if self.commands.values:
            return {name for name, value in self.commands.values.items() if value == word}
        return {name for name, bit in self.commands.bits.items() if word & bit.mask == bit.value}

    def _apply_direction(self, names: set[str]) -> None:
        if names & {"reverse", "start_reverse"}:
            self.reverse = True
        elif names & {"forward", "start_forward"}:
            self.reverse = False

    def _stop(self, names: set[str]) -> None:
        if "coast" in names:
            self.motor.coast()
        elif "quick_stop" in names:
            self.motor.stop(min(1.0, self.motor.decel_s))
        else:
            self.motor.stop()


def _parameter_specs(profile: DriveProfile) -> dict[int, ParameterSpec]:
    """Return every readable parameter at its factory setting, or where it meets a precondition or the maximum."""
    default_ramp = ParameterSpec(TENTH_SECONDS.raw(DEFAULT_RAMP_S), 1, 36000)
    specs = {ACCEL_TIME: default_ramp, DECEL_TIME: default_ramp}
    accepted = {precondition.notation: precondition.accepted[0] for precondition in profile.preconditions}
    for notation, parameter in profile.parameters.items():
        if parameter.readable:
            initial = accepted.get(notation, _initial_word(profile, parameter))
            specs[_memory_key(parameter.locator)] = ParameterSpec(
                initial, maximum=(1 << 16 * parameter.scale.words) - 1
            )
    return specs


def _memory_key(locator: Locator) -> int:
    """Return the key of a parameter: its register, or beyond all registers and ramp times for another space."""
    return SPACE_KEYS[locator[0]] + locator[1]


def _number_places(profile: DriveProfile) -> dict[Locator, tuple[Locator, int, int]]:
    """Return each register of a number in two: the locator of the number, its place there, and the count."""
    places: dict[Locator, tuple[Locator, int, int]] = {}
    spans = [span_of(entry) for entry in profile.entries()]
    if profile.commands is not None:
        spans.append(Span("holding", profile.commands.setpoint_register, profile.setpoint_scale.words))
    for span in spans:
        for place in range(span.length):
            places[span.space, span.start + place] = ((span.space, span.start), place, span.length)
    return places


def _acknowledged(request: Any) -> int:
    """Return the last word of an acknowledgement: the value of a single write, else the count."""
    match request:
        case modbus.WriteRegister():
            return request.value
        case modbus.WriteBit():
            return modbus.COIL_ON if request.value else modbus.COIL_OFF
    return len(request.values)


def _initial_word(profile: DriveProfile, parameter: Parameter) -> int:
    share = profile.setpoint_share
    if share is not None and share.maximum == parameter.notation:
        return parameter.scale.raw(parameter.factory or DEFAULT_MAXIMUM_HZ)
    if parameter.notation in (profile.ramp_notations or ()):
        return parameter.scale.raw(parameter.factory or DEFAULT_RAMP_S)
    return 0 if parameter.factory is None else parameter.scale.raw(parameter.factory)


def _clipped(scale: Scale, value: float) -> int:
    try:
        return scale.raw(value)
    except ValueError:
        return 0xFFFF
