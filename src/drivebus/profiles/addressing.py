"""Where signals and parameters live: notations, registers, group sizes, and names that other tables refer to."""

from __future__ import annotations

import re
from collections.abc import Iterator

from drivebus.errors import ProfileError
from drivebus.profiles.diagnostics import Issue, issue
from drivebus.profiles.model import NotationRule
from drivebus.profiles.notation import nearest_names, parse_notation
from drivebus.profiles.schema import ParameterIn, ProfileIn, SignalIn


def check_addressing(profile: ProfileIn) -> Iterator[Issue]:
    """Notations and registers that can't be, two entries at one address, references to nothing."""
    wrong_groups = list(_check_group_sizes(profile))
    yield from wrong_groups
    if not wrong_groups:
        yield from _check_locators(profile)
    yield from _check_references(profile)
    yield from _check_registers(profile)


def _check_registers(profile: ProfileIn) -> Iterator[Issue]:
    """Setpoint and status apart from the command word, and an EEPROM bit that is one bit."""
    bit = profile.write.eeprom_address_bit
    if bit is not None and bit.bit_count() != 1:
        choices = ", ".join(f"0x{1 << place:04X}" for place in range(15, -1, -1))
        yield issue("choice", ("write", "eeprom_address_bit"), f"{bit:04X}H", choices=choices)
    if profile.commands is None:
        return
    word, setpoint = profile.commands.register_, profile.commands.setpoint_register
    also = [("commands", "register"), ("commands", "setpoint_register")]
    if setpoint == word:
        path = ("commands", "setpoint_register")
        yield issue("duplicate", path, f"{word:04X}H", related=also, other="[commands] register")
    if profile.status is not None and profile.status.register_ in (word, setpoint):
        found = f"{profile.status.register_:04X}H"
        yield issue("duplicate", ("status", "register"), found, related=also, other="[commands]")


def _check_group_sizes(profile: ProfileIn) -> Iterator[Issue]:
    wrong = [name for name in profile.group_sizes if not re.fullmatch("F[0-9]{2}", name)]
    for name in wrong:
        yield issue("group", ("group_sizes", name), name)
    total = sum(profile.group_sizes.values())
    if profile.notation.style == "consecutive" and total > profile.notation.highest + 1:
        yield issue("group_total", ("group_sizes",), total, most=profile.notation.highest + 1)


def resolve_locator(profile: ProfileIn, notation: str, register: int | None) -> tuple[str, int] | Issue | ProfileError:
    """The locator; a problem where the notation is wrong; the error ``profiles.unplaced`` where data is lacking."""
    if register is not None:
        return "holding", register
    rule = NotationRule(profile.notation.style, profile.notation.highest)
    try:
        return parse_notation(notation, rule, profile.group_sizes)
    except ProfileError as error:
        if error.key == "profiles.notation":
            return issue("notation", (), notation, examples=error.params["examples"])
        return error if error.key == "profiles.unplaced" else issue("beyond", (), notation, **error.params)


def _check_locators(profile: ProfileIn) -> Iterator[Issue]:
    """Notations that can't be, addresses outside the space, and two entries at one address."""
    taken = _command_locators(profile)
    eeprom_bit = profile.write.eeprom_address_bit or 0
    eeprom_bit = eeprom_bit if eeprom_bit.bit_count() == 1 else 0  # else it is complained of below
    entries: list[tuple[tuple[str, str], str, SignalIn | ParameterIn]] = [
        *((("signals", name), signal.notation, signal) for name, signal in profile.signals.items()),
        *((("parameters", notation), notation, parameter) for notation, parameter in profile.parameters.items()),
    ]
    for path, notation, entry in entries:
        at = path if path[0] == "parameters" else (*path, "notation")
        if entry.register_ is not None and profile.family != "modbus":
            yield issue("register", (*path, "register"), entry.register_, family=profile.family)
            continue
        place_ = resolve_locator(profile, notation, entry.register_)
        if isinstance(place_, Issue):
            yield issue(place_.kind, at, notation, **place_.params)
        elif isinstance(place_, tuple):
            if profile.family == "modbus" and place_[1] & eeprom_bit:
                yield issue("eeprom_bit", at, notation, bit=f"{eeprom_bit:04X}H")
            other = taken.setdefault(place_, path[1])
            if other != path[1]:
                also = (("signals", other, "notation"), ("parameters", other), ("group_sizes",))
                yield issue("duplicate", at, notation, related=also, other=other)


def _command_locators(profile: ProfileIn) -> dict[tuple[str, int], str]:
    """The command and setpoint registers: a parameter there would be a way round the gate for moving frames."""
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
