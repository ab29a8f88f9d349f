"""Profile of a drive model as frozen values; ``load`` builds them from TOML.

A locator is ``(space, index)``, for example ("monitor", n) and ("parameter", group << 8 | item) of the Sunfar family,
("query", n) of the DZB100, ("holding", register) of Modbus, whose other spaces are "input", "coil" and "discrete".
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from typing import Any, Literal

from drivebus.profiles.words import CommandMap, StatusMap
from drivebus.protocols.family import JogFrequency, Locator, protocol_family
from drivebus.serial_settings import StationTiming
from drivebus.values import Scale, Text, bilingual_text


@dataclass(frozen=True, slots=True)
class Evidence:
    """Origin of a fact."""

    kind: Literal["manual", "computed", "sister", "program", "assumed", "user", "measured"]
    source: Text = Text("", "")


@dataclass(frozen=True, slots=True)
class Caveat:
    """Warning for the user, with an id and its source."""

    id: str
    text: Text
    evidence: Evidence


@dataclass(frozen=True, slots=True, kw_only=True)
class Signal:
    """Value that is polled."""

    name: str
    """The names state, set_frequency, output_frequency, output_current, output_voltage, output_power, output_speed,
    dc_bus_voltage, temperature and fault mean the same in every profile; any other name is the profile's own."""
    notation: str
    """The manual's own: d.0, 3002H, Q01."""
    locator: Locator
    text: Text
    unit: str = ""
    scale: Scale = Scale()
    period_s: float = 1.0
    minimum: float | None = None
    maximum: float | None = None
    """Plausible range: a reading outside it is uncertain."""
    evidence: Evidence = Evidence("assumed")
    uncertain: str | None = None
    """i18n key of the reason why every reading is at best uncertain, as when the scale is not published."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Parameter:
    """Parameter of the drive."""

    notation: str
    locator: Locator
    text: Text
    unit: str = ""
    scale: Scale = Scale()
    minimum: float | None = None
    maximum: float | None = None
    writable: bool = True
    choices: Mapping[int, Text] = field(default_factory=dict)
    choices_complete: bool = True
    """False where the manual names the choices as examples only: the drive accepts others."""
    help: Text | None = None
    caveat: str | None = None
    factory: float | None = None
    """The factory setting as a value, not as a raw word."""
    evidence: Evidence = Evidence("assumed")
    readable: bool = True
    """False for a write-only register (VC660 2002H ..., DF800 2000H)."""
    listed: bool = True
    """False where only the notation gave the address: a raw word without range."""
    uncertain: str | None = None
    """i18n key of the reason why its value is uncertain."""


@dataclass(frozen=True, slots=True)
class UnplacedParameter:
    """Parameter whose address the manual does not give, with what the user has to supply."""

    parameter: Parameter
    """Its locator is ("unplaced", 0): it can't be read or written."""
    reason: Text


@dataclass(frozen=True, slots=True)
class Precondition:
    """Parameter that must have a value before the drive accepts commands from the bus."""

    notation: str
    accepted: tuple[int, ...]
    """Raw values that are accepted."""
    keypad: Text
    """Keypad step that sets it."""
    unreadable: Text | None = None
    """Reason why the host can't read it, and what to supply; the user sees this instead of an assumed value."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultEntry:
    """Fault code: label on the keypad, text, and cause and remedy where the maker gives them."""

    code: int
    label: str
    text: Text
    cause: Text | None = None
    remedy: Text | None = None
    evidence: Evidence | None = None
    """Origin of its texts; None for the general text of a code that the profile does not list."""


POLE_PAIRS = "pole_pairs"
"""Option of a model whose setpoint is a speed: the pole pairs of the motor, 0 for unknown."""
MAX_POLE_PAIRS = 24
MAXIMUM_FREQUENCY = "maximum_frequency"
"""Option of a model whose setpoint is a share: the confirmed maximum frequency in Hz, 0 for none."""
SETPOINT_STEP = "setpoint_step"
"""Option of a model whose step of the setpoint nothing proves: the step in Hz as text, or UNDETERMINED."""
UNDETERMINED = "unknown"
USUAL_STEPS_HZ = (0.01, 0.1)
"""Steps that a drive may count in where a profile only assumes one of them."""


@dataclass(frozen=True, slots=True)
class SetpointShare:
    """Setpoint as a share of the drive's maximum frequency."""

    full_scale: int
    """Word that means the maximum frequency."""
    maximum: str | None
    """Notation of the parameter that holds the maximum frequency in Hz; None where it can't be read."""
    maximum_hz: float | None
    """Stated maximum frequency, in force until it is confirmed."""
    lowest_hz: float
    highest_hz: float
    """Smallest and largest maximum frequency that a drive of the model can be set to."""


@dataclass(frozen=True, slots=True)
class CommLossParameters:
    """Parameters that decide what the drive does when communication is lost."""

    time_notation: str | None = None
    action_notation: str | None = None
    trips_values: tuple[int, ...] = ()
    """Raw values of the action parameter that stop the motor; empty where not published."""


