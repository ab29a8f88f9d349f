"""What every family's dialect offers: intents become requests, replies become readings. Shapes and small parts."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any, Protocol

from drivebus import i18n
from drivebus.drives.book import Book, Facts
from drivebus.drives.state import Direction, Fault, Verdict
from drivebus.errors import LimitError, ProtocolError
from drivebus.message import Codec, Complete, StationLink, WriteClass
from drivebus.profiles.model import DriveProfile, Parameter, Signal, Text
from drivebus.reading import Quality, Reading


class Stop(StrEnum):
    """Ways to take motion away; the value is the capability that a profile must have."""

    STOP = "stop"
    COAST = "coast"
    QUICK_STOP = "quick_stop"
    JOG_STOP = "jog"


@dataclass(frozen=True, slots=True)
class Frame:
    """One frame of a command and how it may be repeated."""

    request: Any
    write_class: WriteClass


@dataclass(frozen=True, slots=True)
class Refusal:
    """The drive's own no: an i18n key, and its code where it gives one."""

    key: str
    code: int | None


class Dialect(Protocol):
    """One drive's language. Pure but for counters and shadows of what was sent; no clock."""

    profile: DriveProfile
    address: int
    settings: dict[str, Any]
    codec: Codec
    link: StationLink
    state_names: tuple[str, ...]
    """Readings that the state rests on."""

    @property
    def can_tell(self) -> bool:
        """The drive reports whether it runs."""
        ...

    @property
    def carries_frequency(self) -> bool:
        """The start frame itself carries the frequency."""
        ...

    def fence(self, avoid: Any = None) -> Any:
        """The next fence of our own conversations (ruling 2); never one that the bus uses, nor like ``avoid``."""
        ...

    def proves(self, reply: Any) -> bool:
        """This reply to a fence echoes enough to be nobody else's."""
        ...

    def clashes(self, request: Any) -> bool:
        """A reply to this request looks like one to another class (T04): put a fence before it."""
        ...

    def state_reads(self) -> tuple[Any, ...]:
        """The smallest set of reads that shows state, direction and fault."""
        ...

    def plain_read(self) -> Any:
        """A read whose reply differs from it: shows that a port has no echo."""
        ...

    def fault_reads(self) -> tuple[Any, ...]:
        """Further reads that name a fault; empty where the state itself carries its code."""
        ...

    def setpoint_reads(self) -> tuple[Any, ...]:
        """Reads that show the set frequency; empty where nothing does."""
        ...

    def setpoint_shown(self, book: Book, word: int, frequency_hz: float) -> bool | None:
        """The last two reads of the set frequency agree with what was sent; None where they can't tell."""
        ...

    def can_wait(self) -> bool:
        """Running at the set frequency can be seen."""
        ...

    def polls(self, names: tuple[str, ...]) -> tuple[tuple[Any, float], ...]:
        """Requests and periods that keep these signals (and the state) current; nothing that nobody asked for (F22)."""
        ...

    def facts(self, request: Any, reply: Any, at: float | None) -> Facts:
        """What a reply says; empty for the reply of a command."""
        ...

    def judge(self, book: Book) -> Verdict | None:
        """State, direction and fault from the last two readings; None where they do not agree (yet)."""
        ...

    def stop_seen(self, book: Book) -> bool:
        """Whatever else the family shows of a stop command, the last two readings show it (DZB100: Q03's A)."""
        ...

    def start_seen(self, book: Book) -> bool:
        """The last two readings show that a start was the last command the drive took (DZB100: Q03's A)."""
        ...

    def refusal(self, reply: Any) -> Refusal | None:
        """Whether this reply is the drive's own no."""
        ...

    def setpoint_word(self, frequency_hz: float) -> int:
        """The raw word of a frequency. Raises LimitError where the coding forbids it."""
        ...

    def frequency_of(self, word: int) -> float:
        """What a setpoint word means, in Hz (DZB100: under the coding in force)."""
        ...

    def start(self, direction: Direction | None, word: int) -> tuple[Frame, ...]:
        """The start, then what must follow it. Raises CapabilityError or GateError for a direction."""
        ...

    def set_frequency(self, word: int, book: Book) -> tuple[Frame, ...]:
        """Change the frequency. Raises CapabilityError or GateError."""
        ...

    def jog(self, direction: Direction, word: int | None) -> tuple[Frame, ...]:
        """Begin to jog; ``word`` None is the drive's own jog frequency."""
        ...

    def stop(self, how: Stop) -> tuple[Any, ...]:
        """Requests that take motion away, then what must follow. Raises CapabilityError."""
        ...

    def stop_everyone(self) -> tuple[Any, ...]:
        """The family's broadcast stop; empty where it has none."""
        ...

    def reset(self) -> tuple[Frame, ...]:
        """Fault reset, then what must follow."""
        ...

    def read_parameter(self, parameter: Parameter) -> Any:
        """The request that reads it."""
        ...

    def parameter_raw(self, reply: Any) -> int | None:
        """The raw word in the reply of a parameter read; None where it carries none."""
        ...

    def parameter_reading(self, parameter: Parameter, raw: int, at: float | None) -> Reading:
        """A parameter's raw word in its unit."""
        ...

    def parameter_word(self, parameter: Parameter, value: float) -> int:
        """The raw word of a parameter's value. Raises ValueError where it fits none."""
        ...

    def write_parameter(self, parameter: Parameter, raw: int, save: bool) -> Frame:
        """The request that writes it, to RAM or EEPROM."""
        ...

    def lawful(self, frame: bytes) -> bool:
        """The encoded request is on the family's allow-list (I7, T12): else no permit is asked for."""
        ...

    def settle(self, setting: str, value: Any) -> None:
        """An open question of the family is answered for this drive."""
        ...

    def noted(self, request: Any) -> None:
        """This request has left: shadows follow."""
        ...


