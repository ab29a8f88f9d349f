"""Simulated Huanyang drive, after the sources in this package's docstring.

Frames that no source prints (a rejected write, a control without effect) and ramps are the simulator's own.
"""

from __future__ import annotations

from typing import Any, ClassVar, Literal

from drivebus.families.huanyang.codec import (
    CONTROL,
    FREQUENCY,
    READ,
    STATUS,
    WRITE,
    HuanyangCodec,
    HuanyangReply,
    HuanyangRequest,
)
from drivebus.protocols.codec import Codec
from drivebus.serial_settings import SerialSettings
from drivebus.simulator.framing import MODBUS_RTU_FRAMING, FramingRule
from drivebus.simulator.motor import Motor, Trip
from drivebus.simulator.parameter_memory import ParameterSpec
from drivebus.simulator.station import SimulatedModel, SimulatedStation

COMMAND_SOURCE, FREQUENCY_SOURCE, KEYPAD_HZ, BASE_HZ, MAXIMUM_HZ, LOWEST_HZ = 1, 2, 3, 4, 5, 11
ACCEL_TIME, DECEL_TIME, REVERSE_ENABLED = 14, 15, 23
RATED_VOLTAGE, RATED_CURRENT, MOTOR_POLES, RATED_SPEED = 141, 142, 143, 144
ADDRESS, BAUD, FORMAT = 163, 164, 165
FROM_BUS = 2
"""Value of the command source and of the frequency source."""
ONE_BYTE = frozenset({0, COMMAND_SOURCE, FREQUENCY_SOURCE, REVERSE_ENABLED, MOTOR_POLES, ADDRESS, BAUD, FORMAT})
"""Parameters of one byte."""
RUN, FORWARD, REVERSE, STOP, OTHER_DIRECTION = 0x01, 0x02, 0x04, 0x08, 0x10
"""Bits of a control request: 01H runs forward, 11H in the other direction, 08H stops."""


def _specs() -> dict[int, ParameterSpec]:
    """Return the parameters of a commissioned drive: commands and frequency from the bus."""
    table = {number: ParameterSpec(0, 0, 0xFF if number in ONE_BYTE else 0xFFFF) for number in range(183)}
    table |= {
        COMMAND_SOURCE: ParameterSpec(FROM_BUS, 0, 2),
        FREQUENCY_SOURCE: ParameterSpec(FROM_BUS, 0, 2),
        KEYPAD_HZ: ParameterSpec(0, 0, 40000),
        BASE_HZ: ParameterSpec(5000, 1, 40000),
        MAXIMUM_HZ: ParameterSpec(5000, 1, 40000),
        LOWEST_HZ: ParameterSpec(0, 0, 40000),
        ACCEL_TIME: ParameterSpec(100, 1, 65000),
        DECEL_TIME: ParameterSpec(100, 1, 65000),
        REVERSE_ENABLED: ParameterSpec(1, 0, 1),
        RATED_VOLTAGE: ParameterSpec(3800, 0, 5000),
        RATED_CURRENT: ParameterSpec(51, 0, 5000),
        MOTOR_POLES: ParameterSpec(4, 2, 10),
        RATED_SPEED: ParameterSpec(1440, 0, 9999),
        ADDRESS: ParameterSpec(1, 0, 250),
        BAUD: ParameterSpec(1, 0, 3),
        FORMAT: ParameterSpec(3, 0, 5),
    }
    return table


