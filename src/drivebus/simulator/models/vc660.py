"""Simulated VC660 spindle drive: Modbus RTU, after its debugging guide (§ one, four, five, six).

Sizes of the parameter groups, places beyond F00.00-F00.03 and fault bits beyond b0 are the simulator's own.
"""

from __future__ import annotations

from typing import Any, ClassVar, Literal

from drivebus.errors import ProtocolError
from drivebus.protocols import modbus
from drivebus.protocols.codec import Codec
from drivebus.protocols.modbus.messages import DEVICE_FAILURE, ILLEGAL_ADDRESS, ILLEGAL_FUNCTION, ILLEGAL_VALUE
from drivebus.serial_settings import SerialSettings
from drivebus.simulator.framing import MODBUS_RTU_FRAMING, FramingRule
from drivebus.simulator.motor import Motor, OutputPhase, Trip
from drivebus.simulator.parameter_memory import Access, ParameterSpec, RejectReason
from drivebus.simulator.station import SimulatedModel, SimulatedStation

PARAMETERS = 451
"""Indices 0-450 (0-1C2H)."""
SAVE_BIT = 0x8000
"""Bit of an index with which a write is also saved in the EEPROM."""
MAX_READ = 4
GROUP_SIZES = (30, 40, 60, 60, 50, 60, 20, 50, 40, 41)
"""Number of parameters of each group from the first: not published, the simulator's own, 451 in all."""

START, STOP, REVERSE, JOG_FORWARD, JOG_REVERSE = 1 << 0, 1 << 1, 1 << 2, 1 << 3, 1 << 4
COAST, EMERGENCY, PAUSE, HOLD, RESET = 1 << 5, 1 << 6, 1 << 7, 1 << 8, 1 << 9
PULSE_BITS = START | STOP | COAST | EMERGENCY | RESET
"""Marked * in the control table."""

FAULT_BITS = {Trip.UNDERVOLTAGE: 0} | {
    trip: 1 + n for n, trip in enumerate(t for t in Trip if t is not Trip.UNDERVOLTAGE)
}
"""b0 of the first fault word is under-voltage; the others are the simulator's own."""
ANALOG_LIMIT = 0x3FFF
"""The guide prints "0~3ffff", which fits no register."""


def parameter_index(group: int, number: int) -> int:
    """Return the consecutive index of Fgg.nn."""
    return sum(GROUP_SIZES[:group]) + number


FREQUENCY_SOURCE, KEYPAD_HZ = parameter_index(0, 1), parameter_index(0, 2)
COMMAND_SOURCE = parameter_index(1, 0)
REPLY_DELAY, VIRTUAL_INPUTS = parameter_index(6, 6), parameter_index(6, 7)
FIRST_OUTPUT, BUS_OUTPUT = parameter_index(4, 0), 28
ACCEL_TIME, DECEL_TIME, JOG_HZ = parameter_index(0, 8), parameter_index(0, 9), parameter_index(0, 10)
"""The simulator's own places; 0.1 s and 0.01 Hz."""


def parameter_specs() -> dict[int, ParameterSpec]:
    """Return the parameters of a commissioned drive: commands and frequency from the bus."""
    table = dict.fromkeys(range(PARAMETERS), ParameterSpec())
    table |= {
        parameter_index(0, 0): ParameterSpec(5000, 0, 40000, Access.LOCKED_WHILE_RUNNING),
        FREQUENCY_SOURCE: ParameterSpec(4, 0, 9, Access.LOCKED_WHILE_RUNNING),
        KEYPAD_HZ: ParameterSpec(5000, 0, 40000),
        parameter_index(0, 3): ParameterSpec(0, 0, 40000),
        ACCEL_TIME: ParameterSpec(100, 1, 36000),
        DECEL_TIME: ParameterSpec(100, 1, 36000),
        JOG_HZ: ParameterSpec(500, 0, 40000),
        COMMAND_SOURCE: ParameterSpec(2, 0, 2, Access.LOCKED_WHILE_RUNNING),
        parameter_index(6, 2): ParameterSpec(0, 0, 1, Access.LOCKED_WHILE_RUNNING),
        parameter_index(6, 3): ParameterSpec(1, 0, 247, Access.LOCKED_WHILE_RUNNING),
        parameter_index(6, 4): ParameterSpec(5, 0, 7, Access.LOCKED_WHILE_RUNNING),
        parameter_index(6, 5): ParameterSpec(0, 0, 2, Access.LOCKED_WHILE_RUNNING),
        REPLY_DELAY: ParameterSpec(4, 0, 1000),
        VIRTUAL_INPUTS: ParameterSpec(0, 0, 1),
    }
    return table


