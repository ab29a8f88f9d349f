"""Simulated DF800: Modbus ASCII or RTU with its own error form, after the RS485 supplement of its manual.

It has no status register. Monitors beyond F0.03 and F0.05, the jog frequency and the scales that the supplement does
not print are the simulator's own.
"""

from __future__ import annotations

from typing import Any, ClassVar, Literal

from drivebus.errors import ProtocolError
from drivebus.protocols import modbus
from drivebus.protocols.codec import Codec
from drivebus.serial_settings import SerialSettings
from drivebus.simulator.framing import MODBUS_ASCII_FRAMING, MODBUS_RTU_FRAMING
from drivebus.simulator.motor import Motor, Trip
from drivebus.simulator.parameter_memory import Access, ParameterSpec
from drivebus.simulator.station import SimulatedModel, SimulatedStation

COMMAND, FREQUENCY = 0x2000, 0x2001
MAX_READ = 4
KEYPAD_HZ, FREQUENCY_SOURCE, COMMAND_SOURCE, ACCEL_TIME, DECEL_TIME = 100, 101, 102, 107, 108
JOG_HZ = 120
"""The simulator's own place, 0.01 Hz."""
BAUD, FORMAT, ADDRESS = 700, 701, 702
STOP, START, JOG = 1, 2, 3
BACKWARD, FORWARD, TOGGLE = 1, 2, 3
"""The direction field read with b3 on the left."""


def parameter_specs(address: int, encoding: str) -> dict[int, ParameterSpec]:
    """Return the parameters Fg.nn = 100 g + nn of a commissioned drive."""
    table = {number: ParameterSpec(access=Access.READ_ONLY) for number in range(16)}
    table |= {
        KEYPAD_HZ: ParameterSpec(5000, 0, 40000),
        FREQUENCY_SOURCE: ParameterSpec(5, 0, 5, Access.LOCKED_WHILE_RUNNING),
        COMMAND_SOURCE: ParameterSpec(2, 0, 2, Access.LOCKED_WHILE_RUNNING),
        ACCEL_TIME: ParameterSpec(100, 1, 36000),
        DECEL_TIME: ParameterSpec(100, 1, 36000),
        JOG_HZ: ParameterSpec(500, 0, 40000),
        BAUD: ParameterSpec(1, 0, 3, Access.LOCKED_WHILE_RUNNING),
        FORMAT: ParameterSpec(0 if encoding == "ascii" else 3, 0, 5, Access.LOCKED_WHILE_RUNNING),
        ADDRESS: ParameterSpec(address, 0, 247, Access.LOCKED_WHILE_RUNNING),
    }
    return table


