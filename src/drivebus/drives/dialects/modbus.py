"""Dialect of Modbus drives: VC660, DF800 and every inverter that a profile describes.

The effect of a frame follows from its bytes and the profile's command map; what the map does not name is never sent.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from drivebus.bus.messages import RetryPolicy, StationConfig
from drivebus.drives.dialects.base import (
    DEFAULT_NONCE_START,
    UNNAMED_FAULT_CODE,
    CommandFrame,
    Identity,
    Rejection,
    StopMode,
    frequency_word,
    parameter_reading,
    setpoint_matches,
    signal_reading,
    signals_by_index,
)
from drivebus.drives.dialects.command_word import CommandWord, make_command_word
from drivebus.drives.dialects.setpoint_share import setpoint_scale
from drivebus.drives.dialects.status_word import is_valid_status, status_direction, status_state
from drivebus.drives.readings import ReadingPairs, Readings
from drivebus.drives.state import DerivedState, Direction, DriveState
from drivebus.errors import CapabilityError, ConfigurationError, ProtocolError, StartInhibited
from drivebus.profiles.model import CommandMap, DriveProfile, ModbusFeatures, Parameter, StatusMap
from drivebus.protocols.codec import Codec, Effect
from drivebus.protocols.modbus import (
    EXCEPTION_NAMES,
    Diagnostics,
    DiagnosticsReply,
    ExceptionReply,
    ModbusAsciiCodec,
    ModbusRtuCodec,
    ReadRegisters,
    RegisterValues,
    WriteRegister,
    WriteRegisters,
    registers_written,
)
from drivebus.serial_settings import StationTiming
from drivebus.values import Quality, Reading, missing_reading

SYNC_READ_COUNT = 2
"""Registers of a sync probe without FC08, by which its reply is recognised: no other read has this count."""
MAX_MERGE_PERIOD_RATIO = 4.0
"""Registers whose periods differ by more are not merged."""


def merge_reads(
    address: int, wanted: dict[int, float], max_read: int, *, reserve_sync_count: bool
) -> tuple[tuple[ReadRegisters, float], ...]:
    """Merge touching registers into reads within the model's limit, at the shortest period of each run.

    ``reserve_sync_count``: sync probes are recognised by their count, so no other read may have it.
    """
    runs: list[tuple[ReadRegisters, float]] = []
    for register, period in sorted(wanted.items()):
        last = runs[-1] if runs else None
        if last is not None and _can_merge(last, register, period, max_read):
            runs[-1] = replace(last[0], count=last[0].count + 1), min(last[1], period)
        else:
            runs.append((ReadRegisters(address, register, 1), period))
    if not reserve_sync_count:
        return tuple(runs)
    return tuple((part, period) for request, period in runs for part in _split_sync_count(request))


def _can_merge(run: tuple[ReadRegisters, float], register: int, period: float, max_read: int) -> bool:
    """Return whether a register joins a run: two more bytes cost less than a frame, unless read far less often."""
    request, shortest = run
    touches = register == request.register + request.count and request.count < max_read
    return touches and max(period, shortest) <= MAX_MERGE_PERIOD_RATIO * min(period, shortest)


def _split_sync_count(request: ReadRegisters) -> tuple[ReadRegisters, ...]:
    if request.count != SYNC_READ_COUNT:
        return (request,)
    return replace(request, count=1), replace(request, register=request.register + 1, count=1)


def sync_register_pairs(profile: DriveProfile) -> tuple[int, ...]:
    """Return the first registers of touching pairs that are read anyway, around preconditions and ramp times."""
    named = [p.notation for p in profile.preconditions] + list(profile.ramp_notations or ())
    wanted = {profile.parameters[n].locator[1] for n in named if n in profile.parameters}
    wanted |= set(signals_by_index(profile, "holding"))
    wanted |= {profile.status.register} if profile.status else set()
    known = {p.locator[1] for p in profile.parameters.values() if p.readable and p.locator[0] == "holding"} | wanted
    pairs: list[int] = []
    for index in sorted(known):
        touches = index + 1 in known and (index in wanted or index + 1 in wanted)
        if touches and (not pairs or index > pairs[-1] + 1):
            pairs.append(index)
    if not pairs:
        raise ConfigurationError("drives.no_sync_probe", model=profile.model)
    return tuple(pairs)


RTU_END_SILENCE_CHARACTERS = 3.5
"""Characters (Modbus over serial line 2.5.1.1); at 300 baud 117 ms, more than VC660's whole reply delay."""
LOOPBACK_NONCE_STEP = 0x9E37
"""An odd step visits all 65,536 nonces before one comes again."""


