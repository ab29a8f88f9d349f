"""Command and status words: masks that must not touch, and the one command that is never offered (T16)."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from typing import Any

from drivebus.profiles.complaint import Path, Problem, problem
from drivebus.profiles.schema import BitIn, ProfileIn

Places = dict[str, tuple[Path, BitIn]]
"""Command name → where its bits stand, and the bits."""
OWN_BIT = ("start", "stop", "coast", "quick_stop", "reset", "jog_forward", "jog_reverse")
"""Commands that must be recognisable in a word: what frame is a stop, and so exempt from permits, is read from it."""


STOPS = ("stop", "coast", "quick_stop", "jog_stop")
MOVES = ("start", "jog_forward", "jog_reverse")


def problems(profile: ProfileIn) -> Iterator[Problem]:
    """Everything wrong with the words' bits."""
    yield from _commands(profile)
    yield from _words(profile)
    yield from _status(profile)


def _commands(profile: ProfileIn) -> Iterator[Problem]:
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
                yield problem("outside_mask", (*path, name), f"{bit.value:04X}H", mask=f"{bit.mask:04X}H")
            if name in OWN_BIT and not bit.value:
                yield problem("no_bit", (*path, name), "0000H", name=name)
        yield from _overlaps(path, bits)


def _words(profile: ProfileIn) -> Iterator[Problem]:
    """What is wrong with whole words, a setting's bits laid over the common ones."""
    commands = profile.commands
    if commands is None:
        return
    plain: Places = {name: (("commands", "bits", name), bit) for name, bit in commands.bits.items()}
    layers = [plain]
    for setting, choices in commands.variants.items():
        for value, bits in choices.items():
            path = ("commands", "variants", setting, value)
            layers.append(plain | {name: ((*path, name), bit) for name, bit in bits.items()})
    seen: set[Path] = set()
    for placed in layers:
        for found in (*_toggles(placed), *_alike(placed), *_moving_stops(placed)):
            if found.path not in seen:
                seen.add(found.path)
                yield found


def _toggles(placed: Places) -> Iterator[Problem]:
    """A field of two bits that hold both directions: both at once reverse whatever is (T16), in any command."""
    fields = {placed[name][1].mask for name in ("forward", "reverse") if name in placed}
    for path, bit in placed.values():
        if any(field.bit_count() > 1 and bit.value & field == field for field in fields):
            yield problem("toggle", path, f"{bit.value:04X}H")


def _alike(placed: Places) -> Iterator[Problem]:
    """Two commands that are the same word: forward and reverse could not be told apart."""
    for (first, (at, a)), (second, (path, b)) in combinations(placed.items(), 2):
        if (a.mask, a.value) == (b.mask, b.value) and not (a.pulse or b.pulse or _same_stop(first, second)):
            yield problem("alike", path, f"{b.value:04X}H", also=(at,), first=first, second=second)


def _moving_stops(placed: Places) -> Iterator[Problem]:
    """A stop needs no permit: its word must not start or jog as well."""
    for stop, move in ((s, m) for s in STOPS for m in MOVES if s in placed and m in placed):
        (path, bit), (at, moving) = placed[stop], placed[move]
        if moving.value and bit.value & moving.mask == moving.value and not (bit.pulse and moving.pulse):
            yield problem("moving_stop", path, f"{bit.value:04X}H", also=(at,), stop=stop, move=move)


def _overlaps(path: tuple[str, ...], bits: dict[Any, BitIn]) -> Iterator[Problem]:
    """Two pulses may share a mask only as two values of one field; a pulse shares nothing with a level."""
    for (first, a), (second, b) in combinations(bits.items(), 2):
        if not a.mask & b.mask or not (a.pulse or b.pulse):
            continue
        if a.mask != b.mask or a.pulse != b.pulse or (a.value == b.value and not _same_stop(first, second)):
            also = ((*path, first),)
            yield problem("overlap", (*path, second), f"{b.mask:04X}H", also=also, other=first, mask=f"{a.mask:04X}H")


def _same_stop(first: str, second: str) -> bool:
    """A jog may be ended by the ordinary stop (DF800)."""
    return {first, second} == {"stop", "jog_stop"}


def _status(profile: ProfileIn) -> Iterator[Problem]:
    if profile.status is None:
        return
    seen = profile.status.reserved_mask
    for name, mask in profile.status.bits.items():
        if mask.bit_count() != 1 or mask & seen:
            also: list[Path] = [("status", "bits", other) for other, bit in profile.status.bits.items() if bit & mask]
            also.append(("status", "reserved_mask"))
            yield problem("status_bit", ("status", "bits", name), f"{mask:04X}H", also=also, seen=f"{seen:04X}H")
        seen |= mask
