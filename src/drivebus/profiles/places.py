"""Where signals and parameters live: notations, registers, group sizes, and names that other tables refer to."""

from __future__ import annotations

import re
from collections.abc import Iterator

from drivebus.errors import ProfileError
from drivebus.profiles.complaint import Problem, problem
from drivebus.profiles.model import NotationRule
from drivebus.profiles.notation import locate, nearest
from drivebus.profiles.schema import ParameterIn, ProfileIn, SignalIn


def problems(profile: ProfileIn) -> Iterator[Problem]:
    """Notations and registers that can't be, two entries at one address, references to nothing."""
    wrong_groups = list(_group_sizes(profile))
    yield from wrong_groups
    if not wrong_groups:
        yield from _places(profile)
    yield from _references(profile)
    yield from _registers(profile)


def _registers(profile: ProfileIn) -> Iterator[Problem]:
    """Setpoint and status apart from the command word, and an EEPROM bit that is one bit."""
    bit = profile.write.eeprom_address_bit
    if bit is not None and bit.bit_count() != 1:
        choices = ", ".join(f"0x{1 << place:04X}" for place in range(15, -1, -1))
        yield problem("choice", ("write", "eeprom_address_bit"), f"{bit:04X}H", choices=choices)
    if profile.commands is None:
        return
    word, setpoint = profile.commands.register_, profile.commands.setpoint_register
    also = [("commands", "register"), ("commands", "setpoint_register")]
    if setpoint == word:
        path = ("commands", "setpoint_register")
        yield problem("duplicate", path, f"{word:04X}H", also=also, other="[commands] register")
    if profile.status is not None and profile.status.register_ in (word, setpoint):
        found = f"{profile.status.register_:04X}H"
        yield problem("duplicate", ("status", "register"), found, also=also, other="[commands]")


def _group_sizes(profile: ProfileIn) -> Iterator[Problem]:
    wrong = [name for name in profile.group_sizes if not re.fullmatch("F[0-9]{2}", name)]
    for name in wrong:
        yield problem("group", ("group_sizes", name), name)
    total = sum(profile.group_sizes.values())
    if profile.notation.style == "consecutive" and total > profile.notation.highest + 1:
        yield problem("group_total", ("group_sizes",), total, most=profile.notation.highest + 1)


def place(profile: ProfileIn, notation: str, register: int | None) -> tuple[str, int] | Problem | ProfileError:
    """The locator; a problem where the notation is wrong; the error ``profiles.unplaced`` where data is lacking."""
    if register is not None:
        return "holding", register
    rule = NotationRule(profile.notation.style, profile.notation.highest)
    try:
        return locate(notation, rule, profile.group_sizes)
    except ProfileError as error:
        if error.key == "profiles.notation":
            return problem("notation", (), notation, examples=error.params["examples"])
        return error if error.key == "profiles.unplaced" else problem("beyond", (), notation, **error.params)


def _places(profile: ProfileIn) -> Iterator[Problem]:
    """Notations that can't be, addresses outside the space, and two entries at one address."""
    taken = _taken_by_commands(profile)
    eeprom_bit = profile.write.eeprom_address_bit or 0
    eeprom_bit = eeprom_bit if eeprom_bit.bit_count() == 1 else 0  # else it is complained of below
    entries: list[tuple[tuple[str, str], str, SignalIn | ParameterIn]] = [
        *((("signals", name), signal.notation, signal) for name, signal in profile.signals.items()),
        *((("parameters", notation), notation, parameter) for notation, parameter in profile.parameters.items()),
    ]
    for path, notation, entry in entries:
        at = path if path[0] == "parameters" else (*path, "notation")
        if entry.register_ is not None and profile.family != "modbus":
            yield problem("register", (*path, "register"), entry.register_, family=profile.family)
            continue
        place_ = place(profile, notation, entry.register_)
        if isinstance(place_, Problem):
            yield problem(place_.kind, at, notation, **place_.params)
        elif isinstance(place_, tuple):
            if profile.family == "modbus" and place_[1] & eeprom_bit:
                yield problem("eeprom_bit", at, notation, bit=f"{eeprom_bit:04X}H")
            other = taken.setdefault(place_, path[1])
            if other != path[1]:
                also = (("signals", other, "notation"), ("parameters", other), ("group_sizes",))
                yield problem("duplicate", at, notation, also=also, other=other)


def _taken_by_commands(profile: ProfileIn) -> dict[tuple[str, int], str]:
    """The command and setpoint registers: a parameter there would be a way round the gate for moving frames."""
    if profile.commands is None:
        return {}
    return {
        ("holding", profile.commands.register_): "[commands] register",
        ("holding", profile.commands.setpoint_register): "[commands] setpoint_register",
    }


def _references(profile: ProfileIn) -> Iterator[Problem]:
    named: set[tuple[tuple[str, ...], str]] = {(("preconditions", n), n) for n in profile.preconditions}
    named |= {(("roles", role), n) for role, n in profile.roles.items()}
    named |= {(("comm_loss", key), n) for key in ("time", "action") if (n := getattr(profile.comm_loss, key))}
    named |= {(("ramp",), n) for n in profile.ramp or ()}
    for path, notation in sorted(named):
        if notation not in profile.parameters:
            near = ", ".join(nearest(notation, profile.parameters)) or "-"
            yield problem("unlisted", path, notation, near=near)
