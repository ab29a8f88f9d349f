"""What a profile says of a drive model: values only; ``load`` makes them from TOML.

A locator is ``(space, index)``: C320 ("monitor", n) and ("parameter", group << 8 | item) and ("identity", group);
DZB100 ("query", n) and ("parameter", n); Modbus ("holding", register).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from drivebus.message import StationTiming
from drivebus.units import Scale

Locator = tuple[str, int]


@dataclass(frozen=True, slots=True)
class Text:
    """A sentence in both languages."""

    en: str
    zh: str


@dataclass(frozen=True, slots=True)
class Evidence:
    """Where a fact comes from."""

    kind: Literal["manual", "computed", "sister", "assumed", "user", "measured"]
    source: str


@dataclass(frozen=True, slots=True)
class Caveat:
    """What the user must know, with an id (T08, …) and its source."""

    id: str
    text: Text
    evidence: Evidence


@dataclass(frozen=True, slots=True)
class Signal:
    """A value read again and again."""

    name: str
    """Canonical: state, set_frequency, output_frequency, output_current, output_voltage, output_power,
    dc_bus_voltage, temperature, fault, …; anything else is the profile's own."""
    notation: str
    """The manual's own: d.0, 3002H, Q01."""
    locator: Locator
    text: Text
    unit: str = ""
    scale: Scale = Scale()
    period_s: float = 1.0
    minimum: float | None = None
    maximum: float | None = None
    """Plausible range: outside it a reading is uncertain (range check of RELIABILITY 4)."""
    evidence: Evidence = Evidence("assumed", "")


@dataclass(frozen=True, slots=True)
class Parameter:
    """A setting of the drive."""

    notation: str
    locator: Locator
    text: Text
    unit: str = ""
    scale: Scale = Scale()
    minimum: float | None = None
    maximum: float | None = None
    writable: bool = True
    choices: Mapping[int, Text] = field(default_factory=dict)
    help: Text | None = None
    caveat: str | None = None
    factory: float | None = None
    evidence: Evidence = Evidence("assumed", "")


@dataclass(frozen=True, slots=True)
class Precondition:
    """A parameter that must hold a value before the drive obeys the bus (ruling 4)."""

    notation: str
    accepted: tuple[int, ...]
    """Raw values, any of which will do."""
    keypad: Text
    """The keypad step that mends it."""


@dataclass(frozen=True, slots=True)
class FaultEntry:
    """One fault code: the keypad's label, the text, cause and remedy where the maker gives them."""

    code: int
    label: str
    text: Text
    cause: Text | None = None
    remedy: Text | None = None


@dataclass(frozen=True, slots=True)
class CommandBit:
    """One bit (or field value under ``mask``) of a Modbus command word."""

    mask: int
    value: int
    pulse: bool = False
    """Acts on its edge; else a level that every write sets."""


@dataclass(frozen=True, slots=True)
class CommandMap:
    """How a Modbus model takes commands. Names: start, stop, coast, quick_stop, reset, forward, reverse,
    jog_forward, jog_reverse, jog_stop, pause, hold_ramp. What is absent the model can't do."""

    register: int
    bits: Mapping[str, CommandBit]
    setpoint_register: int
    rewrite_levels_after_pulse: bool = False
    function: int = 6


@dataclass(frozen=True, slots=True)
class StatusMap:
    """How a Modbus model reports its state: bit masks of one status register, by name: ready, fault, under_voltage,
    running, emergency_stopping, paused, speed_search, dc_braking, jogging, set_reverse, output_reverse."""

    register: int
    bits: Mapping[str, int]
    reserved_mask: int = 0
    """Bits that must read 0; else the word is not believed."""
    fault_registers: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class CommLoss:
    """What the drive does when its host falls silent, read from the drive where it can be."""

    time_notation: str | None = None
    action_notation: str | None = None
    trips_values: tuple[int, ...] = ()
    """Raw values of the action parameter that stop the motor; empty where not published."""


@dataclass(frozen=True, slots=True)
class WriteRule:
    """RAM and EEPROM writes (ruling 8)."""

    ram: bool
    """The drive can write without saving."""
    eeprom: bool = True
    eeprom_address_bit: int | None = None
    """VC660: index | 8000H saves as well."""


@dataclass(frozen=True, slots=True)
class ModbusRule:
    """What a Modbus model bends."""

    functions: tuple[int, ...] = (3, 6)
    max_read: int = 125
    error_form: Literal["exception", "short"] = "exception"
    """"short": function unchanged and one byte 00 (DF800); exceptions are accepted as well."""
    loopback: bool = False


@dataclass(frozen=True, slots=True)
class Limits:
    """Frequency limits of the model in Hz until the drive or the user says narrower."""

    minimum_hz: float
    maximum_hz: float


@dataclass(frozen=True, slots=True)
class LineDefaults:
    """Factory line settings and what can be chosen."""

    baud: int
    format: str
    bauds: tuple[int, ...]
    formats: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class DriveProfile:
    """All that drivebus knows of one drive model."""

    model: str
    """The id used with --model: c320, dzb100, …"""
    maker: Text
    title: Text
    family: Literal["sifang", "dzb", "modbus"]
    grade: Literal["draft", "bench", "proved"]
    """draft: claims only what a sister's manual supports; bench: every worked frame of its manual passes and a
    simulated drive of its own exists; proved: on hardware."""
    encodings: tuple[str, ...]
    """First is the default: ascii, hex, rtu."""
    addresses: tuple[int, int]
    broadcast: int | None
    line: LineDefaults
    timing: StationTiming
    limits: Limits
    capabilities: frozenset[str]
    """Of: run, reverse, stop, coast, quick_stop, jog, set_frequency, reset_fault, read, write, write_ram, save,
    identify, broadcast_stop, status. Anything else is refused before sending."""
    signals: Mapping[str, Signal]
    parameters: Mapping[str, Parameter]
    preconditions: tuple[Precondition, ...]
    faults: Mapping[int, FaultEntry]
    write_rule: WriteRule
    comm_loss: CommLoss
    caveats: tuple[Caveat, ...]
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Open questions of the family as settings with their value, e.g. monitor_index, setpoint_coding, parity,
    direction_field; see ``settings`` of the family's page."""
    setpoint_scale: Scale = Scale(0.01, decimals=2)
    modbus: ModbusRule | None = None
    commands: CommandMap | None = None
    status: StatusMap | None = None
    group_sizes: Mapping[str, int] = field(default_factory=dict)
    """VC660: group → number of parameters, user supplied; gives Fgg.nn their consecutive index."""
    ramp_notations: tuple[str, str] | None = None
    """Parameters of acceleration and deceleration time, where known."""
    keypad: tuple[Text, ...] = ()
    """Keypad steps, in order."""
    wiring: Text | None = None
    source: str = ""
    """File that it was read from."""
    format_version: int = 1
