"""The Modbus dialect: VC660, DF800 and every inverter that a profile describes. No model has Python of its own.

What a frame does is told from its bytes and the profile's command map; what the map does not name is never sent.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from drivebus.drives.book import Book, Facts
from drivebus.drives.command_word import CommandWord
from drivebus.drives.dialect import (
    UNNAMED,
    Frame,
    Refusal,
    Stop,
    frequency_word,
    parameter_reading,
    reading_of,
    shows,
    signals_in,
)
from drivebus.drives.modbus_reads import FENCE_COUNT, merged, wanted_pairs
from drivebus.drives.modbus_status import direction_of, state_of
from drivebus.drives.state import Direction, Verdict
from drivebus.errors import CapabilityError, GateError, ProtocolError
from drivebus.message import Codec, Effect, StationLink, StationTiming, WriteClass
from drivebus.profiles.model import CommandMap, DriveProfile, ModbusRule, Parameter, StatusMap
from drivebus.protocols.modbus import (
    AsciiCodec,
    ErrorReply,
    Loopback,
    Looped,
    ReadRegisters,
    Registers,
    RtuCodec,
    WriteRegister,
    written,
)
from drivebus.reading import Quality, Reading, missing

END_SILENCE = 3.5
"""Characters (Modbus over serial line 2.5.1.1); at 300 baud 117 ms, more than VC660's whole reply delay."""
NONCE_STEP, NONCE_START = 0x9E37, 0x5AA5
"""An odd step visits all 65,536 nonces before one comes again."""


