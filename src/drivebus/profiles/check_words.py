"""Checks of the command and status words of a profile: bits that must not collide, and values that mean one thing."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from typing import Any

from drivebus.profiles.diagnostics import Issue, KeyPath, issue
from drivebus.profiles.schema import BitTable, CommandsTable, ProfileFile
from drivebus.profiles.words import MOTION_COMMANDS, MOTION_VALUES, STOP_COMMANDS
from drivebus.values import Text

BitPaths = dict[str, tuple[KeyPath, BitTable]]
"""Command name to the key path of its bits, and the bits."""
COMMANDS_WITH_OWN_BIT = ("start", "stop", "coast", "quick_stop", "reset", "jog_forward", "jog_reverse")
"""Commands that need a bit set: whether a frame is a stop, and so needs no permit, is read from its bits."""
STATES_WITHOUT_MOTION = ("stopped", "fault", "not_ready")
"""Names of status values that confirm a stop."""


def check_words(profile: ProfileFile) -> Iterator[Issue]:
    """Yield the issues of command and status words."""
    for section in ("commands", "status"):
        table = getattr(profile, section)
        if table is not None and bool(table.bits) is bool(table.values):
            present = [kind for kind in ("bits", "values") if getattr(table, kind)]
            yield issue("bits_or_values", (section,), Text.join_names(present or ["-"]))
    yield from _check_masks(profile)
    yield from _check_whole_words(profile)
    yield from _check_command_values(profile)
    yield from _check_preparation(profile)
    yield from _check_status_bits(profile)
    yield from _check_status_values(profile)


def offered_commands(commands: CommandsTable) -> tuple[str, set[str]]:
    """Return the table of the commands and their names, those of an option too."""
    reset = {"reset"} if commands.reset else set()
    if commands.values:
        return "[commands.values]", {*commands.values, *reset}
    variants = (bits for choices in commands.variants.values() for bits in choices.values())
    return "[commands.bits]", set(commands.bits).union(reset, *variants)


def offered_states(profile: ProfileFile) -> tuple[str, set[str]]:
    """Return the table of the status word, and of "running" and "fault" those that the drive reports."""
    status = profile.status
    if status is None:
        return "[status.bits]", set()
    names = {str(name) for name in (status.values.values() if status.values else status.bits)}
    if any(name.startswith("running") for name in names):
        names.add("running")
    if status.fault_registers:
        names.add("fault")  # a fault register that is read with the status word
    return ("[status.values]" if status.values else "[status.bits]"), names


def _check_masks(profile: ProfileFile) -> Iterator[Issue]:
    commands = profile.commands
    if commands is None:
        return
    groups: list[tuple[tuple[str, ...], dict[Any, BitTable]]] = [(("commands", "bits"), dict(commands.bits))]
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


def _check_whole_words(profile: ProfileFile) -> Iterator[Issue]:
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
        for problem in (*_find_toggles(placed), *_find_identical_commands(placed), *_find_moving_stops(placed)):
            if problem.path not in reported:
                reported.add(problem.path)
                yield problem


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
    """Yield stops whose word also starts or jogs: a stop is sent without a permit."""
    for stop, move in ((s, m) for s in STOP_COMMANDS for m in MOTION_COMMANDS if s in placed and m in placed):
        (path, bit), (at, moving) = placed[stop], placed[move]
        if moving.value and bit.value & moving.mask == moving.value and not (bit.pulse and moving.pulse):
            yield issue("moving_stop", path, f"{bit.value:04X}H", related=(at,), stop=stop, move=move)


def _find_overlaps(path: tuple[str, ...], bits: dict[Any, BitTable]) -> Iterator[Issue]:
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
    """Return whether both are stops: a jog may end with the ordinary stop."""
    return {first, second} == {"stop", "jog_stop"}


def _check_status_bits(profile: ProfileFile) -> Iterator[Issue]:
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


def _check_command_values(profile: ProfileFile) -> Iterator[Issue]:
    """Check that no word means two commands; several stops may share one."""
    values = profile.commands.values if profile.commands else {}
    for (first, a), (second, b) in combinations(values.items(), 2):
        if a == b and not {first, second} <= set(STOP_COMMANDS):
            path = ("commands", "values", second)
            yield issue(
                "same_value", path, f"{b:04X}H", related=(("commands", "values", first),), first=first, second=second
            )


def _check_preparation(profile: ProfileFile) -> Iterator[Issue]:
    """Check that no word before a start can start: it is sent without the permit of a start."""
    commands = profile.commands
    if commands is None or not (commands.preparation or commands.ready):
        return
    by_status = [step for step in commands.preparation if step.when or step.until]
    is_whole = all(step.when and step.until for step in by_status) and bool(by_status) is (commands.ready is not None)
    if not is_whole or not commands.values or profile.status is None:
        yield issue("preparation_parts", ("commands", "preparation"), len(commands.preparation))
        return
    moves = {name: word for name, word in commands.values.items() if name in MOTION_VALUES}
    for place, step in enumerate(commands.preparation):
        for name, word in moves.items():
            if step.word & word == word:
                path = ("commands", "preparation", place, "word")
                yield issue("preparation_moves", path, f"{step.word:04X}H", name=name, word=f"{word:04X}H")
        if step.until and step.when == step.until:
            yield issue("preparation_idle", ("commands", "preparation", place, "until"), f"{step.until.value:04X}H")
    for match in (*(match for step in by_status for match in (step.when, step.until)), commands.ready):
        if match is not None and match.value & ~match.mask:
            yield issue("outside_mask", ("commands", "preparation"), f"{match.value:04X}H", mask=f"{match.mask:04X}H")


def _check_status_values(profile: ProfileFile) -> Iterator[Issue]:
    status = profile.status
    if status is None:
        return
    for value in status.values:
        if not is_word(value) or int(value) & ~status.mask:
            yield issue("number", ("status", "values", value), value)
            return
    yield from _find_hidden_motion({int(value): name for value, name in status.values.items()}, status.mask)


def _find_hidden_motion(values: dict[int, str], mask: int) -> Iterator[Issue]:
    """Yield values without motion that have a run bit: a fault may be reported while the motor still turns.

    A run bit is one that values with motion have and no other state without motion has. It is a bit, and no part of a
    number, where the value without it has the same name, or where the mask has gaps and that value is not listed.
    """
    moving = [value for value, name in values.items() if name not in STATES_WITHOUT_MOTION]
    has_gaps = "0" in f"{mask:b}".strip("0")
    for value, name in values.items():
        if name not in ("fault", "not_ready"):
            continue
        standing = [number for number, other in values.items() if other in STATES_WITHOUT_MOTION and other != name]
        for bit in (1 << place for place in range(16) if value >> place & 1):
            is_run_bit = any(bit & number for number in moving) and not any(bit & number for number in standing)
            if is_run_bit and values.get(value ^ bit, name if has_gaps else None) == name:
                related = [("status", "values", str(number)) for number in moving if bit & number]
                path = ("status", "values", str(value))
                yield issue("hidden_motion", path, name, related=related, bit=f"{bit:04X}H")
                break


def is_word(digits: str) -> bool:
    """Return whether the digits are a 16-bit number without leading zeros, which would allow the same word twice."""
    is_short = len(digits) <= 5 and digits.isascii() and digits.isdecimal()
    return is_short and int(digits) <= 0xFFFF and digits == str(int(digits))
