"""Checks of how a Modbus profile reads and writes: spaces, functions, numbers in two registers, commands in coils."""

from __future__ import annotations

from collections.abc import Iterator

from drivebus.profiles.diagnostics import Issue, KeyPath, issue
from drivebus.profiles.schema import CommandsTable, ModbusTable, ParameterTable, ProfileFile, SignalTable
from drivebus.profiles.spaces import BIT_SPACES, READ_FUNCTION_BY_SPACE, SYNC_READ_COUNT
from drivebus.protocols.family import Locator, protocol_family

SINGLE_COILS = 16
"""Coils from ``[commands] register`` on that a command may name with ``written_to = "coil"``."""
READ_ONLY_SPACES = ("input", "discrete")
WRITE_COIL, WRITE_COILS, WRITE_REGISTERS = 5, 15, 16


def command_places(profile: ProfileFile) -> list[tuple[Locator, str, KeyPath]]:
    """Return what commands, setpoints and resets write, with the name and the key path of each."""
    commands = profile.commands
    if commands is None:
        return []
    space = "holding" if commands.written_to == "register" else "coil"
    count = {"register": commands.words, "coils": commands.coil_count, "coil": SINGLE_COILS}[commands.written_to]
    spans: list[tuple[str, int, int, str, KeyPath]] = [
        (space, commands.register_, count, "[commands] register", ("commands", "register")),
        (
            "holding",
            commands.setpoint_register,
            profile.setpoint.words,
            "[commands] setpoint_register",
            ("commands", "setpoint_register"),
        ),
    ]
    for name, fixed in (("reset", commands.reset), ("unlock", commands.unlock)):
        if fixed is not None:
            at: KeyPath = ("commands", name, "register")
            spans.append(("holding", fixed.register_, 1, f"[commands.{name}] register", at))
    return [((kind, first + place), name, path) for kind, first, size, name, path in spans for place in range(size)]


def block_registers(profile: ProfileFile) -> set[Locator]:
    """Return the registers that the drive gives only with their whole block."""
    blocks = profile.modbus.blocks if profile.modbus else []
    return {("holding", register) for first, count in blocks for register in range(first, first + count)}


def check_access(profile: ProfileFile) -> Iterator[Issue]:
    """Yield the issues of reads and writes that the model has no function for, or that could be half done."""
    if not protocol_family(profile.family).register_based:
        for path, _, entry in profile.entries:
            for name in ("space", "words"):
                if name in entry.model_fields_set:
                    yield issue("register", (*path, name), getattr(entry, name), family=profile.family)
        if "words" in profile.setpoint.model_fields_set:
            yield issue("register", ("setpoint", "words"), profile.setpoint.words, family=profile.family)
        return
    for path, _, entry in profile.entries:
        yield from _check_entry(profile, path, entry)
    if profile.status is not None and profile.status.space not in ("holding", *_readable_spaces(profile)):
        yield _needs_function(("status", "space"), profile.status.space)
    if profile.setpoint.words > 1:
        yield from _check_pair(profile, ("setpoint", "words"), written=True)
    if profile.setpoint.words > 1 and profile.setpoint.coding == "bcd":
        yield issue("choice", ("setpoint", "coding"), "bcd", choices=("binary", "signed"))
    if profile.commands is not None:
        yield from _check_commands(profile, profile.commands)
    yield from _check_blocks(profile)
    yield from _check_replies(profile)