class ModbusDialect:
    """One Modbus inverter (see ``dialect.Dialect``)."""

    def __init__(
        self, profile: DriveProfile, address: int, encoding: str, settings: dict[str, Any], timing: StationTiming
    ) -> None:
        self.profile, self.address, self.settings = profile, address, settings
        self._rule: ModbusRule = profile.modbus or ModbusRule()
        form, most = self._rule.error_form, self._rule.max_read
        ascii_codec = AsciiCodec(form, most, resync=timing.leading_junk)
        self.codec: Codec = ascii_codec if encoding == "ascii" else RtuCodec(form, most)
        self.status: StatusMap | None = profile.status
        self.word = CommandWord(profile.commands.resolved(settings)) if profile.commands else None
        self._pairs = () if self._rule.loopback else wanted_pairs(profile)
        self._signals = signals_in(profile, "holding")
        self._count = 0
        extra = {"longest": tuple(request for request, _ in self.polls(tuple(profile.signals)))}
        self.link = StationLink(
            address, self.codec, _with_silence(timing, encoding), self.effect, self._bus_fence, profile.model, extra
        )

    @property
    def can_tell(self) -> bool:
        """Only where the profile names a status register: DF800 has none (T17), and a state is never guessed."""
        return self.status is not None

    carries_frequency = False
    state_names: tuple[str, ...] = ("state",)

    @property
    def _map(self) -> CommandMap:
        return self._command().map

    def effect(self, frame: bytes) -> Effect:
        """What these bytes do; bytes that are no request, and registers that no table has, may move (T12)."""
        try:
            changes = written(frame, self.codec.encoding)
        except (ProtocolError, KeyError):
            return Effect.MOTION
        effects = {self._effect_of(*change) for change in changes}
        if not effects:
            return Effect.NONE
        return effects.pop() if len(effects) == 1 else Effect.MOTION

    def _effect_of(self, space: str, register: int, value: int) -> Effect:
        if space != "holding":
            return Effect.MOTION
        if self.word is not None and register == self.word.map.register:
            return self.word.effect(value)
        if self.word is not None and register == self.word.map.setpoint_register:
            return Effect.SETTING
        return Effect.SETTING if self._plain(register) is not None else Effect.MOTION

    def _plain(self, register: int) -> Parameter | None:
        """The listed parameter of a register, its EEPROM form too. A write-only register without a stated range may
        be a terminal that somebody wired to "run" (VC660 2002H to 2005H): it counts as motion."""
        bit = self.profile.write_rule.eeprom_address_bit or 0
        for parameter in self.profile.parameters.values():
            space, index = parameter.locator
            if space == "holding" and register in (index, index | bit) and parameter.writable:
                return parameter if parameter.readable or parameter.maximum is not None else None
        return None

    def lawful(self, frame: bytes) -> bool:
        """Only registers of the profile's tables, and only command words made of its own bits (T12, T16)."""
        try:
            changes = written(frame, self.codec.encoding)
        except (ProtocolError, KeyError):
            return False
        if changes and not self._for_us(frame):
            return False
        return all(self._allowed(*change) for change in changes)

    def _for_us(self, frame: bytes) -> bool:
        """Nothing but a stop is ever sent to everybody (matrix: broadcast X), and stops ask for no leave."""
        address = int(frame[1:3], 16) if self.codec.encoding == "ascii" else frame[0]
        return address == self.address

    def _allowed(self, space: str, register: int, value: int) -> bool:
        if space == "holding" and self.word is not None and register == self.word.map.register:
            return self.word.known(value)
        return self._effect_of(space, register, value) is Effect.SETTING

    def _bus_fence(self, n: int) -> Any:
        return self._fence(2 * n)

    def fence(self, avoid: Any = None) -> Any:
        self._count += 1
        return self._fence(2 * self._count + 1)

    def _fence(self, n: int) -> Any:
        if self._rule.loopback:
            return Loopback(self.address, (NONCE_START + n * NONCE_STEP) & 0xFFFF)
        return ReadRegisters(self.address, self._pairs[n // 2 % len(self._pairs)], FENCE_COUNT)

    def proves(self, reply: Any) -> bool:
        """A loop-back that came back whole, or a read with the fence's count; an error echoes only its function."""
        return isinstance(reply, (Looped, Registers))

    def clashes(self, request: Any) -> bool:
        """A read's reply names neither register nor value (F01): a read of settings goes behind a fence."""
        return isinstance(request, ReadRegisters)

    def state_reads(self) -> tuple[Any, ...]:
        if self.status is None:
            return ()
        return tuple(request for request, _ in self.polls(("set_frequency", "output_frequency")))

    def plain_read(self) -> Any:
        indexes = [signal.locator[1] for signal in self.profile.signals.values()]
        indexes += [p.locator[1] for p in self.profile.parameters.values() if p.readable]
        return ReadRegisters(self.address, self.status.register if self.status else indexes[0], 1)

    def fault_reads(self) -> tuple[Any, ...]:
        """Reads that name the fault once the status word says that there is one."""
        registers = self.status.fault_registers if self.status else ()
        return tuple(request for request, _ in self._merged(dict.fromkeys(registers, 1.0)))

    def polls(self, names: tuple[str, ...]) -> tuple[tuple[Any, float], ...]:
        """Signals of one period share a read where their registers touch; no register that nobody asked for (F22)."""
        wanted: dict[int, float] = {}
        if self.status is not None:
            wanted[self.status.register] = 0.5
        for name in names:
            signal = self.profile.signals.get(name)
            if signal is not None and signal.locator[0] == "holding":
                index = signal.locator[1]
                wanted[index] = min(wanted.get(index, signal.period_s), signal.period_s)
        return self._merged(wanted)

    def _merged(self, wanted: dict[int, float]) -> tuple[tuple[ReadRegisters, float], ...]:
        return merged(self.address, wanted, self._rule.max_read, keep_fence_count=not self._rule.loopback)

    def facts(self, request: Any, reply: Any, at: float | None) -> Facts:
        if not isinstance(request, ReadRegisters):
            return {}
        registers = range(request.register, request.register + request.count)
        if not isinstance(reply, Registers):
            return self._refused(registers)
        found: dict[str, Reading] = {}
        for register, raw in zip(registers, reply.values, strict=True):
            found |= self._facts_of(register, raw, at)
        return found

    def _refused(self, registers: range) -> Facts:
        found = [signal for register in registers for signal in self._signals.get(register, [])]
        return {signal.name: missing("drives.refused_read", signal.unit) for signal in found}

    def _facts_of(self, register: int, raw: int, at: float | None) -> Facts:
        found = {s.name: reading_of(s, raw, at) for s in self._signals.get(register, [])}
        status = self.status
        if status is None:
            return found
        if register == status.register:
            broken = raw & status.reserved_mask
            quality, reason = (Quality.BAD, "drives.reserved_bits") if broken else (Quality.GOOD, None)
            found["state"] = Reading(raw, "", quality, at, reason, raw)
            if not broken and self.word is not None:
                self.word.learn(bool(raw & status.bits.get("set_reverse", 0)))
        if register in status.fault_registers:
            found[f"fault_{status.fault_registers.index(register)}"] = Reading(raw, "", Quality.GOOD, at, None, raw)
        return found

    def judge(self, book: Book) -> Verdict | None:
        """Two status words that mean the same state; of two different turning states the newer one."""
        pair = book.raw_pair("state")
        if self.status is None or pair is None:
            return None
        older, newer = (state_of(self.status, raw) for raw in pair)
        if older is not newer and not (older.turning and newer.turning):
            return None
        fault = self._fault(book) if pair[1] & self.status.bits.get("fault", 0) else None
        return Verdict(newer, direction_of(self.status, pair[1]) if newer.turning else None, fault)

    def _fault(self, book: Book) -> int:
        """The lowest bit that is set in the fault words; ``UNNAMED`` where the drive names none (yet)."""
        assert self.status is not None
        for place, _ in enumerate(self.status.fault_registers):
            word = book.agreed(f"fault_{place}")
            if word:
                return 16 * place + (word & -word).bit_length() - 1
        return UNNAMED

    def stop_seen(self, book: Book) -> bool:
        return True

    def start_seen(self, book: Book) -> bool:
        return False

    def setpoint_reads(self) -> tuple[Any, ...]:
        signal = self.profile.signals.get("set_frequency")
        return () if signal is None else (ReadRegisters(self.address, signal.locator[1], 1),)

    def setpoint_shown(self, book: Book, word: int, frequency_hz: float) -> bool | None:
        return shows(book, self.profile, frequency_hz)

    def can_wait(self) -> bool:
        return self.can_tell and "output_frequency" in self.profile.signals

    def refusal(self, reply: Any) -> Refusal | None:
        if not isinstance(reply, ErrorReply):
            return None
        return Refusal("drives.modbus_refused_short" if reply.code is None else "drives.modbus_refused", reply.code)

    def setpoint_word(self, frequency_hz: float) -> int:
        return frequency_word(self.profile, frequency_hz)

    def frequency_of(self, word: int) -> float:
        return self.profile.setpoint_scale.value(word)

    def start(self, direction: Direction | None, word: int) -> tuple[Frame, ...]:
        self._check_direction(direction)
        return self._words(self._command().start(direction))

    def _check_direction(self, direction: Direction | None) -> None:
        """DF800: which way round the direction field is, is open until a watched jog has settled it."""
        if direction is not None and self.settings.get("direction_proved") is False:
            raise GateError("drives.direction_unproved", direction=direction, model=self.profile.model)

    def _command(self) -> CommandWord:
        if self.word is None:
            raise CapabilityError("drives.cannot", model=self.profile.model, what="run")
        return self.word

    def _words(self, words: tuple[int, ...]) -> tuple[Frame, ...]:
        """The pulse, an edge; then the levels without it (VC660: whether a pulse must return to 0 is open)."""
        requests = [WriteRegister(self.address, self._map.register, word) for word in words]
        classes = [WriteClass.EDGE] + [WriteClass.ABSOLUTE] * (len(words) - 1)
        return tuple(Frame(request, how) for request, how in zip(requests, classes, strict=True))

    def set_frequency(self, word: int, book: Book) -> tuple[Frame, ...]:
        return (Frame(WriteRegister(self.address, self._map.setpoint_register, word), WriteClass.ABSOLUTE),)

    def jog(self, direction: Direction, word: int | None) -> tuple[Frame, ...]:
        if word is not None:
            raise CapabilityError("drives.jog_frequency_keypad", model=self.profile.model)
        self._check_direction(direction)
        return self._words(self._command().jog(direction))

    def proof_jog(self) -> tuple[Frame, ...]:
        """The one jog before the direction field is proved: "forward" as b3b2 reads it, whatever the setting says."""
        commands = self.profile.commands
        bits = {} if commands is None else commands.variants.get("direction_field", {}).get("b3b2", {})
        if "jog_forward" not in bits:
            raise CapabilityError("drives.cannot", model=self.profile.model, what="direction proof")
        return self._words((bits["jog_forward"].value,))

    def stop(self, how: Stop) -> tuple[Any, ...]:
        words = self._command().stop(how, self.profile.model)
        return tuple(WriteRegister(self.address, self._map.register, word) for word in words)

    def stop_everyone(self) -> tuple[Any, ...]:
        if self.profile.broadcast is None:
            return ()
        requests = self.stop(Stop.STOP)
        return tuple(replace(request, address=self.profile.broadcast) for request in requests)

    def reset(self) -> tuple[Frame, ...]:
        return self._words(self._command().reset(self.profile.model))

    def read_parameter(self, parameter: Parameter) -> Any:
        return ReadRegisters(self.address, parameter.locator[1], 1)

    def parameter_raw(self, reply: Any) -> int | None:
        return reply.values[0] if isinstance(reply, Registers) else None

    def parameter_reading(self, parameter: Parameter, raw: int, at: float | None) -> Reading:
        return parameter_reading(parameter, raw, at)

    def parameter_word(self, parameter: Parameter, value: float) -> int:
        return parameter.scale.raw(value)

    def write_parameter(self, parameter: Parameter, raw: int, save: bool) -> Frame:
        bit = self.profile.write_rule.eeprom_address_bit if save else None
        request = WriteRegister(self.address, parameter.locator[1] | (bit or 0), raw)
        return Frame(request, WriteClass.EEPROM if save else WriteClass.ABSOLUTE)

    def settle(self, setting: str, value: Any) -> None:
        self.settings[setting] = value
        self.word = CommandWord(self.profile.commands.resolved(self.settings)) if self.profile.commands else None

    def noted(self, request: Any) -> None:
        """A command word has left: its levels are what the drive holds now."""
        ours = self.word is not None and isinstance(request, WriteRegister) and request.address == self.address
        if ours and self.word is not None and request.register == self.word.map.register:
            self.word.sent(request.value)


def _with_silence(timing: StationTiming, encoding: str) -> StationTiming:
    """An RTU station knows that a request has ended by 3.5 characters of silence: only then its delay begins."""
    if encoding != "rtu":
        return timing
    return replace(timing, reply_delay_characters=max(timing.reply_delay_characters, END_SILENCE))
