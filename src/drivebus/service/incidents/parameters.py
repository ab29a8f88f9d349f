"""Which parameters of a drive matter when it has tripped. Pure."""

from __future__ import annotations

from drivebus.profiles.model import DriveProfile


def incident_parameters(profile: DriveProfile) -> tuple[str, ...]:
    """Ramps, what makes it obey the bus, what it does when the host falls silent: what of it can be read."""
    rule = profile.comm_loss
    asked = [one.notation for one in profile.preconditions if one.unreadable is None]
    names = [*(profile.ramp_notations or ()), *asked, rule.time_notation, rule.action_notation]
    return tuple(dict.fromkeys(name for name in names if name is not None))
