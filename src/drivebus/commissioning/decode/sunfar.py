"""Descriptions of Sunfar frames with the facts of a profile.

Added fields: ``scaled``, a text with unit; the fault's label, text, cause and remedy: see ``annotate.fault_fields``;
``broadcast`` for a request to every drive.
"""

from __future__ import annotations

from drivebus.commissioning.decode.annotate import (
    annotate,
    broadcast_field,
    fault_fields,
    quantity_fields,
)
from drivebus.profiles import DriveProfile
from drivebus.protocols import sunfar
from drivebus.protocols.describe import FrameDescription, FrameDirection, note

_READ_CLASSES = {read.frame_class for read in (sunfar.ReadIdentity, sunfar.ReadMonitor, sunfar.SunfarReadParameter)}


def describe(
    profile: DriveProfile, data: bytes, encoding: str, direction: FrameDirection | None, request: bytes | None
) -> FrameDescription:
    """Describe a frame; parameters, monitors and frequencies are named by the protocol, other quantities here."""
    description = sunfar.describe(data, encoding, direction, request, decode_options(profile))
    fields = description.fields
    notation = fields.get("parameter") or fields.get("monitor")
    entry = next((entry for entry in profile.entries() if entry.notation == notation), None)
    added = {} if entry is None or entry.unit == "Hz" else quantity_fields(entry, fields.get("data"))
    is_broadcast = broadcast_field(profile, description)
    is_read = fields.get("class") in _READ_CLASSES
    errata = (note("explain.broadcast_read", address=profile.broadcast),) if is_broadcast and is_read else ()
    return annotate(description, added | fault_fields(profile, fields) | is_broadcast, errata)


def decode_options(profile: DriveProfile) -> sunfar.SunfarDecodeOptions:
    """Return the frequency step, the frequencies and the monitor coding of a model."""
    hertz = [entry.locator for entry in profile.entries() if entry.unit == "Hz"]
    return sunfar.SunfarDecodeOptions(
        frequency_step_hz=profile.setpoint_scale.factor,
        frequency_monitors=frozenset(index for space, index in hertz if space == "monitor"),
        frequency_parameters=frozenset((index >> 8, index & 0xFF) for space, index in hertz if space == "parameter"),
        monitor_index="bcd" if profile.options.get("monitor_index") == "bcd" else "binary",
    )
