"""Command and status words: masks that must not touch, and the one command that is never offered (T16)."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from typing import Any

from drivebus.profiles.complaint import Path, Problem, problem
from drivebus.profiles.schema import BitIn, ProfileIn

OWN_BIT = ("start", "stop", "coast", "quick_stop", "reset", "jog_forward", "jog_reverse")
"""Commands that must be recognisable in a word: what frame is a stop, and so exempt from permits, is read from it."""


def problems(profile: ProfileIn) -> Iterator[Problem]:
    """Everything wrong with the words' bits."""
    yield from _commands(profile)
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
            if name in ("forward", "reverse") and bit.mask.bit_count() > 1 and bit.value == bit.mask:
                yield problem("toggle", (*path, name), f"{bit.value:04X}H")
        yield from _overlaps(path, bits)


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
