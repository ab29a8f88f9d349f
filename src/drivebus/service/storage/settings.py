"""Waivers, limits and communication-loss tests of drives, read back after a restart, also from a damaged file.

A file that can't be read is put aside. The new file in its place, or in that of a missing one, names the drives whose
limits are lost: a start without them might be too fast for the machine.
"""

from __future__ import annotations

import json
import logging
import math
from collections.abc import Iterable
from dataclasses import asdict, dataclass

from drivebus import i18n
from drivebus.drives.context import DriveLimits
from drivebus.drives.store import FileStore, Store
from drivebus.errors import ConfigurationError
from drivebus.service.config.model import BusConfig, DriveConfig
from drivebus.service.control.comm_loss_record import CommLossRecord, record_key
from drivebus.service.control.waivers import CommLossWaiver, waiver_key

SETTINGS_FILE = "plant.json"
LOST_LIMITS_KEY = "lost-limits"
"""Key of the drives, as a JSON list, whose limits were lost with a file that was put aside."""
LOG = logging.getLogger("drivebus.service")


@dataclass(frozen=True, slots=True)
class DriveIdentity:
    """Model, port and address of a drive, which tell it from another one of its name."""

    model: str
    port: str
    address: int

    @classmethod
    def of(cls, drive: DriveConfig, bus: BusConfig) -> DriveIdentity:
        return cls(drive.model, bus.port, drive.address)


@dataclass(frozen=True, slots=True)
class StoredSettings:
    """Stored waiver, limits and communication-loss test of one drive."""

    waiver: CommLossWaiver | None
    limits: DriveLimits | None
    limits_lost: bool
    """Its limits can't be read, or were lost with a file that was put aside, and were not set again since."""
    comm_loss_record: CommLossRecord | None = None
    limits_set_for: DriveIdentity | None = None
    """The drive that its limits were set for.

    None where no limits are set, an earlier version stored them, or it can't be read: then the limits hold all the
    same, and no event tells that they may be another motor's.
    """

    @classmethod
    def of(cls, store: Store, drive: str) -> StoredSettings:
        """Read the settings of a drive. Never raises: what can't be read permits nothing."""
        try:
            stored = store.get(limits_key(drive))
            limits, identity = (None, None) if stored is None else _limits_from_json(stored)
            lost = stored is None and drive in _names_from_json(store.get(LOST_LIMITS_KEY) or "[]")
        except (ConfigurationError, ValueError, TypeError, OverflowError, RecursionError):
            limits, identity, lost = None, None, True
        return cls(_stored_waiver(store, drive), limits, lost, _stored_record(store, drive), identity)


def limits_key(drive: str) -> str:
    """Return the key of a drive's own limits in the settings."""
    return f"limits/{drive}"


def limits_to_json(limits: DriveLimits, identity: DriveIdentity) -> str:
    """Return limits as they are stored, with the drive that they were set for."""
    return json.dumps({**asdict(limits), "set_for": asdict(identity)})


def _limits_from_json(text: str) -> tuple[DriveLimits, DriveIdentity | None]:
    """Return stored limits and the drive that they were set for, if known.

    Raises ValueError, TypeError, OverflowError or ConfigurationError for anything else, also where a limit is missing:
    its default might permit what an engineer forbade.
    """
    stored = {**json.loads(text)}
    identity = stored.pop("set_for", None)
    limits = DriveLimits(**stored)
    if missing := {"minimum_hz", "maximum_hz", "forward", "reverse"} - stored.keys():
        raise ValueError(f"without {', '.join(sorted(missing))}")
    frequencies_hz = [limits.minimum_hz, *([] if limits.maximum_hz is None else [limits.maximum_hz])]
    if not all(type(hz) in (int, float) and math.isfinite(hz) for hz in frequencies_hz):
        raise TypeError("a frequency is not a finite number")
    if type(limits.forward) is not bool or type(limits.reverse) is not bool:
        raise TypeError("a direction is neither true nor false")
    return limits, _identity_from_json(identity)


def _identity_from_json(stored: object) -> DriveIdentity | None:
    """Return a stored identity; None for anything else."""
    match stored:
        case {"model": str(model), "port": str(port), "address": int(address)} if type(address) is int:
            return DriveIdentity(model, port, address)
    return None


def _names_from_json(text: str) -> list[str]:
    """Return a stored list of names. Raises ValueError, TypeError."""
    names = json.loads(text)
    if not isinstance(names, list):
        raise TypeError("a list was expected")
    return names


def _stored_waiver(store: Store, drive: str) -> CommLossWaiver | None:
    try:
        waiver = CommLossWaiver.from_json(store.get(waiver_key(drive)))
    except (ConfigurationError, ValueError, TypeError, RecursionError):
        return None
    return (
        waiver
        if waiver is not None and all(type(field) is str for field in (waiver.text, waiver.model, waiver.port))
        else None
    )


def _stored_record(store: Store, drive: str) -> CommLossRecord | None:
    try:
        return CommLossRecord.from_json(store.get(record_key(drive)))
    except (ConfigurationError, ValueError, TypeError, KeyError, RecursionError):
        return None


def recover_settings(store: FileStore, drives: Iterable[str], now_ms: int) -> None:
    """Put a settings file that can't be read aside, and replace a missing one.

    Never raises: where that fails, it stays and is read as lost.
    """
    try:
        store.get(LOST_LIMITS_KEY)
    except ConfigurationError as error:
        try:
            aside = store.put_aside({LOST_LIMITS_KEY: json.dumps(sorted(drives))}, f".damaged-{now_ms}")
        except ConfigurationError as failure:
            language = i18n.preferred()
            LOG.error(i18n.join((error.text(language), failure.text(language)), "clauses", language))
        else:
            if aside is None:
                LOG.error(error.text(i18n.preferred()))
            else:
                LOG.error(i18n.preferred_text("log.put_aside", why=error, copy=aside))
