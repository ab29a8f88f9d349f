"""Dialect of Modbus drives: VC660, DF800 and every inverter that a profile describes.

The effect of a frame follows from its bytes and the profile's command map; what the map does not name is never sent.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from drivebus.bus.messages import RetryPolicy
from drivebus.drives.dialects.base import (
    DEFAULT_NONCE_START,
    DEFAULT_POLL_PERIOD_S,
    CommandFrame,
    Dialect,
    Hold,
    Identity,
    Rejection,
    StopMode,
    setpoint_matches,
    signal_reading,
)
from drivebus.drives.dialects.command_word import CommandWord, make_command_word
from drivebus.drives.dialects.modbus_reads import (
    ReadRequest,
    Span,
    join_words,
    merge_reads,
    reply_values,
    request_span,
    span_of,
    span_value,
    status_span,
    sync_spans,
    whole_span,
)
from drivebus.drives.dialects.modbus_writes import (
    CommandWrite,
    ModbusWrites,
    ParameterWrite,
    RecognizedWrite,
    UnlockWrite,
)
from drivebus.drives.dialects.setpoint_share import setpoint_scale
from drivebus.drives.dialects.status_word import derive_state, is_valid_status, state_names, status_state
from drivebus.drives.readings import ReadingPairs, Readings
from drivebus.drives.state import DerivedState, Direction, DriveState
from drivebus.errors import CapabilityError, ProtocolError, StartInhibited
from drivebus.profiles.model import DriveProfile, Parameter, Signal
from drivebus.profiles.words import CommandMap, StatusMap
from drivebus.protocols.codec import Codec, Effect
from drivebus.protocols.family import Locator
from drivebus.protocols.modbus import (
    BitValues,
    Diagnostics,
    DiagnosticsReply,
    ExceptionReply,
    ModbusAsciiCodec,
    ModbusRtuCodec,
    ReadBits,
    ReadRegisters,
    RegisterValues,
    registers_written,
    request_writes,
)
from drivebus.serial_settings import StationTiming
from drivebus.values import Quality, Reading, missing_reading

RTU_END_SILENCE_CHARACTERS = 3.5
"""Characters (Modbus over serial line 2.5.1.1); at 300 baud 117 ms, more than VC660's whole reply delay."""
_EXECUTION_UNKNOWN_CODES = frozenset({5, 11})
"""Exceptions of a request that is or may be executed: acknowledge; a gateway without reply of the drive."""
_STANDARD_CODES = frozenset({1, 2, 3, 4})
"""Exceptions with the meaning of the Modbus application protocol 7; above, the meaning differs between makers."""
LOOPBACK_NONCE_STEP = 0x9E37
"""An odd step visits all 65,536 nonces before one comes again."""


