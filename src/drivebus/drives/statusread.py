"""``status``: what a drive reports now, and what it does not, with the reason. Pure."""

from __future__ import annotations

from dataclasses import replace

from drivebus.drives.dialect import Dialect
from drivebus.drives.operation import Talk
from drivebus.drives.state import DriveState, DriveStatus, Verdict
from drivebus.drives.talk import Conversation
from drivebus.errors import DrivebusError
from drivebus.profiles.model import DriveProfile
from drivebus.reading import Reading, missing

CANONICAL = {
    "set_frequency": "Hz",
    "output_frequency": "Hz",
    "output_current": "A",
    "output_voltage": "V",
    "dc_bus_voltage": "V",
}
"""What every drive is asked about: present in each status, None with a reason where the model does not report it."""


def status(talk: Talk, names: tuple[str, ...] | None = None) -> Conversation[DriveStatus]:
    """State and readings. Raises the bus's error where the drive does not answer at all."""
    wanted = tuple(talk.dialect.profile.signals) if names is None else names
    error = yield from talk.judged()
    answered = error is None and bool(talk.dialect.state_reads())
    if not talk.dialect.can_tell:
        talk.verdict = Verdict(DriveState.UNKNOWN, reason="drives.no_run_status")
    done = talk.dialect.state_reads()
    for request, _ in talk.dialect.polls(wanted) if error is None else ():
        if request in done:
            continue
        answer = yield from talk.read(request)
        answered = answered or answer.error is None
        if answer.error is not None:
            error = answer.error if isinstance(answer.error, DrivebusError) else error
    if not answered and error is None:
        error = yield from talk.fence()
        answered = error is None
    if not answered and error is not None:
        raise error
    return complete(talk.dialect, talk.status(), wanted)


def complete(dialect: Dialect, found: DriveStatus, wanted: tuple[str, ...] | None = None) -> DriveStatus:
    """The status with every signal of the profile in it, and the canonical ones, missing ones with their reason."""
    profile = dialect.profile
    readings: dict[str, Reading] = {}
    for name, unit in CANONICAL.items():
        if name not in profile.signals:
            readings[name] = missing("drives.not_reported", unit)
    for name, signal in profile.signals.items():
        readings[name] = found.readings.get(name) or missing(_why(name, wanted), signal.unit)
    return replace(found, readings=_ordered(profile, readings))


def _why(name: str, wanted: tuple[str, ...] | None) -> str:
    return "drives.no_answer" if wanted is None or name in wanted else "drives.not_read"


def _ordered(profile: DriveProfile, readings: dict[str, Reading]) -> dict[str, Reading]:
    names = [*(n for n in CANONICAL if n in readings), *(n for n in profile.signals if n not in CANONICAL)]
    return {name: readings[name] for name in names}
