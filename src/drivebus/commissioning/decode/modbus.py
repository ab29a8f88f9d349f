"""Descriptions of Modbus frames with the facts of a profile: registers, command bits, misprints of the manual.

Added fields: ``parameter`` (notation), ``frequency_hz`` or ``scaled``, ``commands`` (names of the command word's bits),
``values`` (each register of a read with notation, raw, value and the bits that are set), ``name`` (of a register that
is written), ``exception_name``, ``saves`` (the write goes to EEPROM as well).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

from drivebus import i18n
from drivebus.commissioning.decode.annotate import (
    FieldDict,
    annotate,
    broadcast_field,
    quantity_fields,
    scaled_value,
)
from drivebus.commissioning.decode.errata import canonical_of_misprint, misprint_of
from drivebus.drives.dialects.modbus import is_terminal_word
from drivebus.drives.dialects.modbus_reads import SPACES, Span, join_words, span_of, span_value
from drivebus.drives.dialects.modbus_writes import (
    CommandWrite,
    ModbusWrites,
    ParameterWrite,
    ResetWrite,
    SetpointWrite,
    UnlockWrite,
)
from drivebus.drives.state import Fault
from drivebus.profiles import DriveProfile
from drivebus.profiles.model import Parameter, Signal
from drivebus.profiles.notation import format_locator
from drivebus.protocols import modbus
from drivebus.protocols.describe import FrameDescription, FrameDirection, Note, note
from drivebus.protocols.family import Locator

REQUEST_SPACES: Final = SPACES | {5: "coil", 15: "coil"}
"""Function of a request to the space of its addresses; holding registers for all others."""
DIRECTION_TOGGLE: Final = 0x000C
"""Direction field of DF800 register 2000H, bits 2 and 3: both set change the direction."""
JOG_START: Final = 0x0003
"""Run field of DF800 register 2000H, bits 0 and 1: both set jog, in the direction of the direction field."""


def describe(
    profile: DriveProfile, data: bytes, encoding: str, direction: FrameDirection | None, request: bytes | None
) -> FrameDescription:
    """Describe a frame. A misprinted reply of the manual shows the fields that were meant, and stays invalid."""
    features = profile.modbus_features
    description = modbus.describe(data, encoding, direction, request, features.error_form, features.reply_count_bytes)
    sent = {} if request is None else modbus.describe(request, encoding, "request", None, features.error_form).fields
    misprint = misprint_of(profile.model, data)
    annotated = _annotate(profile, description, sent)
    if misprint is None:
        return replace(annotated, canonical=canonical_of_misprint(profile.model, annotated))
    fields = annotated.fields
    if not annotated.valid:
        meant = modbus.describe(misprint.canonical, encoding, description.direction)
        fields = _annotate(profile, meant, sent).fields
    errata = (*annotated.errata, misprint.erratum)
    return replace(annotated, fields=fields, errata=errata, canonical=misprint.canonical)


def _annotate(profile: DriveProfile, description: FrameDescription, sent: Mapping[str, Any]) -> FrameDescription:
    """Add the facts of the profile; ``sent`` holds the fields of the request, if known."""
    fields = description.fields
    hazards: list[Note] = []
    added = FieldDict()
    errata = _model_errata(profile, fields) if description.valid and description.direction == "request" else []
    added |= broadcast_field(profile, description)
    exception = modbus.EXCEPTION_NAMES.get(fields.get("exception", 0))
    if exception is not None:
        added["exception_name"] = exception
    space = REQUEST_SPACES.get(sent.get("function", fields.get("function")), "holding")
    if "register" in sent and ("registers" in fields or "bits" in fields):
        values = fields["registers"] if "registers" in fields else fields["bits"][: sent.get("count", 0)]
        added |= _value_rows(profile, Span(space, sent["register"], len(values)), values)
    elif "register" in fields:
        register, saves = _strip_eeprom_bit(profile, fields["register"])
        notation = format_locator((space, register), profile)
        if notation.startswith("F"):
            added["parameter"] = notation
        if "value" in fields and space == "holding":
            added |= _written_fields(profile, register, fields["value"]) | ({"saves": True} if saves else {})
            hazards = _write_hazards(profile, register, fields["value"])
        else:
            added |= _recognized_fields(profile, fields)
            if profile.commands and profile.commands.words == 1 and space == "holding":
                hazards = [
                    hazard for _, place, word in _changes(fields) for hazard in _write_hazards(profile, place, word)
                ]
    return annotate(description, added, tuple(errata), tuple(hazards))


def _strip_eeprom_bit(profile: DriveProfile, register: int) -> tuple[int, bool]:
    """Return the plain register of an address that writes to EEPROM or RAM, and whether that saves."""
    bit = profile.write_support.eeprom_address_bit
    if bit and register & bit and register ^ bit <= profile.notation.highest:
        return register ^ bit, True
    mask = profile.write_support.ram_address_mask
    if mask and isinstance(profile.entry_at(("holding", register | mask)), Parameter):
        return register | mask, register & mask == mask
    return register, False


def _is_known_register(profile: DriveProfile, space: str, register: int) -> bool:
    commands, status = profile.commands, profile.status
    special = {commands.register, commands.setpoint_register} if commands else set()
    special |= {status.register} if status else set()
    return register <= profile.notation.highest or register in special or bool(profile.entry_at((space, register)))


def _model_errata(profile: DriveProfile, fields: Mapping[str, Any]) -> list[Note]:
    """Report functions, counts and registers that the manual of this model does not have."""
    notes, features = _access_errata(profile, fields), profile.modbus
    function, count = fields.get("function"), fields.get("count", 1)
    if features and function is not None and function not in features.functions:
        notes.append(note("explain.function", model=profile.model, found=function, expected=features.functions))
    if features and function in (3, 4) and count > features.max_read and count != features.rejected_read:
        notes.append(note("explain.too_many", model=profile.model, found=count, expected=features.max_read))
    if "register" in fields:
        register, _ = _strip_eeprom_bit(profile, fields["register"])
        space = REQUEST_SPACES.get(function or 0, "holding")
        span = range(register, register + min(count, 8)) if function in (3, 4) else (register,)
        unknown = [each for each in span if not _is_known_register(profile, space, each)]
        if unknown:
            shown = tuple(f"{each:04X}H" for each in unknown)
            notes.append(note("explain.no_table", model=profile.model, registers=shown))
    return notes


def _access_errata(profile: DriveProfile, fields: Mapping[str, Any]) -> list[Note]:
    """Report an address or register that does not take this access, and a frequency above the manual's limit."""
    notes: list[Note] = []
    function, address, register = fields.get("function"), fields.get("address"), fields.get("register")
    if address == modbus.BROADCAST and profile.broadcast is None:
        notes.append(note("explain.no_broadcast", model=profile.model, address=address))
    elif address == profile.broadcast and function in (1, 2, 3, 4):
        notes.append(note("explain.broadcast_read", address=address))
    space = REQUEST_SPACES.get(function or 0, "holding")
    entry = None if register is None else profile.entry_at((space, register))
    commands = profile.commands
    if commands and function == 6 and (commands.space, commands.register) == ("holding", register):
        notes += _undescribed_bits(profile, fields["value"])
    if function == 6 and isinstance(entry, Parameter):
        notes += _range_errata(entry, fields["value"])
    if function in (5, 6, 15, 16) and isinstance(entry, Signal):
        notes.append(note("explain.read_only", register=register))
    is_write_only = (space, register) in profile.command_registers or (
        isinstance(entry, Parameter) and not entry.readable
    )
    contradicted = any(caveat.id == "write_only" for caveat in profile.caveats)  # DF800: an example reads 2000H
    if function in (3, 4) and is_write_only and not contradicted:
        notes.append(note("explain.write_only", register=register))
    counts_hz = profile.setpoint_share is None and profile.setpoint_rpm is None
    if commands and function == 6 and register == commands.setpoint_register and counts_hz:
        hz, limit = profile.setpoint_scale.value(fields["value"]), profile.limits.maximum_hz
        if hz > limit and profile.evidence["limits"].kind == "manual":
            notes.append(note("explain.setpoint_range", frequency_hz=hz, limit_hz=limit))
    return notes


