"""Notation of a manual to addresses and back, and the search for a name that a user typed.

Each protocol family declares its notation styles (``ProtocolFamily.notations``); this module applies them to a profile.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

from drivebus.errors import LimitError, ProfileError
from drivebus.profiles.diagnostics import nearest_names
from drivebus.profiles.model import DriveProfile, NotationRule, Parameter, Signal
from drivebus.protocols.family import Locator, NotationStyle, protocol_family
from drivebus.user_input import parse_decimal, parse_hex_word
from drivebus.values import Text, bilingual_text

_LEADING_ZERO = re.compile(r"0[0-9]+", re.ASCII)
_GROUP_AND_ITEM = re.compile(r"F([0-9]{1,2})[.\-]([0-9]{1,3})", re.ASCII)


def parse_notation(notation: str, rule: NotationRule, group_sizes: Mapping[str, int] | None = None) -> Locator:
    """Return the locator of a notation, listed in a profile or not.

    Raises ProfileError: ``profiles.notation`` for text of another style or out of range, ``profiles.unplaced`` where
    the sizes of the preceding groups are unknown, ``profiles.beyond_group``.
    """
    style = _style(rule)
    locator = style.parse(notation.strip().upper(), rule.highest, group_sizes or {})
    if locator is None:
        raise ProfileError("profiles.notation", notation=notation, examples=style.examples)
    return locator


def parse_value(text: str) -> float | str:
    """Return the number that a user typed as the value of a parameter. Raises ValueError where it is none.

    A hexadecimal word (``0010H``, ``0x10``) and digits behind a zero (``0010``) are returned as text: their meaning
    depends on the parameter.
    """
    if parse_hex_word(text) is not None or _LEADING_ZERO.fullmatch(text):
        return text
    return parse_decimal(text)


def parse_number(parameter: Parameter, text: str) -> float:
    """Return the number of a text. Raises LimitError, also for digits behind a zero that are ambiguous.

    ``0010`` means the digits of the keypad where the parameter is coded so; elsewhere it may be ten or the word 0010H.
    """
    try:
        number = parse_decimal(text)
    except ValueError as error:
        raise LimitError("drives.parameter_word", notation=parameter.notation, value=text) from error
    if _LEADING_ZERO.fullmatch(text) and parameter.scale.coding != "bcd" and int(text, 16) != int(text):
        word = f"{int(text, 16):04X}H"
        raise LimitError(
            "drives.parameter_digits", notation=parameter.notation, value=text, number=int(text), word=word
        )
    return number


def format_locator(locator: Locator, profile: DriveProfile) -> str:
    """Return the manual's notation of an address: the profile's own where it lists the address.

    Where that notation finds an entry at another address, the space stands before it: ``holding:0000H``.
    """
    listed = profile.entry_at(locator)
    notation = listed.notation if listed else _style(profile.notation).format(locator, profile.notation.highest)
    other = _find_by_notation(profile, notation) if listed is None else None
    return notation if other is None else f"{locator[0]}:{notation}"


def find_entry(profile: DriveProfile, name: str) -> Signal | Parameter:
    """Return the signal or parameter of a name: a signal's name, or any notation (``F0.01`` is ``F0.1``).

    A well-formed notation that the profile does not list gives a Parameter with ``listed`` False, which is only read;
    ``writable`` False marks a bare register. Raises ProfileError: ``profiles.unknown_name``, with similar names
    ``profiles.unknown_name_near``, ``profiles.no_group``, ``profiles.unplaced`` or ``profiles.beyond_group``.
    """
    signal = profile.signals.get(name.strip().lower())
    if signal is not None:
        return signal
    try:
        locator = parse_notation(name, profile.notation, profile.group_sizes)
    except ProfileError as error:
        placed = _find_by_notation(profile, name) or _find_by_numbers(profile, name)
        if placed is not None:
            return placed
        if error.key != "profiles.notation":
            raise (_no_group_error(profile, name) or error) from None
        raise _unknown_name_error(profile, name) from None
    listed = profile.entry_at(locator) or _find_by_notation(profile, name)
    return listed or _unlisted_parameter(profile, name, locator)


def find_entries(
    profile: DriveProfile, names: Iterable[str]
) -> tuple[dict[str, Signal | Parameter], dict[str, ProfileError]]:
    """Return the entry of each known name, and the error that ``find_entry`` raises for each of the others."""
    entries: dict[str, Signal | Parameter] = {}
    unknown: dict[str, ProfileError] = {}
    for name in names:
        try:
            entries[name] = find_entry(profile, name)
        except ProfileError as error:
            unknown[name] = error
    return entries, unknown


def require_entries(profile: DriveProfile, names: Iterable[str]) -> dict[str, Signal | Parameter]:
    """Return the entry of each name. Raises ProfileError ``drives.unknown_names``, which explains each unknown one."""
    entries, unknown = find_entries(profile, names)
    if unknown:
        problems = [Text.per_language(error.text) for error in unknown.values()]
        raise ProfileError("drives.unknown_names", names=tuple(unknown), why=Text.join(problems, "clauses"))
    return entries


def _style(rule: NotationRule) -> NotationStyle:
    return protocol_family(rule.family).notations[rule.style]


def _find_by_notation(profile: DriveProfile, name: str) -> Signal | Parameter | None:
    """Find the entry of a notation that gives no address (P0-10), or not its space; the profile gives the register."""
    folded_name = name.strip().casefold()
    return next((entry for entry in profile.entries() if entry.notation.casefold() == folded_name), None)


def _find_by_numbers(profile: DriveProfile, name: str) -> Parameter | None:
    """Find a parameter whose profile entry gives the register although the group sizes are unknown (VC660 F00.02)."""
    numbers = _group_and_item(name)
    return next((p for p in profile.parameters.values() if numbers and _group_and_item(p.notation) == numbers), None)


def _group_and_item(notation: str) -> tuple[int, int] | None:
    match = _GROUP_AND_ITEM.fullmatch(notation.strip().upper())
    return (int(match[1]), int(match[2])) if match else None


def _unknown_name_error(profile: DriveProfile, name: str) -> ProfileError:
    """Return the error of a name with similar ones: none of a number or a group and a number, which are out of range.

    Of another notation only those of its group.
    """
    examples = _style(profile.notation).examples
    group, dot, _ = name.strip().upper().partition(".")
    is_number = name.strip().isdecimal() or _group_and_item(name) is not None
    near = [] if is_number else nearest_names(name, [*profile.signals, *profile.parameters])
    near = [candidate for candidate in near if not dot or candidate.upper().partition(".")[0] == group]
    if not near:
        return ProfileError("profiles.unknown_name", name=name, model=profile.model, examples=examples)
    return ProfileError(
        "profiles.unknown_name_near", name=name, model=profile.model, examples=examples, near=tuple(near)
    )


def _no_group_error(profile: DriveProfile, name: str) -> ProfileError | None:
    """Return the error of a notation behind the last group that the profile lists; None for any other."""
    listed = map(
        _group_and_item, [*profile.parameters, *profile.unplaced, *(f"{group}.0" for group in profile.group_sizes)]
    )
    groups, named = sorted({part[0] for part in listed if part}), _group_and_item(name)
    if named is None or not groups or named[0] <= groups[-1]:
        return None
    names = tuple(f"F{group:02d}" for group in groups)
    return ProfileError("profiles.no_group", notation=name, model=profile.model, group=f"F{named[0]:02d}", groups=names)


def _unlisted_parameter(profile: DriveProfile, name: str, locator: Locator) -> Parameter:
    bare = _style(profile.notation).is_raw_address(name.strip().upper())
    return Parameter(
        notation=format_locator(locator, profile),
        locator=locator,
        text=bilingual_text("profiles.command_word" if locator in profile.command_registers else "profiles.raw_word"),
        writable=not bare and locator[0] in ("parameter", "holding"),
        listed=False,
    )
