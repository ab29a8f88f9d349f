"""Checks of settings without effect: a key that the drive's kind of word ignores misleads its author."""

from __future__ import annotations

from collections.abc import Iterator

from drivebus.profiles.check_words import offered_states
from drivebus.profiles.diagnostics import Issue, issue
from drivebus.profiles.schema import ProfileFile, StrictTable


def check_effect(profile: ProfileFile) -> Iterator[Issue]:
    """Yield every setting that another one makes ineffective."""
    setpoint, commands, status = profile.setpoint, profile.commands, profile.status
    if setpoint.full_scale is not None:
        yield from _ineffective("setpoint", setpoint, ("factor", "coding", "rpm"), "full_scale")
    else:
        share = ("maximum", "maximum_hz", "lowest_hz", "highest_hz")
        yield from _ineffective("setpoint", setpoint, share, "full_scale", beside=False)
    if setpoint.rpm is not None and setpoint.full_scale is None:
        yield from _ineffective("setpoint", setpoint, ("factor", "coding"), "rpm")
    if commands is not None and commands.values:
        yield from _ineffective("commands", commands, ("variants", "rewrite_levels_after_pulse"), "values")
    if status is not None and status.values:
        yield from _ineffective("status", status, ("reserved_mask",), "values")
    elif status is not None:
        yield from _ineffective("status", status, ("mask",), "values", beside=False)
    if profile.write.ram_address_mask is not None and profile.write.eeprom_address_bit is not None:
        yield from _ineffective("write", profile.write, ("ram_address_mask",), "eeprom_address_bit")
    if profile.write.ram_address_mask is not None and not profile.write.ram:
        yield from _ineffective("write", profile.write, ("ram_address_mask",), "ram = true", beside=False)
    if status is not None and status.shares_command_register:
        is_shared = commands is not None and commands.written_to == "register"
        if not is_shared or commands is None or status.register_ != commands.register_ or status.space != "holding":
            yield issue("no_effect_without", ("status", "shares_command_register"), "true", other="[commands] register")
    if status is not None and status.hides_faults and "fault" in offered_states(profile)[1]:
        yield issue("no_effect_beside", ("status", "hides_faults"), "true", other="fault")
    if status is not None and not status.fault_registers:
        yield from _ineffective("status", status, ("fault_coding", "fault_mask"), "fault_registers", beside=False)
    elif status is not None and status.fault_coding == "bits":
        yield from _ineffective("status", status, ("fault_mask",), 'fault_coding = "number"', beside=False)


def _ineffective(
    section: str, table: StrictTable, names: tuple[str, ...], other: str, *, beside: bool = True
) -> Iterator[Issue]:
    """Yield the named keys that the file sets, beside ``other`` or without it."""
    for name in names:
        if name in table.model_fields_set and getattr(table, name) not in (None, False, {}):
            setting = getattr(table, name)
            shown = name if isinstance(setting, dict) else setting
            if beside:
                yield issue("no_effect_beside", (section, name), shown, other=other)
            else:
                yield issue("no_effect_without", (section, name), shown, other=other)