def _check_replies(profile: ProfileFile) -> Iterator[Issue]:
    """Check that replies which deviate from the standard are those of RTU, and can't be mistaken for each other."""
    modbus = profile.modbus
    if modbus is None:
        return
    other = next((encoding for encoding in profile.encodings if encoding != "rtu"), None)
    for name in ("reply_count_bytes", "rejected_read"):
        if other is not None and getattr(modbus, name) not in (1, None):
            yield issue("no_effect_beside", ("modbus", name), getattr(modbus, name), other=f'encodings "{other}"')
    if modbus.reply_count_bytes > 1 and modbus.error_form == "short":
        yield issue("no_effect_beside", ("modbus", "reply_count_bytes"), 2, other='error_form = "short"')
    if modbus.rejected_read is None:
        return
    if modbus.loopback:
        yield issue("no_effect_beside", ("modbus", "rejected_read"), modbus.rejected_read, other="loopback = true")
    if modbus.rejected_read <= modbus.max_read:
        path: KeyPath = ("modbus", "rejected_read")
        related = (("modbus", "max_read"),)
        yield issue("range", path, modbus.rejected_read, related=related, bound=f"> {modbus.max_read}")
    if profile.status is not None and profile.status.space in BIT_SPACES:
        other = f'status.space = "{profile.status.space}"'
        yield issue("no_effect_beside", ("modbus", "rejected_read"), modbus.rejected_read, other=other)


def _check_blocks(profile: ProfileFile) -> Iterator[Issue]:
    """Check that each block can be read at once, and that its reply does not look like that to a sync probe."""
    modbus = profile.modbus
    block_of: dict[int, int] = {}
    for place, (first, count) in enumerate(modbus.blocks if modbus else []):
        path: KeyPath = ("modbus", "blocks", place)
        low = 2 if modbus is not None and modbus.loopback else SYNC_READ_COUNT + 1
        high = min(modbus.max_read if modbus is not None else 0, 0x10000 - first)
        if not low <= count <= high:
            yield issue("range", path, count, related=(("modbus", "blocks"),), bound=f"{low} - {high}")
        for register in range(first, first + count):
            if block_of.setdefault(register, place) != place:
                other = f"[modbus] blocks {block_of[register] + 1}"
                yield issue("duplicate", path, f"{register:04X}H", related=(("modbus", "blocks"),), other=other)
                break
    if modbus is not None and modbus.sync_block is not None:
        yield from _check_sync_block(modbus, modbus.sync_block)


def _check_sync_block(modbus: ModbusTable, block: list[int]) -> Iterator[Issue]:
    """Check that the sync probe is the read of a block by function 04."""
    at: KeyPath = ("modbus", "sync_block")
    if READ_FUNCTION_BY_SPACE["input"] not in modbus.functions:
        yield _needs_function(at, "input")
    if block not in modbus.blocks:
        choices = tuple(map(str, modbus.blocks)) or "-"
        yield issue("choice", at, block, related=(("modbus", "blocks"),), choices=choices)
    if modbus.loopback or modbus.rejected_read is not None:
        yield issue("no_effect_beside", at, block, other="loopback" if modbus.loopback else "rejected_read")


def check_codes(profile: ProfileFile) -> Iterator[Issue]:
    """Check that the code of the identity has its models, and that its register is none that a command writes."""
    identity = profile.identity
    if identity is None:
        return
    if identity.codes and identity.code_register is None:
        yield issue("no_effect_without", ("identity", "codes"), "codes", other="code_register")
    if identity.code_register is not None and not identity.codes:
        yield issue("missing_key", ("identity", "codes"), None, name="codes")
    for place, name, _ in command_places(profile):
        if place == ("holding", identity.code_register):
            yield issue("duplicate", ("identity", "code_register"), f"{place[1]:04X}H", other=name)


def _readable_spaces(profile: ProfileFile) -> list[str]:
    functions = profile.modbus.functions if profile.modbus else []
    return [space for space, function in READ_FUNCTION_BY_SPACE.items() if function in functions]


def _needs_function(path: KeyPath, value: object, *functions: int) -> Issue:
    required = functions or (READ_FUNCTION_BY_SPACE[str(value)],)
    names = " / ".join(map(str, required))
    return issue("access", path, value, related=(("modbus", "functions"),), what=f"[modbus] functions {names}")


