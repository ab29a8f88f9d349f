"""What an expression comes to: values come from a function. Pure.

A value that is not good makes its comparison neither true nor false but unknown, and what rests on it too, ``not``
included: only what certainly holds is True (fail safe).
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping

from drivebus.drives.state import DriveState
from drivebus.service.interlocks.expression import (
    STATE_NAME,
    Comparison,
    Expression,
    Not,
    Operand,
    Or,
    Quantity,
    SignalReference,
    StateWord,
)

UNIT_MEASURES: Mapping[str, tuple[str, float]] = {
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
ZERO_AT_STANDSTILL = frozenset(
    {"output_frequency", "output_current", "output_voltage", "output_power", "output_torque", "speed"}
)
"""Signals that are 0 while a drive's output is off."""
ANY_UNIT = "any"
"""The unit of the 0 that stands for a motor at rest: it is 0 in every unit."""
_OPERATORS: Mapping[str, Callable[[float, float], bool]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "==": operator.eq,
    "!=": operator.ne,
}
RUNNING_WORD = str(DriveState.RUNNING)
_RUNNING_STATES = frozenset({RUNNING_WORD, str(DriveState.ACCELERATING), str(DriveState.DECELERATING)})
"""A drive that changes its speed runs: a setpoint must not trip what requires it (C320 reports its ramps as states)."""
_BOTH_RESULTS = frozenset({True, False})
ValueLookup = Callable[[str, str], tuple[float | str, str] | None]
"""Drive and name → value and unit; None where there is none that is good."""


def evaluate(expression: Expression, look: ValueLookup) -> bool | None:
    """True: certainly. None: a value that matters is not good. Never raises."""
    if isinstance(expression, Comparison):
        return compare(expression, look)
    if isinstance(expression, Not):
        inner = evaluate(expression.inner, look)
        return None if inner is None else not inner
    found = [evaluate(part, look) for part in expression.parts]
    decides = isinstance(expression, Or)
    if decides in found:
        return decides
    return None if None in found else not decides


def compare(comparison: Comparison, look: ValueLookup) -> bool | None:
    """One comparison."""
    left, right = _operand_value(comparison.left, look), _operand_value(comparison.right, look)
    if left is None or right is None:
        return None
    (one, one_measures), (other, other_measures) = left, right
    if isinstance(one, str) or isinstance(other, str):
        known = isinstance(one, str) and isinstance(other, str) and comparison.operator in ("==", "!=")
        return _same_state(comparison, str(one), str(other)) is (comparison.operator == "==") if known else None
    if ANY_UNIT not in (one_measures, other_measures) and one_measures != other_measures:
        return None
    return _OPERATORS[comparison.operator](one, other)


def _same_state(comparison: Comparison, one: str, other: str) -> bool:
    """The same state; the word ``running`` stands for every state of a drive that runs, its ramps too."""
    if RUNNING_WORD in (str(comparison.left), str(comparison.right)):
        return one in _RUNNING_STATES and other in _RUNNING_STATES
    return one == other


def _operand_value(side: Operand, look: ValueLookup) -> tuple[float | str, str] | None:
    """A number in its measure's first unit, or a state's word."""
    if isinstance(side, StateWord):
        return side.text, STATE_NAME
    found = (side.value, side.unit) if isinstance(side, Quantity) else look(side.drive, side.name)
    if found is None:
        return None
    value, unit = found
    if isinstance(value, str):
        return (value, STATE_NAME) if isinstance(side, SignalReference) and side.name == STATE_NAME else None
    if value != value or not (unit in UNIT_MEASURES or unit == ANY_UNIT):
        return None
    measures, factor = UNIT_MEASURES.get(unit, (ANY_UNIT, 1.0))
    return value * factor, measures


def requires_running(expression: Expression, drive: str) -> bool:
    """It can't hold while this drive's output is off, whatever all other values are: the drive must run first."""
    return True not in _possible_results(expression, drive)


def _possible_results(expression: Expression, drive: str) -> frozenset[bool]:
    """What it can be while the drive's output is off."""
    if isinstance(expression, Comparison):
        return _results_at_standstill(expression, drive)
    if isinstance(expression, Not):
        return frozenset(not one for one in _possible_results(expression.inner, drive))
    parts = [_possible_results(part, drive) for part in expression.parts]
    decides = isinstance(expression, Or)
    one_can = {decides} if any(decides in part for part in parts) else set()
    all_can = {not decides} if all((not decides) in part for part in parts) else set()
    return frozenset(one_can | all_can)


def _results_at_standstill(comparison: Comparison, drive: str) -> frozenset[bool]:
    found = {compare(comparison, _standstill_lookup(drive, state)) for state in DriveState if state.output_off}
    return _BOTH_RESULTS if None in found else frozenset(one for one in found if one is not None)


def _standstill_lookup(drive: str, state: DriveState) -> ValueLookup:
    def look(of: str, name: str) -> tuple[float | str, str] | None:
        if of != drive:
            return None
        if name == STATE_NAME:
            return str(state), ""
        return (0.0, ANY_UNIT) if name in ZERO_AT_STANDSTILL else None

    return look
