"""Setpoint that is a share of the drive's maximum frequency: 10000 means the maximum, whatever that is set to.

A wrong maximum is a wrong speed, so it is read before each frequency where the profile names its parameter.
Otherwise the profile states it, and a cap holds under the largest maximum that the model allows until the user confirms
it with the option ``maximum_frequency``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from drivebus.drives.dialects.setpoint_speed import speed_scale
from drivebus.drives.dialects.setpoint_step import ROUNDING, UNCALIBRATED_CAP_HZ
from drivebus.errors import LimitError
from drivebus.profiles.model import MAXIMUM_FREQUENCY, DriveProfile, SetpointShare
from drivebus.values import Scale


def setpoint_scale(profile: DriveProfile, options: Mapping[str, Any]) -> Scale:
    """Return the scale of the setpoint word.

    For a share whose maximum is to be read and was not yet, it is that of the largest maximum: a word computed with it
    never means more than was asked for.
    """
    share = profile.setpoint_share
    if profile.setpoint_rpm is not None:
        return speed_scale(profile, options)
    if share is None:
        return profile.setpoint_scale
    maximum_hz = _known_maximum_hz(options) or (share.maximum_hz if share.maximum is None else None)
    return Scale((maximum_hz or share.highest_hz) / share.full_scale, decimals=profile.setpoint_scale.decimals)


def share_word(profile: DriveProfile, options: Mapping[str, Any], frequency_hz: float) -> int:
    """Return the word of a share or a speed, rounded down: it never means more than was asked for.

    Raises ValueError for a frequency below 0 or beyond its words.
    """
    scale = setpoint_scale(profile, options)
    word = int(frequency_hz / scale.factor + ROUNDING)
    if frequency_hz < 0 or word >= 1 << 16 * profile.setpoint_scale.words:
        raise ValueError(f"{frequency_hz} Hz does not fit its words at a step of {scale.factor} Hz")
    return word


def highest_capped_word(share: SetpointShare) -> int:
    """Return the largest word that means at most 5 Hz under every maximum of the model."""
    return int(UNCALIBRATED_CAP_HZ / share.highest_hz * share.full_scale + ROUNDING)


def share_cap_hz(profile: DriveProfile, options: Mapping[str, Any]) -> float | None:
    """Return the highest frequency while the maximum of the drive is only stated; None: no cap holds."""
    share = profile.setpoint_share
    if share is None or share.maximum is not None or _known_maximum_hz(options) is not None:
        return None
    return setpoint_scale(profile, options).value(highest_capped_word(share))


def check_setpoint_share(profile: DriveProfile, options: Mapping[str, Any], frequency_hz: float, word: int) -> None:
    """Raise LimitError for a frequency above the maximum, or above the cap while the maximum is only stated."""
    share = profile.setpoint_share
    if share is None:
        return
    maximum_hz = _known_maximum_hz(options)
    if maximum_hz is not None:
        if word > share.full_scale:
            raise LimitError("drives.above_drive_maximum", frequency_hz=frequency_hz, limit_hz=maximum_hz)
        return
    if share.maximum is None and word > highest_capped_word(share):
        raise LimitError(
            "drives.share_cap",
            model=profile.model,
            frequency_hz=frequency_hz,
            stated_hz=share.maximum_hz,
            limit_hz=UNCALIBRATED_CAP_HZ,
            cap_hz=share_cap_hz(profile, options),
        )


def _known_maximum_hz(options: Mapping[str, Any]) -> float | None:
    """Return the maximum frequency that was read or that the user confirmed; 0 stands for none."""
    return float(options.get(MAXIMUM_FREQUENCY) or 0) or None
