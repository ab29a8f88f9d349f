"""The manual's own notation ↔ locator, per style, and the search for a name that a user typed. Pure; reads no file.

=============  =======================================================================  ==========================
style          parameters                                                               registers and monitors
=============  =======================================================================  ==========================
sifang         ``F0.1`` ``F1.10`` ``FC.03``: group << 8 | item (group digits of §3 (4))    ``d.0`` ``d.37``
dzb            ``10``: two decimal digits, 00-80                                        ``Q01``
consecutive    ``F00.02``: index over all groups (VC660 §5), by ``group_sizes``         ``3002H`` ``0x3002``
hundreds       ``F1.07``: group x 100 + item (DF800)                                    ``2001H`` ``0x2001``
register       none                                                                     ``3002H`` ``0x3002`` ``12290``
=============  =======================================================================  ==========================
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Mapping

from drivebus.errors import ProfileError
from drivebus.profiles.diagnostics import bilingual_text
from drivebus.profiles.model import DriveProfile, Locator, NotationRule, Parameter, Signal

SUNFAR_GROUPS = {**{str(n): n for n in range(10)}, "C": 10, "E": 11, "F": 12, "H": 13, "L": 14, "P": 15}
"""Function group letter → data class digit (manual §3 (4))."""
_SUNFAR_LETTERS = {number: letter for letter, number in SUNFAR_GROUPS.items()}

_EXAMPLES = {
    "sifang": "F0.1, F1.10, FC.03, d.0",
    "dzb": "10, Q01",
    "consecutive": "F00.02, 3002H, 0x3002",
    "hundreds": "F1.07, 2001H, 0x2001",
    "register": "3002H, 0x3002, 12290",
}
_PARAMETER = re.compile(r"F([0-9A-Z]{1,2})[.\-]([0-9]{1,3})", re.ASCII)
_MONITOR = re.compile(r"D[.\-]([0-9]{1,3})", re.ASCII)
_QUERY = re.compile(r"Q([0-9]{1,2})", re.ASCII)
_REGISTER = re.compile(r"0X([0-9A-F]{1,4})|([0-9][0-9A-F]{0,4})H", re.ASCII)
_DECIMAL = re.compile(r"[0-9]{1,5}", re.ASCII)


def parse_notation(notation: str, rule: NotationRule, group_sizes: Mapping[str, int] | None = None) -> Locator:
    """The locator of a notation, listed in a profile or not.

    Raises ProfileError: ``profiles.notation`` (not this style's, or out of its range), ``profiles.unplaced`` (right,
    but the sizes of the groups before it are not known).
    """
    text = notation.strip().upper()
    found = _parse_by_style(text, rule, group_sizes or {})
    if found is None:
        raise ProfileError("profiles.notation", notation=notation, examples=_EXAMPLES[rule.style])
    return found


def _parse_by_style(text: str, rule: NotationRule, sizes: Mapping[str, int]) -> Locator | None:
    if rule.style == "sifang":
        return _parse_sunfar(text)
    if rule.style == "dzb":
        return _parse_dzb100(text, rule.highest)
    register = _REGISTER.fullmatch(text)
    if register:
        number = int(register[1] or register[2], 16)
        return ("holding", number) if number <= 0xFFFF else None
    if rule.style == "register":
        return ("holding", int(text)) if _DECIMAL.fullmatch(text) and int(text) <= rule.highest else None
    match = _PARAMETER.fullmatch(text)
    if not match or not match[1].isdecimal():
        return None
    group, item = int(match[1]), int(match[2])
    index = group * 100 + item if rule.style == "hundreds" else _consecutive_index(group, item, sizes)
    fits = item <= 99 and index <= rule.highest
    return ("holding", index) if fits else None


def _parse_sunfar(text: str) -> Locator | None:
    monitor = _MONITOR.fullmatch(text)
    if monitor:
        return ("monitor", int(monitor[1])) if int(monitor[1]) <= 0xFF else None
    match = _PARAMETER.fullmatch(text)
    if not match or match[1] not in SUNFAR_GROUPS or int(match[2]) > 0xFF:
        return None
    return "parameter", SUNFAR_GROUPS[match[1]] << 8 | int(match[2])


def _parse_dzb100(text: str, highest: int) -> Locator | None:
    query = _QUERY.fullmatch(text)
    if query:
        return ("query", int(query[1])) if int(query[1]) <= 3 else None
    return ("parameter", int(text)) if _DECIMAL.fullmatch(text) and int(text) <= highest else None


def _consecutive_index(group: int, item: int, sizes: Mapping[str, int]) -> int:
    """Index over all groups. An item above 0 must be known to be in its group; item 0 of a group always is."""
    known = {int(name[1:]): size for name, size in sizes.items()}
    lacking = [g for g in range(group) if g not in known]
    if group not in known and item > 0:
        lacking.append(group)
    name = f"F{group:02d}.{item:02d}"
    if lacking:
        raise ProfileError("profiles.unplaced", notation=name, groups=", ".join(f"F{g:02d}" for g in lacking))
    if item >= known.get(group, 1):
        raise ProfileError("profiles.beyond_group", notation=name, group=f"F{group:02d}", size=known[group])
    return sum(known[g] for g in range(group)) + item


def format_locator(locator: Locator, profile: DriveProfile) -> str:
    """The manual's notation of an address: the profile's own where it lists it, else by the style."""
    listed = _find_listed(profile, locator)
    if listed is not None:
        return listed.notation
    space, index = locator
    if space == "monitor":
        return f"d.{index}"
    if space == "query":
        return f"Q{index:02d}"
    if space == "parameter" and profile.notation.style == "sifang":
        return f"F{_SUNFAR_LETTERS.get(index >> 8, '?')}.{index & 0xFF}"
    if space == "parameter":
        return f"{index:02d}"
    if profile.notation.style == "hundreds" and index <= profile.notation.highest:
        return f"F{index // 100}.{index % 100:02d}"
    return f"{index:04X}H"


def _find_listed(profile: DriveProfile, locator: Locator) -> Signal | Parameter | None:
    everything: list[Signal | Parameter] = [*profile.signals.values(), *profile.parameters.values()]
    return next((entry for entry in everything if entry.locator == locator), None)


def find_entry(profile: DriveProfile, name: str) -> Signal | Parameter:
    """What a user means by ``name``: a signal's name, or any notation of the manual (``F0.01`` is ``F0.1``).

    A well-formed notation that the profile does not list gives a raw Parameter (``listed`` False): readable;
    writable only in the parameter space, never a bare register (T12). Raises ProfileError ``profiles.unknown_name``
    with the nearest names, ``profiles.unplaced`` or ``profiles.beyond_group``.
    """
    signal = profile.signals.get(name.strip().lower())
    if signal is not None:
        return signal
    try:
        locator = parse_notation(name, profile.notation, profile.group_sizes)
    except ProfileError as error:
        explicit = _find_by_numbers(profile, name)
        if explicit is not None:
            return explicit
        if error.key != "profiles.notation":
            raise
        raise ProfileError("profiles.unknown_name", **_unknown_name_params(profile, name)) from None
    return _find_listed(profile, locator) or _unlisted_parameter(profile, name, locator)


def _find_by_numbers(profile: DriveProfile, name: str) -> Parameter | None:
    """A parameter with an explicit register although the sizes of the groups are unknown (VC660 F00.02)."""
    wanted = _group_and_item(name)
    return next((p for p in profile.parameters.values() if wanted and _group_and_item(p.notation) == wanted), None)


def _group_and_item(notation: str) -> tuple[int, int] | None:
    match = _PARAMETER.fullmatch(notation.strip().upper())
    return (int(match[1]), int(match[2])) if match and match[1].isdecimal() else None


def _unknown_name_params(profile: DriveProfile, name: str) -> dict[str, object]:
    near = nearest_names(name, [*profile.signals, *profile.parameters])
    return {
        "name": name,
        "model": profile.model,
        "examples": _EXAMPLES[profile.notation.style],
        "near": ", ".join(near) or "-",
    }


def nearest_names(name: str, known: Iterable[str]) -> list[str]:
    """Up to three known names that look like ``name``, best first."""
    by_folded = {candidate.lower(): candidate for candidate in known}
    return [by_folded[found] for found in difflib.get_close_matches(name.strip().lower(), by_folded, 3, 0.5)]


def _unlisted_parameter(profile: DriveProfile, name: str, locator: Locator) -> Parameter:
    text = bilingual_text("profiles.raw_word")
    bare = _REGISTER.fullmatch(name.strip().upper()) is not None or profile.notation.style == "register"
    shown = format_locator(locator, profile)
    return Parameter(shown, locator, text, writable=not bare and locator[0] in ("parameter", "holding"), listed=False)
