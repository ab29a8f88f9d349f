"""Description of one frame for a drive model: fields of the protocol with names and units of the profile.

The readers are tolerant where the master is strict, and report every difference.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from drivebus import profiles
from drivebus.commissioning.decode.annotate import annotate
from drivebus.drives.dialects.create import create_dialect
from drivebus.errors import ConfigurationError
from drivebus.profiles import DriveProfile
from drivebus.protocols import modbus
from drivebus.protocols.codec import Effect
from drivebus.protocols.describe import FrameDescription, FrameDirection, Note, note
from drivebus.protocols.family import protocol_family, resolve


def describe_frame(
    profile: DriveProfile | str | Path,
    data: bytes,
    *,
    encoding: str | None = None,
    direction: str | None = None,
    request: bytes | None = None,
) -> FrameDescription:
    """Describe one frame by a profile, or by the name or file of one, whatever its bytes are.

    Without ``encoding`` the first byte decides; without ``direction`` a frame is a response where its ``request`` is
    given, else its shape decides, and a response has ``interpretations``. Raises ProfileError for an unknown model,
    ConfigurationError for an encoding or direction that it can't have.
    """
    loaded = profile if isinstance(profile, DriveProfile) else profiles.load(profile)
    describe = resolve(protocol_family(loaded.family).describe)
    chosen = _choose_encoding(loaded, data, encoding)
    description: FrameDescription = describe(loaded, data, chosen, _check_direction(direction), request)
    hazard = _broadcast_hazard(loaded, description)
    if hazard is None or not description.valid or description.direction != "request":
        return description
    dialect = create_dialect(replace(loaded, encodings=(chosen,)), loaded.addresses[0])
    effect_of, canonical = dialect.station_config.effect_of, description.canonical
    is_misspelt_stop = canonical is not None and effect_of(canonical) is Effect.STOP
    moves = effect_of(data) is Effect.MOTION and not is_misspelt_stop
    return annotate(description, {}, hazards=(hazard,) if moves else ())


def _broadcast_hazard(profile: DriveProfile, description: FrameDescription) -> Note | None:
    """Return the hazard of a frame that moves and that every drive may execute; None for a frame to one drive.

    Modbus over Serial Line V1.02, 2.1: a station executes a write to address 0, whether its manual names it or not.
    """
    address = description.fields.get("address")
    if description.fields.get("broadcast") is True:
        return note("explain.broadcast_motion")
    if profile.family == "modbus" and address == modbus.BROADCAST < profile.addresses[0]:
        return note("explain.possible_broadcast_motion", model=profile.model, address=address)
    return None


def alternative_fields(description: FrameDescription) -> Mapping[str, Any] | None:
    """Return the second interpretation of ambiguous bytes (Sunfar hex data); None where they are not ambiguous."""
    if not any(key.endswith(".ambiguous") for key, _ in description.errata):
        return None
    for interpretation in description.interpretations:
        if interpretation.note[0].endswith(".nibbles"):
            return interpretation.fields
    return None


def _choose_encoding(profile: DriveProfile, data: bytes, requested: str | None) -> str:
    """Return an encoding of the family, also one that the model does not offer."""
    family = protocol_family(profile.family)
    encodings = family.encodings
    if requested is None:
        default = next((encoding for encoding in profile.encodings if encoding in encodings), encodings[0])
        return family.first_bytes.get(data[0], default) if data else default
    if requested not in encodings:
        raise ConfigurationError("explain.encoding", model=profile.model, found=requested, expected=tuple(encodings))
    return requested


def _check_direction(direction: str | None) -> FrameDirection | None:
    if direction is None:
        return None
    if direction == "request":
        return "request"
    if direction == "response":
        return "response"
    raise ConfigurationError("explain.direction", found=direction, expected=("request", "response"))
