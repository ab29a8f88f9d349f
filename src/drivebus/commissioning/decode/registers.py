"""What a Modbus model's profile says of registers: names and scaled values, command bits, and registers of no table.

Added fields: ``parameter`` (notation), ``frequency_hz`` or ``scaled``, ``commands`` (names of the command word's bits),
``values`` (each register of a read with notation, raw and value), ``saves`` (the write goes to EEPROM as well).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from drivebus.commissioning.decode.quantity import Annotations, FieldDict, entry_at, quantity_fields, scaled_value
from drivebus.profiles import DriveProfile
from drivebus.profiles.notation import format_locator
from drivebus.protocols.describe import FrameDescription, Note, note

DIRECTION_TOGGLE: Final = 0x000C
"""DF800 2000H, bits 2 and 3: 11 toggles, whichever way round the field is (T16)."""


def annotate_modbus(profile: DriveProfile, found: FrameDescription, asked: Mapping[str, Any]) -> Annotations:
    """Fields, errata and hazards that the profile adds to a frame."""
    fields = found.fields
    hazards: list[Note] = []
    added = FieldDict()
    errata = _model_errata(profile, fields) if found.valid and found.direction == "request" else []
    if "registers" in fields and "register" in asked:
        added |= _register_rows(profile, asked["register"], fields["registers"])
    elif "register" in fields:
        register, saves = _strip_eeprom_bit(profile, fields["register"])
        notation = format_locator(("holding", register), profile)
        if notation.startswith("F"):
            added["parameter"] = notation
        if "value" in fields:
            added |= _written_fields(profile, register, fields["value"]) | ({"saves": True} if saves else {})
            hazards = _write_hazards(profile, register, fields["value"])
    return added, tuple(errata), tuple(hazards)


def _strip_eeprom_bit(profile: DriveProfile, register: int) -> tuple[int, bool]:
    """The register without the bit that saves to EEPROM, and whether that bit was there (T14)."""
    bit = profile.write_support.eeprom_address_bit
    if bit and register & bit and register ^ bit <= profile.notation.highest:
        return register ^ bit, True
    return register, False


def _is_known_register(profile: DriveProfile, register: int) -> bool:
    commands, status = profile.commands, profile.status
    special = {commands.register, commands.setpoint_register} if commands else set()
    special |= {status.register} if status else set()
    return register <= profile.notation.highest or register in special or bool(entry_at(profile, ("holding", register)))


def _model_errata(profile: DriveProfile, fields: Mapping[str, Any]) -> list[Note]:
    """Where a request asks for what this model's manual does not have (T12)."""
    notes, rule = [], profile.modbus
    function, count = fields.get("function"), fields.get("count", 1)
    if rule and function is not None and function not in rule.functions:
        notes.append(
            note("explain.function", model=profile.model, found=function, expected=_join_numbers(rule.functions))
        )
    if rule and function in (3, 4) and count > rule.max_read:
        notes.append(note("explain.too_many", model=profile.model, found=count, expected=rule.max_read))
    if "register" in fields:
        register, _ = _strip_eeprom_bit(profile, fields["register"])
        span = range(register, register + min(count, 8)) if function in (3, 4) else (register,)
        strange = [each for each in span if not _is_known_register(profile, each)]
        if strange:
            shown = ", ".join(f"{each:04X}H" for each in strange)
            notes.append(note("explain.no_table", model=profile.model, registers=shown))
    return notes


def _join_numbers(numbers: tuple[int, ...]) -> str:
    return ", ".join(map(str, numbers))


def _register_rows(profile: DriveProfile, first: int, words: list[int]) -> FieldDict:
    rows = [_register_row(profile, first + place, word) for place, word in enumerate(words)]
    added = FieldDict(values=rows)
    if len(rows) == 1 and rows[0].get("unit") == "Hz":
        added["frequency_hz"] = rows[0]["value"]
    return added


def _register_row(profile: DriveProfile, register: int, word: int) -> FieldDict:
    """One register of a reply: notation, raw, and name, value and unit where the profile has them."""
    row = FieldDict(notation=format_locator(("holding", register), profile), raw=word)
    entry = entry_at(profile, ("holding", register))
    if entry is None:
        return row
    name = getattr(entry, "name", None)
    value = scaled_value(entry, word) if entry.unit else None
    return row | ({"name": name} if name else {}) | ({} if value is None else {"value": value, "unit": entry.unit})


def _written_fields(profile: DriveProfile, register: int, word: int) -> FieldDict:
    commands = profile.commands
    if commands and register == commands.setpoint_register:
        return FieldDict(frequency_hz=profile.setpoint_scale.value(word))
    if commands and register == commands.register:
        return FieldDict(commands=_command_names(profile, word))
    return quantity_fields(entry_at(profile, ("holding", register)), word)


def _command_names(profile: DriveProfile, word: int) -> list[str]:
    """Names of the commands that a command word gives; levels that are off are not named."""
    if profile.commands is None:
        return []
    bits = profile.commands.resolved(profile.settings).bits
    return [name for name, bit in bits.items() if bit.value and word & bit.mask == bit.value]


def _write_hazards(profile: DriveProfile, register: int, word: int) -> list[Note]:
    commands = profile.commands
    if not commands or register != commands.register or "direction_field" not in commands.variants:
        return []
    return [note("explain.toggle", word=word)] if word & DIRECTION_TOGGLE == DIRECTION_TOGGLE else []