class VC660Station(SimulatedStation):
    """Simulated VC660. ``pulses``: a bit acts on 0→1 ("edge", the stricter reading) or on every write of a 1 ("write").

    Address 0 is the factory setting: it executes broadcasts and never replies.
    """

    rule: FramingRule = MODBUS_RTU_FRAMING
    broadcast: ClassVar[int] = 0
    ramp_keys: ClassVar[tuple[int, int]] = (ACCEL_TIME, DECEL_TIME)
    factory_settings: ClassVar[SerialSettings] = SerialSettings(9600)

    def __init__(
        self,
        address: int,
        *,
        pulses: Literal["edge", "write"] = "edge",
        maximum_hz: float = 400.0,
        motor: Motor | None = None,
    ) -> None:
        super().__init__(address, parameter_specs(), motor)
        self.codecs: tuple[Codec, ...] = (modbus.ModbusRtuCodec(),)
        self.pulses = pulses
        self.maximum_hz = maximum_hz
        self.power_up()

    def power_up(self) -> None:
        self.control = 0
        """Last written control word."""
        self.paused = self.emergency = False
        self.inputs = [0, 0]
        self.outputs = 0
        self.analog = [0, 0]

    def reply_delay_s(self, settings: SerialSettings) -> float:
        """Return F06.06, at least the silence that ends the request."""
        return max(self.memory[REPLY_DELAY] / 1000.0, settings.seconds(3.5))

    def elapse(self, dt: float) -> None:
        ram = self.memory.ram
        self.motor.accel_s = ram[ACCEL_TIME] / 10.0
        self.motor.decel_s = ram[DECEL_TIME] / 10.0
        super().elapse(dt)
        if self.emergency and not self.motor.energised:
            self.emergency = False

    def handle_request(self, message: Any, codec: Codec) -> Any:
        match message:
            case modbus.Diagnostics():
                return modbus.DiagnosticsReply(message.address, message.data)
            case modbus.ReadRegisters(function=3):
                return self._read(message)
            case modbus.WriteRegister():
                return self._write(message)
        return modbus.ExceptionReply(message.address, message.function, ILLEGAL_FUNCTION)

    def reply_to_error(self, error: ProtocolError, codec: Codec) -> Any:
        """Return an exception for a complete frame with a good CRC and an illegal request, else None."""
        if not isinstance(error, modbus.IllegalRequest):
            return None
        code = error.code if error.function in (3, 6, 8) else ILLEGAL_FUNCTION
        return modbus.ExceptionReply(error.address, error.function, code)

    @property
    def reference_hz(self) -> float:
        """Set frequency: 2001H with F00.01 = 4, else the keypad's F00.02."""
        return self.setpoint_hz if self.memory[FREQUENCY_SOURCE] == 4 else self.memory[KEYPAD_HZ] / 100.0

    # Reading.

    def _read(self, request: modbus.ReadRegisters) -> Any:
        if request.count > MAX_READ:
            return modbus.ExceptionReply(request.address, 3, ILLEGAL_VALUE)
        motor = self.displayed_motor
        values: list[int] = []
        for register in range(request.register, request.register + request.count):
            if register < PARAMETERS:
                values.append(self.memory[register])
            elif 0x3000 <= register <= 0x3018:
                values.append(self._monitor(register - 0x3000, motor) & 0xFFFF)
            else:  # write-only or in no table (200BH)
                return modbus.ExceptionReply(request.address, 3, ILLEGAL_ADDRESS)
        return modbus.RegisterValues(request.address, 3, tuple(values))

    def _monitor(self, number: int, motor: Motor) -> int:
        match number:
            case 0x00:
                return self._status(motor)
            case 0x01:
                return round(self.reference_hz * 100)
            case 0x02:
                return round(abs(motor.output_hz) * 100)
            case 0x03:
                return round(motor.current_a * 10)
            case 0x04:
                return round(motor.voltage_v * 10)
            case 0x05:
                return max(0, round(motor.power_kw * 100))
            case 0x06:
                return round(motor.bus_v)
            case 0x07:
                return self.inputs[0] if self.memory[VIRTUAL_INPUTS] else 0
            case 0x0B:
                return round(motor.temperature_c)
            case 0x0C:
                return round(self.reference_hz * 60 / motor.rating.pole_pairs)
            case 0x08 | 0x14:
                return self.outputs & self._bus_controlled_outputs()
            case 0x16:
                return 1 << FAULT_BITS[motor.trip] if motor.trip else 0
            case 0x18:
                return 1 if motor.temperature_c > 80.0 else 0
        return 0

    def _bus_controlled_outputs(self) -> int:
        """Return the mask of outputs Y0-Y2 that F04.00-02 assign to the bus (28, 29, 30)."""
        return sum(1 << n for n in range(3) if self.memory[FIRST_OUTPUT + n] == BUS_OUTPUT + n)

    def _status(self, motor: Motor) -> int:
        running, ready, tripped = motor.energised, motor.ready, motor.trip is not None
        return (
            (ready and not tripped) << 0
            | tripped << 1
            | (not ready) << 2
            | running << 3
            | self.emergency << 4
            | self.paused << 5
            | (running and motor.phase is OutputPhase.DC_BRAKING) << 7
            | (self.jogging and running) << 8
            | self.reverse << 14
            | (motor.output_hz < 0.0) << 15
        )

    # Writing.

    def _write(self, request: modbus.WriteRegister) -> Any:
        code = self._store(request.register, request.value)
        if code:
            return modbus.ExceptionReply(request.address, 6, code)
        return modbus.WriteAck(request.address, 6, request.register, request.value)

    def _store(self, register: int, value: int) -> int:
        """Execute a write. Return 0 or the code of the exception."""
        if 0x2000 <= register <= 0x2009:
            return self._control_register(register - 0x2000, value)
        key = register & ~SAVE_BIT
        rejection = self.memory.write_rejection(key, value, running=self.running)
        if rejection is None:
            self.memory.write(key, value, save=bool(register & SAVE_BIT))
            return 0
        if rejection in (RejectReason.UNKNOWN, RejectReason.HIDDEN):
            return ILLEGAL_ADDRESS
        return ILLEGAL_VALUE if rejection is RejectReason.RANGE else DEVICE_FAILURE

    def _control_register(self, number: int, value: int) -> int:
        match number:
            case 0:
                self._command(value)
            case 1:
                return self._set_frequency(value)
            case 2 | 4:
                self.inputs[number // 2 - 1] |= value
            case 3 | 5:
                self.inputs[number // 2 - 1] &= ~value
            case 6:
                self.outputs |= value & 0b111
            case 7:
                self.outputs &= ~value
            case 8 | 9:
                if value > ANALOG_LIMIT:
                    return ILLEGAL_VALUE
                self.analog[number - 8] = value
        return 0

    def _set_frequency(self, value: int) -> int:
        if value > round(self.maximum_hz * 100):
            return ILLEGAL_VALUE
        if self.memory[FREQUENCY_SOURCE] == 4:
            self.setpoint_hz = value / 100.0
            if self.running and not self.jogging and not self.paused and not self.motor.stopping:
                self.run_towards(self.setpoint_hz)
        return 0

    def _command(self, word: int) -> None:
        """Execute a write to 2000H: all levels, and each pulse bit on its edge (or whenever it is 1); stops first."""
        pulses = word & PULSE_BITS & (~self.control if self.pulses == "edge" else 0xFFFF)
        rising = word & ~self.control
        falling = self.control & ~word
        self.control = word
        if self.memory[COMMAND_SOURCE] != 2:
            return
        self._apply_levels(word)
        if pulses & RESET:
            self.motor.reset()
        if pulses & EMERGENCY:
            self.emergency = self.running
            self.motor.stop(min(1.0, self.motor.decel_s))
        elif pulses & COAST:
            self.motor.coast()
        elif pulses & STOP:
            self.motor.stop()
        elif pulses & START:
            self.jogging = False
            self.run_towards(0.0 if self.paused else self.reference_hz)
        else:
            self._jog(word, rising, falling)

    def _apply_levels(self, word: int) -> None:
        turned = self.reverse != bool(word & REVERSE)
        self.reverse = bool(word & REVERSE)
        paused, self.paused = self.paused, bool(word & PAUSE)
        self.motor.hold = bool(word & HOLD)
        if self.running and not self.jogging and not self.motor.stopping:
            if self.paused:
                self.run_towards(0.0)
            elif turned or paused:
                self.run_towards(self.reference_hz)

    def _jog(self, word: int, rising: int, falling: int) -> None:
        jogs = JOG_FORWARD | JOG_REVERSE
        if rising & jogs and not self.running:
            self.jogging = True
            hz = self.memory[JOG_HZ] / 100.0
            self.motor.run(-hz if rising & JOG_REVERSE else hz)
        elif falling & jogs and not word & jogs and self.jogging:
            self.motor.stop()

    def trip_code(self, trip: Trip) -> int:
        return FAULT_BITS[trip]


MODELS = {"vc660": SimulatedModel(station=VC660Station, addresses=range(248), options={"pulses": ("edge", "write")})}