@dataclass(frozen=True, slots=True)
class WriteSupport:
    """Kinds of parameter writes; an EEPROM write wears the memory."""

    ram: bool
    """The drive can write without saving."""
    eeprom: bool = True
    eeprom_address_bit: int | None = None
    """Address bit that makes a write go to EEPROM as well (VC660: 8000H)."""
    ram_address_mask: int | None = None
    """Bits of a parameter's address that are 0 in the address that writes RAM only, which can't be read."""

    def address(self, register: int, *, save: bool) -> int:
        """Return the address that writes a parameter, to EEPROM as well where it is to be saved."""
        if save:
            return register | (self.eeprom_address_bit or 0)
        return register & ~(self.ram_address_mask or 0)

    def saves(self, register: int, written: int) -> bool:
        """Return whether a write of a parameter to this address goes to EEPROM."""
        return not self.ram or (written == self.address(register, save=True) != self.address(register, save=False))


@dataclass(frozen=True, slots=True, kw_only=True)
class ModbusFeatures:
    """Modbus functions and limits of a model."""

    functions: tuple[int, ...]
    max_read: int
    error_form: Literal["exception", "short"]
    """"short": function unchanged and one byte 00 (DF800); exceptions are accepted as well."""
    loopback: bool
    word_order: Literal["high_first", "low_first"]
    """Order of the registers of a number that has two."""
    blocks: tuple[tuple[int, int], ...]
    """First register and count of each block of holding registers that is read only as a whole."""
    reply_count_bytes: int
    """Bytes of the byte count in the reply to a read (Huanyang H2A: 2)."""
    rejected_read: int | None
    """Registers of a read that only exception 03 answers, and that no other read is answered by: the sync probe."""
    sync_block: tuple[int, int] | None
    """The block that function 04 reads as the sync probe; None where two neighbouring registers or FC08 serve."""


@dataclass(frozen=True, slots=True)
class FrequencyLimits:
    """Frequency limits of the model in Hz; drive and user may narrow them."""

    minimum_hz: float
    maximum_hz: float


@dataclass(frozen=True, slots=True)
class SerialDefaults:
    """Factory serial settings, and the values that can be chosen."""

    baud: int
    format: str
    bauds: tuple[int, ...]
    formats: tuple[str, ...]


def is_choice(value: object, choices: Iterable[object], span: Sequence[int] | None) -> bool:
    """Return whether a value is one of the choices, of the same type, or a whole number from span[0] to span[1]."""
    if span is not None and type(value) is int and span[0] <= value <= span[1]:
        return True
    return any(type(value) is type(choice) and value == choice for choice in choices)


@dataclass(frozen=True, slots=True, kw_only=True)
class OpenQuestion:
    """Behaviour that the manuals leave open, with the value in force, the reason, and how to determine it."""

    name: str
    value: str | int | float | bool | Text
    """Words where the answer is no value of a file."""
    choices: tuple[str | int | float | bool, ...]
    """Allowed values; empty where any value of the same type is allowed."""
    text: Text
    reason: Text
    procedure: Text
    where: str | None = None
    """Part of the profile that holds the answer (``[timing]``); None for an option."""
    span: tuple[int, int] | None = None
    """Any whole number from the first to the second is a choice as well."""

    def allows(self, value: object) -> bool:
        """Return whether the option may have this value."""
        if not (self.choices or self.span):
            return type(value) is type(self.value)
        return is_choice(value, self.choices, self.span)

    @property
    def expected(self) -> tuple[str, ...]:
        """The values that the option may have, or their type."""
        span = [f"{self.span[0]} … {self.span[1]}"] if self.span else []
        shown = [str(choice).lower() if isinstance(choice, bool) else str(choice) for choice in self.choices]
        return (*shown, *span) or (type(self.value).__name__,)


@dataclass(frozen=True, slots=True)
class NotationRule:
    """Notation style of a manual; see ``ProtocolFamily.notations``."""

    family: str
    style: str
    highest: int
    """Largest parameter address (the index part of the locator)."""


@dataclass(frozen=True, slots=True)
class IdentityCodes:
    """Register whose code names the model among those with the same map."""

    register: int
    models: Mapping[int, tuple[str, ...]]
    """Code to the models that report it."""

    def names_other(self, code: int, model: str) -> bool:
        """Return whether a code is that of other models only, where the code of this one is known."""
        has_code = any(model in names for names in self.models.values())
        return has_code and code in self.models and model not in self.models[code]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)  # by identity: it can be the key of a cache
