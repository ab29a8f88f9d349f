"""``identify``: what a drive says of itself, and no more than that. Pure."""

from __future__ import annotations

from dataclasses import dataclass

from drivebus.drives.dialects.sunfar import SunfarDialect
from drivebus.drives.operations.context import OperationContext
from drivebus.drives.operations.steps import DriveOperation

VOLTAGE_CLASSES = {"2": 220, "4": 380}
"""C320 manual 3 (1), first digit of group 0."""
IDENTITY_PARTS = ("model", "series", "version", "control")


@dataclass(frozen=True, slots=True)
class Identity:
    """Who answers at an address. ``reported`` False: the model has no identity to read, it only answers."""

    model: str
    reported: bool
    voltage_class_v: int | None = None
    power_kw: float | None = None
    digits: tuple[tuple[str, str], ...] = ()
    """Part (model, series, version, control) and its six digits; "-" where a fault hides one."""
    host_controls: bool | None = None
    host_sets_frequency: bool | None = None


def identify(talk: OperationContext) -> DriveOperation[Identity]:
    """Ask the drive who it is. Raises the bus's error where it does not answer."""
    dialect = talk.dialect
    error = yield from talk.sync()
    if error is not None:
        raise error
    if not isinstance(dialect, SunfarDialect):
        return Identity(dialect.profile.model, reported=False)
    digits: list[tuple[str, str]] = []
    for part, request in zip(IDENTITY_PARTS, dialect.identity_reads(), strict=True):
        answer = yield from talk.transact(request)
        info = getattr(answer.reply, "info", None)
        if answer.error is None and info and dialect.rejection(answer.reply) is None:
            digits.append((part, info))
    return _from_digits(dialect.profile.model, tuple(digits))


def _from_digits(model: str, digits: tuple[tuple[str, str], ...]) -> Identity:
    """Manual 3 (1): group 0 voltage class and power in decimal digits, group 3 who controls."""
    found = dict(digits)
    first, control = found.get("model", "------"), found.get("control", "--")
    power = int(first[2:]) / 10 if first[2:].isdecimal() else None
    return Identity(
        model, bool(digits), VOLTAGE_CLASSES.get(first[0]), power, digits, _flag(control[0]), _flag(control[1])
    )


def _flag(digit: str) -> bool | None:
    return {"0": False, "1": True}.get(digit)
