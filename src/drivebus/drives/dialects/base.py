"""What every family's dialect offers: intents become requests, replies become readings. Shapes and small parts."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any, Protocol

from drivebus import i18n
from drivebus.bus.messages import RetryPolicy, StationConfig
from drivebus.drives.readings import ReadingPairs, Readings
from drivebus.drives.state import DerivedState, Direction, Fault
from drivebus.errors import LimitError, ProtocolError
from drivebus.profiles.model import DriveProfile, Parameter, Signal, Text
from drivebus.protocols.codec import Codec, Complete
from drivebus.values import Quality, Reading


class StopMode(StrEnum):
    """Ways to take motion away; the value is the capability that a profile must have."""

    STOP = "stop"
    COAST = "coast"
    QUICK_STOP = "quick_stop"
    JOG_STOP = "jog"


@dataclass(frozen=True, slots=True)
class CommandFrame:
    """One frame of a command and how it may be repeated."""

    request: Any
    retry_policy: RetryPolicy


@dataclass(frozen=True, slots=True)
class Rejection:
    """The drive's own no: an i18n key, and its code where it gives one."""

    key: str
    code: int | None


class Dialect(Protocol):
    """One drive's language. Pure but for counters and shadows of what was sent; no clock."""

    profile: DriveProfile
    address: int
    settings: dict[str, Any]
    codec: Codec
    station_config: StationConfig
    state_names: tuple[str, ...]
    """Readings that the state rests on."""

    @property
    def reports_run_state(self) -> bool:
        """The drive reports whether it runs."""
        ...

    @property
    def start_includes_setpoint(self) -> bool:
        """The start frame itself carries the frequency."""
        ...

    def sync_request(self, avoid: Any = None) -> Any:
        """The next fence of our own conversations (ruling 2); never one that the bus uses, nor like ``avoid``."""
        ...

    def is_valid_sync_reply(self, reply: Any) -> bool:
        """This reply to a fence echoes enough to be nobody else's."""
        ...

    def needs_sync(self, request: Any) -> bool:
        """A reply to this request looks like one to another class (T04): put a fence before it."""
        ...

    def state_reads(self) -> tuple[Any, ...]:
        """The smallest set of reads that shows state, direction and fault."""
        ...

    def echo_test_read(self) -> Any:
        """A read whose reply differs from it: shows that a port has no echo."""
        ...

    def fault_reads(self) -> tuple[Any, ...]:
        """Further reads that name a fault; empty where the state itself carries its code."""
        ...

    def setpoint_reads(self) -> tuple[Any, ...]:
        """Reads that show the set frequency; empty where nothing does."""
        ...

    def setpoint_matches(self, readings: ReadingPairs, word: int, frequency_hz: float) -> bool | None:
        """The last two reads of the set frequency agree with what was sent; None where they can't tell."""
        ...

    def can_confirm_speed(self) -> bool:
        """Running at the set frequency can be seen."""
        ...

    def polls(self, names: tuple[str, ...]) -> tuple[tuple[Any, float], ...]:
        """Requests and periods that keep these signals (and the state) current; nothing that nobody asked for (F22)."""
        ...

    def decode_readings(self, request: Any, reply: Any, at: float | None) -> Readings:
        """What a reply says; empty for the reply of a command."""
        ...

    def derive_state(self, readings: ReadingPairs) -> DerivedState | None:
        """State, direction and fault from the last two readings; None where they do not agree (yet)."""
        ...

    def confirms_stop(self, readings: ReadingPairs) -> bool:
        """Whatever else the family shows of a stop command, the last two readings show it (DZB100: Q03's A)."""
        ...

    def confirms_start(self, readings: ReadingPairs) -> bool:
        """The last two readings show that a start was the last command the drive took (DZB100: Q03's A)."""
        ...

    def rejection(self, reply: Any) -> Rejection | None:
        """Whether this reply is the drive's own no."""
        ...

    def setpoint_word(self, frequency_hz: float) -> int:
        """The raw word of a frequency. Raises LimitError where the coding forbids it."""
        ...

    def setpoint_frequency(self, word: int) -> float:
        """What a setpoint word means, in Hz (DZB100: under the coding in force)."""
        ...

    def start(self, direction: Direction | None, word: int) -> tuple[CommandFrame, ...]:
        """The start, then what must follow it. Raises CapabilityError or StartInhibited for a direction."""
        ...

    def set_frequency(self, word: int, readings: ReadingPairs) -> tuple[CommandFrame, ...]:
        """Change the frequency. Raises CapabilityError or StartInhibited."""
        ...

    def jog(self, direction: Direction, word: int | None) -> tuple[CommandFrame, ...]:
        """Begin to jog; ``word`` None is the drive's own jog frequency."""
        ...

    def stop(self, mode: StopMode) -> tuple[Any, ...]:
        """Requests that take motion away, then what must follow. Raises CapabilityError."""
        ...

    def broadcast_stop(self) -> tuple[Any, ...]:
        """The family's broadcast stop; empty where it has none."""
        ...

    def reset(self) -> tuple[CommandFrame, ...]:
        """Fault reset, then what must follow."""
        ...

    def identity_reads(self) -> tuple[Any, ...]:
        """Return the reads of model, series, version and control source; empty where the drive reports none."""
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

    def write_parameter(self, parameter: Parameter, raw: int, save: bool) -> CommandFrame:
        """The request that writes it, to RAM or EEPROM."""
        ...

    def is_allowed(self, frame: bytes) -> bool:
        """The encoded request is on the family's allow-list (I7, T12): else no permit is asked for."""
        ...

    def set_option(self, setting: str, value: Any) -> None:
        """An open question of the family is answered for this drive."""
        ...

    def on_sent(self, request: Any) -> None:
        """This request has left: shadows follow."""
        ...


