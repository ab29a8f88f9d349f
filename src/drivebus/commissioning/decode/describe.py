"""A frame explained for a model: what its protocol reads, and what the model's profile says of it.

``explain`` is the logic of the ``decode`` verb. It is tolerant where the master is strict, and says so: nothing that
was learnt here ever goes to a drive.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

from drivebus import profiles
from drivebus.commissioning.decode import annotate, errata
from drivebus.errors import ConfigurationError
from drivebus.profiles import DriveProfile
from drivebus.protocols import dzb100, modbus, sunfar
from drivebus.protocols.describe import Direction, FrameDescription

FAMILY_ENCODINGS: Final[Mapping[str, tuple[str, ...]]] = {
    "sifang": ("ascii", "hex"),
    "dzb": ("ascii",),
    "modbus": ("rtu", "ascii"),
}
"""What the protocols of a family know, whatever a model's keypad offers."""
_ENCODING_BY_FIRST_BYTE: Final = {("sifang", 0x2A): "ascii", ("sifang", 0x5A): "hex", ("modbus", 0x3A): "ascii"}


def describe_frame(
    model: str | Path,
    data: bytes,
    *,
    encoding: str | None = None,
    direction: str | None = None,
    request: bytes | None = None,
) -> FrameDescription:
    """Explain one frame of a model's line, whatever its bytes are.

    Without ``encoding`` the first byte decides; without ``direction`` a frame is a response where its ``request`` is
    given, else what its shape says. A response without its request has its candidate ``readings``.
    Raises ProfileError for an unknown model, ConfigurationError for an encoding or direction that it can't have.
    """
    profile = profiles.load(model)
    chosen, way, read = (
        _choose_encoding(profile, data, encoding),
        _check_direction(direction),
        _DESCRIBERS[profile.family],
    )
    found = read(profile, data, chosen, way, request)
    asked = None if request is None else read(profile, request, chosen, "request", None).fields
    return errata.apply_errata(profile, data, asked, annotate.annotate(profile, found, asked))


def alternative_fields(found: FrameDescription) -> Mapping[str, Any] | None:
    """The other reading of bytes that are ambiguous by themselves (C320 hex data, T03); None where they are not."""
    if not any(key.endswith(".ambiguous") for key, _ in found.errata):
        return None
    return next((reading.fields for reading in found.readings if reading.note[0].endswith(".nibbles")), None)


def _choose_encoding(profile: DriveProfile, data: bytes, wanted: str | None) -> str:
    known = FAMILY_ENCODINGS[profile.family]
    if wanted is None:
        default = next((each for each in profile.encodings if each in known), known[0])
        return _ENCODING_BY_FIRST_BYTE.get((profile.family, data[0]), default) if data else default
    if wanted not in known:
        raise ConfigurationError("explain.encoding", model=profile.model, found=wanted, expected=", ".join(known))
    return wanted


def _check_direction(wanted: str | None) -> Direction | None:
    if wanted is None:
        return None
    if wanted == "request":
        return "request"
    if wanted == "response":
        return "response"
    raise ConfigurationError("explain.direction", found=wanted, expected="request, response")


def _describe_sunfar(
    p: DriveProfile, data: bytes, encoding: str, way: Direction | None, request: bytes | None
) -> FrameDescription:
    return sunfar.describe(data, encoding, way, request, annotate.sunfar_decode_options(p))


def _describe_dzb100(
    p: DriveProfile, data: bytes, encoding: str, way: Direction | None, request: bytes | None
) -> FrameDescription:
    return dzb100.describe(data, encoding, way, request, annotate.dzb100_decode_options(p))


def _describe_modbus(
    p: DriveProfile, data: bytes, encoding: str, way: Direction | None, request: bytes | None
) -> FrameDescription:
    return modbus.describe(data, encoding, way, request, p.modbus.error_form if p.modbus else "exception")


Describer = Callable[[DriveProfile, bytes, str, Direction | None, bytes | None], FrameDescription]
_DESCRIBERS: Final[Mapping[str, Describer]] = {
    "sifang": _describe_sunfar,
    "dzb": _describe_dzb100,
    "modbus": _describe_modbus,
}
