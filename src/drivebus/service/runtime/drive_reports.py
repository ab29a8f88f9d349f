"""Reports of a drive as events and alarms: presence, faults, starts and standstills, another speed than was set."""

from __future__ import annotations

from math import inf

from drivebus.bus.station import Presence
from drivebus.drives.dialects.base import UNNAMED_FAULT_CODE
from drivebus.drives.state import DriveState, DriveStatus, names_fault_label
from drivebus.service.alarms import SystemAlarm
from drivebus.service.alarms.condition import UNNAMED_FAULT_DELAY_S
from drivebus.service.config.model import title_of
from drivebus.service.runtime.drive import DriveRuntime
from drivebus.service.runtime.plant import Plant
from drivebus.types import Json

STANDSTILL_CONFIRM_S = 3.0  # so soon after a start command, a reported standstill may be the one before the start
OTHER_SPEED_DELAY_S = 10.0  # a frequency that a slow bus is setting just now is no alarm


def report_presence(plant: Plant, runtime: DriveRuntime, status: DriveStatus) -> None:
    """Publish an event when a drive stops answering, when its late or damaged replies come, and when it is back."""
    presence = runtime.bus.presence(runtime.config.address)
    before, runtime.reported_presence = runtime.reported_presence, presence
    unusable = presence is Presence.OFFLINE and status.unusable_reply is not None
    if presence is not before:
        runtime.reported_unusable_reply = False
    is_reported = presence is before and (runtime.reported_unusable_reply or not unusable)
    is_first_contact = before in (None, Presence.NEVER_SEEN) and presence is not Presence.OFFLINE
    if is_reported or is_first_contact:
        return
    params: Json = {"drive": title_of(runtime.config)}
    key = "plant.drive_silent" if presence is Presence.OFFLINE else "plant.drive_back"
    if unusable:
        key, params["reason"] = "plant.drive_unusable_reply", status.unusable_reply
        runtime.reported_unusable_reply = True
    plant.publish_event("presence", runtime.id, key, **params)


def report_fault(plant: Plant, runtime: DriveRuntime, status: DriveStatus) -> None:
    """Publish an event when a drive trips; the same fault after a pause in communication is no new one."""
    fault = status.fault
    if fault is None:
        if status.state is not DriveState.UNKNOWN or "status" not in runtime.profile.capabilities:
            runtime.reported_fault = None
    elif runtime.reported_fault != fault.code and not _is_naming_awaited(runtime, fault.code, plant.now()):
        runtime.reported_fault = fault.code
        key = "plant.drive_fault_says" if names_fault_label(fault.text.en, fault.label) else "plant.drive_fault"
        plant.publish_event("fault", runtime.id, key, label=fault.label, fault=fault.text)


def report_motion(plant: Plant, runtime: DriveRuntime, status: DriveStatus) -> None:
    """Publish a start or a standstill that no command explains, and clear the alarms that no longer hold.

    A standstill ends the motion that the service has started or adopted.
    """
    state = status.state
    if state is DriveState.UNKNOWN:
        return
    is_starting = runtime.last_motion_at == inf  # a standstill may have been read before the start frame
    explained = runtime.last_known_turning or runtime.runs_for_service or is_starting
    if state.turning and not explained:
        plant.publish_event("start", runtime.id, "plant.started_by_itself")
    runtime.state_was_known, runtime.last_known_turning = True, state.turning
    if state.output_off and status.at is not None and status.at > runtime.last_motion_at + STANDSTILL_CONFIRM_S:
        if not runtime.drive.stop_pending:
            plant.clear_alarm(SystemAlarm.STOP_UNCONFIRMED, runtime.id)
        if _has_stopped_by_itself(runtime, status):
            plant.publish_event("stop", runtime.id, "plant.stopped_by_itself")
        runtime.end_motion()  # a later start is not by the service
    has_control = plant.leases.get(runtime.id, plant.now()) is not None
    if has_control or not (state.turning or is_starting):
        for kind in (SystemAlarm.RUNNING_AT_START, SystemAlarm.CONTROL_LOST):
            plant.clear_alarm(kind, runtime.id)


def _has_stopped_by_itself(runtime: DriveRuntime, status: DriveStatus) -> bool:
    """Return whether a drive at standstill was run by the service, and has neither tripped nor been stopped by it."""
    is_run = runtime.started_by_service and runtime.commanded_hz is not None and runtime.comm_loss.test is None
    return is_run and runtime.last_stop is None and status.state is not DriveState.FAULT


def report_other_speed(plant: Plant, runtime: DriveRuntime, status: DriveStatus) -> None:
    """Raise the alarm of a drive that keeps another speed than was set, or clear it.

    After a dip of its supply it may run again by itself at the frequency of its keypad.
    """
    if status.state is DriveState.UNKNOWN:
        return
    is_set = runtime.started_by_service and runtime.last_motion_at != inf and not runtime.ramp_holds
    difference = runtime.speed_difference
    before = difference.since
    difference.update(status, runtime.commanded_hz if is_set else None)
    if difference.since is None:
        if before is not None:
            plant.clear_alarm(SystemAlarm.OTHER_SPEED, runtime.id)
    elif difference.found_at - difference.since >= OTHER_SPEED_DELAY_S:
        found_hz, set_hz = difference.found_hz, runtime.commanded_hz
        plant.raise_alarm(SystemAlarm.OTHER_SPEED, runtime.id, found_hz=found_hz, set_hz=set_hz)


def _is_naming_awaited(runtime: DriveRuntime, code: int, now: float) -> bool:
    """Return whether a fault has no code yet because its fault word is being read."""
    if code != UNNAMED_FAULT_CODE:
        runtime.unnamed_fault_at = None
    elif runtime.unnamed_fault_at is None:
        runtime.unnamed_fault_at = now
    return runtime.unnamed_fault_at is not None and now - runtime.unnamed_fault_at < UNNAMED_FAULT_DELAY_S