def whole_request(codec: Codec, frame: bytes) -> Any | None:
    """The message of bytes that are exactly one whole request; None for all other bytes, which may move."""
    try:
        verdict = codec.decode_request(frame)
    except ProtocolError:
        return None
    return verdict.message if isinstance(verdict, Complete) and verdict.size == len(frame) else None


def reading_of(signal: Signal, raw: int, at: float | None) -> Reading:
    """A raw word as the profile scales it, checked for its coding and plausible range (RELIABILITY 4)."""
    try:
        value = signal.scale.value(raw)
    except ValueError:
        return Reading(None, signal.unit, Quality.BAD, at, "drives.not_decimal", raw)
    return plausible(signal, Reading(value, signal.unit, Quality.GOOD, at, None, raw))


def parameter_reading(parameter: Parameter, raw: int, at: float | None) -> Reading:
    """A parameter's raw word as the profile scales it."""
    try:
        value = parameter.scale.value(raw)
    except ValueError:
        return Reading(None, parameter.unit, Quality.BAD, at, "drives.not_decimal", raw)
    return Reading(value, parameter.unit, Quality.GOOD, at, None, raw)


def plausible(signal: Signal, reading: Reading) -> Reading:
    """The reading, uncertain where the profile's range or its unpublished scale says so."""
    value = reading.value
    if isinstance(value, (int, float)) and _outside(signal, value):
        return replace(reading, quality=Quality.UNCERTAIN, reason="drives.implausible")
    if signal.uncertain:
        return replace(reading, quality=Quality.UNCERTAIN, reason=signal.uncertain)
    return reading


def _outside(signal: Signal, value: float) -> bool:
    below = signal.minimum is not None and value < signal.minimum
    return below or (signal.maximum is not None and value > signal.maximum)


def frequency_word(profile: DriveProfile, frequency_hz: float) -> int:
    """The setpoint's raw word by the profile's scale. Raises LimitError where it fits no word."""
    try:
        return profile.setpoint_scale.raw(frequency_hz)
    except ValueError as error:
        raise LimitError("drives.no_word", frequency_hz=frequency_hz, step_hz=profile.setpoint_scale.factor) from error


UNNAMED = -1
"""Fault code where the drive says that there is a fault and not which."""


def shows(book: Book, profile: DriveProfile, frequency_hz: float) -> bool | None:
    """Two agreeing reads of the set frequency, against what was asked for, to one step of the setpoint."""
    pair = book.pair("set_frequency")
    if pair is None or "set_frequency" not in profile.signals:
        return None
    step = profile.setpoint_scale.factor
    return all(isinstance(r.value, (int, float)) and abs(r.value - frequency_hz) <= step for r in pair)


def fault_of(profile: DriveProfile, code: int) -> Fault:
    """The fault of a code, with the maker's words where published."""
    if code == UNNAMED:
        words = {language: i18n.text("drives.unnamed_fault", language) for language in i18n.LANGUAGES}
        return Fault(code, "", Text(words["en"], words["zh"]))
    entry = profile.fault(code)
    return Fault(entry.code, entry.label, entry.text, entry.cause, entry.remedy)


def signals_in(profile: DriveProfile, space: str) -> dict[int, list[Signal]]:
    """Signals of one address space by index."""
    found: dict[int, list[Signal]] = {}
    for signal in profile.signals.values():
        if signal.locator[0] == space:
            found.setdefault(signal.locator[1], []).append(signal)
    return found


def period_of(profile: DriveProfile, names: tuple[str, ...], default_s: float = 0.5) -> float:
    """The shortest period of these signals."""
    return min((profile.signals[name].period_s for name in names if name in profile.signals), default=default_s)
