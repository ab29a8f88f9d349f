"""Schema of a profile file: strict pydantic models without unknown keys; checks of several keys are in ``check``.

A file is TOML with ``format = 1``; docs/reference/profiles.md describes its keys. Each entry that a user may override
has a key of its own (signals by name, parameters and preconditions by notation, faults by code, caveats by id), so that
``extends`` is a plain merge.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, StringConstraints
from pydantic_core import PydanticKnownError

from drivebus.protocols.family import ProtocolFamily, protocol_families
from drivebus.serial_settings import ANY_REPLY_LATENESS_S

NEWEST_FORMAT = 1
"""Newest file format that this version reads."""


def _registered(names: Callable[[ProtocolFamily], Iterable[str]]) -> AfterValidator:
    """Return a check that some registered family has a name; it reports an unknown one as a literal type does."""

    def check(value: str) -> str:
        known = {name: None for family in protocol_families() for name in names(family)}
        if value not in known:
            raise PydanticKnownError("literal_error", {"expected": ", ".join(known) or "-"})
        return value

    return AfterValidator(check)


FamilyName = Annotated[str, _registered(lambda family: [family.name])]
Encoding = Annotated[str, _registered(lambda family: family.encodings)]
NotationName = Annotated[str, _registered(lambda family: family.notations)]
Capability = Literal[
    "run",
    "reverse",
    "stop",
    "coast",
    "quick_stop",
    "pause",
    "hold_ramp",
    "jog",
    "set_frequency",
    "reset_fault",
    "read",
    "write",
    "write_ram",
    "save",
    "identify",
    "broadcast_stop",
    "status",
]
CommandName = Literal[
    "start",
    "stop",
    "coast",
    "quick_stop",
    "reset",
    "forward",
    "reverse",
    "jog_forward",
    "jog_reverse",
    "jog_stop",
    "pause",
    "hold_ramp",
]
StatusName = Literal[
    "ready",
    "fault",
    "under_voltage",
    "running",
    "emergency_stopping",
    "paused",
    "speed_search",
    "dc_braking",
    "jogging",
    "set_reverse",
    "output_reverse",
]
CommandValueName = Literal[
    "start_forward",
    "start_reverse",
    "stop",
    "coast",
    "quick_stop",
    "reset",
    "jog_forward",
    "jog_reverse",
    "jog_stop",
]
StatusValueName = Literal[
    "not_ready",
    "stopped",
    "running",
    "running_forward",
    "running_reverse",
    "jogging",
    "jogging_forward",
    "jogging_reverse",
    "accelerating",
    "decelerating",
    "braking",
    "restarting",
    "paused",
    "fault",
]
Role = Literal["monitor_selector", "protocol", "address", "baud", "format", "reply_delay"]
Unit = Literal["", "Hz", "A", "mA", "V", "kW", "kWh", "°C", "rpm", "s", "ms", "h", "%", "N·m"]
OptionValue = str | int | float | bool
Word = Annotated[int, Field(ge=0, le=0xFFFF)]
Words = Annotated[int, Field(ge=0, le=2**63 - 1)]
"""Number in up to four registers; TOML has no larger one."""
Space = Literal["holding", "input", "coil", "discrete"]
"""Modbus: read by functions 03, 04, 01 and 02."""
Baud = Annotated[int, Field(ge=50, le=4_000_000)]
Name = Annotated[str, StringConstraints(pattern=r"^[a-z][a-z0-9_]*$")]
LanguageCode = Annotated[str, StringConstraints(pattern=r"^[a-z]{2,3}(-[A-Za-z0-9]{2,8})*$")]
"""BCP 47: ``en``, ``zh``, ``pt-BR``."""
Sentence = Annotated[str, StringConstraints(min_length=1)]
MAX_GAP_S = 0.25  # far below the 1 s after which a bus counts as never silent: a longer gap would never be found
MAX_WAIT_S = 1.0  # ten times the slowest of the included models, at 0.1 s
EVIDENCE_PATTERN = r"^(manual|computed|sister|program|assumed|user|measured)([,:]? \S.*)?$"
"""Kind of evidence, then its location."""


class StrictTable(BaseModel):
    """Table without unknown keys and without type coercion."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)


