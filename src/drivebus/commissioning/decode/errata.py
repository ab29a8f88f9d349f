"""Frames that the manuals print wrong, so that whoever copied one learns it. Values from the manuals, nothing else."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

from drivebus.commissioning.decode import annotate
from drivebus.profiles import DriveProfile
from drivebus.protocols import modbus
from drivebus.protocols.describe import FrameDescription, Note, note


@dataclass(frozen=True, slots=True)
class Misprint:
    """One printed frame, what is wrong with it, and what a correct sender emits."""

    printed: bytes
    erratum: Note
    canonical: bytes


MISPRINTED_FRAMES: Final[Mapping[str, tuple[Misprint, ...]]] = {
    "vc660": (
        Misprint(
            bytes.fromhex("01 03 08 C3 88 00 02 13 88 00 00 21 A8"),
            note("explain.misprint.vc660_c3"),
            bytes.fromhex("01 03 08 13 88 00 02 13 88 00 00 21 A8"),
        ),
    ),
}
"""VC660 section 6 example 2. What C320 and DZB100 print wrong their own readers know."""

MISPRINTED_REGISTERS: Final[Mapping[tuple[str, int, int], int]] = {
    ("vc660", 3, 0x200B): 0x3001,
    ("vc660", 6, 0x200B): 0x2000,
}
"""Model, function and printed register → the register of the tables (VC660 section 5)."""


def apply_errata(
    profile: DriveProfile, data: bytes, asked: Mapping[str, Any] | None, found: FrameDescription
) -> FrameDescription:
    """The description with what is known of this very frame. A misprinted reply shows what it meant, and stays
    invalid."""
    for misprint in MISPRINTED_FRAMES.get(profile.model, ()):
        if misprint.printed == data:
            return _correct_frame(profile, misprint, asked, found)
    return _correct_register(profile, found)


def _correct_frame(
    profile: DriveProfile, misprint: Misprint, asked: Mapping[str, Any] | None, found: FrameDescription
) -> FrameDescription:
    fields = found.fields
    if not found.valid:
        meant = modbus.describe(misprint.canonical, found.encoding, found.direction)
        fields = annotate.annotate(profile, meant, asked).fields
    return replace(found, fields=fields, errata=(*found.errata, misprint.erratum), canonical=misprint.canonical)


def _correct_register(profile: DriveProfile, found: FrameDescription) -> FrameDescription:
    """A register of the manual's examples that its tables have elsewhere (T12)."""
    fields = found.fields
    right = MISPRINTED_REGISTERS.get((profile.model, fields.get("function", 0), fields.get("register", -1)))
    if right is None or not found.valid or found.direction != "request":
        return found
    codec = modbus.ModbusRtuCodec() if found.encoding == "rtu" else modbus.ModbusAsciiCodec()
    if fields["function"] == 3:
        request: modbus.ModbusRequest = modbus.ReadRegisters(fields["address"], right, fields["count"])
    else:
        request = modbus.WriteRegister(fields["address"], right, fields["value"])
    return replace(found, canonical=_encode_or_default(codec, request, found.canonical))


def _encode_or_default(codec: Any, request: modbus.ModbusRequest, otherwise: bytes | None) -> bytes | None:
    try:
        return bytes(codec.encode_request(request))
    except ValueError:
        return otherwise
