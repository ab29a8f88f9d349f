"""Effect of an operation by its name in a manual."""

from __future__ import annotations

from verification.reference.effects import RequestEffect


def effect_of_name(name: str) -> RequestEffect:
    """Return the effect of an operation by its name in the manual."""
    if "stop" in name:
        return RequestEffect.STOP
    if name.startswith(("run", "jog", "forward", "reverse")):
        return RequestEffect.MOTION
    return RequestEffect.READ if name == "none" else RequestEffect.SETTING