def table_of_text(text: Any) -> Any:
    """Return a plain string as a table of one language. Raises PydanticKnownError for an empty table."""
    if text == {}:
        raise PydanticKnownError("missing", {})
    return {"en": text} if isinstance(text, str) else text


LocalizedText = Annotated[dict[LanguageCode, Sentence], BeforeValidator(table_of_text)]
"""Text by language. A plain string, or a table of one language, serves for all."""


def evidence_kind(line: str) -> str:
    """Return the kind with which a line of evidence begins, or "" where it begins with none."""
    match = re.match(EVIDENCE_PATTERN, line)
    return match[1] if match else ""


def is_assumed(evidence: Mapping[str, str]) -> bool:
    """Return whether evidence is of the kind ``assumed``."""
    return all(evidence_kind(line) == "assumed" for line in evidence.values())


def _table_of_evidence(evidence: Any) -> Any:
    """Return evidence as a table of languages. Raises PydanticKnownError unless all its lines begin with one kind."""
    table = table_of_text(evidence)
    if isinstance(table, dict) and all(isinstance(line, str) for line in table.values()):
        kinds = {evidence_kind(line) for line in table.values()}
        if len(kinds) > 1 or "" in kinds:
            raise PydanticKnownError("string_pattern_mismatch", {"pattern": EVIDENCE_PATTERN})
    return table


EvidenceLines = Annotated[dict[LanguageCode, Sentence], BeforeValidator(_table_of_evidence)]
"""Evidence by language, as ``LocalizedText``: each line begins with the same kind."""


class ScaleTable(StrictTable):
    factor: Annotated[float, Field(gt=0, le=1e6)] = 1.0
    offset: float = 0.0
    coding: Literal["binary", "signed", "bcd"] = "binary"
    decimals: Annotated[int, Field(ge=0, le=4)] = 0
    words: Literal[1, 2] = 1
    """Registers of the number; of two, ``[modbus] word_order`` tells which is first."""


class SetpointTable(StrictTable):
    """Scale of the setpoint. Narrow bounds catch a wrong factor, which could overspeed a motor.

    Either steps of ``factor`` Hz, or a share (``full_scale``) of the drive's maximum frequency, which is read from the
    parameter ``maximum`` or stated as ``maximum_hz``.
    """

    factor: Annotated[float, Field(ge=0.001, le=10)] = 0.01
    """Hz a step."""
    rpm: Annotated[float, Field(ge=0.01, le=1000)] | None = None
    """Revolutions per minute a step, of a setpoint that is a speed: the option ``pole_pairs`` makes it Hz."""
    full_scale: Annotated[int, Field(ge=100, le=0xFFFF)] | None = None
    """Word that means the maximum frequency."""
    maximum: Sentence | None = None
    """Notation of the readable parameter, in Hz, that holds the maximum frequency."""
    maximum_hz: Annotated[float, Field(gt=0, le=4000)] | None = None
    """Factory setting of the maximum frequency, where no parameter of it can be read."""
    lowest_hz: Annotated[float, Field(gt=0, le=4000)] | None = None
    """Smallest maximum frequency that a drive of the model can be set to; without it, half of ``maximum_hz``."""
    highest_hz: Annotated[float, Field(gt=0, le=4000)] | None = None
    """Largest maximum frequency that any drive of the model can be set to, required: the cap holds under it."""
    coding: Literal["binary", "signed", "bcd"] = "binary"
    """``signed`` where the drive takes a word of 8000H or more for a frequency in the other direction."""
    decimals: Annotated[int, Field(ge=0, le=4)] = 0
    words: Literal[1, 2] = 1
    """Registers of the setpoint; two are written in one frame."""
    evidence: EvidenceLines = {"en": "assumed"}
    """An assumed ``factor`` gives the profile the option ``setpoint_step``: a cap holds until it is determined."""

    @property
    def is_assumed(self) -> bool:
        """Whether no source gives the scale."""
        return is_assumed(self.evidence)


