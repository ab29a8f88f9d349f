"""Simulated DZB100: the 11-byte protocol, after its manual (sections one to three).

The manual leaves codings, parity, the meaning of B and the fault digits open; they are settings here. State bits of
Q03, limits and unnamed parameters are the simulator's own.
"""

from __future__ import annotations

from typing import Any, ClassVar, Literal

from drivebus.protocols import dzb100
from drivebus.protocols.codec import Codec
from drivebus.serial_settings import SerialSettings
from drivebus.simulator.framing import FramingRule
from drivebus.simulator.motor import Motor, Trip
from drivebus.simulator.parameter_memory import Access, ParameterSpec
from drivebus.simulator.station import SimulatedModel, SimulatedStation

WordCoding = Literal["hex-0.1", "hex-0.01", "decimal-0.1", "hex-1"]

FREQUENCY_SOURCE, COMMAND_SOURCE, ACCEL_TIME, DECEL_TIME, JOG_HZ, BAUD, ADDRESS = 0, 1, 10, 11, 23, 77, 78
"""Parameters 00, 01, 77, 78 by the last page, 10 and 23 by examples 2 and 3; 11 is the simulator's own."""
FREQUENCY_FROM_BUS, COMMANDS_FROM_BUS = 2, 3
LAST_PARAMETER = 80
MAX_SETPOINT_WORD = 4000
"""Highest setpoint word: 0000-4000 in every coding."""

FAULT_CODES = {
    Trip.OVERCURRENT_RUNNING: 12,
    Trip.OVERCURRENT_ACCELERATING: 10,
    Trip.OVERCURRENT_DECELERATING: 11,
    Trip.OVERVOLTAGE: 2,
    Trip.OVERHEAT: 3,
    Trip.OVERLOAD: 4,
    Trip.EXTERNAL: 6,
    Trip.UNDERVOLTAGE: 14,
    Trip.COMM_LOSS: 17,
    Trip.OTHER: 7,
}
"""Fault code in the digits CD of Q03."""

_STEPS_PER_HZ = {"hex-0.1": 10, "hex-0.01": 100, "decimal-0.1": 10, "hex-1": 1}


def encode_steps(number: int, coding: WordCoding) -> int:
    """Return the word of a number of steps: itself, or its decimal digits."""
    return int(f"{min(number, 9999):04d}", 16) if coding == "decimal-0.1" else min(number, 0xFFFF)


def decode_steps(word: int, coding: WordCoding) -> int | None:
    """Return the number of steps of a word; None where it is no decimal number."""
    if coding != "decimal-0.1":
        return word
    return int(f"{word:X}") if f"{word:X}".isdecimal() else None


def parameter_specs(address: int, parameter_coding: WordCoding) -> dict[int, ParameterSpec]:
    """Return parameters 00-80 of a commissioned drive. There is no RAM: every write is saved."""
    table = dict.fromkeys(range(LAST_PARAMETER + 1), ParameterSpec())
    table |= {
        FREQUENCY_SOURCE: ParameterSpec(FREQUENCY_FROM_BUS, 0, 9, Access.LOCKED_WHILE_RUNNING),
        COMMAND_SOURCE: ParameterSpec(COMMANDS_FROM_BUS, 0, 9, Access.LOCKED_WHILE_RUNNING),
        ACCEL_TIME: ParameterSpec(100, 1, 0xFFFF),
        DECEL_TIME: ParameterSpec(100, 1, 0xFFFF),
        JOG_HZ: ParameterSpec(encode_steps(5 * _STEPS_PER_HZ[parameter_coding], parameter_coding), 0, 0xFFFF),
        BAUD: ParameterSpec(2, 0, 2, Access.LOCKED_WHILE_RUNNING),
        ADDRESS: ParameterSpec(address, 0, 31, Access.LOCKED_WHILE_RUNNING),
    }
    return table


