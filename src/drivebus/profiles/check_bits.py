"""Command and status words: masks that must not touch, and the one command that is never offered (T16)."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from typing import Any

from drivebus.profiles.diagnostics import Issue, KeyPath, issue
from drivebus.profiles.schema import BitIn, ProfileIn

BitPaths = dict[str, tuple[KeyPath, BitIn]]
"""Command name → where its bits stand, and the bits."""
COMMANDS_WITH_OWN_BIT = ("start", "stop", "coast", "quick_stop", "reset", "jog_forward", "jog_reverse")
"""Commands that must be recognisable in a word: what frame is a stop, and so exempt from permits, is read from it."""


STOP_COMMANDS = ("stop", "coast", "quick_stop", "jog_stop")
MOTION_COMMANDS = ("start", "jog_forward", "jog_reverse")


def check_bits(profile: ProfileIn) -> Iterator[Issue]:
    """Everything wrong with the words' bits."""
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
    """What is wrong with whole words, a setting's bits laid over the common ones."""
    commands = profile.commands
    if commands is None:
        return
    plain: BitPaths = {name: (("commands", "bits", name), bit) for name, bit in commands.bits.items()}
    layers = [plain]
    for setting, choices in commands.variants.items():
        for value, bits in choices.items():
            path = ("commands", "variants", setting, value)
            layers.append(plain | {name: ((*path, name), bit) for name, bit in bits.items()})
    seen: set[KeyPath] = set()
    for placed in layers:
        for found in (*_find_toggles(placed), *_find_identical_commands(placed), *_find_moving_stops(placed)):
            if found.path not in seen:
                seen.add(found.path)
                yield found


def _find_toggles(placed: BitPaths) -> Iterator[Issue]:
    """A field of two bits that hold both directions: both at once reverse whatever is (T16), in any command."""
    fields = {placed[name][1].mask for name in ("forward", "reverse") if name in placed}
    for path, bit in placed.values():
        if any(field.bit_count() > 1 and bit.value & field == field for field in fields):
            yield issue("toggle", path, f"{bit.value:04X}H")


def _find_identical_commands(placed: BitPaths) -> Iterator[Issue]:
    """Two commands that are the same word: forward and reverse could not be told apart."""
    for (first, (at, a)), (second, (path, b)) in combinations(placed.items(), 2):
        if (a.mask, a.value) == (b.mask, b.value) and not (a.pulse or b.pulse or _is_shared_stop(first, second)):
            yield issue("alike", path, f"{b.value:04X}H", related=(at,), first=first, second=second)


def _find_moving_stops(placed: BitPaths) -> Iterator[Issue]:
    """A stop needs no permit: its word must not start or jog as well."""
    for stop, move in ((s, m) for s in STOP_COMMANDS for m in MOTION_COMMANDS if s in placed and m in placed):
        (path, bit), (at, moving) = placed[stop], placed[move]
        if moving.value and bit.value & moving.mask == moving.value and not (bit.pulse and moving.pulse):
            yield issue("moving_stop", path, f"{bit.value:04X}H", related=(at,), stop=stop, move=move)


def _find_overlaps(path: tuple[str, ...], bits: dict[Any, BitIn]) -> Iterator[Issue]:
    """Two pulses may share a mask only as two values of one field; a pulse shares nothing with a level."""
    for (first, a), (second, b) in combinations(bits.items(), 2):
        if not a.mask & b.mask or not (a.pulse or b.pulse):
            continue
        if a.mask != b.mask or a.pulse != b.pulse or (a.value == b.value and not _is_shared_stop(first, second)):
            also = ((*path, first),)
            yield issue("overlap", (*path, second), f"{b.mask:04X}H", related=also, other=first, mask=f"{a.mask:04X}H")


def _is_shared_stop(first: str, second: str) -> bool:
    """A jog may be ended by the ordinary stop (DF800)."""
    return {first, second} == {"stop", "jog_stop"}


def _check_status_bits(profile: ProfileIn) -> Iterator[Issue]:
    if profile.status is None:
        return
    seen = profile.status.reserved_mask
    for name, mask in profile.status.bits.items():
        if mask.bit_count() != 1 or mask & seen:
            also: list[KeyPath] = [
                ("status", "bits", other) for other, bit in profile.status.bits.items() if bit & mask
            ]
            also.append(("status", "reserved_mask"))
            yield issue("status_bit", ("status", "bits", name), f"{mask:04X}H", related=also, seen=f"{seen:04X}H")
        seen |= mask
