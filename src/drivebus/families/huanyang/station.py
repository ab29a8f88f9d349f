"""Simulated Huanyang drive, after the sources in this package's docstring.

Frames that no source prints (a rejected write, a control without effect) and ramps are the simulator's own.
"""

from __future__ import annotations

from typing import Any, ClassVar, Literal

from drivebus.families.huanyang.codec import (
    CONTROL,
    FREQUENCY,
    STATUS,
    WRITE,
    HuanyangCodec,
    HuanyangReply,
    HuanyangRequest,
)
from drivebus.protocols.codec import Codec
from drivebus.serial_settings import SerialSettings
from drivebus.simulator.framing import FramingRule
from drivebus.simulator.motor import Motor, Trip
from drivebus.simulator.parameter_memory import ParameterSpec
from drivebus.simulator.station import SimulatedModel, SimulatedStation

COMMANDS, FREQUENCIES, MAXIMUM, LOWEST, ACCEL, DECEL = 1, 2, 5, 11, 14, 15
REVERSE_ENABLED, ADDRESS, BAUD, FORMAT = 23, 163, 164, 165
ONE_BYTE = frozenset({0, COMMANDS, FREQUENCIES, REVERSE_ENABLED, 143, ADDRESS, BAUD, FORMAT})
"""Parameters of one byte."""
RUN, FORWARD, REVERSE, STOP, OTHER_DIRECTION = 0x01, 0x02, 0x04, 0x08, 0x10
"""Bits of a control request: 01H runs forward, 11H in the other direction, 08H stops."""


def _specs() -> dict[int, ParameterSpec]:
    """Return the parameters of a commissioned drive: commands and frequency from the bus."""
    table = {number: ParameterSpec(0, 0, 0xFF if number in ONE_BYTE else 0xFFFF) for number in range(183)}
    table |= {
        COMMANDS: ParameterSpec(2, 0, 2),
        FREQUENCIES: ParameterSpec(2, 0, 2),
        3: ParameterSpec(0, 0, 40000),
        4: ParameterSpec(5000, 1, 40000),
        MAXIMUM: ParameterSpec(5000, 1, 40000),
        LOWEST: ParameterSpec(0, 0, 40000),
        ACCEL: ParameterSpec(100, 1, 65000),
        DECEL: ParameterSpec(100, 1, 65000),
        REVERSE_ENABLED: ParameterSpec(1, 0, 1),
        141: ParameterSpec(3800, 0, 5000),
        142: ParameterSpec(51, 0, 5000),
        143: ParameterSpec(4, 2, 10),
        144: ParameterSpec(1440, 0, 9999),
        ADDRESS: ParameterSpec(1, 0, 250),
        BAUD: ParameterSpec(1, 0, 3),
        FORMAT: ParameterSpec(3, 0, 5),
    }
    return table


class HuanyangStation(SimulatedStation):
    """Simulated HY drive. ``answer``: a control is answered with the state (CNST) or, as one program has it, echoed."""

    family: ClassVar[str] = "huanyang"
    rule: FramingRule = FramingRule(gap_characters=3.5, ends_by_silence=True)
    broadcast: ClassVar[int] = 0
    ramp_keys: ClassVar[tuple[int, int]] = (ACCEL, DECEL)
    factory_settings: ClassVar[SerialSettings] = SerialSettings(9600, 8, "N")

    def __init__(self, address: int, *, answer: Literal["state", "echo"] = "state", motor: Motor | None = None) -> None:
        super().__init__(address, _specs(), motor)
        self.codecs: tuple[Codec, ...] = (HuanyangCodec(),)
        self.answer = answer

    def reply_delay_s(self, line: SerialSettings) -> float:
        return max(0.01, line.seconds(3.5))

    def power_up(self) -> None:
        return

    def trip_code(self, trip: Trip) -> int:
        return 0

    def elapse(self, dt: float) -> None:
        self.motor.accel_s, self.motor.decel_s = self.memory[ACCEL] / 10.0, self.memory[DECEL] / 10.0
        self.motor.ramp_base_hz = self.memory[MAXIMUM] / 100.0
        super().elapse(dt)

    def handle_request(self, message: Any, codec: Codec) -> Any:
        request: HuanyangRequest = message
        match request.function:
            case 1:
                return self._value(request)
            case 2:
                return self._write(request)
            case 3:
                return self._control(request)
            case 4:
                return HuanyangReply(self.address, STATUS, request.index, self._status(request.index))
        return self._set_frequency(request)

    def _value(self, request: HuanyangRequest) -> HuanyangReply:
        if request.index not in self.memory.specs:
            return HuanyangReply(self.address, request.function, request.index, accepted=False)
        width = 1 if request.index in ONE_BYTE else 2
        return HuanyangReply(self.address, request.function, request.index, self.memory[request.index], width)

    def _write(self, request: HuanyangRequest) -> HuanyangReply:
        if self.memory.write_rejection(request.index, request.value, self.running) is not None:
            return HuanyangReply(self.address, WRITE, request.index, accepted=False)
        self.memory.write(request.index, request.value, save=True)
        return self._value(request)

    def _control(self, request: HuanyangRequest) -> HuanyangReply:
        bits = request.value
        if self.memory[COMMANDS] != 2:
            return HuanyangReply(self.address, CONTROL, self._state_bits(), accepted=False)
        if bits & STOP:
            self.motor.stop()
        elif bits & RUN:
            self.reverse = bool(bits & (REVERSE | OTHER_DIRECTION)) and self.memory[REVERSE_ENABLED] == 1
            self.run_towards(self._target_hz())
        value = bits if self.answer == "echo" else self._state_bits()
        return HuanyangReply(self.address, CONTROL, 0, value, 1)

    def _set_frequency(self, request: HuanyangRequest) -> HuanyangReply:
        if self.memory[FREQUENCIES] == 2:
            self.setpoint_hz = min(request.value, self.memory[MAXIMUM]) / 100.0
            if self.running and not self.motor.stopping:
                self.run_towards(self._target_hz())
        return HuanyangReply(self.address, FREQUENCY, 0, request.value)

    def _target_hz(self) -> float:
        own = self.memory[FREQUENCIES] != 2
        return self.memory[3] / 100.0 if own else self.setpoint_hz

    def _state_bits(self) -> int:
        running, reverse = self.motor.energised, self.motor.output_hz < 0
        commanded = running and not self.motor.stopping
        return commanded | (commanded and self.reverse) << 2 | running << 3 | (running and reverse) << 5

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