class DF800Station(SimulatedStation):
    """Simulated DF800, with settings for what the supplement leaves open."""

    broadcast: ClassVar[int] = 0
    ramp_keys: ClassVar[tuple[int, int]] = (ACCEL_TIME, DECEL_TIME)
    factory_settings: ClassVar[SerialSettings] = SerialSettings(9600)

    def __init__(
        self,
        address: int,
        *,
        encoding: Literal["ascii", "rtu"] = "rtu",
        direction_field: Literal["b3b2", "b2b3"] = "b3b2",  # the left digit of the printed field is b3 or b2
        accepts_broadcast: bool = False,  # the supplement does not mention broadcasts
        reads_command: bool = False,  # one table reads 2000H, another marks it write-only
        delay_s: float = 0.005,
        motor: Motor | None = None,
    ) -> None:
        super().__init__(address, parameter_specs(address, encoding), motor)
        self.rule = MODBUS_ASCII_FRAMING if encoding == "ascii" else MODBUS_RTU_FRAMING
        codec: Codec = modbus.ModbusAsciiCodec("short") if encoding == "ascii" else modbus.ModbusRtuCodec("short")
        self.codecs: tuple[Codec, ...] = (codec,)
        self.direction_field = direction_field
        self.accepts_broadcast = accepts_broadcast
        self.reads_command = reads_command
        self.delay_s = delay_s
        self.bus_hz = 0.0
        """Last written 2001H, effective only while F1.01 = 5."""
        self.command = 0

    def power_up(self) -> None:
        self.bus_hz, self.command = 0.0, 0

    def reply_delay_s(self, settings: SerialSettings) -> float:
        return max(self.delay_s, settings.seconds(3.5))

    def elapse(self, dt: float) -> None:
        self.motor.accel_s = self.memory[ACCEL_TIME] / 10.0
        self.motor.decel_s = self.memory[DECEL_TIME] / 10.0
        super().elapse(dt)

    @property
    def reference_hz(self) -> float:
        """Set frequency: 2001H with F1.01 = 5, else F1.00."""
        return self.bus_hz if self.memory[FREQUENCY_SOURCE] == 5 else self.memory[KEYPAD_HZ] / 100.0

    def handle_request(self, message: Any, codec: Codec) -> Any:
        if message.address == self.broadcast and not self.accepts_broadcast:
            return None
        match message:
            case modbus.ReadRegisters(function=3):
                return self._read(message)
            case modbus.WriteRegister():
                if self._store(message.register, message.value):
                    return modbus.WriteAck(message.address, 6, message.register, message.value)
        return modbus.ExceptionReply(message.address, message.function, None)

    def reply_to_error(self, error: ProtocolError, codec: Codec) -> Any:
        """Return its error form: the function unchanged and one byte 00."""
        if not isinstance(error, modbus.IllegalRequest):
            return None
        return modbus.ExceptionReply(error.address, error.function, None)

    def _read(self, request: modbus.ReadRegisters) -> Any:
        values: list[int] = []
        for register in range(request.register, request.register + request.count):
            value = self._register(register) if request.count <= MAX_READ else None
            if value is None:
                return modbus.ExceptionReply(request.address, 3, None)
            values.append(value)
        return modbus.RegisterValues(request.address, 3, tuple(values))

    def _register(self, register: int) -> int | None:
        if register in (COMMAND, FREQUENCY):
            word = self.command if register == COMMAND else round(self.bus_hz * 100)
            return word if self.reads_command else None
        if register < 16:
            return self._monitor(register) & 0xFFFF
        return None if self.memory.read_rejection(register) else self.memory[register]

    def _monitor(self, number: int) -> int:
        """Return the value of F0.nn: F0.03 is the current, F0.05 the speed, the others are the simulator's own."""
        motor = self.displayed_motor
        match number:
            case 0:
                return round(abs(motor.output_hz) * 100)
            case 1:
                return round(self.reference_hz * 100)
            case 2:
                return round(motor.voltage_v)
            case 3:
                return round(motor.current_a * 10)
            case 4:
                return round(motor.bus_v)
            case 5:
                return round(abs(motor.speed_rpm))
            case 6:
                return round(motor.temperature_c)
        return 0

    def _store(self, register: int, value: int) -> bool:
        if register == COMMAND:
            self._command(value)
            return True
        if register == FREQUENCY:
            return self._set_frequency(value)
        if self.memory.write_rejection(register, value, running=self.running) is not None:
            return False
        self.memory.write(register, value, save=True)
        return True

    def _set_frequency(self, value: int) -> bool:
        if value > 40000:
            return False
        self.bus_hz = value / 100.0
        if self.running and not self.jogging and not self.motor.stopping:
            self.run_towards(self.reference_hz)
        return True

    def _command(self, word: int) -> None:
        """Execute a write to 2000H: without effect unless F1.02 = 2. A direction toggle is executed."""
        self.command = word
        if self.memory[COMMAND_SOURCE] != 2:
            return
        if word & 0x10:
            self.motor.reset()
        self._apply_direction(word >> 2 & 3)
        run = word & 3
        if run == STOP:
            self.motor.stop()
        elif run == START:
            self.jogging = False
            self.run_towards(self.reference_hz)
        elif run == JOG and not self.running:
            self.jogging = True
            self.run_towards(self.memory[JOG_HZ] / 100.0)

    def _apply_direction(self, field: int) -> None:
        if self.direction_field == "b2b3":
            field = field >> 1 | (field & 1) << 1
        if field == 0:
            return
        self.reverse = not self.reverse if field == TOGGLE else field == BACKWARD
        if self.running and not self.motor.stopping:
            self.run_towards(abs(self.motor.target_hz))

    def trip_code(self, trip: Trip) -> int:
        return list(Trip).index(trip) + 1


MODELS = {
    "df800": SimulatedModel(
        station=DF800Station,
        addresses=range(1, 248),
        options={"encoding": ("rtu", "ascii"), "direction_field": ("b3b2", "b2b3")},
    )
}
