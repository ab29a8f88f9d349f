"""The drives that campaigns are run with, and what their manuals say of times, written here once more from them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True, slots=True)
class DriveVariant:
    """One family in one encoding. Times are the observer's own, from the manuals (RELIABILITY 5 where silent)."""

    name: str
    model: str
    encoding: str
    baud: int
    drive_options: Mapping[str, Any] = field(default_factory=dict)
    """Undocumented options that the host takes as determined."""
    options: Mapping[str, str] = field(default_factory=dict)
    """The same for the simulated drives."""
    gap_characters: float = 3.5
    gap_floor_s: float = 0.0
    min_timeout_s: float = 0.1
    """The host may give up no sooner after its last bit …"""
    min_timeout_characters: float = 8
    """… plus so many characters."""
    max_reply_lateness_s: float = 0.5
    """The family's longest lateness."""
    identical_probe_quarantine_s: float = 0.0
    """DF800: fences differ in nothing but their count; after an unanswered question of that count none is believed for
    so long."""
    reports_running: bool = True
    """The drive reports whether it runs."""
    broadcast: int | None = 0
    maximum_hz: float = 50.0
    """No higher frequency is ever sent, unless a user of the drive allows it."""


_CODINGS = {"setpoint_coding": "hex-0.1", "query_coding": "hex-0.1", "parameter_coding": "hex-0.1"}
_DIRECTION_CALIBRATED = {"direction_calibrated": True}

C320 = DriveVariant(
    "c320-ascii",
    "c320",
    "ascii",
    9600,
    gap_characters=5,
    min_timeout_s=0.0,
    min_timeout_characters=26,
    max_reply_lateness_s=0.18,
    broadcast=31,
)
C320_HEX = DriveVariant(
    "c320-hex",
    "c320",
    "hex",
    9600,
    gap_characters=5,
    min_timeout_s=0.0,
    min_timeout_characters=26,
    max_reply_lateness_s=0.18,
    broadcast=31,
)
DZB100 = DriveVariant("dzb100", "dzb100", "ascii", 4800, _CODINGS, min_timeout_characters=11, maximum_hz=400.0)
VC660 = DriveVariant(
    "vc660", "vc660", "rtu", 9600, gap_floor_s=0.00175, min_timeout_s=0.004, max_reply_lateness_s=0.204
)
DF800 = DriveVariant(
    "df800-rtu",
    "df800",
    "rtu",
    9600,
    _DIRECTION_CALIBRATED,
    gap_floor_s=0.00175,
    identical_probe_quarantine_s=5.0,
    reports_running=False,
    maximum_hz=400.0,
)
DF800_ASCII = DriveVariant(
    "df800-ascii",
    "df800",
    "ascii",
    9600,
    _DIRECTION_CALIBRATED,
    {"encoding": "ascii"},
    min_timeout_characters=15,
    reports_running=False,
    identical_probe_quarantine_s=5.0,
    maximum_hz=400.0,
)
DRIVE_VARIANTS = (C320, C320_HEX, DZB100, VC660, DF800, DF800_ASCII)
VARIANTS_BY_NAME = {kind.name: kind for kind in DRIVE_VARIANTS}
