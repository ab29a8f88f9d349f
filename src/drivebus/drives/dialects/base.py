"""Interface of the dialects, and the parts that they share.

A dialect turns the intents of an operation into requests of one protocol family, and replies into readings.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from types import MappingProxyType
from typing import Any

from drivebus.bus.messages import RetryPolicy, StationConfig
from drivebus.drives.dialects.setpoint_share import check_setpoint_share, setpoint_scale, share_cap_hz, share_word
from drivebus.drives.dialects.setpoint_speed import check_pole_pairs
from drivebus.drives.dialects.setpoint_step import check_setpoint_step, step_cap_hz
from drivebus.drives.readings import ReadingPairs, Readings
from drivebus.drives.state import FAULT_LABEL_SEPARATOR, DerivedState, Direction, Fault
from drivebus.errors import CapabilityError, LimitError, ProtocolError
from drivebus.profiles.model import DriveProfile, Parameter, Signal
from drivebus.protocols.codec import Codec, Complete, Effect
from drivebus.serial_settings import StationTiming
from drivebus.types import Json
from drivebus.values import Quality, Reading, Text, bilingual_text

DEFAULT_NONCE_START = 0x5AA5
"""First number of the numbered sync probes where nothing is sent, or where a run must repeat."""


class StopMode(StrEnum):
    """Way to stop; the value is the capability that a profile must have."""

    STOP = "stop"
    COAST = "coast"
    QUICK_STOP = "quick_stop"
    JOG_STOP = "jog"


class Hold(StrEnum):
    """Level that keeps a running motor from its set frequency; the value is the capability that a profile must have."""

    PAUSE = "pause"
    """The motor ramps down to 0 Hz and runs again with the next start."""
    RAMP = "hold_ramp"
    """The output frequency stays where it is."""


@dataclass(frozen=True, slots=True)
class CommandFrame:
    """Frame of a command and its retry policy."""

    request: Any
    retry_policy: RetryPolicy


@dataclass(frozen=True, slots=True)
class Rejection:
    """Rejection by the drive: an i18n key, and the drive's code where it gives one."""

    key: str
    code: int | None
    may_be_executed: bool = False
    """Whether the drive may execute the request nevertheless."""
    remedy_key: str | None = None
    """Key of the sentence that names the next step after a rejected command."""

    @property
    def text(self) -> Text:
        """The sentence in both languages."""
        return bilingual_text(self.key, code=self.code)

    @property
    def explains_code(self) -> bool:
        """Whether the sentence is the meaning of this one code in the manual, and so needs no parameter."""
        return self.code is not None and self.key.endswith(f"_{self.code}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Identity:
    """Identity of a drive. ``reported`` False: the model has none that can be read, it only answers."""

    model: str
    reported: bool
    voltage_class_v: int | None = None
    power_kw: float | None = None
    models: tuple[str, ...] = ()
    """Models that report the same; empty where the profile lists no such codes."""
    digits: tuple[tuple[str, str], ...] = ()
    """Part (model, series, version, control) and its six digits; "-" where a fault hides one."""
    host_controls: bool | None = None
    host_sets_frequency: bool | None = None

    def as_json(self) -> Json:
        """Return what a drive reports about itself; None for what it does not report."""
        return {
            "voltage_class_v": self.voltage_class_v,
            "power_kw": self.power_kw,
            "digits": dict(self.digits),
            "host_controls": self.host_controls,
            "host_sets_frequency": self.host_sets_frequency,
        }


class Dialect(ABC):
    """Protocol of one drive, without clock: it keeps only counters and the levels that were sent last.

    A method that is not abstract is that of a drive without the feature, or follows the profile.
    """

    codec: Codec
    station_config: StationConfig
    state_names: tuple[str, ...]
    """Readings that the derived state depends on."""

    def __init__(self, profile: DriveProfile, address: int, options: dict[str, Any]) -> None:
        self.profile, self.address, self.options = profile, address, options
        self.contact_losses = 0
        """``Bus.contact_losses`` when the station was last found to answer."""

    def _make_station_config(
        self, timing: StationTiming, effect_of: Callable[[bytes], Effect], **more: Any
    ) -> StationConfig:
        """Return the configuration of the station for the bus; ``more``: further fields of it."""
        return StationConfig(
            address=self.address,
            codec=self.codec,
            timing=timing,
            effect_of=effect_of,
            sync_request=self._bus_sync_request,
            label=self.profile.model,
            **more,
        )

    @abstractmethod
    def _bus_sync_request(self, n: int) -> Any:
        """Return sync probe ``n`` of the bus; ``n`` counts up."""

    @property
    @abstractmethod
    def reports_run_state(self) -> bool:
        """Whether the replies of the drive show that it runs."""

    @property
    @abstractmethod
    def start_includes_setpoint(self) -> bool:
        """Whether the start frame carries the frequency."""

    @abstractmethod
    def sync_request(self, avoid: Any = None) -> Any:
        """Return the next sync probe of an operation: not one that the bus uses, nor one like ``avoid``."""

    @abstractmethod
    def is_valid_sync_reply(self, reply: Any) -> bool:
        """Return whether a reply to a sync probe echoes enough to belong to it."""

    @abstractmethod
    def needs_sync(self, request: Any) -> bool:
        """Return whether the reply to a request looks like that to another class: it needs a sync probe before it."""

    def follow_contact_losses(self, count: int) -> None:
        """Require the model check again where the station was lost since the last call: another drive may answer."""
        if count != self.contact_losses:
            self.contact_losses = count
            self._forget_model()

    def _forget_model(self) -> None:
        """Require the model check again, where the model has one."""
        return

    def model_check(self) -> Any | None:
        """Return the read that shows whether the station is of this model; None where none is needed, or no more."""
        return None

    def preparation_frame(self, word: int) -> CommandFrame:
        """Return the frame of a word that the profile lists before a start. Raises CapabilityError without one."""
        raise CapabilityError("drives.cannot", model=self.profile.model, what="run")

    def unlock(self) -> Any | None:
        """Return the write without which the drive rejects every command; None where it needs none."""
        return None

    @abstractmethod
    def state_reads(self) -> tuple[Any, ...]:
        """Return the smallest set of reads that shows state, direction and fault."""

    @abstractmethod
    def echo_test_read(self) -> Any:
        """Return a read whose reply differs from it, which shows that a port has no echo."""

    def fault_reads(self) -> tuple[Any, ...]:
        """Return further reads that name a fault; empty where the state carries its code."""
        return ()

    @abstractmethod
    def setpoint_reads(self) -> tuple[Any, ...]:
        """Return reads that show the set frequency; empty where none does."""

    def setpoint_matches(self, readings: ReadingPairs, word: int, frequency_hz: float) -> bool | None:
        """Return whether the last two reads of the set frequency match what was sent; None where they can't show it."""
        return setpoint_matches(readings, self.profile, frequency_hz)

    @abstractmethod
    def can_confirm_speed(self) -> bool:
        """Return whether the drive shows that it runs at the set frequency."""

    @abstractmethod
    def polls(self, names: tuple[str, ...]) -> tuple[tuple[Any, float], ...]:
        """Return requests and periods that keep these signals and the state current, and read nothing else."""

    @abstractmethod
    def decode_readings(self, request: Any, reply: Any, at: float | None) -> Readings:
        """Return the readings of a reply; none for the reply to a command."""

    @abstractmethod
    def derive_state(self, readings: ReadingPairs) -> DerivedState | None:
        """Derive state, direction and fault from the last two readings; None where they do not agree."""

    def confirms_stop(self, readings: ReadingPairs) -> bool:
        """Return whether the last two readings confirm a stop by the family's own sign (DZB100: Q03's A)."""
        return True

    def confirms_start(self, readings: ReadingPairs) -> bool:
        """Return whether the last two readings show that a start was the last command (DZB100: Q03's A)."""
        return False

    @abstractmethod
    def rejection(self, reply: Any) -> Rejection | None:
        """Return the rejection that a reply carries, or None."""

    def setpoint_word(self, frequency_hz: float) -> int:
        """Return the raw word of a frequency. Raises LimitError where the coding forbids it."""
        return frequency_word(self.profile, frequency_hz, self.options)

    @property
    def setpoint_cap_hz(self) -> float | None:
        """Highest frequency that is sent while the scale of the setpoint is not determined; None: no cap holds."""
        caps_hz = (step_cap_hz(self.profile, self.options), share_cap_hz(self.profile, self.options))
        return min((cap_hz for cap_hz in caps_hz if cap_hz is not None), default=None)

    def setpoint_frequency(self, word: int) -> float:
        """Return the frequency of a setpoint word in Hz (DZB100: under the coding in force)."""
        return self.profile.setpoint_scale.value(word)

    @abstractmethod
    def start(self, direction: Direction | None, word: int) -> tuple[CommandFrame, ...]:
        """Return the start frame and the frames that must follow it. Raises CapabilityError or StartInhibited."""

    @abstractmethod
    def set_frequency(self, word: int, readings: ReadingPairs) -> tuple[CommandFrame, ...]:
        """Return the frames that change the frequency. Raises CapabilityError or StartInhibited."""

    def jog(self, direction: Direction, word: int | None) -> tuple[CommandFrame, ...]:
        """Return the frames that begin a jog. Raises CapabilityError for a drive without one.

        ``word`` None is the drive's own jog frequency.
        """
        raise CapabilityError("drives.cannot", model=self.profile.model, what="jog")

    @abstractmethod
    def stop(self, mode: StopMode) -> tuple[Any, ...]:
        """Return the requests of a stop and those that must follow it. Raises CapabilityError."""

    @abstractmethod
    def broadcast_stop(self) -> tuple[Any, ...]:
        """Return the family's broadcast stop; empty where it has none."""

    def reset(self) -> tuple[CommandFrame, ...]:
        """Return the frames of a fault reset. Raises CapabilityError for a drive without one."""
        raise CapabilityError("drives.cannot", model=self.profile.model, what="reset_fault")

    def adopt_direction(self, readings: ReadingPairs) -> None:
        """Adopt the set direction of a verified state for the next hold: another program may have changed it."""
        return

    def hold(self, hold: Hold) -> CommandFrame:
        """Return the frame that begins a hold. Raises CapabilityError for a drive without it."""
        raise CapabilityError("drives.cannot", model=self.profile.model, what=hold.value)

    def end_hold(self) -> CommandFrame:
        """Return the frame that ends a hold without a start. Raises CapabilityError for a drive without one."""
        raise CapabilityError("drives.cannot", model=self.profile.model, what=Hold.RAMP.value)

    def identity_reads(self) -> tuple[Any, ...]:
        """Return the reads of the identity (C320: class 0, Modbus: the model code); empty where there is none."""
        return ()

    def decode_identity(self, replies: tuple[Any, ...]) -> Identity:
        """Return the identity in the replies to ``identity_reads``; None stands for a read without a valid reply."""
        return Identity(model=self.profile.model, reported=False)

    @abstractmethod
    def read_parameter(self, parameter: Parameter) -> Any:
        """Return the request that reads a parameter."""

    @abstractmethod
    def parameter_raw(self, reply: Any) -> int | None:
        """Return the raw word in the reply of a parameter read; None where it carries none."""

    @abstractmethod
    def names_parameter(self, reply: Any) -> bool:
        """Return whether the reply to a parameter read has every field that it should repeat (C320: not in a fault)."""

    def read_rejection_key(self, reply: Any) -> str:
        """Return the i18n key of the reason why a rejected read has no value: the meaning of its code, if published."""
        rejection = self.rejection(reply)
        return rejection.key if rejection is not None and rejection.explains_code else "drives.read_refused"

    def parameter_reading(self, parameter: Parameter, raw: int, at: float | None) -> Reading:
        """Return the reading of a parameter's raw word."""
        return parameter_reading(parameter, raw, at)

    def parameter_word(self, parameter: Parameter, value: float) -> int:
        """Return the raw word of a parameter's value. Raises ValueError where none fits."""
        return parameter.scale.raw(value)

    @abstractmethod
    def write_parameter(self, parameter: Parameter, raw: int, *, save: bool) -> CommandFrame:
        """Return the frame that writes a parameter to RAM or EEPROM."""

    @abstractmethod
    def is_allowed(self, frame: bytes) -> bool:
        """Return whether an encoded request is on the family's allow-list; otherwise it never gets a permit."""

    def set_option(self, option: str, value: Any) -> None:
        """Set an undocumented option of the family for this drive."""
        self.options[option] = value

    def on_accepted(self, request: Any) -> None:
        """Record that the drive has accepted a request, after ``on_sent``: its levels and options may be others now."""
        return

    def on_sent(self, request: Any) -> None:
        """Record that a request was sent: the levels that the drive holds may be others now."""
        return


def decode_whole_request(codec: Codec, frame: bytes) -> Any | None:
    """Return the message of bytes that are exactly one request; None for all other bytes, which may move the motor."""
    try:
        result = codec.decode_request(frame)
    except ProtocolError:
        return None
    return result.message if isinstance(result, Complete) and result.size == len(frame) else None


def signal_reading(signal: Signal, raw: int, at: float | None) -> Reading:
    """Return the reading of a signal's raw word, checked for its coding and plausible range."""
    reading = _scaled_reading(signal, raw, at)
    return reading if reading.quality is Quality.BAD else with_plausibility(signal, reading)


def parameter_reading(parameter: Parameter, raw: int, at: float | None) -> Reading:
    """Return the reading of a parameter's raw word by the profile's scale."""
    reading = _scaled_reading(parameter, raw, at)
    return reading if reading.quality is Quality.BAD else _with_uncertainty(parameter, reading)


def _scaled_reading(entry: Signal | Parameter, raw: int, at: float | None) -> Reading:
    """Return the value of a raw word as a good reading, or a bad one where its coding forbids the word."""
    try:
        value = entry.scale.value(raw)
    except ValueError:
        return Reading(
            value=None, unit=entry.unit, quality=Quality.BAD, source_time=at, reason="drives.not_decimal", raw=raw
        )
    return Reading(value=value, unit=entry.unit, quality=Quality.GOOD, source_time=at, reason=None, raw=raw)


def _with_uncertainty(entry: Signal | Parameter, reading: Reading) -> Reading:
    """Return the reading, as uncertain where the scale of its entry is not published."""
    return replace(reading, quality=Quality.UNCERTAIN, reason=entry.uncertain) if entry.uncertain else reading


def with_plausibility(signal: Signal, reading: Reading) -> Reading:
    """Return the reading, as uncertain where it is outside the profile's range or its scale is not published."""
    value = reading.value
    if isinstance(value, (int, float)) and _is_out_of_range(signal, value):
        return replace(reading, quality=Quality.UNCERTAIN, reason="drives.implausible")
    return _with_uncertainty(signal, reading)


def without_item_echo(reading: Reading) -> Reading:
    """Return the reading of a reply that does not name its item, as uncertain (C320 in a fault)."""
    return replace(reading, quality=Quality.UNCERTAIN, reason="drives.item_not_echoed")


def _is_out_of_range(signal: Signal, value: float) -> bool:
    below = signal.minimum is not None and value < signal.minimum
    return below or (signal.maximum is not None and value > signal.maximum)


NO_OPTIONS: Mapping[str, Any] = MappingProxyType({})


def frequency_word(profile: DriveProfile, frequency_hz: float, options: Mapping[str, Any] = NO_OPTIONS) -> int:
    """Return the raw word of a frequency by the profile's scale.

    Raises LimitError where none fits, or where the drive may count in another step by its ``options``.
    """
    check_pole_pairs(profile, options, frequency_hz)
    try:
        counts_hz = profile.setpoint_share is None and profile.setpoint_rpm is None
        word = profile.setpoint_scale.raw(frequency_hz) if counts_hz else share_word(profile, options, frequency_hz)
    except ValueError as error:
        raise LimitError("drives.no_word", frequency_hz=frequency_hz, step_hz=profile.setpoint_scale.factor) from error
    check_setpoint_step(profile, options, frequency_hz, word)
    check_setpoint_share(profile, options, frequency_hz, word)
    return word


UNNAMED_FAULT_CODE = -1
"""Fault code of a drive that reports a fault without naming it."""


def setpoint_matches(
    readings: ReadingPairs, profile: DriveProfile, frequency_hz: float, options: Mapping[str, Any] = NO_OPTIONS
) -> bool | None:
    """Return whether two reads of the set frequency match a frequency, to one step of the setpoint."""
    pair = readings.pair("set_frequency")
    if pair is None or "set_frequency" not in profile.signals:
        return None
    step = setpoint_scale(profile, options).factor
    return all(isinstance(r.value, (int, float)) and abs(r.value - frequency_hz) <= step for r in pair)


def reported_fault(profile: DriveProfile, derived: DerivedState) -> Fault | None:
    """Return the fault of a state, with the maker's text where published; several faults are one with all texts."""
    if derived.fault_code is None:
        return None
    faults = [_fault_from_code(profile, code) for code in (derived.fault_code, *derived.further_fault_codes)]
    return Fault(
        code=faults[0].code,
        label=FAULT_LABEL_SEPARATOR.join(fault.label for fault in faults if fault.label),
        text=_join_texts([fault.text for fault in faults]) or Text("", ""),
        cause=_join_texts([fault.cause for fault in faults if fault.cause]),
        remedy=_join_texts([fault.remedy for fault in faults if fault.remedy]),
    )


def _fault_from_code(profile: DriveProfile, code: int) -> Fault:
    if code == UNNAMED_FAULT_CODE:
        return Fault(code, "", bilingual_text("drives.unnamed_fault"))
    entry = profile.fault(code)
    return Fault(entry.code, entry.label, entry.text, entry.cause, entry.remedy)


def _join_texts(texts: list[Text]) -> Text | None:
    return Text.join(texts, "clauses") if texts else None


def signals_by_index(profile: DriveProfile, space: str) -> dict[int, list[Signal]]:
    """Return the signals of one address space by index."""
    by_index: dict[int, list[Signal]] = {}
    for signal in profile.signals.values():
        if signal.locator[0] == space:
            by_index.setdefault(signal.locator[1], []).append(signal)
    return by_index


DEFAULT_POLL_PERIOD_S = 0.5
"""Period of a poll of which the profile describes no signal, such as that of the state."""


def shortest_period_s(profile: DriveProfile, signals: Iterable[Signal]) -> float:
    """Return the shortest poll period of these signals by the profile in force: a reload can change or lack them."""
    in_force = (profile.signals.get(signal.name, signal) for signal in signals)
    return min((signal.period_s for signal in in_force), default=DEFAULT_POLL_PERIOD_S)