def _undescribed_bits(profile: DriveProfile, word: int) -> list[Note]:
    """Report bits of a command word of bits that have no function in the profile."""
    commands = profile.commands
    if commands is None or commands.values:
        return []
    choices = [bits for variants in commands.variants.values() for bits in variants.values()]
    described = 0
    for bits in (commands.bits, *choices):
        for bit in bits.values():
            described |= bit.mask
    for step in commands.preparation:
        described |= step.word
    unknown = tuple(bit for bit in range(16) if word >> bit & 1 and not described >> bit & 1)
    return [note("explain.undescribed_bits", word=word, bits=unknown)] if unknown else []


def _range_errata(parameter: Parameter, word: int) -> list[Note]:
    """Report a value outside the range of the parameter in the manual; one that is in doubt has a caveat."""
    value, minimum, maximum = scaled_value(parameter, word), parameter.minimum, parameter.maximum
    if value is None or minimum is None or maximum is None or minimum <= value <= maximum:
        return []
    if parameter.caveat or parameter.evidence.kind != "manual":
        return []
    return [note("explain.value_range", found=f"{value:g}", minimum=f"{minimum:g}", maximum=f"{maximum:g}")]


def _value_rows(profile: DriveProfile, read: Span, values: Sequence[int]) -> FieldDict:
    by_locator = {(read.space, read.start + place): int(value) for place, value in enumerate(values)}
    rows = [_value_row(profile, locator, by_locator) for locator in by_locator]
    added = FieldDict(values=rows)
    if len(rows) == 1 and rows[0].get("unit") == "Hz":
        added["frequency_hz"] = rows[0]["value"]
    return added