def _check_entry(profile: ProfileFile, path: KeyPath, entry: SignalTable | ParameterTable) -> Iterator[Issue]:
    if entry.space not in ("holding", *_readable_spaces(profile)):
        yield _needs_function((*path, "space"), entry.space)
    if entry.space in BIT_SPACES and (entry.words > 1 or entry.coding != "binary"):
        name = "words" if entry.words > 1 else "coding"
        yield issue("no_effect_beside", (*path, name), getattr(entry, name), other=f'space = "{entry.space}"')
    if entry.words > 1 and entry.coding == "bcd":
        yield issue("choice", (*path, "coding"), "bcd", choices=("binary", "signed"))
    is_written = isinstance(entry, ParameterTable) and entry.writable
    if is_written and entry.space in READ_ONLY_SPACES:
        yield issue("choice", (*path, "writable"), "true", related=((*path, "space"),), choices="false")
    functions = profile.modbus.functions if profile.modbus else []
    if is_written and entry.space == "coil" and not {WRITE_COIL, WRITE_COILS} & set(functions):
        yield _needs_function((*path, "space"), "coil", WRITE_COIL, WRITE_COILS)
    if entry.words > 1 and entry.space not in BIT_SPACES:
        yield from _check_pair(profile, (*path, "words"), written=is_written)


def _check_pair(profile: ProfileFile, path: KeyPath, *, written: bool) -> Iterator[Issue]:
    """Check a number in two registers: read in one frame that no sync probe looks like, written in one frame."""
    modbus = profile.modbus
    if modbus is None:
        return
    if not modbus.loopback:
        yield issue("access", path, 2, related=(("modbus", "loopback"),), what="[modbus] loopback")
    if modbus.max_read < 2:
        yield issue("access", path, 2, related=(("modbus", "max_read"),), what="[modbus] max_read 2")
    if written and WRITE_REGISTERS not in modbus.functions:
        yield _needs_function(path, 2, WRITE_REGISTERS)


def _check_commands(profile: ProfileFile, commands: CommandsTable) -> Iterator[Issue]:
    functions = profile.modbus.functions if profile.modbus else []
    at = ("commands", "written_to")
    if commands.written_to == "coils" and WRITE_COILS not in functions:
        yield _needs_function(at, commands.written_to, WRITE_COILS)
    if commands.written_to == "coil" and not {WRITE_COIL, WRITE_COILS} & set(functions):
        yield _needs_function(at, commands.written_to, WRITE_COIL, WRITE_COILS)
    if commands.written_to == "coils" and not commands.coil_count:
        yield issue("missing_key", ("commands", "coil_count"), None, name="coil_count")
    if commands.written_to != "coils" and commands.coil_count:
        other = 'written_to = "coils"'
        yield issue("no_effect_without", ("commands", "coil_count"), commands.coil_count, other=other)
    if commands.words > 1 and WRITE_REGISTERS not in functions:
        yield _needs_function(("commands", "words"), commands.words, WRITE_REGISTERS)
    if commands.words > 1 and commands.written_to != "register":
        yield issue(
            "no_effect_beside", ("commands", "words"), commands.words, other=f'written_to = "{commands.written_to}"'
        )
    if commands.bits and (commands.written_to == "coil" or commands.words > 1):
        other = 'written_to = "coil"' if commands.written_to == "coil" else f"words = {commands.words}"
        yield issue("no_effect_beside", ("commands", "bits"), "bits", other=other)
    highest = _highest_word(commands)
    for name, value in commands.values.items():
        if value > highest:
            yield issue("range", ("commands", "values", name), value, bound=f"<= {highest}")
    if commands.reset is not None and "reset" in (*commands.bits, *commands.values):
        yield issue("no_effect_beside", ("commands", "reset"), "reset", other="[commands.reset] register")


def _highest_word(commands: CommandsTable) -> int:
    if commands.written_to == "coils":
        return (1 << (commands.coil_count or 16)) - 1
    return SINGLE_COILS - 1 if commands.written_to == "coil" else (1 << 16 * commands.words) - 1