class DZB100Station(SimulatedStation):
    """Simulated DZB100, with settings for the three codings, the meaning of B in a C reply and the fault digits.

    Address 0 is the factory setting: it executes broadcasts and never replies.
    """

    rule: FramingRule = FramingRule(gap_characters=5.0, start_bytes=b"CPRQ")
    broadcast: ClassVar[int] = 0
    address_is_parameter: ClassVar[bool] = True
    ramp_keys: ClassVar[tuple[int, int]] = (ACCEL_TIME, DECEL_TIME)
    factory_settings: ClassVar[SerialSettings] = SerialSettings(4800, 8, "E")

    def __init__(
        self,
        address: int,
        *,
        setpoint_coding: WordCoding = "hex-0.1",
        query_coding: WordCoding = "hex-0.1",
        parameter_coding: WordCoding = "hex-0.1",
        b_digit: Literal["06", "state"] = "06",
        fault_coding: Literal["decimal", "hex"] = "decimal",
        delay_characters: float = 5.0,
        motor: Motor | None = None,
    ) -> None:
        super().__init__(address, parameter_specs(address, parameter_coding), motor)
        self.codecs: tuple[Codec, ...] = (dzb100.Dzb100Codec(),)
        self.setpoint_coding: WordCoding = setpoint_coding
        self.query_coding: WordCoding = query_coding
        self.parameter_coding: WordCoding = parameter_coding
        self.b_digit = b_digit
        self.fault_coding = fault_coding
        self.delay_characters = delay_characters
        """Not stated in the manual."""
        self.command = 0

    def power_up(self) -> None:
        self.command = 0
        self.address = self.memory[ADDRESS]

    def reply_delay_s(self, settings: SerialSettings) -> float:
        return settings.seconds(self.delay_characters)

    def elapse(self, dt: float) -> None:
        self.motor.accel_s = max(1, decode_steps(self.memory[ACCEL_TIME], self.parameter_coding) or 1) / 10.0
        self.motor.decel_s = max(1, decode_steps(self.memory[DECEL_TIME], self.parameter_coding) or 1) / 10.0
        super().elapse(dt)

    def handle_request(self, message: Any, codec: Codec) -> Any:
        match message:
            case dzb100.Dzb100Control():
                return self._control(message)
            case dzb100.Dzb100ReadParameter():
                return self._read(message)
            case dzb100.Dzb100Query():
                return self._query(message)
            case dzb100.Dzb100WriteParameter():
                return self._write(message)
        return None

    def _control(self, request: dzb100.Dzb100Control) -> Any:
        """Reply with B as 06 (example 1) or as the state digit (text): neither proves that the motor turns."""
        self._execute(int(request.command), request.data)
        accepted, digit = (True, None) if self.b_digit == "06" else (None, self.command)
        return dzb100.Dzb100Reply(
            head="C",
            address=self.address,
            index=int(request.command),
            data=request.data,
            accepted=accepted,
            digit=digit,
        )

    def _execute(self, command: int, word: int) -> None:
        if self.memory[COMMAND_SOURCE] != COMMANDS_FROM_BUS:
            return
        self.command = command
        if self.memory[FREQUENCY_SOURCE] == FREQUENCY_FROM_BUS:
            self._take_setpoint(word)
        if command in (0, 2):
            self.motor.stop()
        elif command in (1, 3):
            self.jogging, self.reverse = False, command == 3
            self.run_towards(self.setpoint_hz)
        elif command in (4, 5, 6, 7) and (self.jogging or not self.running):
            self.jogging = True
            hz = (decode_steps(self.memory[JOG_HZ], self.parameter_coding) or 0) / _STEPS_PER_HZ[self.parameter_coding]
            self.motor.run(-hz if command >= 6 else hz)
        elif command == 8:
            self.motor.reset()

    def _take_setpoint(self, word: int) -> None:
        """Take the frequency of a control frame; a word that can't be one is ignored."""
        steps = decode_steps(word, self.setpoint_coding)
        if steps is not None and steps <= MAX_SETPOINT_WORD:
            self.setpoint_hz = steps / _STEPS_PER_HZ[self.setpoint_coding]

    def _read(self, request: dzb100.Dzb100ReadParameter) -> Any:
        known = self.memory.read_rejection(request.parameter) is None
        data = self.memory[request.parameter] if known else 0
        return dzb100.Dzb100Reply(head="R", address=self.address, index=request.parameter, data=data, accepted=known)

    def _write(self, request: dzb100.Dzb100WriteParameter) -> Any:
        refused = self.memory.write_rejection(request.parameter, request.data, running=self.running) is not None
        if not refused:
            self.memory.write(request.parameter, request.data, save=True)
        return dzb100.Dzb100Reply(
            head="P", address=self.address, index=request.parameter, data=request.data, accepted=not refused
        )

    def _query(self, request: dzb100.Dzb100Query) -> Any:
        """Reply to a query of X0-X3; only the low digit counts."""
        word = self.query_word(request.item % 10)
        return dzb100.Dzb100Reply(
            head="Q", address=self.address, index=request.item, data=word or 0, accepted=word is not None
        )

    def query_word(self, item: int) -> int | None:
        """Return the word of Q00-Q03; None for an item that does not exist."""
        motor, steps = self.displayed_motor, _STEPS_PER_HZ[self.query_coding]
        match item:
            case 0:
                return encode_steps(round(self.setpoint_hz * steps), self.query_coding)
            case 1:
                return encode_steps(round(abs(motor.output_hz) * steps), self.query_coding)
            case 2:
                return encode_steps(round(motor.current_a * 10), self.query_coding)
            case 3:
                return self._state_word(motor)
        return None

    def _state_word(self, motor: Motor) -> int:
        """Return A the last command, B the simulator's own bits (running, reverse), CD the fault code."""
        bits = int(motor.energised) | int(motor.output_hz < 0.0) << 1
        code = self.trip_code(motor.trip) if motor.trip else 0
        return self.command << 12 | bits << 8 | (int(str(code), 16) if self.fault_coding == "decimal" else code)

    def set_ramps(self, accel_s: float, decel_s: float) -> None:
        """Set both ramp times at the keypad, in 0.1 s and in this drive's parameter coding."""
        for key, seconds in zip(self.ramp_keys, (accel_s, decel_s), strict=True):
            self.keypad_set(key, encode_steps(max(1, round(seconds * 10)), self.parameter_coding))

    def trip_code(self, trip: Trip) -> int:
        return FAULT_CODES[trip]


_CODINGS = ("hex-0.1", "hex-0.01", "decimal-0.1", "hex-1")
MODELS = {
    "dzb100": SimulatedModel(
        station=DZB100Station,
        addresses=range(32),
        options={
            "setpoint_coding": _CODINGS,
            "query_coding": _CODINGS,
            "parameter_coding": _CODINGS,
            "b_digit": ("06", "state"),
            "fault_coding": ("decimal", "hex"),
        },
    )
}