class ValueTable(ScaleTable):
    text: LocalizedText
    register_: Annotated[Word | None, Field(alias="register")] = None
    """Register address, where the notation does not give it (register-based families)."""
    space: Space = "holding"
    """Modbus only."""
    unit: Unit = ""
    minimum: float | None = None
    maximum: float | None = None
    scale_published: bool = True
    """False for a raw word without a published step; its readings are uncertain."""
    evidence: EvidenceLines


class SignalTable(ValueTable):
    notation: Sentence
    period_s: Annotated[float, Field(gt=0, le=86400)] = 1.0


class ParameterTable(ValueTable):
    writable: bool = True
    readable: bool = True
    maximum_option: Name | None = None
    """Option that holds the maximum, where the user supplies it."""
    choices: dict[str, LocalizedText] = {}
    choices_complete: bool = True
    """False where the manual names the choices as examples only."""
    help: LocalizedText | None = None
    caveat: str | None = None
    factory: float | None = None


class PreconditionTable(StrictTable):
    accepted: Annotated[list[Word], Field(min_length=1)]
    keypad: LocalizedText


class FaultTable(StrictTable):
    label: str = ""
    text: LocalizedText
    cause: LocalizedText | None = None
    remedy: LocalizedText | None = None
    evidence: EvidenceLines = {"en": "user"}


class CaveatTable(StrictTable):
    text: LocalizedText
    evidence: EvidenceLines


class OptionTable(StrictTable):
    """Undocumented option. A file that extends another may give the value alone: all else is then the base's."""

    value: OptionValue
    choices: list[OptionValue] = []
    span: Annotated[list[int], Field(min_length=2, max_length=2)] | None = None
    """Any whole number from the first to the second is allowed as well."""
    text: LocalizedText | None = None
    reason: LocalizedText | None = None
    procedure: LocalizedText | None = None
    """How the value is determined."""


class OpenQuestionTable(StrictTable):
    """Undocumented fact that is no option: its answer belongs to another part of the profile."""

    assumed: OptionValue | dict[LanguageCode, Sentence]
    """Value as the file writes it, or words by language."""
    where: str
    """Part of the profile that holds the answer, such as ``[timing]``; "-" where none does."""
    text: LocalizedText
    reason: LocalizedText
    procedure: LocalizedText


class BitTable(StrictTable):
    mask: Annotated[int, Field(ge=1, le=0xFFFF)]
    value: Word
    pulse: bool = False


class FixedWriteTable(StrictTable):
    """Value that is written to a register of its own."""

    register_: Annotated[Word, Field(alias="register")]
    value: Word


class WordMatchTable(StrictTable):
    """Part of a status word and the value that it must have."""

    mask: Annotated[int, Field(ge=1, le=0xFFFF)]
    value: Word


class StartStepTable(StrictTable):
    """Word that a drive needs before it accepts a start, such as the 6 and 7 of DRIVECOM; it moves nothing."""

    when: WordMatchTable | None = None
    """Status in which the word is sent; without it before every start, and the reply alone confirms it."""
    word: Word
    until: WordMatchTable | None = None
    """Status that the word brings about; required with ``when``."""
    timeout_s: Annotated[float, Field(ge=0.1, le=10)] = 1.0
    """Longest time until then."""


class CommandsTable(StrictTable):
    register_: Annotated[Word, Field(alias="register")]
    setpoint_register: Word
    words: Annotated[int, Field(ge=1, le=4)] = 1
    """Registers of the command word, such as run and direction: a frame of function 16 writes them all."""
    written_to: Literal["register", "coils", "coil"] = "register"
    """coils: the bits of the word are the coils from ``register`` on; coil: the word counts from there to one coil."""
    coil_count: Annotated[int, Field(ge=0, le=16)] = 0
    """Coils that a command writes, for ``written_to = "coils"``."""
    reset: FixedWriteTable | None = None
    """Fault reset outside the command word."""
    unlock: FixedWriteTable | None = None
    """Write without which the drive rejects every command; it moves nothing. A stop is sent without it first."""
    preparation: list[StartStepTable] = []
    """Words before a start, in their order; each is sent once at most, in the status that asks for it."""
    ready: WordMatchTable | None = None
    """Status in which a start word may be sent; required where a word of ``preparation`` has a ``when``."""
    reset_on_edge: bool = False
    """The drive resets on the rising edge of a bit: the stop word is sent before the reset."""
    rewrite_levels_after_pulse: bool = False
    bits: dict[CommandName, BitTable] = {}
    values: dict[CommandValueName, Words] = {}
    """Whole words of a drive whose command word is a number; then there are no ``bits``."""
    variants: dict[str, dict[str, dict[CommandName, BitTable]]] = {}
    evidence: EvidenceLines


