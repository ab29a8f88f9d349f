"""Dialect of the DZB100: 11-byte frames without checksum, a derived state, undocumented frequency codings.

No check on the wire detects a flipped bit, so every value that drives logic needs two agreeing readings. Four codings
of frequencies are possible, which differ by a factor of ten: until one is determined, ``UNCALIBRATED_CAP_HZ`` holds.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

from drivebus.bus.messages import RetryPolicy
from drivebus.drives.dialects.base import (
    CommandFrame,
    Dialect,
    Rejection,
    StopMode,
    decode_whole_request,
    parameter_reading,
    setpoint_matches,
    shortest_period_s,
    signal_reading,
    signals_by_index,
    with_plausibility,
)
from drivebus.drives.dialects.setpoint_step import UNCALIBRATED_CAP_HZ
from drivebus.drives.readings import ReadingPairs, Readings
from drivebus.drives.state import DerivedState, Direction, DriveState
from drivebus.errors import CapabilityError, LimitError, ProtocolError, StartInhibited
from drivebus.profiles.model import DriveProfile, Parameter, Signal
from drivebus.protocols.codec import Codec
from drivebus.protocols.dzb100 import (
    FREQUENCY_CODINGS,
    LAST_PARAMETER,
    Dzb100Codec,
    Dzb100Command,
    Dzb100Control,
    Dzb100Query,
    Dzb100ReadParameter,
    Dzb100Reply,
    Dzb100WriteParameter,
    FrequencyCoding,
    StateWord,
    decode_frequency,
    encode_frequency,
    frame_effect,
)
from drivebus.serial_settings import StationTiming
from drivebus.values import Quality, Reading, missing_reading

DEFAULT_CODING = FREQUENCY_CODINGS[0]
MAX_SETPOINT_WORD = 4000  # setpoints are 0000 to 4000 (manual 2 (5))


def possible_codings(options: dict[str, Any]) -> tuple[FrequencyCoding, ...]:
    """Return the setpoint codings that are not excluded; one where it is determined."""
    coding = options.get("setpoint_coding", "unknown")
    return (coding,) if coding in FREQUENCY_CODINGS else FREQUENCY_CODINGS


def is_within_cap(word: int, codings: tuple[FrequencyCoding, ...]) -> bool:
    """Return whether every coding decodes this word as at most 5 Hz."""
    try:
        return all(decode_frequency(word, coding) <= UNCALIBRATED_CAP_HZ for coding in codings)
    except ValueError:
        return False


def decode_or_none(word: int, coding: str) -> float | None:
    """Return a word in Hz; None where the coding can't decode it."""
    known = next((c for c in FREQUENCY_CODINGS if c == coding), None)
    try:
        return None if known is None else decode_frequency(word, known)
    except ValueError:
        return None


@cache  # tries up to 4,000 words, and each status of a drive asks for its cap
def highest_safe_word(codings: tuple[FrequencyCoding, ...]) -> int:
    """Return the largest raw word that every coding decodes as at most 5 Hz."""
    return max(word for word in range(MAX_SETPOINT_WORD + 1) if is_within_cap(word, codings))


FREQUENCY_ITEMS = (0, 1)
STATE_ITEM = 3
PARAMETER_COUNT = LAST_PARAMETER + 1


