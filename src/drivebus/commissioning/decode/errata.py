"""Frames and registers that the manuals print wrong, with what a correct sender emits.

The readers of the Sunfar and DZB100 protocols know the misprints of their manuals themselves.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from drivebus.protocols import modbus
from drivebus.protocols.describe import FrameDescription, Note, note


@dataclass(frozen=True, slots=True)
class Misprint:
    """Printed frame, its erratum, and the frame of a correct sender."""

    printed: bytes
    erratum: Note
    canonical: bytes


MISPRINTED_FRAMES: Final[Mapping[str, tuple[Misprint, ...]]] = {
    "vc660": (
        Misprint(
            printed=bytes.fromhex("01 03 08 C3 88 00 02 13 88 00 00 21 A8"),
            erratum=note("explain.misprint.vc660_c3"),
            canonical=bytes.fromhex("01 03 08 13 88 00 02 13 88 00 00 21 A8"),
        ),
    ),
}
"""Model to its misprints (VC660 manual, section 6, example 2)."""

MISPRINTED_REGISTERS: Final[Mapping[tuple[str, int, int], int]] = {
    ("vc660", 3, 0x200B): 0x3001,
    ("vc660", 6, 0x200B): 0x2000,
}
"""Model, function and printed register to the register of the manual's tables (VC660 manual, section 5)."""


def misprint_of(model: str, data: bytes) -> Misprint | None:
    """Return the misprint that has exactly these bytes."""
    return next((each for each in MISPRINTED_FRAMES.get(model, ()) if each.printed == data), None)


def canonical_of_misprint(model: str, description: FrameDescription) -> bytes | None:
    """Return the canonical frame, with the register of the manual's tables where an example prints another."""
    fields = description.fields
    register = MISPRINTED_REGISTERS.get((model, fields.get("function", 0), fields.get("register", -1)))
    if register is None or not description.valid or description.direction != "request":
        return description.canonical
    codec = modbus.ModbusRtuCodec() if description.encoding == "rtu" else modbus.ModbusAsciiCodec()
    request: modbus.ModbusRequest = (
        modbus.ReadRegisters(fields["address"], register, fields["count"])
        if fields["function"] == 3
        else modbus.WriteRegister(fields["address"], register, fields["value"])
    )
    try:
        return codec.encode_request(request)
    except ValueError:
        return description.canonical
