"""What a profile says of a drive model: values only; ``load`` makes them from TOML.

A locator is ``(space, index)``: C320 ("monitor", n) and ("parameter", group << 8 | item) and ("identity", group);
DZB100 ("query", n) and ("parameter", n); Modbus ("holding", register).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final, Literal

from drivebus import i18n
from drivebus.serial_settings import StationTiming
from drivebus.values import Scale

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
    uncertain: str | None = None
    """An i18n key where every reading of it is at best uncertain (its scale is not published): the reading's reason."""


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
    """The factory setting as a value, not as a raw word."""
    evidence: Evidence = Evidence("assumed", "")
    readable: bool = True
    """False for a write-only register (VC660 2002H ..., DF800 2000H)."""
    listed: bool = True
    """False where the profile does not know it and only the notation gave its address: raw word, no range."""
    uncertain: str | None = None
    """As a signal's: an i18n key where the scale is not published."""


@dataclass(frozen=True, slots=True)
class Precondition:
    """A parameter that must hold a value before the drive obeys the bus (ruling 4)."""

    notation: str
    accepted: tuple[int, ...]
    """Raw values, any of which will do."""
    keypad: Text
    """The keypad step that mends it."""
    unreadable: Text | None = None
    """Set where the host can't read it: why, and what to supply. Then the user is told, nothing is assumed."""


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
    jog_forward, jog_reverse, jog_stop, pause, hold_ramp. What is absent the model can't do.
    ``resolved`` puts in the bits that an open question's setting decides (DF800: direction_field)."""

    register: int
    bits: Mapping[str, CommandBit]
    setpoint_register: int
    rewrite_levels_after_pulse: bool = False
    function: int = 6
    variants: Mapping[str, Mapping[str, Mapping[str, CommandBit]]] = field(default_factory=dict)
    """Setting → its value → bits that stand only under that value."""

    def resolved(self, settings: Mapping[str, Any]) -> CommandMap:
        """The map under these settings, all bits in ``bits``. A setting without a known value adds none."""
        bits = dict(self.bits)
        for setting, choices in self.variants.items():
            bits |= choices.get(str(settings.get(setting)), {})
        return replace(self, bits=bits, variants={})


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
class CommLossParameters:
    """What the drive does when its host falls silent, read from the drive where it can be."""

    time_notation: str | None = None
    action_notation: str | None = None
    trips_values: tuple[int, ...] = ()
    """Raw values of the action parameter that stop the motor; empty where not published."""


@dataclass(frozen=True, slots=True)
class WriteSupport:
    """RAM and EEPROM writes (ruling 8)."""

    ram: bool
    """The drive can write without saving."""
    eeprom: bool = True
    eeprom_address_bit: int | None = None
    """VC660: index | 8000H saves as well."""


@dataclass(frozen=True, slots=True)
class ModbusFeatures:
    """What a Modbus model bends."""

    functions: tuple[int, ...] = (3, 6)
    max_read: int = 125
    error_form: Literal["exception", "short"] = "exception"
    """"short": function unchanged and one byte 00 (DF800); exceptions are accepted as well."""
    loopback: bool = False


@dataclass(frozen=True, slots=True)
class FrequencyLimits:
    """Frequency limits of the model in Hz until the drive or the user says narrower."""

    minimum_hz: float
    maximum_hz: float


@dataclass(frozen=True, slots=True)
class SerialDefaults:
    """Factory line settings and what can be chosen."""

    baud: int
    format: str
    bauds: tuple[int, ...]
    formats: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class OpenQuestion:
    """What nothing in the manuals settles: a setting, its default, why, and how to settle it."""

    setting: str
    default: str | int | float | bool
    choices: tuple[str | int | float | bool, ...]
    """The values it can have; empty where any value of the default's type will do."""
    text: Text
    reason: Text
    settle: Text
    where: str | None = None
    """Part of the profile that answers it (``[timing]``); None: a setting, in ``settings`` too."""
    span: tuple[int, int] | None = None
    """Any whole number from the first to the second is a choice as well."""


Style = Literal["sifang", "dzb", "consecutive", "hundreds", "register"]


@dataclass(frozen=True, slots=True)
class NotationRule:
    """How the manual's parameter notation becomes an address; see ``profiles.notation``."""

    style: Style
    highest: int
    """Largest parameter address (the index part of the locator)."""


JogFrequency = Literal["drive", "asked", "either"]
"""drive: its own setting, the bus can't say it; asked: every jog frame carries it; either: asked, else its own."""
JOG_FREQUENCY_BY_FAMILY: Final[Mapping[str, JogFrequency]] = {"sifang": "either", "dzb": "asked", "modbus": "drive"}


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
    serial: SerialDefaults
    timing: StationTiming
    limits: FrequencyLimits
    capabilities: frozenset[str]
    """Of: run, reverse, stop, coast, quick_stop, jog, set_frequency, reset_fault, read, write, write_ram, save,
    identify, broadcast_stop, status. Anything else is refused before sending."""
    signals: Mapping[str, Signal]
    parameters: Mapping[str, Parameter]
    preconditions: tuple[Precondition, ...]
    faults: Mapping[int, FaultEntry]
    write_support: WriteSupport
    comm_loss: CommLossParameters
    caveats: tuple[Caveat, ...]
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Open questions of the family as settings with their value, e.g. monitor_index, setpoint_coding, parity,
    direction_field; see ``settings`` of the family's page."""
    setpoint_scale: Scale = Scale(0.01, decimals=2)
    modbus: ModbusFeatures | None = None
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
    open_questions: tuple[OpenQuestion, ...] = ()
    notation: NotationRule = NotationRule("register", 0xFFFF)
    unplaced: Mapping[str, Text] = field(default_factory=dict)
    """Parameters that the manual names and whose address is unknown until the user supplies something: why."""
    roles: Mapping[str, str] = field(default_factory=dict)
    """Parameters with a part in the protocol, by part: monitor_selector (what a class-4 reply carries), protocol,
    address, baud, format, reply_delay. Absent where unknown."""
    fault_label: str = ""
    """Label of a code that ``faults`` does not list, e.g. ``Fu.{code}``."""
    fault_text: Text | None = None
    """Text of such a code, with a place ``{code}``."""
    evidence: Mapping[str, Evidence] = field(default_factory=dict)
    """Where whole sections come from: line, timing, limits, setpoint, write_rule, comm_loss, commands, status."""

    def fault(self, code: int) -> FaultEntry:
        """The entry of a fault code; one made from label and text above where the maker does not publish it."""
        known = self.faults.get(code)
        if known is not None:
            return known
        text = self.fault_text or Text(*(i18n.text("profiles.fault_undescribed", side) for side in ("en", "zh")))
        return FaultEntry(
            code,
            self.fault_label.replace("{code}", str(code)),
            Text(text.en.replace("{code}", str(code)), text.zh.replace("{code}", str(code))),
        )

    @property
    def jog_frequency(self) -> JogFrequency | None:
        """What decides the frequency of a jog, by the family's frames; None where the model can't jog."""
        return JOG_FREQUENCY_BY_FAMILY[self.family] if "jog" in self.capabilities else None

    def writable_registers(self) -> frozenset[int]:
        """Modbus: the only registers that may ever be written (T12), EEPROM forms not counted."""
        listed = {p.locator[1] for p in self.parameters.values() if p.writable and p.locator[0] == "holding"}
        if self.commands is not None:
            listed |= {self.commands.register, self.commands.setpoint_register}
        return frozenset(listed)