class HuanyangStation(SimulatedStation):
    """Simulated HY drive. ``answer``: a control is answered with the state (CNST) or, as one program has it, echoed."""

    rule: FramingRule = MODBUS_RTU_FRAMING
    broadcast: ClassVar[int] = 0
    ramp_keys: ClassVar[tuple[int, int]] = (ACCEL_TIME, DECEL_TIME)
    factory_settings: ClassVar[SerialSettings] = SerialSettings(9600, 8, "N")

    def __init__(self, address: int, *, answer: Literal["state", "echo"] = "state", motor: Motor | None = None) -> None:
        super().__init__(address, _specs(), motor)
        self.codecs: tuple[Codec, ...] = (HuanyangCodec(),)
        self.answer = answer

    def reply_delay_s(self, settings: SerialSettings) -> float:
        return max(0.01, settings.seconds(3.5))

    def power_up(self) -> None:
        return

    def trip_code(self, trip: Trip) -> int:
        return 0

    def elapse(self, dt: float) -> None:
        self.motor.accel_s, self.motor.decel_s = self.memory[ACCEL_TIME] / 10.0, self.memory[DECEL_TIME] / 10.0
        self.motor.ramp_base_hz = self.memory[MAXIMUM_HZ] / 100.0
        super().elapse(dt)

    def handle_request(self, message: Any, codec: Codec) -> Any:
        request: HuanyangRequest = message
        execute = {
            READ: self._read,
            WRITE: self._write,
            CONTROL: self._control,
            STATUS: self._read_status,
            FREQUENCY: self._set_frequency,
        }
        return execute[request.function](request)

    def _read(self, request: HuanyangRequest) -> HuanyangReply:
        if request.index not in self.memory.specs:
            return HuanyangReply(self.address, request.function, request.index, accepted=False)
        width = 1 if request.index in ONE_BYTE else 2
        return HuanyangReply(self.address, request.function, request.index, self.memory[request.index], width)

    def _write(self, request: HuanyangRequest) -> HuanyangReply:
        if self.memory.write_rejection(request.index, request.value, running=self.running) is not None:
            return HuanyangReply(self.address, WRITE, request.index, accepted=False)
        self.memory.write(request.index, request.value, save=True)
        return self._read(request)

    def _control(self, request: HuanyangRequest) -> HuanyangReply:
        bits = request.value
        if self.memory[COMMAND_SOURCE] != FROM_BUS:
            return HuanyangReply(self.address, CONTROL, self._state_bits(), accepted=False)
        if bits & STOP:
            self.motor.stop()
        elif bits & RUN:
            self.reverse = bool(bits & (REVERSE | OTHER_DIRECTION)) and self.memory[REVERSE_ENABLED] == 1
            self.run_towards(self._target_hz())
        value = bits if self.answer == "echo" else self._state_bits()
        return HuanyangReply(self.address, CONTROL, 0, value, 1)

    def _set_frequency(self, request: HuanyangRequest) -> HuanyangReply:
        if self.memory[FREQUENCY_SOURCE] == FROM_BUS:
            self.setpoint_hz = min(request.value, self.memory[MAXIMUM_HZ]) / 100.0
            if self.running and not self.motor.stopping:
                self.run_towards(self._target_hz())
        return HuanyangReply(self.address, FREQUENCY, 0, request.value)

    def _target_hz(self) -> float:
        return self.setpoint_hz if self.memory[FREQUENCY_SOURCE] == FROM_BUS else self.memory[KEYPAD_HZ] / 100.0

    def _state_bits(self) -> int:
        running, reverse = self.motor.energised, self.motor.output_hz < 0
        commanded = running and not self.motor.stopping
        return commanded | (commanded and self.reverse) << 2 | running << 3 | (running and reverse) << 5

    def _read_status(self, request: HuanyangRequest) -> HuanyangReply:
        return HuanyangReply(self.address, STATUS, request.index, self._status(request.index))

    def _status(self, item: int) -> int:
        motor = self.displayed_motor
        match item:
            case 0:
                return round(self._target_hz() * 100)
            case 1:
                return round(abs(motor.output_hz) * 100)
            case 2:
                return round(motor.current_a * 10)
            case 3:
                return round(abs(motor.speed_rpm))
            case 4:
                return round(motor.bus_v)
            case 5:
                return round(motor.voltage_v)
            case 7:
                return round(motor.temperature_c)
        return 0


MODELS = {
    "huanyang_hy": SimulatedModel(
        station=HuanyangStation, addresses=range(1, 251), options={"answer": ("state", "echo")}
    )
}