def _value_row(profile: DriveProfile, locator: Locator, values: Mapping[Locator, int]) -> FieldDict:
    """Return one register or coil of a reply: notation, raw word, and name, value and unit where the profile has them.

    A number in two registers has its value in the row of the first.
    """
    row, bits = (
        FieldDict(notation=format_locator(locator, profile), raw=values[locator]),
        _word_fields(profile, locator, values[locator]),
    )
    entry = profile.entry_at(locator)
    if entry is None:
        return row | bits
    name = getattr(entry, "name", None)
    if name and not i18n.known(f"signal.{name}"):  # a name of the profile's own has its text there only
        row["meaning"] = entry.text
    number = span_value(span_of(entry), values, profile.modbus_features)
    value = scaled_value(entry, number) if entry.unit and number is not None else None
    scaled = {} if value is None else {"value": value, "unit": entry.unit}
    return row | ({"name": name} if name else {}) | scaled | bits


def _word_fields(profile: DriveProfile, locator: Locator, word: int) -> FieldDict:
    """Return the bits that are set in a status word, and the faults in a fault register."""
    status, (space, register) = profile.status, locator
    if status is None or space != status.space:
        return FieldDict()
    if register == status.register and status.bits:
        return FieldDict(status_bits=list(status.set_bits(word)))
    if register not in status.fault_registers:
        return FieldDict()
    first = 16 * status.fault_registers.index(register)
    bits = [first + bit for bit in range(16) if word >> bit & 1]
    codes = [number for number in [status.fault_number(word)] if number] if status.numbers_fault else bits
    entries_of_codes = [profile.fault(code) for code in codes]
    return FieldDict(faults=[Fault(entry.code, entry.label, entry.text).name for entry in entries_of_codes])


