"""Checks of a profile beyond its shape: values that must fit each other, and addresses.

The checks yield issues and never raise. What a protocol family allows comes from its ``ProtocolFamily``.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

from drivebus.errors import ProfileError
from drivebus.profiles.check_access import block_registers, check_access, check_codes, command_places
from drivebus.profiles.check_effect import check_effect
from drivebus.profiles.check_words import check_words, is_word, offered_commands, offered_states
from drivebus.profiles.diagnostics import Issue, issue, listed_values, nearest_names
from drivebus.profiles.model import MAXIMUM_FREQUENCY, POLE_PAIRS, USUAL_STEPS_HZ, NotationRule, is_choice
from drivebus.profiles.notation import parse_notation
from drivebus.profiles.schema import (
    MAX_GAP_S,
    MAX_WAIT_S,
    OptionTable,
    ParameterTable,
    ProfileFile,
    SignalTable,
    ValueTable,
    is_assumed,
)
from drivebus.profiles.spaces import BIT_SPACES
from drivebus.protocols.family import Locator, protocol_family
from drivebus.serial_settings import SerialSettings
from drivebus.values import Text

_SAME_IN_BOTH = {
    "stop": ("stop",),
    "coast": ("coast",),
    "quick_stop": ("quick_stop",),
    "pause": ("pause",),
    "hold_ramp": ("hold_ramp",),
    "reset_fault": ("reset",),
}
REQUIRED_BITS = _SAME_IN_BOTH | {
    "run": ("start",),
    "reverse": ("forward", "reverse"),
    "jog": ("jog_forward", "jog_stop"),
}
"""Capability of a register-based model to the bits that it needs in the command word."""
REQUIRED_VALUES = _SAME_IN_BOTH | {
    "run": ("start_forward",),
    "reverse": ("start_reverse",),
    "jog": ("jog_forward", "stop"),
}
"""The same for a command word that is a number."""
BITS_OF_A_CHARACTER = 11  # with parity or two stop bits: the longest


def check_profile(profile: ProfileFile) -> Iterator[Issue]:
    """Yield every issue; where the family has some, only those, because the other checks depend on it."""
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
    yield from check_words(profile)
    yield from check_effect(profile)
    yield from check_access(profile)
    yield from _check_setpoint(profile)
    yield from _check_options(profile)
    yield from _check_identity(profile)


def _check_serial(profile: ProfileFile) -> Iterator[Issue]:
    serial = profile.serial
    for index, text in enumerate([serial.format, *serial.formats]):
        path = ("serial", "format") if index == 0 else ("serial", "formats")
        try:
            SerialSettings.parse(9600, text)
        except ValueError:
            yield issue("serial_format", path, text)
    if serial.format not in serial.formats:
        yield issue("not_in", ("serial", "format"), serial.format, choices=listed_values(serial.formats))
    if serial.baud not in serial.bauds:
        yield issue("not_in", ("serial", "baud"), serial.baud, choices=listed_values(serial.bauds))
    yield from _check_waits(profile)


def _check_waits(profile: ProfileFile) -> Iterator[Issue]:
    """Check that no wait counted in characters is longer at the lowest baud rate than one in seconds may be."""
    timing, gap = profile.timing, protocol_family(profile.family).gap_characters
    if timing.gap_characters < gap:
        yield issue("range", ("timing", "gap_characters"), timing.gap_characters, bound=f">= {gap}")
    per_second = min(profile.serial.bauds) / BITS_OF_A_CHARACTER
    highest = max(gap, MAX_GAP_S * per_second)
    if timing.gap_characters > highest:
        yield issue("range", ("timing", "gap_characters"), timing.gap_characters, bound=f"<= {highest:.3g}")
    highest = (MAX_WAIT_S - timing.reply_delay_s) * per_second
    if timing.reply_delay_characters > highest:
        path, related = ("timing", "reply_delay_characters"), (("timing", "reply_delay_s"),)
        yield issue("range", path, timing.reply_delay_characters, related=related, bound=f"<= {highest:.3g}")


def _check_limits(profile: ProfileFile) -> Iterator[Issue]:
    """Check that the limits are in order and that a setpoint word can express them; a share has limits of its own."""
    low, high = profile.limits.minimum_hz, profile.limits.maximum_hz
    if low >= high:
        yield issue("limits", ("limits", "minimum_hz"), low, related=(("limits", "maximum_hz"),), maximum=high)
    if profile.setpoint.full_scale is not None or profile.setpoint.rpm is not None:
        return
    word = {"binary": 0xFFFF, "signed": 0x7FFF, "bcd": 9999}[profile.setpoint.coding]
    if high > word * profile.setpoint.factor:
        related = (("setpoint", "factor"),)
        bound = f"<= {word * profile.setpoint.factor:g}"
        yield issue("range", ("limits", "maximum_hz"), high, related=related, bound=bound)


def _check_addresses(profile: ProfileFile) -> Iterator[Issue]:
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


def _check_family(profile: ProfileFile) -> Iterator[Issue]:
    """Check that the family has the encodings and the notation."""
    family = protocol_family(profile.family)
    for encoding in profile.encodings:
        if encoding not in family.encodings:
            yield issue("choice", ("encodings",), encoding, choices=listed_values(family.encodings))
    if profile.notation.style not in family.notations:
        choices = listed_values(family.notations)
        yield issue("choice", ("notation", "style"), profile.notation.style, related=(("family",),), choices=choices)


def _check_capabilities(profile: ProfileFile) -> Iterator[Issue]:
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
            yield issue("missing_key", (section,), None, name=section)
    yield from _check_modbus(profile)
    yield from _check_status_names(profile)
    yield from _check_standstill(profile)
    yield from _check_command_names(profile)


def _check_status_names(profile: ProfileFile) -> Iterator[Issue]:
    """Check that the status word has the states that every model needs, and those of its capabilities."""
    able, status = set(profile.capabilities), profile.status
    if "status" not in able and status is None:
        return  # a status word is read, and confirms a stop, without the capability too
    table, states = offered_states(profile)
    fault = () if status and status.hides_faults else ("fault",)
    paused = ("paused",) if "pause" in able else ()
    stopped = ("stopped",) if status and status.values else ()
    for state in ("running", *fault, *stopped, *paused):
        if state not in states and "status" in able:
            yield issue("needs", ("capabilities",), "status", what=f"{table} {state}")
        elif state not in states:
            yield issue("missing_key", ("status",), None, name=f"{table} {state}")


def _check_command_names(profile: ProfileFile) -> Iterator[Issue]:
    """Check that the command word has what each capability needs."""
    if profile.commands is None:
        return
    able = set(profile.capabilities)
    if not profile.commands.rewrite_levels_after_pulse:  # the word of a hold would drop the direction of the run
        for hold in sorted(able & {"pause", "hold_ramp"}):
            yield issue("needs", ("capabilities",), hold, what="commands.rewrite_levels_after_pulse = true")
    table, offered = offered_commands(profile.commands)
    required = REQUIRED_VALUES if profile.commands.values else REQUIRED_BITS
    for capability in sorted(able & required.keys()):
        for name in required[capability]:
            if name not in offered:
                yield issue("needs", ("capabilities",), capability, what=f"{table} {name}")


def _check_standstill(profile: ProfileFile) -> Iterator[Issue]:
    """Check that the signal of the standstill exists, and that ``status_alone`` has a source, which only it needs."""
    status = profile.status
    if status is None:
        return
    is_alone = status.standstill == "status_alone"
    signal = "output_frequency" if is_alone else status.standstill
    if signal not in {"status", *profile.signals}:
        yield issue("needs", ("status", "standstill"), status.standstill, what=f"[signals.{signal}]")
    source = status.standstill_evidence
    if is_alone and (source is None or is_assumed(source)):
        yield issue("standstill_evidence", ("status", "standstill"), status.standstill)
    if source is not None and not is_alone:
        path = ("status", "standstill_evidence")
        yield issue("no_effect_without", path, next(iter(source.values())), other='standstill = "status_alone"')


def _check_modbus(profile: ProfileFile) -> Iterator[Issue]:
    """Check that the model can write a register, read one where it claims to, and answer a sync probe."""
    modbus = profile.modbus
    functions = modbus.functions if modbus else []
    if modbus is not None and not {6, 16} & set(functions):
        yield issue("missing_key", ("modbus", "functions"), Text.join_names(map(str, functions)), name="6 / 16")
    if "read" in profile.capabilities and 3 not in functions:
        related = (("modbus", "functions"),)
        yield issue("needs", ("capabilities",), "read", related=related, what="[modbus] functions 3")
    if modbus is None:
        return
    has_probe = modbus.loopback or modbus.rejected_read is not None or modbus.sync_block is not None
    if not has_probe and not _has_sync_registers(profile):
        yield issue("sync_registers", ("modbus", "loopback"), "false", related=(("modbus",),))


def _has_sync_registers(profile: ProfileFile) -> bool:
    """Return whether two neighbouring registers, one of which is read anyway, can be read at once by a sync probe."""
    signals = {_locator_of(profile, signal.notation, signal) for signal in profile.signals.values()}
    readable = {
        name: _locator_of(profile, name, locator) for name, locator in profile.parameters.items() if locator.readable
    }
    signals |= {(profile.status.space, profile.status.register_)} if profile.status else set()
    read_locators = signals | {readable.get(name) for name in (*profile.preconditions, *(profile.ramp or ()))}
    registers = {
        locator for locator in (*signals, *readable.values()) if locator is not None and locator[0] not in BIT_SPACES
    }
    registers -= block_registers(profile)
    pairs = [
        {locator, (locator[0], locator[1] + 1)} for locator in registers if (locator[0], locator[1] + 1) in registers
    ]
    return profile.modbus is not None and profile.modbus.max_read > 1 and any(pair & read_locators for pair in pairs)


def _register_of(profile: ProfileFile, notation: str, entry: SignalTable | ParameterTable) -> int | None:
    locator = _locator_of(profile, notation, entry)
    return locator[1] if locator else None


def _locator_of(profile: ProfileFile, notation: str, entry: SignalTable | ParameterTable) -> Locator | None:
    locator = resolve_locator(profile, notation, entry)
    return locator if isinstance(locator, tuple) else None


def _check_ranges(profile: ProfileFile) -> Iterator[Issue]:
    for path, _, entry in profile.entries:
        if entry.minimum is not None and entry.maximum is not None and entry.minimum > entry.maximum:
            related = ((*path, "maximum"),)
            yield issue("minimum", (*path, "minimum"), entry.minimum, related=related, maximum=entry.maximum)
    for notation, parameter in profile.parameters.items():
        for raw in parameter.choices:
            if not is_word(raw):
                yield issue("number", ("parameters", notation, "choices", raw), raw)
        maximum = parameter.maximum_option
        numbers = [name for name, option in profile.options.items() if option.span]
        if maximum is not None and maximum not in numbers:
            yield issue("choice", ("parameters", notation, "maximum_option"), maximum, choices=listed_values(numbers))
        if parameter.caveat is not None and parameter.caveat not in profile.caveats:
            known = listed_values(profile.caveats)
            yield issue("choice", ("parameters", notation, "caveat"), parameter.caveat, choices=known)


def _check_fault_codes(profile: ProfileFile) -> Iterator[Issue]:
    for code in profile.faults:
        if not is_word(code):
            yield issue("number", ("faults", code), code)


def _check_options(profile: ProfileFile) -> Iterator[Issue]:
    """Check that every value belongs to a described option and is one of its choices."""
    options = {name: option for name, option in profile.options.items() if _is_described(option)}
    for name, option in profile.options.items():
        if name not in options:
            known = listed_values(nearest_names(name, options) or options)
            yield issue("unknown_key", ("options", name, "value"), name, known=known)
        elif option.span and option.span[0] > option.span[1]:
            yield issue("minimum", ("options", name, "span"), option.span[0], maximum=option.span[1])
        elif (option.choices or option.span) and not is_choice(option.value, option.choices, option.span):
            span = [f"{option.span[0]}-{option.span[1]}"] if option.span else []
            yield issue(
                "choice", ("options", name, "value"), option.value, choices=listed_values([*option.choices, *span])
            )
    for option_name, variants in profile.commands.variants.items() if profile.commands else ():
        choices = [str(choice) for choice in options[option_name].choices] if option_name in options else []
        for value in variants:
            if value not in choices:
                yield issue(
                    "choice", ("commands", "variants", option_name, value), value, choices=listed_values(choices)
                )


def _is_described(option: OptionTable) -> bool:
    """Return whether a profile describes the option; otherwise the value is that of a misspelled name."""
    return None not in (option.text, option.reason, option.procedure)


def check_addressing(profile: ProfileFile) -> Iterator[Issue]:
    """Yield invalid notations and registers, entries that share an address, and references to absent entries."""
    wrong_groups = list(_check_group_sizes(profile))
    yield from wrong_groups
    if not wrong_groups:
        yield from _check_locators(profile)
    yield from _check_references(profile)
    yield from _check_registers(profile)


def _check_registers(profile: ProfileFile) -> Iterator[Issue]:
    """Check that command, setpoint and status registers differ and that the EEPROM bit is one bit."""
    bit = profile.write.eeprom_address_bit
    if bit is not None and bit.bit_count() != 1:
        choices = tuple(f"0x{1 << place:04X}" for place in range(15, -1, -1))
        yield issue("choice", ("write", "eeprom_address_bit"), f"{bit:04X}H", choices=choices)
    if profile.commands is None:
        return
    related = [("commands", "register"), ("commands", "setpoint_register")]
    places: dict[Locator, str] = {}
    for place, name, path in command_places(profile):
        if places.setdefault(place, name) != name:
            yield issue("duplicate", path, f"{place[1]:04X}H", related=related, other=places[place])
    status = (profile.status.space, profile.status.register_) if profile.status is not None else None
    for notation, parameter in profile.parameters.items():
        if parameter.writable and status is not None and _locator_of(profile, notation, parameter) == status:
            at = ("parameters", notation)
            yield issue("status_parameter", at, f"{status[1]:04X}H", related=(("status", "register"),))
    is_shared = profile.status is not None and profile.status.shares_command_register
    if status in places and not (is_shared and places[status] == "[commands] register"):
        yield issue("duplicate", ("status", "register"), f"{status[1]:04X}H", related=related, other="[commands]")


def _check_identity(profile: ProfileFile) -> Iterator[Issue]:
    """Check that the register of the identity is that of a signal: its polls then show the model."""
    registers = {_register_of(profile, signal.notation, signal) for signal in profile.signals.values()} - {None}
    if profile.identity is not None and profile.identity.register_ not in registers:
        choices = listed_values(f"{register:04X}H" for register in sorted(r for r in registers if r is not None))
        yield issue("choice", ("identity", "register"), f"{profile.identity.register_:04X}H", choices=choices)
    yield from check_codes(profile)


def _check_group_sizes(profile: ProfileFile) -> Iterator[Issue]:
    wrong = [name for name in profile.group_sizes if not re.fullmatch("F[0-9]{2}", name)]
    for name in wrong:
        yield issue("group", ("group_sizes", name), name)
    total = sum(profile.group_sizes.values())
    if profile.notation.style == "consecutive" and total > profile.notation.highest + 1:
        yield issue("group_total", ("group_sizes",), total, most=profile.notation.highest + 1)


def resolve_locator(profile: ProfileFile, notation: str, entry: ValueTable) -> Locator | Issue | ProfileError:
    """Return the locator; an issue for a wrong notation; the error ``profiles.unplaced`` where data is missing."""
    if entry.register_ is not None:
        return entry.space, entry.register_
    rule = NotationRule(profile.family, profile.notation.style, profile.notation.highest)
    try:
        space, index = parse_notation(notation, rule, profile.group_sizes)
        return (entry.space if space == "holding" else space), index
    except ProfileError as error:
        if error.key == "profiles.notation":
            return issue("notation", (), notation, examples=error.params["examples"])
        return error if error.key == "profiles.unplaced" else issue("beyond", (), notation, **error.params)


def _check_locators(profile: ProfileFile) -> Iterator[Issue]:
    """Yield wrong notations, addresses outside the space, and entries that share an address."""
    register_based = protocol_family(profile.family).register_based
    name_by_locator = _command_locators(profile)
    eeprom_bit = profile.write.eeprom_address_bit or 0
    eeprom_bit = eeprom_bit if eeprom_bit.bit_count() == 1 else 0  # otherwise reported by _check_registers
    mask = profile.write.ram_address_mask or 0
    for path, notation, entry in profile.entries:
        at = path if path[0] == "parameters" else (*path, "notation")
        if entry.register_ is not None and not register_based:
            yield issue("register", (*path, "register"), entry.register_, family=profile.family)
            continue
        locator = resolve_locator(profile, notation, entry)
        if isinstance(locator, Issue):
            yield issue(locator.kind, at, notation, **locator.params)
        elif isinstance(locator, tuple):
            space, index = locator
            if space == "holding" and index & eeprom_bit:
                yield issue("eeprom_bit", at, notation, bit=f"{eeprom_bit:04X}H")
            registers = {index}
            if isinstance(entry, ParameterTable) and entry.readable and locator in block_registers(profile):
                yield issue("duplicate", at, notation, related=(("modbus", "blocks"),), other="[modbus] blocks")
            is_written = space == "holding" and isinstance(entry, ParameterTable) and entry.writable
            if is_written:
                registers.add(index | eeprom_bit)
            if mask and is_written:
                registers.add(index & ~mask)
                if index & mask != mask:
                    yield issue("choice", at, f"{index:04X}H", choices=f"{index | mask:04X}H")
            places = [register + place for register in sorted(registers) for place in range(entry.words)]
            others = [name_by_locator.setdefault((space, place), path[1]) for place in places]
            for other in dict.fromkeys(other for other in others if other != path[1]):
                related = (("signals", other, "notation"), ("parameters", other), ("group_sizes",))
                yield issue("duplicate", at, notation, related=related, other=other)


def _command_locators(profile: ProfileFile) -> dict[Locator, str]:
    """Return what commands and setpoints write: a parameter there would bypass the start permissives."""
    return {locator: name for locator, name, _ in command_places(profile)}


def _check_references(profile: ProfileFile) -> Iterator[Issue]:
    named: set[tuple[tuple[str, ...], str]] = {(("preconditions", n), n) for n in profile.preconditions}
    named |= {(("roles", role), n) for role, n in profile.roles.items()}
    named |= {(("comm_loss", key), n) for key in ("time", "action") if (n := getattr(profile.comm_loss, key))}
    named |= {(("ramp",), n) for n in profile.ramp or ()}
    for path, notation in sorted(named):
        if notation not in profile.parameters:
            near = tuple(nearest_names(notation, profile.parameters)) or "-"
            yield issue("unlisted", path, notation, near=near)


def _check_setpoint(profile: ProfileFile) -> Iterator[Issue]:
    """Check that its scale has a source or can be calibrated, and that the maximum of a share is read or stated."""
    setpoint = profile.setpoint
    path = ("setpoint", "full_scale")
    steps = setpoint.factor in USUAL_STEPS_HZ and setpoint.full_scale is None and setpoint.rpm is None
    if setpoint.is_assumed and not steps:
        shown = setpoint.full_scale or setpoint.rpm or setpoint.factor
        usual = listed_values(f"{step:g}" for step in USUAL_STEPS_HZ)
        related = tuple(("setpoint", name) for name in ("full_scale", "rpm", "factor"))
        yield issue("setpoint_evidence", ("setpoint", "evidence"), shown, related=related, usual=usual)
    if setpoint.rpm is not None and not protocol_family(profile.family).register_based:
        yield issue("register", ("setpoint", "rpm"), setpoint.rpm, family=profile.family)
    if setpoint.rpm is not None and POLE_PAIRS in profile.options:
        yield issue("duplicate", ("options", POLE_PAIRS), POLE_PAIRS, other="[setpoint] rpm")
    if setpoint.full_scale is None:
        return
    if not protocol_family(profile.family).register_based:
        yield issue("register", path, setpoint.full_scale, family=profile.family)
    if MAXIMUM_FREQUENCY in profile.options:
        yield issue("duplicate", ("options", MAXIMUM_FREQUENCY), MAXIMUM_FREQUENCY, other="[setpoint] full_scale")
    if setpoint.maximum is None and setpoint.maximum_hz is None:
        yield issue("share", path, setpoint.full_scale)
    if setpoint.highest_hz is None:
        yield issue("highest", path, setpoint.full_scale)
        return
    related = (("setpoint", "highest_hz"),)
    for name, hz in (("maximum_hz", setpoint.maximum_hz), ("lowest_hz", setpoint.lowest_hz)):
        if hz is not None and hz > setpoint.highest_hz:
            yield issue("minimum", ("setpoint", name), hz, related=related, maximum=setpoint.highest_hz)
    if setpoint.maximum is None:
        return
    parameter = profile.parameters.get(setpoint.maximum)
    if parameter is None or parameter.unit != "Hz" or not parameter.readable or not parameter.scale_published:
        yield issue("share", ("setpoint", "maximum"), setpoint.maximum)