class ModbusDialect:
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
        self.profile, self.address, self.options = profile, address, options
        self._nonce_start = nonce_start
        self._rule: ModbusFeatures = profile.modbus or ModbusFeatures()
        form, most = self._rule.error_form, self._rule.max_read
        ascii_codec = ModbusAsciiCodec(form, most, tolerate_leading_noise=timing.tolerate_leading_noise)
        self.codec: Codec = ascii_codec if encoding == "ascii" else ModbusRtuCodec(form, most)
        self.status_map: StatusMap | None = profile.status
        self.command_word = make_command_word(profile.commands.resolved(options)) if profile.commands else None
        self._sync_registers = () if self._rule.loopback else sync_register_pairs(profile)
        self._signals = signals_by_index(profile, "holding")
        self._sync_count = 0
        self._is_model_open = profile.needs_model_check
        self._is_status_shown = False
        status = profile.status
        self._fault_names = tuple(f"fault_{place}" for place in range(len(status.fault_registers) if status else 0))
        self.state_names = ("state",) if status is None or status.shows_fault else ("state", *self._fault_names)
        self.station_config = StationConfig(
            address=address,
            codec=self.codec,
            timing=_with_end_silence(timing, encoding),
            effect_of=self.effect,
            sync_request=self._bus_sync_request,
            label=profile.model,
            longest_requests=tuple(request for request, _ in self.polls(tuple(profile.signals))),
        )

    @property
    def reports_run_state(self) -> bool:
        """Whether the profile names a status register; DF800 has none, and a state is never guessed."""
        return self.status_map is not None

    start_includes_setpoint = False

    @property
    def _command_map(self) -> CommandMap:
        return self._require_command_word().map

    def effect(self, frame: bytes) -> Effect:
        """Return the effect of a frame; no valid request, or a register outside the tables, may move the motor."""
        try:
            changes = registers_written(frame, self.codec.encoding)
        except (ProtocolError, KeyError):
            return Effect.MOTION
        effects = {self._effect_of(*change) for change in changes}
        if not effects:
            return Effect.NONE
        return effects.pop() if len(effects) == 1 else Effect.MOTION

    def _effect_of(self, space: str, register: int, value: int) -> Effect:
        if space != "holding":
            return Effect.MOTION
        if self.command_word is not None and register == self.command_word.map.register:
            return self.command_word.effect(value)
        if self.command_word is not None and register == self.command_word.map.setpoint_register:
            return Effect.SETTING
        parameter = self._writable_parameter(register)
        return Effect.MOTION if parameter is None or _is_terminal_word(parameter) else Effect.SETTING

    def _writable_parameter(self, register: int) -> Parameter | None:
        """Return the writable parameter of a register; one that can be read also by its EEPROM address."""
        bit = self.profile.write_support.eeprom_address_bit or 0
        for parameter in self.profile.parameters.values():
            space, index = parameter.locator
            registers = (index, index | bit) if parameter.readable else (index,)
            if space == "holding" and register in registers and parameter.writable:
                return parameter
        return None

    def is_allowed(self, frame: bytes) -> bool:
        """Allow registers of the profile's tables, and command words of mapped bits."""
        try:
            changes = registers_written(frame, self.codec.encoding)
        except (ProtocolError, KeyError):
            return False
        if changes and not self._is_addressed_here(frame):
            return False
        return all(self._is_allowed_change(*change) for change in changes)

    def _is_addressed_here(self, frame: bytes) -> bool:
        """Only a stop is ever broadcast, and a stop needs no permit."""
        address = int(frame[1:3], 16) if self.codec.encoding == "ascii" else frame[0]
        return address == self.address

    def _is_allowed_change(self, space: str, register: int, value: int) -> bool:
        if space == "holding" and self.command_word is not None and register == self.command_word.map.register:
            return self.command_word.is_mapped(value)
        is_setpoint = self.command_word is not None and register == self.command_word.map.setpoint_register
        return space == "holding" and (is_setpoint or self._writable_parameter(register) is not None)

    def _bus_sync_request(self, n: int) -> Any:
        return self._sync_request_at(2 * n)

    def sync_request(self, avoid: Any = None) -> Any:
        self._sync_count += 1
        return self._sync_request_at(2 * self._sync_count + 1)

    def _sync_request_at(self, n: int) -> Any:
        if self._rule.loopback:
            return Diagnostics(self.address, (self._nonce_start + n * LOOPBACK_NONCE_STEP) & 0xFFFF)
        return ReadRegisters(self.address, self._sync_registers[n // 2 % len(self._sync_registers)], SYNC_READ_COUNT)

    def is_valid_sync_reply(self, reply: Any) -> bool:
        """Accept a complete loop-back or a read with the count of a sync probe; an error echoes only its function."""
        return isinstance(reply, (DiagnosticsReply, RegisterValues))

    def needs_sync(self, request: Any) -> bool:
        """A read's reply names neither register nor value."""
        return isinstance(request, ReadRegisters)

    def model_check(self) -> Any | None:
        """The word that stops this model may start another one, so its status is read before the first command.

        So is its identity register, where another model has the same states at the same address.
        """
        if not self._is_model_open:
            return None
        identity = self.profile.identity_register
        if identity is not None and self._is_status_shown:
            return ReadRegisters(self.address, identity, 1)
        if self.status_map is None:
            return self.echo_test_read()
        status = self.status_map.register
        return next(one for one in self.state_reads() if status in range(one.register, one.register + one.count))

    def state_reads(self) -> tuple[Any, ...]:
        if self.status_map is None:
            return ()
        return tuple(request for request, _ in self.polls(("set_frequency", "output_frequency")))

    def echo_test_read(self) -> Any:
        indexes = [signal.locator[1] for signal in self.profile.signals.values()]
        indexes += [p.locator[1] for p in self.profile.parameters.values() if p.readable]
        return ReadRegisters(self.address, self.status_map.register if self.status_map else indexes[0], 1)

    def fault_reads(self) -> tuple[Any, ...]:
        """Return the reads that name the fault once the status word reports one."""
        registers = self.status_map.fault_registers if self.status_map else ()
        return tuple(request for request, _ in self._merged_reads(dict.fromkeys(registers, 1.0)))

    def polls(self, names: tuple[str, ...]) -> tuple[tuple[Any, float], ...]:
        """Merge signals of similar periods into one read where their registers touch."""
        wanted: dict[int, float] = {}
        if self.status_map is not None:
            wanted[self.status_map.register] = 0.5
            if not self.status_map.shows_fault:
                wanted |= dict.fromkeys(self.status_map.fault_registers, 0.5)
        for name in names:
            signal = self.profile.signals.get(name)
            if signal is not None and signal.locator[0] == "holding":
                index = signal.locator[1]
                wanted[index] = min(wanted.get(index, signal.period_s), signal.period_s)
        return self._merged_reads(wanted)

    def _merged_reads(self, wanted: dict[int, float]) -> tuple[tuple[ReadRegisters, float], ...]:
        return merge_reads(self.address, wanted, self._rule.max_read, reserve_sync_count=not self._rule.loopback)

    def decode_readings(self, request: Any, reply: Any, at: float | None) -> Readings:
        if not isinstance(request, ReadRegisters):
            return {}
        registers = range(request.register, request.register + request.count)
        if not isinstance(reply, RegisterValues):
            return self._rejected_readings(registers)
        found: dict[str, Reading] = {}
        for register, raw in zip(registers, reply.values, strict=True):
            found |= self._register_readings(register, raw, at)
        shows_status = self.status_map is None or ("state" in found and found["state"].quality is Quality.GOOD)
        self._is_status_shown = self._is_status_shown or shows_status
        identity = self.profile.identity_register
        if self._is_status_shown and (identity is None or identity in registers):
            self._is_model_open = False
        return found

    def _rejected_readings(self, registers: range) -> Readings:
        signals = [signal for register in registers for signal in self._signals.get(register, [])]
        found = {signal.name: missing_reading("drives.read_refused", signal.unit) for signal in signals}
        if self.status_map is not None and self.status_map.register in registers:
            found["state"] = missing_reading("drives.read_refused")
        if self.status_map is not None:
            for register, name in zip(self.status_map.fault_registers, self._fault_names, strict=True):
                if register in registers:
                    found[name] = missing_reading("drives.read_refused")
        return found

    def _register_readings(self, register: int, raw: int, at: float | None) -> Readings:
        found = {s.name: signal_reading(s, raw, at) for s in self._signals.get(register, [])}
        status = self.status_map
        if status is None:
            return found
        if register == status.register:
            broken = not is_valid_status(status, raw)
            quality, reason = (Quality.BAD, "drives.reserved_bits") if broken else (Quality.GOOD, None)
            found["state"] = Reading(value=raw, unit="", quality=quality, source_time=at, reason=reason, raw=raw)
            if not broken and self.command_word is not None:
                self.command_word.learn_direction(bool(raw & status.bits.get("set_reverse", 0)))
        if register in status.fault_registers:
            found[f"fault_{status.fault_registers.index(register)}"] = Reading(
                value=raw, unit="", quality=Quality.GOOD, source_time=at, reason=None, raw=raw
            )
        return found

    def derive_state(self, readings: ReadingPairs) -> DerivedState | None:
        """Two status words of the same state; of two different turning states the newer one counts."""
        pair = readings.raw_pair("state")
        status = self.status_map
        if status is None or pair is None:
            return None
        older, newer = (status_state(status, raw) for raw in pair)
        if older is not newer and not (older.turning and newer.turning):
            return None
        direction = status_direction(status, pair[1]) if newer.turning else None
        if not status.shows_fault:
            return self._with_polled_fault(readings, newer, direction)
        in_fault = newer is DriveState.FAULT or pair[1] & status.bits.get("fault", 0)
        if not in_fault:
            return DerivedState(newer, direction)
        first, *further = self._fault_codes(readings) or [UNNAMED_FAULT_CODE]
        return DerivedState(newer, direction, first, further_fault_codes=tuple(further))

    def _with_polled_fault(
        self, readings: ReadingPairs, state: DriveState, direction: Direction | None
    ) -> DerivedState | None:
        """Add the fault of a model whose status word shows none: unknown until its fault register was read."""
        assert self.status_map is not None
        if any(readings.agreed_raw(name) is None for name in self._fault_names):
            return None
        codes = self._fault_codes(readings)
        if not codes:
            return DerivedState(state, direction)
        return DerivedState(
            state if state.turning else DriveState.FAULT, direction, codes[0], further_fault_codes=tuple(codes[1:])
        )

    def _fault_codes(self, readings: ReadingPairs) -> list[int]:
        """Return the numbers in the fault registers, or the bits that are set, lowest first."""
        assert self.status_map is not None
        words = [readings.agreed_raw(name) or 0 for name in self._fault_names]
        if self.status_map.numbers_fault:
            return [number for word in words if (number := self.status_map.fault_number(word))]
        return [16 * place + bit for place, word in enumerate(words) for bit in range(16) if word >> bit & 1]

    def confirms_stop(self, readings: ReadingPairs) -> bool:
        return True

    def confirms_start(self, readings: ReadingPairs) -> bool:
        return False

    def setpoint_reads(self) -> tuple[Any, ...]:
        signal = self.profile.signals.get("set_frequency")
        return () if signal is None else (ReadRegisters(self.address, signal.locator[1], 1),)

    def setpoint_matches(self, readings: ReadingPairs, word: int, frequency_hz: float) -> bool | None:
        return setpoint_matches(readings, self.profile, frequency_hz, self.options)

    def can_confirm_speed(self) -> bool:
        return self.reports_run_state and "output_frequency" in self.profile.signals

    def rejection(self, reply: Any) -> Rejection | None:
        if not isinstance(reply, ExceptionReply):
            return None
        if reply.code is None:
            return Rejection("drives.modbus_refused_short", None)
        is_known = reply.code in EXCEPTION_NAMES
        return Rejection(f"drives.modbus_exception_{reply.code}" if is_known else "drives.modbus_refused", reply.code)

    def setpoint_word(self, frequency_hz: float) -> int:
        return frequency_word(self.profile, frequency_hz, self.options)

    def setpoint_frequency(self, word: int) -> float:
        return setpoint_scale(self.profile, self.options).value(word)

    def start(self, direction: Direction | None, word: int) -> tuple[CommandFrame, ...]:
        self._check_direction(direction)
        return self._command_frames(self._require_command_word().start(direction))

    def _check_direction(self, direction: Direction | None) -> None:
        """The order of the direction bits of a DF800 is undocumented until it is calibrated."""
        if direction is not None and self.options.get("direction_calibrated") is False:
            raise StartInhibited("drives.direction_uncalibrated", direction=direction, model=self.profile.model)

    def _require_command_word(self) -> CommandWord:
        if self.command_word is None:
            raise CapabilityError("drives.cannot", model=self.profile.model, what="run")
        return self.command_word

    def _write(self, register: int, word: int) -> WriteRegister | WriteRegisters:
        """Return the write of one register: function 06, or 10H on a model that lacks 06."""
        if WriteRegister.function in self._rule.functions:
            return WriteRegister(self.address, register, word)
        return WriteRegisters(self.address, register, (word,))

    def _command_frames(self, words: tuple[int, ...]) -> tuple[CommandFrame, ...]:
        """Return the pulse, which is edge-triggered, then the levels alone."""
        requests = [self._write(self._command_map.register, word) for word in words]
        classes = [RetryPolicy.EDGE_TRIGGERED] + [RetryPolicy.IDEMPOTENT] * (len(words) - 1)
        return tuple(CommandFrame(request, how) for request, how in zip(requests, classes, strict=True))

    def set_frequency(self, word: int, readings: ReadingPairs) -> tuple[CommandFrame, ...]:
        return (CommandFrame(self._write(self._command_map.setpoint_register, word), RetryPolicy.IDEMPOTENT),)

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
        return tuple(self._write(self._command_map.register, word) for word in words)

    def broadcast_stop(self) -> tuple[Any, ...]:
        if self.profile.broadcast is None:
            return ()
        requests = self.stop(StopMode.STOP)
        return tuple(replace(request, address=self.profile.broadcast) for request in requests)

    def reset(self) -> tuple[CommandFrame, ...]:
        return self._command_frames(self._require_command_word().reset(self.profile.model))

    def identity_reads(self) -> tuple[Any, ...]:
        return ()

    def decode_identity(self, replies: tuple[Any, ...]) -> Identity:
        return Identity(model=self.profile.model, reported=False)

    def read_parameter(self, parameter: Parameter) -> Any:
        return ReadRegisters(self.address, parameter.locator[1], 1)

    def parameter_raw(self, reply: Any) -> int | None:
        return reply.values[0] if isinstance(reply, RegisterValues) else None

    def names_parameter(self, reply: Any) -> bool:
        return True

    def parameter_reading(self, parameter: Parameter, raw: int, at: float | None) -> Reading:
        return parameter_reading(parameter, raw, at)

    def parameter_word(self, parameter: Parameter, value: float) -> int:
        return parameter.scale.raw(value)

    def write_parameter(self, parameter: Parameter, raw: int, save: bool) -> CommandFrame:
        bit = self.profile.write_support.eeprom_address_bit if save else None
        request = self._write(parameter.locator[1] | (bit or 0), raw)
        return CommandFrame(request, RetryPolicy.EEPROM if save else RetryPolicy.IDEMPOTENT)

    def set_option(self, option: str, value: Any) -> None:
        self.options[option] = value
        commands = self.profile.commands
        self.command_word = make_command_word(commands.resolved(self.options)) if commands else None

    def on_sent(self, request: Any) -> None:
        """Record the levels that the drive holds now."""
        if not isinstance(request, WriteRegister | WriteRegisters) or request.address != self.address:
            return
        if self.command_word is not None and request.register == self.command_word.map.register:
            word = request.value if isinstance(request, WriteRegister) else request.values[0]
            self.command_word.on_sent(word)


def _is_terminal_word(parameter: Parameter) -> bool:
    """Return whether a register sets input terminals, one of which may be wired to "run" (VC660 2002H to 2005H).

    Its mark is that it can only be written and has no range.
    """
    return not parameter.readable and parameter.maximum is None


def _with_end_silence(timing: StationTiming, encoding: str) -> StationTiming:
    """An RTU station recognises the end of a request by 3.5 characters of silence, after which its delay begins."""
    if encoding != "rtu":
        return timing
    return replace(timing, reply_delay_characters=max(timing.reply_delay_characters, RTU_END_SILENCE_CHARACTERS))