class StatusTable(StrictTable):
    register_: Annotated[Word, Field(alias="register")]
    space: Space = "holding"
    """Of coils and discrete inputs the word has those from ``register`` on, the first as its lowest bit."""
    bits: dict[StatusName, Annotated[int, Field(ge=1, le=0xFFFF)]] = {}
    values: dict[str, StatusValueName] = {}
    """State of each value, as a decimal number, of a status word that is a number; then there are no ``bits``."""
    mask: Annotated[int, Field(ge=1, le=0xFFFF)] = 0xFFFF
    """Part of the word that ``values`` count."""
    shares_command_register: bool = False
    """A read of the command register gives the status, by the source; otherwise it may give the last command back."""
    reserved_mask: Word = 0
    fault_registers: list[Word] = []
    fault_coding: Literal["bits", "number"] = "bits"
    """A fault register has a bit for each fault, or the number of one fault and 0 for none."""
    fault_mask: Annotated[int, Field(ge=1, le=0xFFFF)] = 0xFFFF
    """Field of the fault register that is the number; its lowest bit counts 1."""
    standstill: Literal["status", "output_frequency", "output_speed", "status_alone"] = "status"
    """What shows that the drive stands: the word, or the signal of this name as well, where the word drops its run bit
    while the drive still ramps down. The signal output_frequency may contradict it, except with status_alone."""
    standstill_evidence: EvidenceLines | None = None
    """Source that the signal output_frequency is not 0 at rest, for ``standstill = "status_alone"``."""
    hides_faults: bool = False
    """The source names no register of a fault: a tripped drive is shown in the state that it reports."""
    evidence: EvidenceLines


class ModbusTable(StrictTable):
    functions: list[Literal[1, 2, 3, 4, 5, 6, 8, 15, 16]] = [3, 6]
    max_read: Annotated[int, Field(ge=1, le=125)] = 125
    error_form: Literal["exception", "short"] = "exception"
    loopback: bool = False
    word_order: Literal["high_first", "low_first"] = "high_first"
    """Order of the registers of a number that has two."""
    blocks: list[Annotated[list[Word], Field(min_length=2, max_length=2)]] = []
    """First register and count of each block of holding registers that the drive gives only as a whole."""
    reply_count_bytes: Literal[1, 2] = 1
    """Bytes of the byte count in the reply to a read: 2 in the non-standard Modbus of some Chinese makers."""
    rejected_read: Annotated[int, Field(ge=2, le=125)] | None = None
    """Registers of a read that the drive answers by exception 03, as it does no other read: its sync probe."""
    sync_block: Annotated[list[Word], Field(min_length=2, max_length=2)] | None = None
    """One of ``blocks``, which function 04 reads too: the sync probe where no two registers can be read at once."""
    evidence: EvidenceLines


class SerialTable(StrictTable):
    baud: Baud
    format: str
    bauds: Annotated[list[Baud], Field(min_length=1)]
    formats: Annotated[list[str], Field(min_length=1)]
    evidence: EvidenceLines


class TimingTable(StrictTable):
    """Waits of a station. Each of them delays the stops of all drives on its bus."""

    gap_characters: Annotated[float, Field(ge=0, le=100)] = 3.5
    gap_floor_s: Annotated[float, Field(ge=0, le=MAX_GAP_S)] = 0.0
    reply_delay_s: Annotated[float, Field(ge=0, le=MAX_WAIT_S)] = 0.1
    reply_delay_characters: Annotated[float, Field(ge=0, le=100)] = 0.0
    adapter_latency_s: Annotated[float, Field(ge=0, le=MAX_WAIT_S)] = 0.02
    turnaround_s: Annotated[float, Field(ge=0, le=MAX_WAIT_S)] = 0.1
    max_reply_lateness_s: Annotated[float, Field(ge=0, le=ANY_REPLY_LATENESS_S)] = 0.5
    tolerate_leading_noise: bool = False
    evidence: EvidenceLines


