"""Checks of a profile beyond its shape: values that must fit each other, addresses, and command bits.

The checks yield issues and never raise. What a protocol family allows comes from its ``ProtocolFamily``.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from itertools import combinations
from typing import Any

from drivebus.errors import ProfileError
from drivebus.profiles.diagnostics import Issue, KeyPath, issue, nearest_names
from drivebus.profiles.model import NotationRule
from drivebus.profiles.notation import parse_notation
from drivebus.profiles.schema import BitIn, OptionIn, ParameterIn, ProfileIn, SignalIn
from drivebus.protocols.family import protocol_family
from drivebus.serial_settings import SerialSettings

REQUIRED_COMMANDS = {
    "run": ("start",),
    "reverse": ("forward", "reverse"),
    "stop": ("stop",),
    "coast": ("coast",),
    "quick_stop": ("quick_stop",),
    "jog": ("jog_forward", "jog_stop"),
    "reset_fault": ("reset",),
}
"""Capability of a register-based model to the commands that it needs."""


BitPaths = dict[str, tuple[KeyPath, BitIn]]
"""Command name to the key path of its bits, and the bits."""
COMMANDS_WITH_OWN_BIT = ("start", "stop", "coast", "quick_stop", "reset", "jog_forward", "jog_reverse")
"""Commands that need a bit set: whether a frame is a stop, and so needs no permit, is read from its bits."""


STOP_COMMANDS = ("stop", "coast", "quick_stop", "jog_stop")
MOTION_COMMANDS = ("start", "jog_forward", "jog_reverse")


def check_profile(profile: ProfileIn) -> Iterator[Issue]:
    """Yield every issue; only those of the family where even these exist."""
    family_issues = list(_check_family(profile))
    if family_issues:
        yield from family_issues
        return
    yield from _check_serial(profile)
    yield from _check_limits(profile)
    yield from _check_addresses(profile)
    yield from _check_capabilities(profile)
    yield from check_addressing(profile)
    yield from _check_ranges(profile)
    yield from _check_fault_codes(profile)
    yield from check_bits(profile)
    yield from _check_options(profile)


def _check_serial(profile: ProfileIn) -> Iterator[Issue]:
    serial = profile.serial
    for index, text in enumerate([serial.format, *serial.formats]):
        path = ("serial", "format") if index == 0 else ("serial", "formats")
        try:
            SerialSettings.parse(9600, text)
        except ValueError:
            yield issue("serial_format", path, text)
    if serial.format not in serial.formats:
        yield issue("not_in", ("serial", "format"), serial.format, choices=_join(serial.formats))
    if serial.baud not in serial.bauds:
        yield issue("not_in", ("serial", "baud"), serial.baud, choices=_join(serial.bauds))
    gap = protocol_family(profile.family).gap_characters
    if profile.timing.gap_characters < gap:
        yield issue("range", ("timing", "gap_characters"), profile.timing.gap_characters, bound=f">= {gap}")


def _check_limits(profile: ProfileIn) -> Iterator[Issue]:
    """Check that the limits are in order and that a setpoint word can express them."""
    low, high = profile.limits.minimum_hz, profile.limits.maximum_hz
    if low >= high:
        yield issue("limits", ("limits", "minimum_hz"), low, related=(("limits", "maximum_hz"),), maximum=high)
    word = 9999 if profile.setpoint.coding == "bcd" else 0xFFFF
    if high > word * profile.setpoint.factor:
        related = (("setpoint", "factor"),)
        bound = f"<= {word * profile.setpoint.factor:g}"
        yield issue("range", ("limits", "maximum_hz"), high, related=related, bound=bound)


def _check_addresses(profile: ProfileIn) -> Iterator[Issue]:
    low, high = profile.addresses
    family = protocol_family(profile.family)
    lowest, highest = family.addresses
    if not lowest <= low <= high <= highest:
        yield issue("addresses", ("addresses",), profile.addresses, lowest=lowest, highest=highest)
    if profile.broadcast is not None and low <= profile.broadcast <= high:
        related = (("addresses",),)
        yield issue("broadcast", ("broadcast",), profile.broadcast, related=related, low=low, high=high)
    elif profile.broadcast is not None and profile.broadcast != family.broadcast:
        choices = "-" if family.broadcast is None else family.broadcast
        yield issue("choice", ("broadcast",), profile.broadcast, choices=choices)


def _check_family(profile: ProfileIn) -> Iterator[Issue]:
    """Check that the family has the encodings and the notation."""
    family = protocol_family(profile.family)
    for encoding in profile.encodings:
        if encoding not in family.encodings:
            yield issue("choice", ("encodings",), encoding, choices=_join(family.encodings))
    if profile.notation.style not in family.notations:
        choices = _join(family.notations)
        yield issue("choice", ("notation", "style"), profile.notation.style, related=(("family",),), choices=choices)


def _check_capabilities(profile: ProfileIn) -> Iterator[Issue]:
    able = set(profile.capabilities)
    if "broadcast_stop" in able and profile.broadcast is None:
        yield issue("needs", ("capabilities",), "broadcast_stop", what="broadcast")
    if "write_ram" in able and not profile.write.ram:
        yield issue("needs", ("capabilities",), "write_ram", what="write.ram = true")
    for moving in sorted(able & {"run", "jog"}):
        if "stop" not in able:
            yield issue("needs", ("capabilities",), moving, what="stop")
    if not protocol_family(profile.family).register_based:
        return
    for section in ("modbus", "commands"):
        if getattr(profile, section) is None:
            yield issue("missing_key", (section,), "-", name=section)
    yield from _check_modbus(profile)
    for bit in ("running", "fault"):
        if "status" in able and (profile.status is None or bit not in profile.status.bits):
            yield issue("needs", ("capabilities",), "status", what=f"[status.bits] {bit}")
    if profile.commands is None:
        return
    offered = set(profile.commands.bits).union(
        *(bits for choice in profile.commands.variants.values() for bits in choice.values())
    )
    for capability in sorted(able & REQUIRED_COMMANDS.keys()):
        for bit in REQUIRED_COMMANDS[capability]:
            if bit not in offered:
                yield issue("needs", ("capabilities",), capability, what=f"[commands.bits] {bit}")


def _check_modbus(profile: ProfileIn) -> Iterator[Issue]:
    """Check that the functions in use are among those that the model has."""
    functions = profile.modbus.functions if profile.modbus else []
    if profile.commands is not None and profile.commands.function not in functions:
        yield issue("not_in", ("commands", "function"), profile.commands.function, choices=_join(functions))
    if "read" in profile.capabilities and 3 not in functions:
        related = (("modbus", "functions"),)
        yield issue("needs", ("capabilities",), "read", related=related, what="[modbus] functions 3")


def _check_ranges(profile: ProfileIn) -> Iterator[Issue]:
    entries = [(("signals", n), s) for n, s in profile.signals.items()]
    entries += [(("parameters", n), p) for n, p in profile.parameters.items()]  # type: ignore[misc]
    for path, entry in entries:
        if entry.minimum is not None and entry.maximum is not None and entry.minimum > entry.maximum:
            related = ((*path, "maximum"),)
            yield issue("minimum", (*path, "minimum"), entry.minimum, related=related, maximum=entry.maximum)
    for notation, parameter in profile.parameters.items():
        for raw in parameter.choices:
            if not _is_word(raw):
                yield issue("number", ("parameters", notation, "choices", raw), raw)
        maximum = parameter.maximum_option
        numbers = [name for name, option in profile.options.items() if option.span]
        if maximum is not None and maximum not in numbers:
            yield issue("choice", ("parameters", notation, "maximum_option"), maximum, choices=_join(numbers))
        if parameter.caveat is not None and parameter.caveat not in profile.caveats:
            known = _join(profile.caveats)
            yield issue("choice", ("parameters", notation, "caveat"), parameter.caveat, choices=known)


def _check_fault_codes(profile: ProfileIn) -> Iterator[Issue]:
    for code in profile.faults:
        if not _is_word(code):
            yield issue("number", ("faults", code), code)


def _check_options(profile: ProfileIn) -> Iterator[Issue]:
    """Check that every value belongs to a described option and is one of its choices."""
    options = {name: option for name, option in profile.options.items() if _is_described(option)}
    for name, option in profile.options.items():
        if name not in options:
            known = _join(nearest_names(name, options) or options)
            yield issue("unknown_key", ("options", name, "value"), name, known=known)
        elif not _is_allowed(option):
            span = [f"{option.span[0]}-{option.span[1]}"] if option.span else []
            yield issue("choice", ("options", name, "value"), option.value, choices=_join([*option.choices, *span]))
    for option_name, variants in profile.commands.variants.items() if profile.commands else ():
        choices = [str(choice) for choice in options[option_name].choices] if option_name in options else []
        for value in variants:
            if value not in choices:
                yield issue("choice", ("commands", "variants", option_name, value), value, choices=_join(choices))


def _is_described(option: OptionIn) -> bool:
    """Whether a profile describes the option; otherwise the value is that of a misspelled name."""
    return None not in (option.text, option.reason, option.procedure)


def _is_allowed(option: OptionIn) -> bool:
    value = option.value
    if option.span and type(value) is int and option.span[0] <= value <= option.span[1]:
        return True
    if not option.choices and not option.span:
        return True
    return any(value == choice and type(value) is type(choice) for choice in option.choices)


def _join(values: Iterable[object]) -> str:
    return ", ".join(map(str, values)) or "-"


def _is_word(digits: str) -> bool:
    """Whether the digits are a 16-bit number without leading zeros, which would allow the same word twice."""
    return digits.isascii() and digits.isdecimal() and int(digits) <= 0xFFFF and digits == str(int(digits))


def check_addressing(profile: ProfileIn) -> Iterator[Issue]:
    """Yield invalid notations and registers, entries that share an address, and references to nothing."""
    wrong_groups = list(_check_group_sizes(profile))
    yield from wrong_groups
    if not wrong_groups:
        yield from _check_locators(profile)
    yield from _check_references(profile)
    yield from _check_registers(profile)


def _check_registers(profile: ProfileIn) -> Iterator[Issue]:
    """Check that command, setpoint and status registers differ and that the EEPROM bit is one bit."""
    bit = profile.write.eeprom_address_bit
    if bit is not None and bit.bit_count() != 1:
        choices = ", ".join(f"0x{1 << place:04X}" for place in range(15, -1, -1))
        yield issue("choice", ("write", "eeprom_address_bit"), f"{bit:04X}H", choices=choices)
    if profile.commands is None:
        return
    word, setpoint = profile.commands.register_, profile.commands.setpoint_register
    related = [("commands", "register"), ("commands", "setpoint_register")]
    if setpoint == word:
        path = ("commands", "setpoint_register")
        yield issue("duplicate", path, f"{word:04X}H", related=related, other="[commands] register")
    if profile.status is not None and profile.status.register_ in (word, setpoint):
        found = f"{profile.status.register_:04X}H"
        yield issue("duplicate", ("status", "register"), found, related=related, other="[commands]")


def _check_group_sizes(profile: ProfileIn) -> Iterator[Issue]:
    wrong = [name for name in profile.group_sizes if not re.fullmatch("F[0-9]{2}", name)]
    for name in wrong:
        yield issue("group", ("group_sizes", name), name)
    total = sum(profile.group_sizes.values())
    if profile.notation.style == "consecutive" and total > profile.notation.highest + 1:
        yield issue("group_total", ("group_sizes",), total, most=profile.notation.highest + 1)


def resolve_locator(profile: ProfileIn, notation: str, register: int | None) -> tuple[str, int] | Issue | ProfileError:
    """Return the locator; an issue for a wrong notation; the error ``profiles.unplaced`` where data is missing."""
    if register is not None:
        return "holding", register
    rule = NotationRule(profile.family, profile.notation.style, profile.notation.highest)
    try:
        return parse_notation(notation, rule, profile.group_sizes)
    except ProfileError as error:
        if error.key == "profiles.notation":
            return issue("notation", (), notation, examples=error.params["examples"])
        return error if error.key == "profiles.unplaced" else issue("beyond", (), notation, **error.params)


def _check_locators(profile: ProfileIn) -> Iterator[Issue]:
    """Yield wrong notations, addresses outside the space, and entries that share an address."""
    register_based = protocol_family(profile.family).register_based
    taken = _command_locators(profile)
    eeprom_bit = profile.write.eeprom_address_bit or 0
    eeprom_bit = eeprom_bit if eeprom_bit.bit_count() == 1 else 0  # otherwise reported by _check_registers
    entries: list[tuple[tuple[str, str], str, SignalIn | ParameterIn]] = [
        *((("signals", name), signal.notation, signal) for name, signal in profile.signals.items()),
        *((("parameters", notation), notation, parameter) for notation, parameter in profile.parameters.items()),
    ]
    for path, notation, entry in entries:
        at = path if path[0] == "parameters" else (*path, "notation")
        if entry.register_ is not None and not register_based:
            yield issue("register", (*path, "register"), entry.register_, family=profile.family)
            continue
        locator = resolve_locator(profile, notation, entry.register_)
        if isinstance(locator, Issue):
            yield issue(locator.kind, at, notation, **locator.params)
        elif isinstance(locator, tuple):
            if register_based and locator[1] & eeprom_bit:
                yield issue("eeprom_bit", at, notation, bit=f"{eeprom_bit:04X}H")
            other = taken.setdefault(locator, path[1])
            if other != path[1]:
                related = (("signals", other, "notation"), ("parameters", other), ("group_sizes",))
                yield issue("duplicate", at, notation, related=related, other=other)


def _command_locators(profile: ProfileIn) -> dict[tuple[str, int], str]:
    """Return the command and setpoint registers: a parameter there would bypass the start permissives."""
    if profile.commands is None:
        return {}
    return {
        ("holding", profile.commands.register_): "[commands] register",
        ("holding", profile.commands.setpoint_register): "[commands] setpoint_register",
    }


def _check_references(profile: ProfileIn) -> Iterator[Issue]:
    named: set[tuple[tuple[str, ...], str]] = {(("preconditions", n), n) for n in profile.preconditions}
    named |= {(("roles", role), n) for role, n in profile.roles.items()}
    named |= {(("comm_loss", key), n) for key in ("time", "action") if (n := getattr(profile.comm_loss, key))}
    named |= {(("ramp",), n) for n in profile.ramp or ()}
    for path, notation in sorted(named):
        if notation not in profile.parameters:
            near = ", ".join(nearest_names(notation, profile.parameters)) or "-"
            yield issue("unlisted", path, notation, near=near)


def check_bits(profile: ProfileIn) -> Iterator[Issue]:
    """Yield the issues of command and status words."""
    yield from _check_masks(profile)
    yield from _check_words(profile)
    yield from _check_status_bits(profile)


def _check_masks(profile: ProfileIn) -> Iterator[Issue]:
    commands = profile.commands
    if commands is None:
        return
    groups: list[tuple[tuple[str, ...], dict[Any, BitIn]]] = [(("commands", "bits"), dict(commands.bits))]
    for setting, choices in commands.variants.items():
        for value, bits in choices.items():
            groups.append((("commands", "variants", setting, value), dict(bits)))
    for path, bits in groups:
        for name, bit in bits.items():
            if bit.value & ~bit.mask:
                yield issue("outside_mask", (*path, name), f"{bit.value:04X}H", mask=f"{bit.mask:04X}H")
            if name in COMMANDS_WITH_OWN_BIT and not bit.value:
                yield issue("no_bit", (*path, name), "0000H", name=name)
        yield from _find_overlaps(path, bits)


def _check_words(profile: ProfileIn) -> Iterator[Issue]:
    """Check whole words: the common bits with those of each option value on top."""
    commands = profile.commands
    if commands is None:
        return
    plain: BitPaths = {name: (("commands", "bits", name), bit) for name, bit in commands.bits.items()}
    layers = [plain]
    for setting, choices in commands.variants.items():
        for value, bits in choices.items():
            path = ("commands", "variants", setting, value)
            layers.append(plain | {name: ((*path, name), bit) for name, bit in bits.items()})
    reported: set[KeyPath] = set()
    for placed in layers:
        for found in (*_find_toggles(placed), *_find_identical_commands(placed), *_find_moving_stops(placed)):
            if found.path not in reported:
                reported.add(found.path)
                yield found


def _find_toggles(placed: BitPaths) -> Iterator[Issue]:
    """Yield commands with both directions set in a field of two bits: such a word reverses the present direction."""
    fields = {placed[name][1].mask for name in ("forward", "reverse") if name in placed}
    for path, bit in placed.values():
        if any(field.bit_count() > 1 and bit.value & field == field for field in fields):
            yield issue("toggle", path, f"{bit.value:04X}H")


def _find_identical_commands(placed: BitPaths) -> Iterator[Issue]:
    """Yield pairs of commands with the same bits: the drive could not tell them apart."""
    for (first, (at, a)), (second, (path, b)) in combinations(placed.items(), 2):
        if (a.mask, a.value) == (b.mask, b.value) and not (a.pulse or b.pulse or _is_shared_stop(first, second)):
            yield issue("alike", path, f"{b.value:04X}H", related=(at,), first=first, second=second)


def _find_moving_stops(placed: BitPaths) -> Iterator[Issue]:
    """Yield stops whose word related starts or jogs: a stop is sent without a permit."""
    for stop, move in ((s, m) for s in STOP_COMMANDS for m in MOTION_COMMANDS if s in placed and m in placed):
        (path, bit), (at, moving) = placed[stop], placed[move]
        if moving.value and bit.value & moving.mask == moving.value and not (bit.pulse and moving.pulse):
            yield issue("moving_stop", path, f"{bit.value:04X}H", related=(at,), stop=stop, move=move)


def _find_overlaps(path: tuple[str, ...], bits: dict[Any, BitIn]) -> Iterator[Issue]:
    """Yield overlaps: two pulses may share a mask only as values of one field, a pulse and a level never."""
    for (first, a), (second, b) in combinations(bits.items(), 2):
        if not a.mask & b.mask or not (a.pulse or b.pulse):
            continue
        if a.mask != b.mask or a.pulse != b.pulse or (a.value == b.value and not _is_shared_stop(first, second)):
            related = ((*path, first),)
            yield issue(
                "overlap", (*path, second), f"{b.mask:04X}H", related=related, other=first, mask=f"{a.mask:04X}H"
            )


def _is_shared_stop(first: str, second: str) -> bool:
    """Whether both are stops: a jog may end with the ordinary stop."""
    return {first, second} == {"stop", "jog_stop"}


def _check_status_bits(profile: ProfileIn) -> Iterator[Issue]:
    if profile.status is None:
        return
    used_mask = profile.status.reserved_mask
    for name, mask in profile.status.bits.items():
        if mask.bit_count() != 1 or mask & used_mask:
            related: list[KeyPath] = [
                ("status", "bits", other) for other, bit in profile.status.bits.items() if bit & mask
            ]
            related.append(("status", "reserved_mask"))
            yield issue(
                "status_bit", ("status", "bits", name), f"{mask:04X}H", related=related, seen=f"{used_mask:04X}H"
            )
        used_mask |= mask