class DriveProfile:
    """Everything that drivebus knows of one drive model."""

    model: str
    """Name used with ``--model``: c320, dzb100, …"""
    maker: Text
    title: Text
    family: str
    """Name of its ``ProtocolFamily``."""
    grade: Literal["draft", "simulated", "verified"]
    """draft: from one source, or from the manual of a related model; simulated: the worked frames of its manual or two
    independent sources agree with it, and so does a simulated drive written from them; verified: tried on hardware."""
    encodings: tuple[str, ...]
    """The first is the default."""
    addresses: tuple[int, int]
    broadcast: int | None
    serial: SerialDefaults
    timing: StationTiming
    limits: FrequencyLimits
    capabilities: frozenset[str]
    """Names of ``schema.Capability``. Any other request is rejected before it is sent."""
    signals: Mapping[str, Signal]
    parameters: Mapping[str, Parameter]
    preconditions: tuple[Precondition, ...]
    faults: Mapping[int, FaultEntry]
    write_support: WriteSupport
    comm_loss: CommLossParameters
    caveats: tuple[Caveat, ...]
    options: Mapping[str, Any]
    """Values of the undocumented options, e.g. monitor_index, setpoint_coding, direction_field."""
    setpoint_scale: Scale
    """Steps of Hz; where the setpoint is a share, those under the largest maximum frequency."""
    setpoint_share: SetpointShare | None
    setpoint_rpm: float | None
    """Revolutions per minute a step, where the setpoint is a speed; None where it counts Hz or a share."""
    modbus: ModbusFeatures | None
    commands: CommandMap | None
    status: StatusMap | None
    identity_register: int | None
    """Register that look-alikes with the same status register do not have; None where the status tells them apart."""
    identity_codes: IdentityCodes | None
    """Codes of the models with this map; None where the drive reports none."""
    group_sizes: Mapping[str, int]
    """Group to its number of parameters, supplied by the user (VC660): gives Fgg.nn its index."""
    ramp_notations: tuple[str, str] | None
    """Parameters of acceleration and deceleration time, where known."""
    keypad: tuple[Text, ...]
    """Keypad steps, in order."""
    wiring: Text | None
    source: str
    """Path of its file."""
    open_questions: tuple[OpenQuestion, ...]
    notation: NotationRule
    unplaced: Mapping[str, UnplacedParameter]
    """Parameters without a known address, by notation."""
    roles: Mapping[str, str]
    """Parameters of the protocol itself: monitor_selector (content of a class-4 reply), protocol, address, baud,
    format, reply_delay. Absent where unknown."""
    fault_label: str
    """Label of a code that ``faults`` does not list, e.g. ``Fu.{code}``."""
    fault_text: Text | None
    """Text of such a code, with the parameter ``{code}``."""
    evidence: Mapping[str, Evidence]
    """Name of a section of the file, such as "serial" → origin of all its facts."""

    def entries(self) -> Iterator[Signal | Parameter]:
        """Return all signals, then all parameters."""
        return chain(self.signals.values(), self.parameters.values())

    def entry_at(self, locator: Locator) -> Signal | Parameter | None:
        """Return the first signal or parameter at an address."""
        return next((entry for entry in self.entries() if entry.locator == locator), None)

    def fault(self, code: int) -> FaultEntry:
        """Return the entry of a fault code; an unpublished code gets the general label and text."""
        known = self.faults.get(code)
        if known is not None:
            return known
        text = self.fault_text or bilingual_text("profiles.fault_undescribed")
        return FaultEntry(
            code=code,
            label=self.fault_label.replace("{code}", str(code)),
            text=text.replace("{code}", str(code)),
        )

    @property
    def jog_frequency(self) -> JogFrequency | None:
        """Source of the frequency of a jog; None where the model can't jog."""
        return protocol_family(self.family).jog_frequency if "jog" in self.capabilities else None

    @property
    def modbus_features(self) -> ModbusFeatures:
        """``modbus`` of a register-based model, whose profile always has it."""
        assert self.modbus is not None
        return self.modbus

    @property
    def command_registers(self) -> frozenset[Locator]:
        """Registers of command word and setpoint, unless the status is read from there."""
        if self.commands is None:
            return frozenset()
        written = {(self.commands.space, self.commands.register), ("holding", self.commands.setpoint_register)}
        return frozenset(written - ({(self.status.space, self.status.register)} if self.status else set()))

    def question(self, option: str) -> OpenQuestion:
        """Return the question that an option of this profile answers."""
        return next(question for question in self.open_questions if question.name == option)

    @property
    def needs_model_check(self) -> bool:
        """Whether a station must answer as this model before its first command: the stop may start another model.

        True where a command word is a number, and where the profile has only one source.
        """
        return self.commands is not None and (bool(self.commands.values) or self.grade == "draft")

    def command_locators(self) -> frozenset[Locator]:
        """Return the addresses of the command word; none where the family has frames of its own for commands."""
        commands = self.commands
        return (
            frozenset((commands.space, commands.register + n) for n in range(commands.words))
            if commands
            else frozenset()
        )

    def setpoint_locators(self) -> frozenset[Locator]:
        """Return the addresses of the set frequency beside the command word."""
        commands = self.commands
        words = range(self.setpoint_scale.words)
        return frozenset(("holding", commands.setpoint_register + n) for n in words) if commands else frozenset()
