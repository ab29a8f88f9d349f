"""Start blockers of a drive: shown in every view, and checked when a start is requested."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import Any

from drivebus.drives import permissives
from drivebus.drives.runner import bus_conditions
from drivebus.errors import (
    AuditUnavailable,
    DrivebusError,
    Interlocked,
    ServiceError,
    ServiceUnavailable,
    WaiverRequired,
)
from drivebus.service.api.errors import localized, to_plain
from drivebus.service.runtime.drive import DriveRuntime
from drivebus.service.runtime.plant import Plant
from drivebus.types import Json
from drivebus.values import Text, bilingual_text


def start_blockers(plant: Plant, runtime: DriveRuntime) -> Iterator[DrivebusError]:
    """Yield every reason against a start now. ``grant_permit`` checks again before the first frame."""
    if plant.state != "running":
        yield ServiceUnavailable("plant.stopping")
        return
    address = runtime.config.address
    conditions = bus_conditions(runtime.bus, address)
    yield from permissives.unmet_bus_permissives(address, conditions)
    yield from permissives.unmet_start_permissives(conditions, runtime.profile.family)
    for violation in plant.interlocks.violations(runtime.id):
        yield Interlocked("interlocks.violated", **violation.message_params)
    if runtime.comm_loss.view.kind != "trips" and runtime.comm_loss.waiver is None:
        yield _waiver_needed(runtime)
    if runtime.limits_lost:
        yield ServiceError("plant.limits_lost", drive=runtime.id)
    if not plant.audit.ok:
        yield AuditUnavailable("plant.audit_unavailable")


def _waiver_needed(runtime: DriveRuntime) -> WaiverRequired:
    """Return the error of a missing waiver; one that was recorded for another drive of this name is mentioned."""
    other = runtime.comm_loss.waiver_of_another
    if other is None:
        record = runtime.comm_loss.record
        tested = record is not None and record.holds_for(runtime.comm_loss.present_values)
        key = "plant.waiver_needed_tested" if tested else "plant.waiver_needed"
        return WaiverRequired(key, drive=runtime.id, why=_comm_loss_reason(runtime))
    return WaiverRequired(
        "plant.waiver_of_another", drive=runtime.id, why=_comm_loss_reason(runtime), **other.recorded_for
    )


def start_blockers_json(plant: Plant, runtime: DriveRuntime) -> Iterator[Json]:
    """Yield the start blockers as JSON."""
    for error in start_blockers(plant, runtime):
        yield _blocker_json(error.key, tuple(error.params.items()))


@lru_cache(maxsize=2048)  # every view of a drive has the same ones until something changes
def _blocker_json(key: str, params: tuple[tuple[str, Any], ...]) -> Json:
    """Return a start blocker as JSON, which must not be changed."""
    return {"key": key, "params": to_plain(dict(params)), "text": localized(key, dict(params))}


def _comm_loss_reason(runtime: DriveRuntime) -> Text:
    """Return why the drive may run on; a test that no longer holds is named."""
    record = runtime.comm_loss.record
    if record is None or record.holds_for(runtime.comm_loss.present_values) or runtime.comm_loss.present_values is None:
        return runtime.comm_loss.view.text
    return bilingual_text(
        "plant.comm_loss_test_outdated", **{"why": runtime.comm_loss.view.text} | record.message_params
    )


def check_test_start(plant: Plant, runtime: DriveRuntime) -> None:
    """Raise the first start blocker of a communication-loss test: a missing waiver is none, the test replaces it."""
    for error in start_blockers(plant, runtime):
        if not isinstance(error, WaiverRequired):
            raise error


def check_start(plant: Plant, runtime: DriveRuntime) -> None:
    """Raise the first start blocker."""
    for error in start_blockers(plant, runtime):
        raise error
