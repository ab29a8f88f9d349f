"""What an expression comes to: values come from a function. Pure.

A value that is not good makes its comparison neither true nor false but unknown, and what rests on it too, ``not``
included: only what certainly holds is True (fail safe).
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping

from drivebus.drives.state import DriveState
from drivebus.plant.expression import STATE, Comparison, Expression, Not, Number, Operand, Or, Reference, Word

UNITS: Mapping[str, tuple[str, float]] = {
    "": ("", 1.0),
    "Hz": ("frequency", 1.0),
    "A": ("current", 1.0),
    "mA": ("current", 0.001),
    "V": ("voltage", 1.0),
    "W": ("power", 0.001),
    "kW": ("power", 1.0),
    "kWh": ("energy", 1.0),
    "°C": ("temperature", 1.0),
    "℃": ("temperature", 1.0),
    "rpm": ("speed", 1.0),
    "ms": ("time", 0.001),
    "s": ("time", 1.0),
    "min": ("time", 60.0),
    "h": ("time", 3600.0),
    "%": ("share", 1.0),
    "N·m": ("torque", 1.0),
    "Nm": ("torque", 1.0),
}
"""Unit → what it measures, and how many of that measure's first unit it is."""
MOVING = frozenset({"output_frequency", "output_current", "output_voltage", "output_power", "output_torque", "speed"})
"""Signals that are 0 while a drive's output is off."""
ANY = "any"
"""The unit of the 0 that stands for a motor at rest: it is 0 in every unit."""
_COMPARE: Mapping[str, Callable[[float, float], bool]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "==": operator.eq,
    "!=": operator.ne,
}
RUNNING = str(DriveState.RUNNING)
_RUNS = frozenset({RUNNING, str(DriveState.ACCELERATING), str(DriveState.DECELERATING)})
"""A drive that changes its speed runs: a setpoint must not trip what requires it (C320 reports its ramps as states)."""
_EITHER = frozenset({True, False})
Look = Callable[[str, str], tuple[float | str, str] | None]
"""Drive and name → value and unit; None where there is none that is good."""


def holds(expression: Expression, look: Look) -> bool | None:
    """True: certainly. None: a value that matters is not good. Never raises."""
    if isinstance(expression, Comparison):
        return compared(expression, look)
    if isinstance(expression, Not):
        inner = holds(expression.inner, look)
        return None if inner is None else not inner
    found = [holds(part, look) for part in expression.parts]
    decides = isinstance(expression, Or)
    if decides in found:
        return decides
    return None if None in found else not decides


def compared(comparison: Comparison, look: Look) -> bool | None:
    """One comparison."""
    left, right = _value(comparison.left, look), _value(comparison.right, look)
    if left is None or right is None:
        return None
    (one, one_measures), (other, other_measures) = left, right
    if isinstance(one, str) or isinstance(other, str):
        known = isinstance(one, str) and isinstance(other, str) and comparison.sign in ("==", "!=")
        return _alike(comparison, str(one), str(other)) is (comparison.sign == "==") if known else None
    if ANY not in (one_measures, other_measures) and one_measures != other_measures:
        return None
    return _COMPARE[comparison.sign](one, other)


def _alike(comparison: Comparison, one: str, other: str) -> bool:
    """The same state; the word ``running`` stands for every state of a drive that runs, its ramps too."""
    if RUNNING in (str(comparison.left), str(comparison.right)):
        return one in _RUNS and other in _RUNS
    return one == other


def _value(side: Operand, look: Look) -> tuple[float | str, str] | None:
    """A number in its measure's first unit, or a state's word."""
    if isinstance(side, Word):
        return side.text, STATE
    found = (side.value, side.unit) if isinstance(side, Number) else look(side.drive, side.name)
    if found is None:
        return None
    value, unit = found
    if isinstance(value, str):
        return (value, STATE) if isinstance(side, Reference) and side.name == STATE else None
    if value != value or not (unit in UNITS or unit == ANY):
        return None
    measures, factor = UNITS.get(unit, (ANY, 1.0))
    return value * factor, measures


def needs(expression: Expression, drive: str) -> bool:
    """It can't hold while this drive's output is off, whatever all other values are: the drive must run first."""
    return True not in _possible(expression, drive)


def _possible(expression: Expression, drive: str) -> frozenset[bool]:
    """What it can be while the drive's output is off."""
    if isinstance(expression, Comparison):
        return _at_rest(expression, drive)
    if isinstance(expression, Not):
        return frozenset(not one for one in _possible(expression.inner, drive))
    parts = [_possible(part, drive) for part in expression.parts]
    decides = isinstance(expression, Or)
    one_can = {decides} if any(decides in part for part in parts) else set()
    all_can = {not decides} if all((not decides) in part for part in parts) else set()
    return frozenset(one_can | all_can)


def _at_rest(comparison: Comparison, drive: str) -> frozenset[bool]:
    found = {compared(comparison, _resting(drive, state)) for state in DriveState if state.output_off}
    return _EITHER if None in found else frozenset(one for one in found if one is not None)


def _resting(drive: str, state: DriveState) -> Look:
    def look(of: str, name: str) -> tuple[float | str, str] | None:
        if of != drive:
            return None
        if name == STATE:
            return str(state), ""
        return (0.0, ANY) if name in MOVING else None

    return look