def _recognized_fields(profile: DriveProfile, fields: Mapping[str, Any]) -> FieldDict:
    """Return what a write of coils or of several registers means."""
    changes = _changes(fields)
    commands = profile.commands.resolved(profile.options) if profile.commands else None
    features = profile.modbus_features
    added = FieldDict()
    place = 0
    for write in ModbusWrites(0, profile, commands).recognize(changes) or ():
        match write:
            case CommandWrite(word=word):
                added |= FieldDict(commands=_command_names(profile, word))
            case SetpointWrite(word=word):
                added |= _setpoint_fields(profile, word)
            case ResetWrite():
                added |= FieldDict(commands=["reset"])
            case UnlockWrite():
                added |= FieldDict(commands=["unlock"])
            case ParameterWrite(parameter=parameter):
                number = join_words((value for _, _, value in changes[place : place + write.width]), features)
                added |= quantity_fields(parameter, number)
        place += write.width
    return added


def _changes(fields: Mapping[str, Any]) -> list[modbus.RegisterWrite]:
    """Return the registers or coils that the fields of a request write."""
    space = REQUEST_SPACES.get(fields.get("function", 0), "holding")
    values = fields.get("values", [fields["value"] == modbus.COIL_ON] if "value" in fields else [])
    return [(space, fields["register"] + place, int(value)) for place, value in enumerate(values)]


def _written_fields(profile: DriveProfile, register: int, word: int) -> FieldDict:
    commands = profile.commands
    if commands and register == commands.setpoint_register:
        return _setpoint_fields(profile, word)
    if commands and (commands.space, commands.register) == ("holding", register):
        return FieldDict(commands=_command_names(profile, word))
    fixed = {"reset": commands.reset, "unlock": commands.unlock} if commands else {}
    for name, write in fixed.items():
        if write is not None and (write.register, write.value) == (register, word):
            return FieldDict(commands=[name])
    entry = profile.entry_at(("holding", register))
    meaning = {} if entry is None else FieldDict(meaning=entry.text)
    choice = entry.choices.get(word) if isinstance(entry, Parameter) else None
    return meaning | quantity_fields(entry, word) | ({} if choice is None else FieldDict(choice=choice))


def _setpoint_fields(profile: DriveProfile, word: int) -> FieldDict:
    share = profile.setpoint_share
    if share is not None:
        return FieldDict(percent_of_maximum=round(100 * word / share.full_scale, 2))
    if profile.setpoint_rpm is not None:
        return FieldDict(speed_rpm=round(word * profile.setpoint_rpm, 2))
    return FieldDict(frequency_hz=profile.setpoint_scale.value(word))


def _command_names(profile: DriveProfile, word: int) -> list[str]:
    """Return the names of the commands in a command word; levels that are off are not named."""
    if profile.commands is None:
        return []
    if profile.commands.values:
        return [name for name, value in profile.commands.values.items() if value == word]
    bits = profile.commands.resolved(profile.options).bits
    names = [name for name, bit in bits.items() if bit.value and word & bit.mask == bit.value]
    return ["jog", *names] if _is_directionless_jog(profile, word) else names


def _is_directionless_jog(profile: DriveProfile, word: int) -> bool:
    """Return whether a command word jogs in no absolute direction."""
    has_field = profile.commands is not None and "direction_field" in profile.commands.variants
    return has_field and word & JOG_START == JOG_START and word & DIRECTION_TOGGLE in (0, DIRECTION_TOGGLE)


def _write_hazards(profile: DriveProfile, register: int, word: int) -> list[Note]:
    commands = profile.commands
    if not commands or (commands.space, commands.register) != ("holding", register):
        entry = profile.entry_at(("holding", register))
        return [note("explain.terminals")] if isinstance(entry, Parameter) and is_terminal_word(entry) else []
    notes = []
    names = _command_names(profile, word)
    if commands.values and not names:
        notes.append(note("explain.unlisted_command", word=word, model=profile.model))
    if "start" in names and "stop" in names:
        notes.append(note("explain.start_and_stop", word=word))
    if _is_directionless_jog(profile, word) and not word & DIRECTION_TOGGLE:
        notes.append(note("explain.jog_direction", word=word))
    if "direction_field" in commands.variants and word & DIRECTION_TOGGLE == DIRECTION_TOGGLE:
        notes.append(note("explain.toggle", word=word))
    return notes