class ModbusDialect(Dialect):
    """Dialect of one Modbus drive."""

    def __init__(
        self,
        profile: DriveProfile,
        address: int,
        encoding: str,
        options: dict[str, Any],
        timing: StationTiming,
        nonce_start: int = DEFAULT_NONCE_START,
    ) -> None:
        """``nonce_start``: first number of the loop-backs that serve as sync probes."""
        super().__init__(profile, address, options)
        self._nonce_start = nonce_start
        self._features = profile.modbus_features
        error_form, max_read = self._features.error_form, self._features.max_read
        ascii_codec = ModbusAsciiCodec(error_form, max_read, tolerate_leading_noise=timing.tolerate_leading_noise)
        rtu_codec = ModbusRtuCodec(
            error_form,
            max_read,
            count_bytes=self._features.reply_count_bytes,
            rejected_read=self._features.rejected_read or 0,
        )
        self.codec: Codec = ascii_codec if encoding == "ascii" else rtu_codec
        self.status_map: StatusMap | None = profile.status
        self.command_word = self._make_command_word()
        self._writes = ModbusWrites(address, profile, self._commands)
        self._sync_spans = () if self._features.loopback or self._features.rejected_read else sync_spans(profile)
        self._sync_span = self._sync_spans[0] if self._sync_spans else None
        self._signals = _signals_by_locator(profile)
        self._status_span = status_span(profile.status) if profile.status else None
        self._identity_span = _identity_span(profile)
        self._sync_count = 0
        self._needs_model_check = profile.needs_model_check
        self._is_status_shown = False
        status = profile.status
        self._fault_names = tuple(f"fault_{place}" for place in range(len(status.fault_registers) if status else 0))
        output = profile.signals.get("output_frequency")
        self._output_step_hz = output.scale.factor if output is not None else 0.0
        self.state_names = state_names(status, self._fault_names) if status else ("state",)
        self.station_config = self._make_station_config(
            _with_end_silence(timing, encoding),
            self.effect,
            longest_requests=tuple(request for request, _ in self.polls(tuple(profile.signals))),
        )

    @property
    def reports_run_state(self) -> bool:
        """Whether the profile names a status register; DF800 has none, and a state is never guessed."""
        return self.status_map is not None

    start_includes_setpoint = False

    @property
    def _commands(self) -> CommandMap | None:
        """The command map under the options in force."""
        return self.profile.commands.resolved(self.options) if self.profile.commands else None

    def _make_command_word(self) -> CommandWord | None:
        commands = self._commands
        return make_command_word(commands) if commands else None

    def effect(self, frame: bytes) -> Effect:
        """Return the effect of a frame; no valid request, or a register outside the tables, may move the motor."""
        try:
            writes = self._writes.recognize(registers_written(frame, self.codec.encoding))
        except (ProtocolError, KeyError):
            return Effect.MOTION
        if writes is None:
            return Effect.MOTION
        effects = {self._effect_of(write) for write in writes}
        if not effects:
            return Effect.NONE
        return effects.pop() if len(effects) == 1 else Effect.MOTION

    def _effect_of(self, write: RecognizedWrite) -> Effect:
        match write:
            case CommandWrite(word=word):
                return self._require_command_word().effect(word)
            case UnlockWrite():  # it moves nothing, and a locked drive rejects a stop without it
                return Effect.STOP
            case ParameterWrite(parameter=parameter) if is_terminal_word(parameter):
                return Effect.MOTION
        return Effect.SETTING

    def is_allowed(self, frame: bytes) -> bool:
        """Return whether a request writes only registers of the profile's tables, with command words of mapped bits."""
        try:
            changes = registers_written(frame, self.codec.encoding)
        except (ProtocolError, KeyError):
            return False
        if changes and not self._is_addressed_here(frame):
            return False
        writes = self._writes.recognize(changes)
        return writes is not None and all(self._is_mapped(write) for write in writes)

    def _is_addressed_here(self, frame: bytes) -> bool:
        """Return whether a frame is for this drive alone: only a stop is ever broadcast, and it needs no permit."""
        address = int(frame[1:3], 16) if self.codec.encoding == "ascii" else frame[0]
        return address == self.address

    def _is_mapped(self, write: RecognizedWrite) -> bool:
        return not isinstance(write, CommandWrite) or self._require_command_word().is_mapped(write.word)

    def _bus_sync_request(self, n: int) -> Any:
        return self._sync_request_at(2 * n)

    def sync_request(self, avoid: Any = None) -> Any:
        self._sync_count += 1
        return self._sync_request_at(2 * self._sync_count + 1)

    def _sync_request_at(self, n: int) -> Any:
        if self._features.loopback:
            return Diagnostics(self.address, (self._nonce_start + n * LOOPBACK_NONCE_STEP) & 0xFFFF)
        if self._features.rejected_read:
            return self.echo_test_read()._replace(count=self._features.rejected_read)
        return self._sync_spans[n // 2 % len(self._sync_spans)].request(self.address)

    def is_valid_sync_reply(self, reply: Any) -> bool:
        """Accept a complete loop-back or a read with the count of a sync probe; an error echoes only its function.

        The codec accepts an error as the reply to a read that the drive rejects only with the code of no other read.
        """
        if self._features.rejected_read:
            return isinstance(reply, ExceptionReply)
        return isinstance(reply, (DiagnosticsReply, RegisterValues))

    def needs_sync(self, request: Any) -> bool:
        """Return True for a read, whose reply names neither register nor value."""
        return isinstance(request, ReadRegisters | ReadBits)

    def _forget_model(self) -> None:
        self._needs_model_check, self._is_status_shown = self.profile.needs_model_check, False

    def model_check(self) -> Any | None:
        """Return the read of the status before the first command: the stop of this model may start another one.

        Then that of the identity register, where another model has the same states at the same address.
        """
        if not self._needs_model_check:
            return None
        if self._identity_span is not None and self._is_status_shown:
            return self._read(self._identity_span)
        status = self._status_span
        if status is None:
            return self.echo_test_read()
        return next(read for read in self.state_reads() if request_span(read).covers(status))

    def state_reads(self) -> tuple[Any, ...]:
        if self.status_map is None:
            return ()
        names = ("set_frequency", "output_frequency", self.status_map.standstill_signal)
        requests = [request for request, _ in self.polls(tuple(name for name in names if name is not None))]
        status = self._status_span  # first: a frequency from before the word does not show that the drive stands
        return tuple(sorted(requests, key=lambda request: status is None or not request_span(request).covers(status)))

    def echo_test_read(self) -> Any:
        if self._status_span is not None:
            return self._read(self._status_span)
        entries: list[Signal | Parameter] = [*self.profile.signals.values()]
        entries += [p for p in self.profile.parameters.values() if p.readable]
        return self._read(span_of(entries[0]))

    def _read(self, span: Span) -> ReadRequest:
        """Return the read of a span, or of the block that has it and is read only as a whole."""
        return whole_span(span, self._features).request(self.address)

    def fault_reads(self) -> tuple[Any, ...]:
        """Return the reads that name the fault once the status word reports one."""
        registers = self.status_map.fault_registers if self.status_map else ()
        return tuple(
            request for request, _ in self._merged_reads({Span("holding", register): 1.0 for register in registers})
        )

    def polls(self, names: tuple[str, ...]) -> tuple[tuple[Any, float], ...]:
        """Merge signals of similar periods into one read where their registers touch."""
        periods: dict[Span, float] = {}
        if self.status_map is not None and self._status_span is not None:
            periods[self._status_span] = DEFAULT_POLL_PERIOD_S
            if not self.status_map.shows_fault:
                registers = self.status_map.fault_registers
                periods |= {Span("holding", register): DEFAULT_POLL_PERIOD_S for register in registers}
        for name in names:
            signal = self.profile.signals.get(name)
            if signal is not None:
                span = span_of(signal)
                periods[span] = min(periods.get(span, signal.period_s), signal.period_s)
        return self._merged_reads(periods)

    def _merged_reads(self, periods: dict[Span, float]) -> tuple[tuple[ReadRequest, float], ...]:
        merged = merge_reads(periods, self._features, self._sync_span)
        return tuple((span.request(self.address), period) for span, period in merged)

    def decode_readings(self, request: Any, reply: Any, at: float | None) -> Readings:
        if not isinstance(request, ReadRegisters | ReadBits):
            return {}
        read = request_span(request)
        if not isinstance(reply, RegisterValues | BitValues):
            return self._rejected_readings(read, self.read_rejection_key(reply))
        values = reply_values(request, reply)
        readings: dict[str, Reading] = {}
        for locator in values:
            for signal, span in self._signals.get(locator, ()):
                raw = span_value(span, values, self._features)
                if raw is not None:
                    readings[signal.name] = signal_reading(signal, raw, at)
        if self.status_map is not None and self._status_span is not None:
            readings |= self._status_readings(self.status_map, self._status_span, values, at)
        shows_status = self.status_map is None or ("state" in readings and readings["state"].quality is Quality.GOOD)
        self._is_status_shown = self._is_status_shown or shows_status
        identity = self._identity_span
        if self._is_status_shown and (identity is None or read.covers(identity)):
            self._needs_model_check = False
        return readings

    def _rejected_readings(self, read: Span, reason: str) -> Readings:
        signals = [entry for entry in self.profile.signals.values() if read.covers(span_of(entry))]
        readings = {signal.name: missing_reading(reason, signal.unit) for signal in signals}
        if self._status_span is not None and read.covers(self._status_span):
            readings["state"] = missing_reading(reason)
        if self.status_map is not None:
            for register, name in zip(self.status_map.fault_registers, self._fault_names, strict=True):
                if read.covers(Span("holding", register)):
                    readings[name] = missing_reading(reason)
        return readings

    def _status_readings(
        self, status: StatusMap, span: Span, values: Mapping[Locator, int], at: float | None
    ) -> Readings:
        readings: dict[str, Reading] = {}
        raw = span_value(span, values, self._features)
        if raw is not None:
            broken = not is_valid_status(status, raw)
            broken_reason = "drives.unlisted_state" if status.values else "drives.reserved_bits"
            quality, reason = (Quality.BAD, broken_reason) if broken else (Quality.GOOD, None)
            readings["state"] = Reading(value=raw, unit="", quality=quality, source_time=at, reason=reason, raw=raw)
            if not broken and self.command_word is not None:
                reverse, paused = (bool(raw & status.bits.get(name, 0)) for name in ("set_reverse", "paused"))
                paused = paused or status_state(status, raw) is DriveState.PAUSED  # a word that is a number
                self.command_word.learn_levels(reverse=reverse, paused=paused)
        for register, name in zip(status.fault_registers, self._fault_names, strict=True):
            word = values.get(("holding", register))
            if word is not None:
                readings[name] = Reading(
                    value=word, unit="", quality=Quality.GOOD, source_time=at, reason=None, raw=word
                )
        return readings

    def derive_state(self, readings: ReadingPairs) -> DerivedState | None:
        if self.status_map is None:
            return None
        return derive_state(self.status_map, readings, self._fault_names, self._output_step_hz)

    def setpoint_reads(self) -> tuple[Any, ...]:
        signal = self.profile.signals.get("set_frequency")
        return () if signal is None else (self._read(span_of(signal)),)

    def setpoint_matches(self, readings: ReadingPairs, word: int, frequency_hz: float) -> bool | None:
        return setpoint_matches(readings, self.profile, frequency_hz, self.options)

    def can_confirm_speed(self) -> bool:
        return self.reports_run_state and "output_frequency" in self.profile.signals

    def rejection(self, reply: Any) -> Rejection | None:
        if not isinstance(reply, ExceptionReply):
            return None
        if reply.code is None:
            return Rejection("drives.modbus_refused_short", None)
        may_be_executed = reply.code in _EXECUTION_UNKNOWN_CODES
        remedy = f"drives.modbus_remedy_{reply.code}" if reply.code in _STANDARD_CODES else None
        return Rejection(f"drives.modbus_exception_{reply.code}", reply.code, may_be_executed, remedy)

    def setpoint_frequency(self, word: int) -> float:
        return setpoint_scale(self.profile, self.options).value(word)

    def start(self, direction: Direction | None, word: int) -> tuple[CommandFrame, ...]:
        self._check_direction(direction)
        return self._command_frames(self._require_command_word().start(direction))

    def _check_direction(self, direction: Direction | None) -> None:
        """Raise StartInhibited until the order of a DF800's direction bits, which is undocumented, is calibrated."""
        if direction is not None and self.options.get("direction_calibrated") is False:
            raise StartInhibited("drives.direction_uncalibrated", direction=direction, model=self.profile.model)

    def _require_command_word(self) -> CommandWord:
        if self.command_word is None:
            raise CapabilityError("drives.cannot", model=self.profile.model, what="run")
        return self.command_word

    def _command_frames(self, words: tuple[int, ...]) -> tuple[CommandFrame, ...]:
        """Return the pulse, which is edge-triggered, then the levels alone."""
        pulse, *levels = (self._writes.command(word) for word in words)
        frames = [CommandFrame(request, RetryPolicy.IDEMPOTENT) for request in levels]
        return (CommandFrame(pulse, RetryPolicy.EDGE_TRIGGERED), *frames)

    def preparation_frame(self, word: int) -> CommandFrame:
        return CommandFrame(self._writes.command(word), RetryPolicy.EDGE_TRIGGERED)

    def unlock(self) -> Any | None:
        return self._writes.unlock()

    def set_frequency(self, word: int, readings: ReadingPairs) -> tuple[CommandFrame, ...]:
        return (CommandFrame(self._writes.setpoint(word), RetryPolicy.IDEMPOTENT),)

    def jog(self, direction: Direction, word: int | None) -> tuple[CommandFrame, ...]:
        if word is not None:
            raise CapabilityError("drives.jog_frequency_keypad", model=self.profile.model)
        self._check_direction(direction)
        return self._command_frames(self._require_command_word().jog(direction))

    def calibration_jog(self) -> tuple[CommandFrame, ...]:
        """Return the jog that determines the direction field: "forward" in the order b3 b2."""
        commands = self.profile.commands
        bits = {} if commands is None else commands.variants.get("direction_field", {}).get("b3b2", {})
        if "jog_forward" not in bits:
            raise CapabilityError("drives.cannot", model=self.profile.model, what="calibrate direction")
        return self._command_frames((bits["jog_forward"].value,))

    def stop(self, mode: StopMode) -> tuple[Any, ...]:
        words = self._require_command_word().stop(mode, self.profile.model)
        return tuple(self._writes.command(word) for word in words)

    def broadcast_stop(self) -> tuple[Any, ...]:
        """Return the stop without the levels after it: no reply shows that every drive has accepted it."""
        if self.profile.broadcast is None:
            return ()
        return (replace(self.stop(StopMode.STOP)[0], address=self.profile.broadcast),)

    def reset(self) -> tuple[CommandFrame, ...]:
        request = self._writes.reset_register()
        if request is not None:
            return (CommandFrame(request, RetryPolicy.EDGE_TRIGGERED),)
        return self._command_frames(self._require_command_word().reset(self.profile.model))

    def adopt_direction(self, readings: ReadingPairs) -> None:
        bit = self.status_map.bits.get("set_reverse", 0) if self.status_map is not None else 0
        words = readings.raw_pair("state")
        if bit and words is not None and words[0] & bit == words[1] & bit:
            self._require_command_word().adopt_direction(reverse=bool(words[1] & bit))

    def hold(self, hold: Hold) -> CommandFrame:
        word = self._require_command_word().hold(hold, self.profile.model)
        return CommandFrame(self._writes.command(word), RetryPolicy.EDGE_TRIGGERED)

    def end_hold(self) -> CommandFrame:
        word = self._require_command_word().end_hold()
        return CommandFrame(self._writes.command(word), RetryPolicy.EDGE_TRIGGERED)

    def identity_reads(self) -> tuple[Any, ...]:
        codes = self.profile.identity_codes
        return () if codes is None else (Span("holding", codes.register).request(self.address),)

    def decode_identity(self, replies: tuple[Any, ...]) -> Identity:
        """Return the model that the code names; a code that the profile does not list names none."""
        codes = self.profile.identity_codes
        code = self.parameter_raw(replies[0]) if replies else None
        models = codes.models.get(code, ()) if codes is not None and code is not None else ()
        if not models:
            return Identity(model=self.profile.model, reported=False)
        return Identity(model=" / ".join(models), reported=True, models=models)

    def read_parameter(self, parameter: Parameter) -> Any:
        return span_of(parameter).request(self.address)

    def parameter_raw(self, reply: Any) -> int | None:
        if isinstance(reply, BitValues):
            return int(reply.values[0])
        return join_words(reply.values, self._features) if isinstance(reply, RegisterValues) else None

    def names_parameter(self, reply: Any) -> bool:
        return True

    def write_parameter(self, parameter: Parameter, raw: int, *, save: bool) -> CommandFrame:
        request = self._writes.parameter(parameter, raw, save=save)
        return CommandFrame(request, RetryPolicy.EEPROM if save else RetryPolicy.IDEMPOTENT)

    def set_option(self, option: str, value: Any) -> None:
        self.options[option] = value
        self.command_word = self._make_command_word()
        self._writes = ModbusWrites(self.address, self.profile, self._commands)

    def on_sent(self, request: Any) -> None:
        """Record the levels that the drive holds now."""
        if self.command_word is not None:
            for word in self._command_words(request):
                self.command_word.on_sent(word)

    def on_accepted(self, request: Any) -> None:
        """Record the holds that the drive is in now."""
        if self.command_word is not None:
            for word in self._command_words(request):
                self.command_word.on_accepted(word)

    def _command_words(self, request: Any) -> list[int]:
        """Return the command words that a request writes to this drive."""
        if request.address != self.address:
            return []
        writes = self._writes.recognize(request_writes(request)) or ()
        return [write.word for write in writes if isinstance(write, CommandWrite)]


def _signals_by_locator(profile: DriveProfile) -> dict[Locator, list[tuple[Signal, Span]]]:
    """Return the signals by their first register, each with its span."""
    by_locator: dict[Locator, list[tuple[Signal, Span]]] = {}
    for signal in profile.signals.values():
        by_locator.setdefault(signal.locator, []).append((signal, span_of(signal)))
    return by_locator


def _identity_span(profile: DriveProfile) -> Span | None:
    """Return the span of the signal at the identity register, None for a profile without one."""
    spans = (span_of(signal) for signal in profile.signals.values())
    return next((span for span in spans if span.start == profile.identity_register), None)


def is_terminal_word(parameter: Parameter) -> bool:
    """Return whether a register sets input terminals, one of which may be wired to "run" (VC660 2002H to 2005H).

    Its mark is that it can only be written and has no range.
    """
    return not parameter.readable and parameter.maximum is None


def _with_end_silence(timing: StationTiming, encoding: str) -> StationTiming:
    """Return the timing with the 3.5 characters of silence after which the reply delay of an RTU station begins."""
    if encoding != "rtu":
        return timing
    return replace(timing, reply_delay_characters=max(timing.reply_delay_characters, RTU_END_SILENCE_CHARACTERS))
