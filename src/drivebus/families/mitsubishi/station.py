"""Simulated FR drive, after the sources in this package's docstring. Ramps and faults are the simulator's own."""

from __future__ import annotations

from typing import Any, ClassVar

from drivebus.errors import ProtocolError
from drivebus.families.mitsubishi.codec import (
    OUTPUT_CURRENT,
    OUTPUT_FREQUENCY,
    OUTPUT_VOLTAGE,
    READ_DIGITS,
    RUN_FORWARD,
    RUN_REVERSE,
    SET_FREQUENCY,
    STATUS,
    MitsubishiCodec,
    MitsubishiReply,
    MitsubishiRequest,
)
from drivebus.protocols.codec import Codec
from drivebus.serial_settings import SerialSettings
from drivebus.simulator.framing import FramingRule
from drivebus.simulator.motor import Motor, Trip
from drivebus.simulator.parameter_memory import ParameterSpec
from drivebus.simulator.station import SimulatedModel, SimulatedStation

ACCEL, DECEL, MODE = 7, 8, 79
"""Pr.7, Pr.8 (0.1 s) and Pr.79; 0 and 1: commands from the PU connector are accepted."""
MODE_ERROR, DATA_RANGE_ERROR = 0xA, 0xC
MAXIMUM_WORD = 40000


class MitsubishiStation(SimulatedStation):
    """Simulated drive with Pr.123 = 9999 and Pr.124 = 0."""

    rule: FramingRule = FramingRule(gap_characters=0.0, start_bytes=b"\x05", restarts_on_start_byte=True)
    broadcast: ClassVar[int] = -1
    ramp_keys: ClassVar[tuple[int, int]] = (ACCEL, DECEL)
    factory_settings: ClassVar[SerialSettings] = SerialSettings(9600, 8, "N", 2)

    def __init__(self, address: int, *, motor: Motor | None = None) -> None:
        specs = {ACCEL: ParameterSpec(50, 1, 36000), DECEL: ParameterSpec(50, 1, 36000), MODE: ParameterSpec(0, 0, 8)}
        super().__init__(address, specs, motor)
        self.codecs: tuple[Codec, ...] = (MitsubishiCodec(),)

    def reply_delay_s(self, settings: SerialSettings) -> float:
        return 0.012

    def power_up(self) -> None:
        return

    def trip_code(self, trip: Trip) -> int:
        return 0x10

    def elapse(self, dt: float) -> None:
        self.motor.accel_s, self.motor.decel_s = self.memory[ACCEL] / 10.0, self.memory[DECEL] / 10.0
        super().elapse(dt)

    def reply_to_error(self, error: ProtocolError, codec: Codec) -> Any:
        return None

    def handle_request(self, message: Any, codec: Codec) -> Any:
        request: MitsubishiRequest = message
        motor = self.displayed_motor
        values = {
            STATUS: self._status(),
            OUTPUT_FREQUENCY: round(abs(motor.output_hz) * 100),
            OUTPUT_CURRENT: round(motor.current_a * 100),
            OUTPUT_VOLTAGE: round(motor.voltage_v * 10),
        }
        if request.code in values:
            return MitsubishiReply(self.address, values[request.code], READ_DIGITS[request.code])
        return MitsubishiReply(self.address, error=self._execute(request))

    def _execute(self, request: MitsubishiRequest) -> int | None:
        """Execute a write; return the code of its rejection."""
        if self.memory[MODE] not in (0, 1):
            return MODE_ERROR
        if request.code == SET_FREQUENCY:
            if request.data > MAXIMUM_WORD:
                return DATA_RANGE_ERROR
            self.setpoint_hz = request.data / 100.0
            if self.running and not self.motor.stopping:
                self.run_towards(self.setpoint_hz)
        elif request.data & (RUN_FORWARD | RUN_REVERSE):
            self.reverse = request.data & (RUN_FORWARD | RUN_REVERSE) == RUN_REVERSE
            self.run_towards(self.setpoint_hz)
        else:
            self.motor.stop()
        return None

    def _status(self) -> int:
        motor = self.displayed_motor
        running = motor.energised
        turning = 0x04 if self.reverse else 0x02
        return int(running) | (turning if running else 0) | (0x80 if motor.trip else 0)


MODELS = {
    name: SimulatedModel(station=MitsubishiStation, addresses=range(32))
    for name in ("fr_a500", "fr_e500", "fr_a700", "fr_e700", "fr_f700", "fr_d700")
}
