"""Numbers as the drive's own display shows them: as many places as the profile's scale has. Text out, sends nothing."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from drivebus.profiles.model import Parameter, Signal
    from drivebus.values import Reading

MISSING_VALUE = "–"


def format_value(value: float | int | str | None, unit: str = "", entry: Signal | Parameter | None = None) -> str:
    """``25.00 Hz``, ``537 V``; a dash where there is no value, which is never 0. ``entry`` knows the places."""
    if value is None:
        return MISSING_VALUE
    return f"{value if isinstance(value, str) else _format_number(value, entry)} {unit}".rstrip()


def _format_number(value: float, entry: Signal | Parameter | None) -> str:
    places = entry.scale.decimals if entry is not None else 0
    rounded = f"{value:.{places}f}"
    return rounded if abs(float(rounded) - value) < 1e-9 else f"{value:g}"


def format_reading(reading: Reading, entry: Signal | Parameter | None = None) -> str:
    """As ``figure``; a word without a unit (terminals, fault bits) has its hexadecimal form beside."""
    said = format_value(reading.value, reading.unit, entry)
    bits = reading.raw is not None and reading.value is not None and not reading.unit
    return f"{said} ({reading.raw:04X}H)" if bits else said