def decode_whole_request(codec: Codec, frame: bytes) -> Any | None:
    """The message of bytes that are exactly one whole request; None for all other bytes, which may move."""
    try:
        verdict = codec.decode_request(frame)
    except ProtocolError:
        return None
    return verdict.message if isinstance(verdict, Complete) and verdict.size == len(frame) else None


def signal_reading(signal: Signal, raw: int, at: float | None) -> Reading:
    """A raw word as the profile scales it, checked for its coding and plausible range (RELIABILITY 4)."""
    try:
        value = signal.scale.value(raw)
    except ValueError:
        return Reading(None, signal.unit, Quality.BAD, at, "drives.not_decimal", raw)
    return with_plausibility(signal, Reading(value, signal.unit, Quality.GOOD, at, None, raw))


def parameter_reading(parameter: Parameter, raw: int, at: float | None) -> Reading:
    """A parameter's raw word as the profile scales it."""
    try:
        value = parameter.scale.value(raw)
    except ValueError:
        return Reading(None, parameter.unit, Quality.BAD, at, "drives.not_decimal", raw)
    return Reading(value, parameter.unit, Quality.GOOD, at, None, raw)


def with_plausibility(signal: Signal, reading: Reading) -> Reading:
    """The reading, uncertain where the profile's range or its unpublished scale says so."""
    value = reading.value
    if isinstance(value, (int, float)) and _is_out_of_range(signal, value):
        return replace(reading, quality=Quality.UNCERTAIN, reason="drives.implausible")
    if signal.uncertain:
        return replace(reading, quality=Quality.UNCERTAIN, reason=signal.uncertain)
    return reading


def _is_out_of_range(signal: Signal, value: float) -> bool:
    below = signal.minimum is not None and value < signal.minimum
    return below or (signal.maximum is not None and value > signal.maximum)


def frequency_word(profile: DriveProfile, frequency_hz: float) -> int:
    """The setpoint's raw word by the profile's scale. Raises LimitError where it fits no word."""
    try:
        return profile.setpoint_scale.raw(frequency_hz)
    except ValueError as error:
        raise LimitError("drives.no_word", frequency_hz=frequency_hz, step_hz=profile.setpoint_scale.factor) from error


UNNAMED_FAULT_CODE = -1
"""Fault code where the drive says that there is a fault and not which."""


def setpoint_matches(readings: ReadingPairs, profile: DriveProfile, frequency_hz: float) -> bool | None:
    """Two agreeing reads of the set frequency, against what was asked for, to one step of the setpoint."""
    pair = readings.pair("set_frequency")
    if pair is None or "set_frequency" not in profile.signals:
        return None
    step = profile.setpoint_scale.factor
    return all(isinstance(r.value, (int, float)) and abs(r.value - frequency_hz) <= step for r in pair)


def fault_from_code(profile: DriveProfile, code: int) -> Fault:
    """The fault of a code, with the maker's words where published."""
    if code == UNNAMED_FAULT_CODE:
        words = {language: i18n.text("drives.unnamed_fault", language) for language in i18n.LANGUAGES}
        return Fault(code, "", Text(words["en"], words["zh"]))
    entry = profile.fault(code)
    return Fault(entry.code, entry.label, entry.text, entry.cause, entry.remedy)


def signals_by_index(profile: DriveProfile, space: str) -> dict[int, list[Signal]]:
    """Signals of one address space by index."""
    found: dict[int, list[Signal]] = {}
    for signal in profile.signals.values():
        if signal.locator[0] == space:
            found.setdefault(signal.locator[1], []).append(signal)
    return found


def shortest_period_s(profile: DriveProfile, names: tuple[str, ...], default_s: float = 0.5) -> float:
    """The shortest period of these signals."""
    return min((profile.signals[name].period_s for name in names if name in profile.signals), default=default_s)
