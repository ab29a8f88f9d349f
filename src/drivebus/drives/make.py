"""The dialect of a profile. Three families have code of their own; models never do."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from drivebus.drives.dialect import Dialect
from drivebus.drives.dzb import DzbDialect
from drivebus.drives.modbus import ModbusDialect
from drivebus.drives.sifang import SifangDialect
from drivebus.errors import ConfigurationError
from drivebus.message import StationTiming
from drivebus.profiles.model import DriveProfile

_FAMILIES: dict[str, Callable[..., Dialect]] = {"sifang": SifangDialect, "dzb": DzbDialect, "modbus": ModbusDialect}


def make_dialect(
    profile: DriveProfile,
    address: int,
    *,
    encoding: str | None = None,
    settings: Mapping[str, Any] | None = None,
    timing: StationTiming | None = None,
) -> Dialect:
    """The dialect that speaks to this drive. Raises ConfigurationError: an address, encoding or setting it has not."""
    low, high = profile.addresses
    if address == profile.broadcast or not low <= address <= high:
        key = "drives.address_broadcast" if address == profile.broadcast else "drives.address"
        raise ConfigurationError(key, model=profile.model, found=address, expected=f"{low}-{high}")
    chosen = encoding or profile.encodings[0]
    if chosen not in profile.encodings:
        known = ", ".join(profile.encodings)
        raise ConfigurationError("drives.encoding", model=profile.model, found=chosen, expected=known)
    unknown = [name for name in settings or {} if name not in profile.settings]
    if unknown:
        known = ", ".join(profile.settings) or "-"
        raise ConfigurationError("drives.setting", model=profile.model, found=unknown[0], expected=known)
    merged = dict(profile.settings) | dict(settings or {})
    return _FAMILIES[profile.family](profile, address, chosen, merged, timing or profile.timing)
