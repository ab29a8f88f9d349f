"""Simulated Modbus drive from a table of its source's registers. It knows no profile.

Ramps, the frequency of a jog, the reply delay and the exceptions are the simulator's own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

from drivebus.errors import ProtocolError
from drivebus.protocols import modbus
from drivebus.protocols.codec import Codec
from drivebus.serial_settings import SerialSettings
from drivebus.simulator.framing import MODBUS_ASCII_FRAMING, MODBUS_RTU_FRAMING
from drivebus.simulator.motor import Motor, OutputPhase, Trip
from drivebus.simulator.parameter_memory import ParameterSpec
from drivebus.simulator.station import SimulatedStation

ILLEGAL_FUNCTION, ILLEGAL_ADDRESS, ILLEGAL_VALUE = 1, 2, 3
ACCEL_TIME, DECEL_TIME = 0x10000, 0x10001
"""Keys of ramp times beyond all registers, 0.1 s."""
JOG_HZ = 5.0
REPLY_DELAY_S = 0.005


@dataclass(frozen=True, kw_only=True)
class SourceDrive:
    """Registers and words of one model, each as its source gives it."""

    model: str
    source: str
    """Documents and programs: repository, path and commit, or manual and page."""
    line: str = "9600 8N1"
    is_ascii: bool = False
    functions: tuple[int, ...] = (3, 6)
    max_read: int = 125
    """Most registers of one read; a longer one gets exception 03."""
    unanswered: frozenset[str] = frozenset()
    """Actions that the drive executes without a reply."""
    commands: Mapping[int, Callable[[int], str | None]]
    """Command register to the action of its words: "forward", "stop", …, "" for none, None for a word that no source
    explains."""
    setpoint_register: int
    setpoint_step_hz: float = 0.0
    """Hz of one step; 0 for a share of the maximum frequency."""
    maximum: tuple[int, int, float] | None = None
    """Register of the maximum frequency, its word, and Hz of one step; 10000 in the setpoint is that maximum."""
    settings: Mapping[int, int] = field(default_factory=dict)
    """Register of each further parameter to the word that the keypad has set."""
    readings: Mapping[int, Callable[[SourceStation], float]]
    """Register to its word."""
    faults: Mapping[Trip, int]
    """Trip to the fault number (or bit) that the source gives for it."""


class SourceStation(SimulatedStation):
    """Simulated drive of a ``SourceDrive``."""

    broadcast: ClassVar[int] = modbus.BROADCAST
    ramp_keys: ClassVar[tuple[int, int]] = (ACCEL_TIME, DECEL_TIME)

    def __init__(self, address: int, drive: SourceDrive, *, motor: Motor | None = None) -> None:
        self.drive = drive
        specs = {ACCEL_TIME: ParameterSpec(100, 1, 36000), DECEL_TIME: ParameterSpec(100, 1, 36000)}
        if drive.maximum is not None:
            specs[drive.maximum[0]] = ParameterSpec(drive.maximum[1])
        specs |= {register: ParameterSpec(word) for register, word in drive.settings.items()}
        super().__init__(address, specs, motor)
        self.rule = MODBUS_ASCII_FRAMING if drive.is_ascii else MODBUS_RTU_FRAMING
        self.codecs: tuple[Codec, ...] = (modbus.ModbusAsciiCodec() if drive.is_ascii else modbus.ModbusRtuCodec(),)
        baud, _, serial_format = drive.line.partition(" ")
        self.factory_settings = SerialSettings.parse(int(baud), serial_format)  # type: ignore[misc]
        self.setpoint_word = 0

    def power_up(self) -> None:
        self.setpoint_word = 0

    def reply_delay_s(self, settings: SerialSettings) -> float:
        return max(REPLY_DELAY_S, settings.seconds(3.5))

    def elapse(self, dt: float) -> None:
        self.motor.accel_s, self.motor.decel_s = self.memory[ACCEL_TIME] / 10.0, self.memory[DECEL_TIME] / 10.0
        super().elapse(dt)

    def trip_code(self, trip: Trip) -> int:
        return self.drive.faults[trip]

    # State for the tables.

    @property
    def set_hz(self) -> float:
        """Set frequency in Hz."""
        if self.drive.maximum is None:
            return self.setpoint_word * self.drive.setpoint_step_hz
        register, _, step_hz = self.drive.maximum
        return self.setpoint_word * self.memory[register] * step_hz / 10000.0

    @property
    def tripped(self) -> bool:
        return self.motor.trip is not None

    @property
    def fault(self) -> int:
        """Fault number of the trip, 0 without one."""
        return 0 if self.motor.trip is None else self.trip_code(self.motor.trip)

    @property
    def rotates_reverse(self) -> bool:
        hz = self.displayed_motor.output_hz
        return hz < 0.0 or (hz == 0.0 and self.reverse)

    @property
    def accelerating(self) -> bool:
        return self.displayed_motor.phase is OutputPhase.ACCELERATING

    @property
    def decelerating(self) -> bool:
        return self.displayed_motor.phase is OutputPhase.DECELERATING

    def either(self, forward: int, reverse: int) -> int:
        """Return the word of the direction in which the output turns."""
        return reverse if self.rotates_reverse else forward

    # Requests.

    def handle_request(self, message: Any, codec: Codec) -> Any:
        if message.function not in self.drive.functions:
            return modbus.ExceptionReply(message.address, message.function, ILLEGAL_FUNCTION)
        match message:
            case modbus.ReadRegisters(function=3):
                return self._read(message)
            case modbus.WriteRegister():
                writes, acknowledged = [(message.register, message.value)], message.value
            case modbus.WriteRegisters():
                writes, acknowledged = list(enumerate(message.values, message.register)), len(message.values)
            case _:
                return modbus.ExceptionReply(message.address, message.function, ILLEGAL_FUNCTION)
        code = next((code for register, value in writes if (code := self._store(register, value))), 0)
        if any(self._action(register, value) in self.drive.unanswered for register, value in writes):
            return None
        if code:
            return modbus.ExceptionReply(message.address, message.function, code)
        return modbus.WriteAck(message.address, message.function, message.register, acknowledged)

    def reply_to_error(self, error: ProtocolError, codec: Codec) -> Any:
        if not isinstance(error, modbus.IllegalRequest):
            return None
        return modbus.ExceptionReply(error.address, error.function, error.code)

    def _action(self, register: int, value: int) -> str | None:
        action = self.drive.commands.get(register)
        return action(value) if action is not None else None

    def _read(self, request: modbus.ReadRegisters) -> Any:
        if request.count > self.drive.max_read:
            return modbus.ExceptionReply(request.address, request.function, ILLEGAL_VALUE)
        values: list[int] = []
        for register in range(request.register, request.register + request.count):
            if register in self.drive.readings:
                values.append(round(self.drive.readings[register](self)) & 0xFFFF)
            elif register in self.memory.specs:
                values.append(self.memory[register])
            else:
                return modbus.ExceptionReply(request.address, request.function, ILLEGAL_ADDRESS)
        return modbus.RegisterValues(request.address, request.function, tuple(values))

    def _store(self, register: int, value: int) -> int:
        """Execute a write. Return 0 or the code of the exception."""
        if register in self.drive.commands:
            action = self._action(register, value)
            if action is None:
                return ILLEGAL_VALUE
            self._execute(action)
            return 0
        if register in self.drive.settings:
            self.keypad_set(register, value)
            return 0
        if register != self.drive.setpoint_register:
            return ILLEGAL_ADDRESS
        self.setpoint_word = value
        if self.running and not self.jogging and not self.motor.stopping:
            self.run_towards(self.set_hz)
        return 0

    def _execute(self, action: str) -> None:
        match action:
            case "forward" | "reverse":
                self.jogging, self.reverse = False, action == "reverse"
                self.run_towards(self.set_hz)
            case "jog_forward" | "jog_reverse":
                self.jogging, self.reverse = True, action == "jog_reverse"
                self.run_towards(JOG_HZ)
            case "stop":
                self.motor.stop()
            case "quick_stop":
                self.motor.stop(min(1.0, self.motor.decel_s))
            case "coast":
                self.motor.coast()
            case "reset":
                self.motor.reset()
