"""``status``: what a drive reports now, and what it does not, with the reason. Pure."""

from __future__ import annotations

from dataclasses import replace

from drivebus.drives.dialects.base import Dialect
from drivebus.drives.operations.context import OperationContext
from drivebus.drives.operations.steps import DriveOperation
from drivebus.drives.state import DerivedState, DriveState, DriveStatus
from drivebus.errors import DrivebusError
from drivebus.profiles.model import DriveProfile
from drivebus.values import Reading, missing_reading

CANONICAL_SIGNALS = {
    "set_frequency": "Hz",
    "output_frequency": "Hz",
    "output_current": "A",
    "output_voltage": "V",
    "dc_bus_voltage": "V",
}
"""What every drive is asked about: present in each status, None with a reason where the model does not report it."""


def read_status(talk: OperationContext, names: tuple[str, ...] | None = None) -> DriveOperation[DriveStatus]:
    """State and readings. Raises the bus's error where the drive does not answer at all."""
    wanted = tuple(talk.dialect.profile.signals) if names is None else names
    error = yield from talk.read_verified_state()
    answered = error is None and bool(talk.dialect.state_reads())
    if not talk.dialect.reports_run_state:
        talk.derived = DerivedState(DriveState.UNKNOWN, reason="drives.no_run_status")
    done = talk.dialect.state_reads()
    for request, _ in talk.dialect.polls(wanted) if error is None else ():
        if request in done:
            continue
        answer = yield from talk.read(request)
        answered = answered or answer.error is None
        if answer.error is not None:
            error = answer.error if isinstance(answer.error, DrivebusError) else error
    if not answered and error is None:
        error = yield from talk.sync()
        answered = error is None
    if not answered and error is not None:
        raise error
    return complete_status(talk.dialect, talk.drive_status(), wanted)


def complete_status(dialect: Dialect, found: DriveStatus, wanted: tuple[str, ...] | None = None) -> DriveStatus:
    """The status with every signal of the profile in it, and the canonical ones, missing ones with their reason."""
    profile = dialect.profile
    readings: dict[str, Reading] = {}
    for name, unit in CANONICAL_SIGNALS.items():
        if name not in profile.signals:
            readings[name] = missing_reading("drives.not_reported", unit)
    for name, signal in profile.signals.items():
        readings[name] = found.readings.get(name) or missing_reading(_missing_reason(name, wanted), signal.unit)
    return replace(found, readings=_ordered(profile, readings))


def _missing_reason(name: str, wanted: tuple[str, ...] | None) -> str:
    return "drives.no_answer" if wanted is None or name in wanted else "drives.not_read"


def _ordered(profile: DriveProfile, readings: dict[str, Reading]) -> dict[str, Reading]:
    names = [
        *(n for n in CANONICAL_SIGNALS if n in readings),
        *(n for n in profile.signals if n not in CANONICAL_SIGNALS),
    ]
    return {name: readings[name] for name in names}
