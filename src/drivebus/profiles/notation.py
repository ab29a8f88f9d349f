"""Notation of a manual to addresses and back, and the search for a name that a user typed.

Each protocol family declares its notation styles (``ProtocolFamily.notations``); this module applies them to a profile.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

from drivebus.errors import ProfileError
from drivebus.profiles.diagnostics import bilingual_text, nearest_names
from drivebus.profiles.model import DriveProfile, NotationRule, Parameter, Signal
from drivebus.protocols.family import Locator, NotationStyle, protocol_family

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


def format_locator(locator: Locator, profile: DriveProfile) -> str:
    """Return the manual's notation of an address: the profile's own where it lists the address."""
    listed = _find_listed(profile, locator)
    if listed is not None:
        return listed.notation
    return _style(profile.notation).format(locator, profile.notation.highest)


def find_entry(profile: DriveProfile, name: str) -> Signal | Parameter:
    """Return the signal or parameter of a name: a signal's name, or any notation (``F0.01`` is ``F0.1``).

    A well-formed notation that the profile does not list gives a Parameter with ``listed`` False: readable, and
    writable unless it is a bare register. Raises ProfileError ``profiles.unknown_name`` with similar names,
    ``profiles.unplaced`` or ``profiles.beyond_group``.
    """
    signal = profile.signals.get(name.strip().lower())
    if signal is not None:
        return signal
    try:
        locator = parse_notation(name, profile.notation, profile.group_sizes)
    except ProfileError as error:
        by_numbers = _find_by_numbers(profile, name)
        if by_numbers is not None:
            return by_numbers
        if error.key != "profiles.notation":
            raise
        raise ProfileError("profiles.unknown_name", **_unknown_name_params(profile, name)) from None
    return _find_listed(profile, locator) or _unlisted_parameter(profile, name, locator)


def _style(rule: NotationRule) -> NotationStyle:
    return protocol_family(rule.family).notations[rule.style]


def _find_listed(profile: DriveProfile, locator: Locator) -> Signal | Parameter | None:
    entries: list[Signal | Parameter] = [*profile.signals.values(), *profile.parameters.values()]
    return next((entry for entry in entries if entry.locator == locator), None)


def _find_by_numbers(profile: DriveProfile, name: str) -> Parameter | None:
    """Find a parameter whose profile entry gives the register although the group sizes are unknown (VC660 F00.02)."""
    wanted = _group_and_item(name)
    return next((p for p in profile.parameters.values() if wanted and _group_and_item(p.notation) == wanted), None)


def _group_and_item(notation: str) -> tuple[int, int] | None:
    match = _GROUP_AND_ITEM.fullmatch(notation.strip().upper())
    return (int(match[1]), int(match[2])) if match else None


def _unknown_name_params(profile: DriveProfile, name: str) -> dict[str, object]:
    near = nearest_names(name, [*profile.signals, *profile.parameters])
    return {
        "name": name,
        "model": profile.model,
        "examples": _style(profile.notation).examples,
        "near": ", ".join(near) or "-",
    }


def _unlisted_parameter(profile: DriveProfile, name: str, locator: Locator) -> Parameter:
    bare = _style(profile.notation).is_raw_address(name.strip().upper())
    return Parameter(
        notation=format_locator(locator, profile),
        locator=locator,
        text=bilingual_text("profiles.raw_word"),
        writable=not bare and locator[0] in ("parameter", "holding"),
        listed=False,
    )
