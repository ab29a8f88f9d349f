"""Factory of dialects: the profile's family decides the class; models have no code of their own."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from drivebus.drives.dialects.base import DEFAULT_NONCE_START, Dialect
from drivebus.errors import ConfigurationError
from drivebus.profiles.model import DriveProfile
from drivebus.protocols.family import protocol_family, resolve
from drivebus.serial_settings import StationTiming


def create_dialect(
    profile: DriveProfile,
    address: int,
    *,
    encoding: str | None = None,
    options: Mapping[str, Any] | None = None,
    timing: StationTiming | None = None,
    nonce_start: int = DEFAULT_NONCE_START,
) -> Dialect:
    """Return the dialect of a drive. Raises ConfigurationError for an unknown address, encoding or option.

    ``nonce_start``: first number of the sync probes of a model with a loop-back; other models have none.
    """
    low, high = profile.addresses
    if address == profile.broadcast or not low <= address <= high:
        key = "drives.address_broadcast" if address == profile.broadcast else "drives.address"
        raise ConfigurationError(key, model=profile.model, found=address, expected=f"{low}-{high}")
    encoding_in_use = encoding or profile.encodings[0]
    if encoding_in_use not in profile.encodings:
        raise ConfigurationError(
            "drives.encoding", model=profile.model, found=encoding_in_use, expected=profile.encodings
        )
    unknown = [name for name in options or {} if name not in profile.options]
    if unknown:
        known = tuple(profile.options) or "-"
        raise ConfigurationError("drives.option", model=profile.model, found=unknown[0], expected=known)
    for name, value in (options or {}).items():
        question = profile.question(name)
        if not question.allows(value):
            raise ConfigurationError("drives.option_value", name=name, found=value, expected=question.expected)
    merged = dict(profile.options) | dict(options or {})
    make = resolve(protocol_family(profile.family).dialect)
    has_nonces = profile.modbus is not None and profile.modbus.loopback
    numbered = {"nonce_start": nonce_start} if has_nonces else {}
    dialect: Dialect = make(profile, address, encoding_in_use, merged, timing or profile.timing, **numbered)
    return dialect
