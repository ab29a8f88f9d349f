"""Step of the setpoint where the bus cannot show it: look-alikes with other steps of Hz, or a step that is assumed.

Such a profile has the option ``setpoint_step``. The set and the reported frequency share the step, so a read-back
confirms a wrong step too; until it is determined, a cap holds under every possible one.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from drivebus.errors import LimitError
from drivebus.profiles.model import SETPOINT_STEP, UNDETERMINED, DriveProfile

UNCALIBRATED_CAP_HZ = 5.0
"""Until the scale of the setpoint is determined, no raw word may mean more than this under any possible scale."""
ROUNDING = 1e-9
"""Part of a step by which a quotient of binary fractions may fall below its whole number."""


def possible_steps_hz(profile: DriveProfile, options: Mapping[str, Any]) -> tuple[float, ...]:
    """Return the steps that are not excluded; one where it is determined or the profile leaves none open."""
    step = options.get(SETPOINT_STEP)
    if step is None:
        return (profile.setpoint_scale.factor,)
    if step != UNDETERMINED:
        return (float(step),)
    return tuple(
        float(choice)
        for question in profile.open_questions
        if question.name == SETPOINT_STEP
        for choice in question.choices
        if choice != UNDETERMINED
    )


def highest_safe_word(steps_hz: tuple[float, ...]) -> int:
    """Return the largest raw word that means at most 5 Hz under each of these steps."""
    return int(UNCALIBRATED_CAP_HZ / max(steps_hz) + ROUNDING)


def step_cap_hz(profile: DriveProfile, options: Mapping[str, Any]) -> float | None:
    """Return the highest frequency while several steps are possible, None once one is determined."""
    steps_hz = possible_steps_hz(profile, options)
    return None if len(steps_hz) == 1 else profile.setpoint_scale.value(highest_safe_word(steps_hz))


def check_setpoint_step(profile: DriveProfile, options: Mapping[str, Any], frequency_hz: float, word: int) -> None:
    """Raise LimitError where the drive counts in another step than its profile, or may do so and exceed the cap."""
    own_hz, steps_hz = profile.setpoint_scale.factor, possible_steps_hz(profile, options)
    if steps_hz == (own_hz,):
        return
    if len(steps_hz) == 1:
        raise LimitError("drives.step_differs", model=profile.model, step_hz=own_hz, found_hz=steps_hz[0])
    if word > highest_safe_word(steps_hz):
        raise LimitError(
            "drives.step_cap",
            model=profile.model,
            frequency_hz=frequency_hz,
            steps_hz=tuple(f"{step:g}" for step in steps_hz),
            limit_hz=UNCALIBRATED_CAP_HZ,
            cap_hz=step_cap_hz(profile, options),
        )