class Dzb100Dialect(Dialect):
    """Dialect of one DZB100."""

    reports_run_state = True
    state_names: tuple[str, ...] = ("output_frequency", "fault")
    start_includes_setpoint = True

    def __init__(
        self, profile: DriveProfile, address: int, encoding: str, options: dict[str, Any], timing: StationTiming
    ) -> None:
        super().__init__(profile, address, options)
        self.codec: Codec = Dzb100Codec()
        self._signals = signals_by_index(profile, "query")
        self._sync_count = 0
        self._last_read: Dzb100ReadParameter | None = None
        self.station_config = self._make_station_config(timing, frame_effect)

    def _bus_sync_request(self, n: int) -> Dzb100ReadParameter:
        request = Dzb100ReadParameter(self.address, 2 * n % (PARAMETER_COUNT + 1))
        return request if request != self._last_read else self._bus_sync_request(n + 1)

    def sync_request(self, avoid: Any = None) -> Dzb100ReadParameter:
        """Return a read of an odd parameter; the bus uses the even ones.

        About 40 of them are sent before one comes again: longer than the latest reply may take.
        """
        self._sync_count += 1
        request = Dzb100ReadParameter(self.address, (2 * self._sync_count + 1) % (PARAMETER_COUNT - 1))
        return self.sync_request(None) if request == avoid else request

    def is_valid_sync_reply(self, reply: Dzb100Reply) -> bool:
        return True

    def needs_sync(self, request: Any) -> bool:
        return False

    def state_reads(self) -> tuple[Any, ...]:
        """Return output frequency and state word: in two rounds each item is read after the other one."""
        return Dzb100Query(self.address, 1), Dzb100Query(self.address, STATE_ITEM)

    def polls(self, names: tuple[str, ...]) -> tuple[tuple[Any, float], ...]:
        signal_items = {self.profile.signals[n].locator[1] for n in names if n in self.profile.signals}
        items = sorted(signal_items | {1, STATE_ITEM})
        return tuple(
            (Dzb100Query(self.address, item), shortest_period_s(self.profile, self._signals.get(item, ())))
            for item in items
        )

    def query(self, item: int) -> Dzb100Query:
        """Return the query of an item."""
        return Dzb100Query(self.address, item)

    def decode_readings(self, request: Any, reply: Dzb100Reply, at: float | None) -> Readings:
        if not isinstance(request, Dzb100Query):
            return {}
        signals = self._signals.get(request.item, [])
        if reply.accepted is not True:
            names = {signal.name: signal.unit for signal in signals} | (
                {"fault": ""} if request.item == STATE_ITEM else {}
            )
            return {name: missing_reading("drives.read_refused", unit) for name, unit in names.items()}
        if request.item == STATE_ITEM:
            return self._state_readings(reply.data, at)
        return {signal.name: self._reading(signal, request.item, reply.data, at) for signal in signals}

    def _state_readings(self, data: int, at: float | None) -> Readings:
        try:
            word = StateWord.parse(data, self.options.get("fault_coding", "decimal"))
        except ProtocolError:
            unlisted = Reading(
                value=data, unit="", quality=Quality.BAD, source_time=at, reason="drives.not_documented", raw=data
            )
            return {"state": unlisted, "fault": unlisted}
        return {
            "state": Reading(
                value=data,
                unit="",
                quality=Quality.UNCERTAIN,
                source_time=at,
                reason="drives.bits_not_published",
                raw=data,
            ),
            "command": Reading(
                value=word.command, unit="", quality=Quality.GOOD, source_time=at, reason=None, raw=word.command
            ),
            "fault": Reading(
                value=word.fault_code, unit="", quality=Quality.GOOD, source_time=at, reason=None, raw=word.fault_code
            ),
        }

    def _reading(self, signal: Signal, item: int, data: int, at: float | None) -> Reading:
        """Return a reading by the query coding; uncertain until that is determined, the current too."""
        coding = self.options.get("query_coding", "unknown")
        reading = self._decoded_reading(signal, item, data, at)
        if coding in FREQUENCY_CODINGS or reading.quality is Quality.BAD:
            return reading
        return replace(reading, quality=Quality.UNCERTAIN, reason="drives.coding_undetermined")

    def _decoded_reading(self, signal: Signal, item: int, data: int, at: float | None) -> Reading:
        coding = self.options.get("query_coding", "unknown")
        if item not in FREQUENCY_ITEMS and coding != "decimal-0.1":
            return signal_reading(signal, data, at)
        try:
            value = decode_frequency(data, coding if coding in FREQUENCY_CODINGS else DEFAULT_CODING)
        except ValueError:
            return Reading(
                value=None, unit=signal.unit, quality=Quality.BAD, source_time=at, reason="drives.not_decimal", raw=data
            )
        return with_plausibility(
            signal, Reading(value=value, unit=signal.unit, quality=Quality.GOOD, source_time=at, reason=None, raw=data)
        )

    def derive_state(self, readings: ReadingPairs) -> DerivedState | None:
        """Return running where Q01 is above 0 twice, stopped or in fault where it is 0 twice, else None."""
        output, code = readings.raw_pair("output_frequency"), readings.agreed_raw("fault")
        if output is None or code is None or (output[0] > 0) is not (output[1] > 0):
            return None
        fault = code or None
        if output[1] > 0:
            return DerivedState(DriveState.RUNNING, None, fault)
        return DerivedState(DriveState.FAULT if fault else DriveState.STOPPED, None, fault)

    def echo_test_read(self) -> Any:
        return Dzb100Query(self.address, 1)

    def setpoint_reads(self) -> tuple[Any, ...]:
        return (Dzb100Query(self.address, 0),)

    def setpoint_matches(self, readings: ReadingPairs, word: int, frequency_hz: float) -> bool | None:
        """Compare by value where both codings are determined, else by word, which shows only acceptance."""
        raw = readings.agreed_raw("set_frequency")
        if raw is None:
            return None
        if self.can_confirm_speed() and len(possible_codings(self.options)) == 1:
            return setpoint_matches(readings, self.profile, frequency_hz)
        return True if raw == word else None

    def can_confirm_speed(self) -> bool:
        """Return whether the query coding is determined."""
        return self.options.get("query_coding", "unknown") in FREQUENCY_CODINGS

    def confirms_stop(self, readings: ReadingPairs) -> bool:
        """Return whether Q03's A is a stop: it is taken for the last command executed, its source is undocumented."""
        return readings.agreed_raw("command") in (Dzb100Command.STOP, Dzb100Command.STOP_2)

    def confirms_start(self, readings: ReadingPairs) -> bool:
        """Return whether Q03's A is a start, also where the drive stands by now, stopped at its keypad."""
        return readings.agreed_raw("command") in (Dzb100Command.FORWARD, Dzb100Command.REVERSE)

    def rejection(self, reply: Dzb100Reply) -> Rejection | None:
        return Rejection("drives.dzb100_rejected", 7) if reply.accepted is False else None

    def setpoint_word(self, frequency_hz: float) -> int:
        codings, coding = possible_codings(self.options), self._setpoint_coding()
        try:
            word = encode_frequency(frequency_hz, coding)
        except ValueError as error:
            raise LimitError("drives.no_word", frequency_hz=frequency_hz, step_hz=coding) from error
        if len(codings) > 1 and not is_within_cap(word, codings):
            cap = highest_safe_word(codings)
            raise LimitError(
                "drives.coding_cap",
                frequency_hz=frequency_hz,
                word=f"{word:04X}H",
                cap=f"{cap:04X}H",
                limit_hz=UNCALIBRATED_CAP_HZ,
            )
        return word

    @property
    def setpoint_cap_hz(self) -> float | None:
        codings = possible_codings(self.options)
        return None if len(codings) == 1 else self.setpoint_frequency(highest_safe_word(codings))

    def setpoint_frequency(self, word: int) -> float:
        return decode_frequency(word, self._setpoint_coding())

    def _setpoint_coding(self) -> FrequencyCoding:
        """Return the determined coding, hex-0.1 until then."""
        codings = possible_codings(self.options)
        return codings[0] if len(codings) == 1 else DEFAULT_CODING

    def start(self, direction: Direction | None, word: int) -> tuple[CommandFrame, ...]:
        return self._control_frame(
            Dzb100Command.REVERSE if direction is Direction.REVERSE else Dzb100Command.FORWARD, word
        )

    def set_frequency(self, word: int, readings: ReadingPairs) -> tuple[CommandFrame, ...]:
        """Repeat the run command that the drive reports, which carries the frequency. Raises StartInhibited without."""
        command = readings.agreed_raw("command")
        if command not in (Dzb100Command.FORWARD, Dzb100Command.REVERSE):
            raise StartInhibited("drives.frequency_with_run", model=self.profile.model)
        return self._control_frame(Dzb100Command(command), word)

    def jog(self, direction: Direction, word: int | None) -> tuple[CommandFrame, ...]:
        if word is None:
            raise CapabilityError("drives.jog_needs_frequency", model=self.profile.model)
        return self._control_frame(
            Dzb100Command.JOG_REVERSE if direction is Direction.REVERSE else Dzb100Command.JOG_FORWARD, word
        )

    def _control_frame(self, command: Dzb100Command, word: int = 0) -> tuple[CommandFrame, ...]:
        return (CommandFrame(Dzb100Control(self.address, command, word), RetryPolicy.EDGE_TRIGGERED),)

    def stop(self, mode: StopMode) -> tuple[Any, ...]:
        """Send 0000 with every stop, so that a flipped bit commands 0 Hz."""
        if mode not in (StopMode.STOP, StopMode.JOG_STOP):
            raise CapabilityError("drives.cannot", model=self.profile.model, what=mode.value)
        return (Dzb100Control(self.address, Dzb100Command.STOP, 0),)

    def broadcast_stop(self) -> tuple[Any, ...]:
        return (Dzb100Control(self.profile.broadcast or 0, Dzb100Command.STOP, 0, broadcast=True),)

    def reset(self) -> tuple[CommandFrame, ...]:
        return self._control_frame(Dzb100Command.RESET)

    def read_parameter(self, parameter: Parameter) -> Any:
        space, index = parameter.locator
        return Dzb100Query(self.address, index) if space == "query" else Dzb100ReadParameter(self.address, index)

    def parameter_raw(self, reply: Dzb100Reply) -> int | None:
        return reply.data if reply.accepted is True else None

    def _scaled_parameter(self, parameter: Parameter) -> Parameter:
        """Return the parameter under the coding of parameters; whole numbers are the same in all codings."""
        scale, coding = parameter.scale, self.options.get("parameter_coding", "unknown")
        if scale.factor >= 1.0 or coding not in FREQUENCY_CODINGS or coding == DEFAULT_CODING:
            return parameter
        if coding == "decimal-0.1":
            return replace(parameter, scale=replace(scale, coding="bcd"))
        times = 0.1 if coding == "hex-0.01" else 10.0
        return replace(parameter, scale=replace(scale, factor=scale.factor * times))

    def names_parameter(self, reply: Dzb100Reply) -> bool:
        return True

    def parameter_reading(self, parameter: Parameter, raw: int, at: float | None) -> Reading:
        reading = parameter_reading(self._scaled_parameter(parameter), raw, at)
        coding_known = self.options.get("parameter_coding", "unknown") in FREQUENCY_CODINGS
        if coding_known or parameter.scale.factor >= 1.0:
            return reading
        return replace(reading, quality=Quality.UNCERTAIN, reason="drives.coding_undetermined")

    def parameter_word(self, parameter: Parameter, value: float) -> int:
        return self._scaled_parameter(parameter).scale.raw(value)

    def write_parameter(self, parameter: Parameter, raw: int, *, save: bool) -> CommandFrame:
        return CommandFrame(Dzb100WriteParameter(self.address, parameter.locator[1], raw), RetryPolicy.EEPROM)

    def is_allowed(self, frame: bytes) -> bool:
        """Allow every frame that the codec decodes, up to the last parameter number."""
        request = decode_whole_request(self.codec, frame)
        return request is not None and (
            not isinstance(request, Dzb100WriteParameter) or request.parameter < PARAMETER_COUNT
        )

    def on_sent(self, request: Any) -> None:
        """Remember the last parameter read, so that the next sync probe of the bus differs from it."""
        if isinstance(request, Dzb100ReadParameter):
            self._last_read = request