class FrequencyLimitsTable(StrictTable):
    minimum_hz: Annotated[float, Field(ge=0)]
    maximum_hz: Annotated[float, Field(gt=0, le=4000)]
    evidence: EvidenceLines


class IdentityTable(StrictTable):
    """Register that look-alikes with the same status register do not have: an answer shows the map."""

    register_: Annotated[Word, Field(alias="register")]
    """Register of a signal, which is polled anyway."""
    code_register: Word | None = None
    """Register of a code that names the model, among those with this map."""
    codes: dict[
        Annotated[str, StringConstraints(pattern=r"^0x[0-9A-F][0-9A-F][0-9A-F][0-9A-F]$")],
        Annotated[list[Name], Field(min_length=1)],
    ] = {}
    """Code to the models that report it."""
    evidence: EvidenceLines


class WriteTable(StrictTable):
    ram: bool
    eeprom: bool = True
    eeprom_address_bit: Word | None = None
    """Bit that makes a write go to EEPROM as well, where the plain address writes RAM."""
    ram_address_mask: Annotated[int, Field(ge=1, le=0xFFFF)] | None = None
    """Bits that are 0 in the address that writes RAM only, where the plain address saves: F00AH and 000AH."""
    evidence: EvidenceLines


class CommLossTable(StrictTable):
    time: Sentence | None = None
    action: Sentence | None = None
    trips_values: list[Word] = []
    evidence: EvidenceLines = {"en": "assumed"}


class NotationTable(StrictTable):
    style: NotationName
    """A key of the family's ``ProtocolFamily.notations``."""
    highest: Word = 0xFFFF


class UnknownFaultTable(StrictTable):
    label: str = ""
    text: LocalizedText


class ProfileFile(StrictTable):
    """Whole file after the merge of ``extends``."""

    format: int
    model: Name
    maker: LocalizedText
    title: LocalizedText
    family: FamilyName
    grade: Literal["draft", "simulated", "verified"]
    encodings: Annotated[list[Encoding], Field(min_length=1)]
    addresses: Annotated[list[Annotated[int, Field(ge=0, le=247)]], Field(min_length=2, max_length=2)]
    broadcast: Annotated[int, Field(ge=0, le=255)] | None = None
    capabilities: list[Capability]
    notation: NotationTable
    serial: SerialTable
    timing: TimingTable
    limits: FrequencyLimitsTable
    setpoint: SetpointTable
    write: WriteTable
    comm_loss: CommLossTable = CommLossTable()
    roles: dict[Role, str] = {}
    ramp: Annotated[list[str], Field(min_length=2, max_length=2)] | None = None
    group_sizes: dict[str, Annotated[int, Field(ge=1, le=4096)]] = {}
    signals: dict[Name, SignalTable] = {}
    parameters: dict[str, ParameterTable] = {}
    preconditions: dict[str, PreconditionTable] = {}
    faults: dict[str, FaultTable] = {}
    unknown_fault: UnknownFaultTable | None = None
    caveats: dict[str, CaveatTable] = {}
    options: dict[Name, OptionTable] = {}
    open_questions: dict[Name, OpenQuestionTable] = {}
    modbus: ModbusTable | None = None
    commands: CommandsTable | None = None
    status: StatusTable | None = None
    identity: IdentityTable | None = None
    keypad: list[LocalizedText] = []
    wiring: LocalizedText | None = None

    @property
    def entries(self) -> list[tuple[tuple[str, str], str, SignalTable | ParameterTable]]:
        """Key path, notation and table of each signal and parameter."""
        return [
            *((("signals", name), signal.notation, signal) for name, signal in self.signals.items()),
            *((("parameters", notation), notation, parameter) for notation, parameter in self.parameters.items()),
        ]
