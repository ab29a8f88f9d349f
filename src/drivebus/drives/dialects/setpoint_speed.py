"""Setpoint that is a speed: revolutions per minute, which the motor's pole pairs make a frequency.

The drive turns the motor at the speed that it was set to, whatever its frequency is; a wrong number of pole pairs is a
wrong frequency on the page and a limit at the wrong speed. So nothing is written before the option gives it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from drivebus.errors import LimitError
from drivebus.profiles.model import POLE_PAIRS, DriveProfile
from drivebus.values import Scale

SECONDS_PER_MINUTE = 60


def speed_scale(profile: DriveProfile, options: Mapping[str, Any]) -> Scale:
    """Return the Hz of a speed word; with unknown pole pairs those of one pair, the smallest for the same speed."""
    assert profile.setpoint_rpm is not None
    pairs = int(options.get(POLE_PAIRS) or 1)
    scale = profile.setpoint_scale
    return Scale(profile.setpoint_rpm * pairs / SECONDS_PER_MINUTE, decimals=scale.decimals, words=scale.words)


def check_pole_pairs(profile: DriveProfile, options: Mapping[str, Any], frequency_hz: float) -> None:
    """Raise LimitError where the setpoint is a speed and the motor's pole pairs are unknown."""
    if profile.setpoint_rpm is not None and not options.get(POLE_PAIRS):
        raise LimitError("drives.pole_pairs_unknown", model=profile.model, frequency_hz=frequency_hz)
