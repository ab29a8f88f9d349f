"""A frame explained for a model: what its protocol reads, and what the model's profile says of it.

``explain`` is the logic of the ``decode`` verb. It is tolerant where the master is strict, and says so: nothing that
was learnt here ever goes to a drive.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

from drivebus import profiles
from drivebus.commissioning import meaning, misprints
from drivebus.errors import ConfigurationError
from drivebus.profiles import DriveProfile
from drivebus.protocols import dzb, modbus, sifang
from drivebus.protocols.describe import Description, Direction

ENCODINGS: Final[Mapping[str, tuple[str, ...]]] = {
    "sifang": ("ascii", "hex"),
    "dzb": ("ascii",),
    "modbus": ("rtu", "ascii"),
}
"""What the protocols of a family know, whatever a model's keypad offers."""
_FIRST_BYTES: Final = {("sifang", 0x2A): "ascii", ("sifang", 0x5A): "hex", ("modbus", 0x3A): "ascii"}


def explain(
    model: str | Path,
    data: bytes,
    *,
    encoding: str | None = None,
    direction: str | None = None,
    request: bytes | None = None,
) -> Description:
    """Explain one frame of a model's line, whatever its bytes are.

    Without ``encoding`` the first byte decides; without ``direction`` a frame is a response where its ``request`` is
    given, else what its shape says. A response without its request has its candidate ``readings``.
    Raises ProfileError for an unknown model, ConfigurationError for an encoding or direction that it can't have.
    """
    profile = profiles.load(model)
    chosen, way, read = _encoding(profile, data, encoding), _direction(direction), _READERS[profile.family]
    found = read(profile, data, chosen, way, request)
    asked = None if request is None else read(profile, request, chosen, "request", None).fields
    return misprints.known(profile, data, asked, meaning.add(profile, found, asked))


def meant(found: Description) -> Mapping[str, Any] | None:
    """The other reading of bytes that are ambiguous by themselves (C320 hex data, T03); None where they are not."""
    if not any(key.endswith(".ambiguous") for key, _ in found.errata):
        return None
    return next((reading.fields for reading in found.readings if reading.note[0].endswith(".nibbles")), None)


def _encoding(profile: DriveProfile, data: bytes, wanted: str | None) -> str:
    known = ENCODINGS[profile.family]
    if wanted is None:
        default = next((each for each in profile.encodings if each in known), known[0])
        return _FIRST_BYTES.get((profile.family, data[0]), default) if data else default
    if wanted not in known:
        raise ConfigurationError("explain.encoding", model=profile.model, found=wanted, expected=", ".join(known))
    return wanted


def _direction(wanted: str | None) -> Direction | None:
    if wanted is None:
        return None
    if wanted == "request":
        return "request"
    if wanted == "response":
        return "response"
    raise ConfigurationError("explain.direction", found=wanted, expected="request, response")


def _sifang(p: DriveProfile, data: bytes, encoding: str, way: Direction | None, request: bytes | None) -> Description:
    return sifang.describe(data, encoding, way, request, meaning.of_sifang(p))


def _dzb(p: DriveProfile, data: bytes, encoding: str, way: Direction | None, request: bytes | None) -> Description:
    return dzb.describe(data, encoding, way, request, meaning.of_dzb(p))


def _modbus(p: DriveProfile, data: bytes, encoding: str, way: Direction | None, request: bytes | None) -> Description:
    return modbus.describe(data, encoding, way, request, p.modbus.error_form if p.modbus else "exception")


Reader = Callable[[DriveProfile, bytes, str, Direction | None, bytes | None], Description]
_READERS: Final[Mapping[str, Reader]] = {"sifang": _sifang, "dzb": _dzb, "modbus": _modbus}
