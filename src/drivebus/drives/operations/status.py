"""Read what a drive reports: status, identity and behaviour on communication loss."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from drivebus import i18n
from drivebus.drives.dialects.base import Dialect, Identity
from drivebus.drives.operations.context import OperationContext
from drivebus.drives.operations.parameters import read_values
from drivebus.drives.operations.steps import DriveOperation
from drivebus.drives.state import DerivedState, DriveState, DriveStatus
from drivebus.errors import DrivebusError, PortLost
from drivebus.profiles.model import DriveProfile
from drivebus.values import Quality, Reading, missing_reading


def identify(op: OperationContext) -> DriveOperation[Identity]:
    """Read the identity. Raises the error of the bus where the drive does not answer."""
    dialect = op.dialect
    error = yield from op.sync()
    if error is not None:
        raise error
    replies: list[Any] = []
    for request in dialect.identity_reads():
        result = yield from op.transact(request)
        valid = result.error is None and result.reply is not None and dialect.rejection(result.reply) is None
        replies.append(result.reply if valid else None)
    return dialect.decode_identity(tuple(replies))


@dataclass(frozen=True, slots=True)
class CommLossReport:
    """Behaviour of a drive on communication loss.

    ``stops_on_comm_loss``: True where it stops after ``time``, False where it keeps running, None where unknown.
    """

    stops_on_comm_loss: bool | None
    key: str
    params: Mapping[str, Any] = field(default_factory=dict)
    time: Reading | None = None
    action: Reading | None = None

    def text(self, language: str = "en") -> str:
        """Return one sentence for the operator."""
        return i18n.text(self.key, language, **self.params)


def comm_loss_behaviour(op: OperationContext) -> DriveOperation[CommLossReport]:
    """Read the communication-loss timer and its action. Unknown must be treated as "it keeps running"."""
    rule, model = op.dialect.profile.comm_loss, op.dialect.profile.model
    notations = tuple(n for n in (rule.time_notation, rule.action_notation) if n is not None)
    if not notations:
        return CommLossReport(None, "drives.comm_loss_unpublished", {"model": model})
    readings = yield from read_values(op, notations)
    time = readings.get(rule.time_notation) if rule.time_notation else None
    action = readings.get(rule.action_notation) if rule.action_notation else None
    if any(r is not None and (r.raw is None or r.quality is Quality.BAD) for r in (time, action)):
        return CommLossReport(None, "drives.comm_loss_unread", {"model": model}, time, action)
    params: dict[str, Any] = {"time": _value_text(time), "notation": rule.time_notation, "action": rule.action_notation}
    params["value"] = None if action is None else action.raw
    if time is not None and time.raw == 0:
        return CommLossReport(False, "drives.comm_loss_off", params, time, action)
    if action is None or not rule.trips_values:
        return CommLossReport(None, "drives.comm_loss_unknown", params, time, action)
    trips = action.raw in rule.trips_values
    return CommLossReport(
        trips, "drives.comm_loss_stops" if trips else "drives.comm_loss_runs_on", params, time, action
    )


def _value_text(reading: Reading | None) -> str:
    if reading is None or not isinstance(reading.value, int | float):
        return "?"
    return f"{reading.value:g} {reading.unit}".strip()


STATUS_SIGNALS = {
    "set_frequency": "Hz",
    "output_frequency": "Hz",
    "output_current": "A",
    "output_voltage": "V",
    "dc_bus_voltage": "V",
}
"""Signals that are in every status, without a value and with a reason where the model does not report them."""


def read_status(op: OperationContext, names: tuple[str, ...] | None = None) -> DriveOperation[DriveStatus]:
    """Read state and signals.

    Raises the error of the bus where the drive does not answer at all, or the port is lost: nothing is known then.
    """
    signals = tuple(op.dialect.profile.signals) if names is None else names
    error = yield from op.read_verified_state()
    answered = error is None and bool(op.dialect.state_reads())
    if not op.dialect.reports_run_state:
        op.derived = DerivedState(DriveState.UNKNOWN, reason="drives.no_run_status")
    done = op.dialect.state_reads()
    for request, _ in op.dialect.polls(signals) if error is None else ():
        if request in done:
            continue
        result = yield from op.read(request)
        answered = answered or result.error is None
        if result.error is not None:
            error = result.error if isinstance(result.error, DrivebusError) else error
    if not answered and error is None:
        error = yield from op.sync()
        answered = error is None
    if error is not None and (not answered or isinstance(error, PortLost)):
        raise error
    return complete_status(op.dialect, op.drive_status(), signals)


def complete_status(dialect: Dialect, status: DriveStatus, names: tuple[str, ...] | None) -> DriveStatus:
    """Return the status with the signals of the profile and ``STATUS_SIGNALS``, missing ones with their reason."""
    profile = dialect.profile
    readings: dict[str, Reading] = {}
    for name, unit in STATUS_SIGNALS.items():
        if name not in profile.signals:
            readings[name] = missing_reading("drives.not_reported", unit)
    for name, signal in profile.signals.items():
        readings[name] = status.readings.get(name) or missing_reading(_missing_reason(name, names), signal.unit)
    return replace(status, readings=_ordered(profile, readings))


def _missing_reason(name: str, names: tuple[str, ...] | None) -> str:
    return "drives.no_answer" if names is None or name in names else "drives.not_read"


def _ordered(profile: DriveProfile, readings: dict[str, Reading]) -> dict[str, Reading]:
    names = [
        *(n for n in STATUS_SIGNALS if n in readings),
        *(n for n in profile.signals if n not in STATUS_SIGNALS),
    ]
    return {name: readings[name] for name in names}
