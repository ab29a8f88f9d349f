"""The DZB100's dialect: 11-byte frames without a checksum, a state that is derived, and the tenfold trap (T08).

Nothing on the wire detects a flipped bit, so every value that drives logic needs two agreeing readings.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from drivebus.drives.book import Book, Facts
from drivebus.drives.dialect import (
    Frame,
    Refusal,
    Stop,
    parameter_reading,
    period_of,
    plausible,
    reading_of,
    shows,
    signals_in,
    whole_request,
)
from drivebus.drives.dzb_coding import CAP_HZ, CODINGS, DEFAULT_CODING, candidates, cap_word, within_cap
from drivebus.drives.state import Direction, DriveState, Verdict
from drivebus.errors import CapabilityError, GateError, LimitError, ProtocolError
from drivebus.message import Codec, Effect, StationLink, StationTiming, WriteClass
from drivebus.profiles.model import DriveProfile, Parameter, Signal
from drivebus.protocols.dzb import (
    Command,
    Control,
    DzbCodec,
    FrequencyCoding,
    Query,
    ReadParameter,
    Reply,
    StateWord,
    WriteParameter,
    decode_frequency,
    encode_frequency,
)
from drivebus.reading import Quality, Reading, missing

FREQUENCY_QUERIES = (0, 1)
STATE_QUERY = 3
STOP_DIGITS = frozenset({Command.STOP, Command.STOP_2})
PARAMETERS = 81
"""00 to 80."""


class DzbDialect:
    """DZB100 (see ``dialect.Dialect``)."""

    can_tell = True
    state_names: tuple[str, ...] = ("output_frequency", "fault")
    carries_frequency = True

    def __init__(
        self, profile: DriveProfile, address: int, encoding: str, settings: dict[str, Any], timing: StationTiming
    ) -> None:
        self.profile, self.address, self.settings = profile, address, settings
        self.codec: Codec = DzbCodec()
        self._signals = signals_in(profile, "query")
        self._count = 0
        self._last_read: ReadParameter | None = None
        self.link = StationLink(address, self.codec, timing, self.effect, self._bus_fence, profile.model)

    def effect(self, frame: bytes) -> Effect:
        """What these bytes do; a stop with a frequency, an unknown number or a frame that is none may move (T11)."""
        heard = whole_request(self.codec, frame)
        return Effect.MOTION if heard is None else _effect(heard)

    def _bus_fence(self, n: int) -> ReadParameter:
        request = ReadParameter(self.address, 2 * n % (PARAMETERS + 1))
        return request if request != self._last_read else self._bus_fence(n + 1)

    def fence(self, avoid: Any = None) -> ReadParameter:
        """Odd numbers; the bus uses the even ones. 40 tags at two frames each outlast the longest lateness."""
        self._count += 1
        request = ReadParameter(self.address, (2 * self._count + 1) % (PARAMETERS - 1))
        return self.fence(None) if request == avoid else request

    def proves(self, reply: Reply) -> bool:
        return True

    def clashes(self, request: Any) -> bool:
        return False

    def state_reads(self) -> tuple[Any, ...]:
        """Output frequency and the state word; two rounds of them put a different item between equal ones."""
        return Query(self.address, 1), Query(self.address, STATE_QUERY)

    def polls(self, names: tuple[str, ...]) -> tuple[tuple[Any, float], ...]:
        wanted = {self.profile.signals[n].locator[1] for n in names if n in self.profile.signals}
        items = sorted(wanted | {1, STATE_QUERY})
        return tuple((Query(self.address, item), self._period(item)) for item in items)

    def query(self, item: int) -> Query:
        """The query of an item, for proofs."""
        return Query(self.address, item)

    def _period(self, item: int) -> float:
        return period_of(self.profile, tuple(s.name for s in self._signals.get(item, [])))

    def facts(self, request: Any, reply: Reply, at: float | None) -> Facts:
        if not isinstance(request, Query):
            return {}
        signals = self._signals.get(request.item, [])
        if reply.accepted is not True:
            return {signal.name: missing("drives.refused_read", signal.unit) for signal in signals}
        if request.item == STATE_QUERY:
            return self._state_facts(reply.data, at)
        return {signal.name: self._reading(signal, request.item, reply.data, at) for signal in signals}

    def _state_facts(self, data: int, at: float | None) -> Facts:
        try:
            word = StateWord.parse(data, self.settings.get("fault_coding", "decimal"))
        except ProtocolError:
            return {"fault": Reading(None, "", Quality.BAD, at, "drives.not_documented", data)}
        return {
            "state": Reading(data, "", Quality.UNCERTAIN, at, "drives.bits_not_published", data),
            "command": Reading(word.command, "", Quality.GOOD, at, None, word.command),
            "fault": Reading(word.fault_code, "", Quality.GOOD, at, None, word.fault_code),
        }

    def _reading(self, signal: Signal, item: int, data: int, at: float | None) -> Reading:
        coding = self.settings.get("query_coding", "unknown")
        settled = coding in CODINGS
        if item not in FREQUENCY_QUERIES and coding != "decimal-0.1":
            return reading_of(signal, data, at)
        try:
            value = decode_frequency(data, coding if settled else DEFAULT_CODING)
        except ValueError:
            return Reading(None, signal.unit, Quality.BAD, at, "drives.not_decimal", data)
        reading = plausible(signal, Reading(value, signal.unit, Quality.GOOD, at, None, data))
        return reading if settled else replace(reading, quality=Quality.UNCERTAIN, reason="drives.coding_unsettled")

    def judge(self, book: Book) -> Verdict | None:
        """Q01 > 0 twice is turning; a fault is a fault; stopped only when Q01 reads 0 twice; else not decided."""
        output, code = book.raw_pair("output_frequency"), book.agreed("fault")
        if output is None or code is None or (output[0] > 0) is not (output[1] > 0):
            return None
        fault = code or None
        if output[1] > 0:
            return Verdict(DriveState.RUNNING, None, fault)
        return Verdict(DriveState.FAULT if fault else DriveState.STOPPED, None, fault)

    def plain_read(self) -> Any:
        return Query(self.address, 1)

    def fault_reads(self) -> tuple[Any, ...]:
        return ()

    def setpoint_reads(self) -> tuple[Any, ...]:
        return (Query(self.address, 0),)

    def setpoint_shown(self, book: Book, word: int, frequency_hz: float) -> bool | None:
        """By value where both codings are settled; else by the word: it proves that it was taken, not what it means."""
        raw = book.agreed("set_frequency")
        if raw is None:
            return None
        if self.can_wait() and len(candidates(self.settings)) == 1:
            return shows(book, self.profile, frequency_hz)
        return True if raw == word else None

    def can_wait(self) -> bool:
        """The output frequency means something only once the query coding is settled."""
        return self.settings.get("query_coding", "unknown") in CODINGS

    def stop_seen(self, book: Book) -> bool:
        """Q03's A echoes the last command: stop, twice (RELIABILITY 6.4)."""
        return book.agreed("command") in STOP_DIGITS

    def start_seen(self, book: Book) -> bool:
        """Also where it stands by now: then somebody has stopped it at the keypad (ruling 6)."""
        return book.agreed("command") in (Command.FORWARD, Command.REVERSE)

    def refusal(self, reply: Reply) -> Refusal | None:
        return Refusal("drives.dzb_refused", 7) if reply.accepted is False else None

    def setpoint_word(self, frequency_hz: float) -> int:
        codings, coding = candidates(self.settings), self._setpoint_coding()
        try:
            word = encode_frequency(frequency_hz, coding)
        except ValueError as error:
            raise LimitError("drives.no_word", frequency_hz=frequency_hz, step_hz=coding) from error
        if len(codings) > 1 and not within_cap(word, codings):
            cap = cap_word(codings)
            raise LimitError(
                "drives.coding_cap", frequency_hz=frequency_hz, word=f"{word:04X}H", cap=f"{cap:04X}H", limit_hz=CAP_HZ
            )
        return word

    def frequency_of(self, word: int) -> float:
        return decode_frequency(word, self._setpoint_coding())

    def _setpoint_coding(self) -> FrequencyCoding:
        """The settled coding; hex-0.1 until then."""
        codings = candidates(self.settings)
        return codings[0] if len(codings) == 1 else DEFAULT_CODING

    def start(self, direction: Direction | None, word: int) -> tuple[Frame, ...]:
        return self._control(Command.REVERSE if direction is Direction.REVERSE else Command.FORWARD, word)

    def set_frequency(self, word: int, book: Book) -> tuple[Frame, ...]:
        """The frequency is part of the run command: only a drive that runs as it was told can take it."""
        command = book.agreed("command")
        if command not in (Command.FORWARD, Command.REVERSE):
            raise GateError("drives.frequency_with_run", model=self.profile.model)
        return self._control(Command(command), word)

    def jog(self, direction: Direction, word: int | None) -> tuple[Frame, ...]:
        if word is None:
            raise CapabilityError("drives.jog_needs_frequency", model=self.profile.model)
        return self._control(Command.JOG_REVERSE if direction is Direction.REVERSE else Command.JOG_FORWARD, word)

    def _control(self, command: Command, word: int = 0) -> tuple[Frame, ...]:
        return (Frame(Control(self.address, command, word), WriteClass.EDGE),)

    def stop(self, how: Stop) -> tuple[Any, ...]:
        """STOP always carries 0000, so that a flipped bit commands 0 Hz (T11)."""
        if how not in (Stop.STOP, Stop.JOG_STOP):
            raise CapabilityError("drives.cannot", model=self.profile.model, what=how.value)
        return (Control(self.address, Command.STOP, 0),)

    def stop_everyone(self) -> tuple[Any, ...]:
        return (Control(self.profile.broadcast or 0, Command.STOP, 0, everyone=True),)

    def reset(self) -> tuple[Frame, ...]:
        return self._control(Command.RESET)

    def read_parameter(self, parameter: Parameter) -> Any:
        space, index = parameter.locator
        return Query(self.address, index) if space == "query" else ReadParameter(self.address, index)

    def parameter_raw(self, reply: Reply) -> int | None:
        return reply.data if reply.accepted is True else None

    def _parameter(self, parameter: Parameter) -> Parameter:
        """The parameter under the coding of parameters: whole numbers are the same in all of them."""
        scale, coding = parameter.scale, self.settings.get("parameter_coding", "unknown")
        if scale.factor >= 1.0 or coding not in CODINGS or coding == DEFAULT_CODING:
            return parameter
        if coding == "decimal-0.1":
            return replace(parameter, scale=replace(scale, coding="bcd"))
        times = 0.1 if coding == "hex-0.01" else 10.0
        return replace(parameter, scale=replace(scale, factor=scale.factor * times))

    def parameter_reading(self, parameter: Parameter, raw: int, at: float | None) -> Reading:
        reading = parameter_reading(self._parameter(parameter), raw, at)
        settled = self.settings.get("parameter_coding", "unknown") in CODINGS or parameter.scale.factor >= 1.0
        return reading if settled else replace(reading, quality=Quality.UNCERTAIN, reason="drives.coding_unsettled")

    def parameter_word(self, parameter: Parameter, value: float) -> int:
        return self._parameter(parameter).scale.raw(value)

    def write_parameter(self, parameter: Parameter, raw: int, save: bool) -> Frame:
        return Frame(WriteParameter(self.address, parameter.locator[1], raw), WriteClass.EEPROM)

    def lawful(self, frame: bytes) -> bool:
        """Every frame that the codec reads is in the manual's tables; numbers beyond them are not (I7)."""
        request = whole_request(self.codec, frame)
        return request is not None and (not isinstance(request, WriteParameter) or request.parameter < PARAMETERS)

    def settle(self, setting: str, value: Any) -> None:
        self.settings[setting] = value

    def noted(self, request: Any) -> None:
        """The last parameter read, so that the bus's next fence is not like it."""
        if isinstance(request, ReadParameter):
            self._last_read = request


def _effect(request: Any) -> Effect:
    if isinstance(request, (ReadParameter, Query)):
        return Effect.NONE
    if isinstance(request, WriteParameter):
        return Effect.SETTING if request.parameter < PARAMETERS else Effect.MOTION
    if not isinstance(request, Control):
        return Effect.MOTION
    digit = int(request.command) % 10
    if digit in STOP_DIGITS and request.data == 0:
        return Effect.STOP
    return Effect.SETTING if digit == Command.RESET and request.data == 0 else Effect.MOTION
