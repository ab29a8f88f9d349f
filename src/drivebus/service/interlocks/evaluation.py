"""Evaluation of interlock expressions in three-valued logic (true, false, unknown); a function gives the values.

A comparison of a value without good quality is unknown, and so is every expression that depends on it, ``not``
included. Only an expression that certainly holds is true, so that missing values never permit a start.
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
    StateLiteral,
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
"""Unit → quantity that it measures, and its factor to the first unit of that quantity."""
ZERO_AT_STANDSTILL = frozenset(
    {"output_frequency", "output_current", "output_voltage", "output_power", "output_torque", "speed"}
)
"""Signals that are 0 while a drive's output is off."""
ANY_UNIT = "any"
"""Unit of the zero of a motor at rest, which is zero in every unit."""
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
"""States that the word ``running`` means. A C320 reports ramps as states, and a new setpoint must trip nothing."""
_BOTH_RESULTS = frozenset({True, False})
ValueLookup = Callable[[str, str], tuple[float | str, str] | None]
"""Drive and name → value and unit; None without good quality."""


def evaluate(expression: Expression, lookup: ValueLookup) -> bool | None:
    """Return whether an expression holds; None if that depends on a value without good quality. Never raises."""
    if isinstance(expression, Comparison):
        return compare(expression, lookup)
    if isinstance(expression, Not):
        inner = evaluate(expression.inner, lookup)
        return None if inner is None else not inner
    results = [evaluate(part, lookup) for part in expression.parts]
    decides = isinstance(expression, Or)
    if decides in results:
        return decides
    return None if None in results else not decides


def compare(comparison: Comparison, lookup: ValueLookup) -> bool | None:
    """Return whether a comparison holds; None if a value has no good quality or another kind of unit. Never raises."""
    left, right = _operand_value(comparison.left, lookup), _operand_value(comparison.right, lookup)
    if left is None or right is None:
        return None
    (left_value, left_quantity), (right_value, right_quantity) = left, right
    if isinstance(left_value, str) or isinstance(right_value, str):
        both_states = isinstance(left_value, str) and isinstance(right_value, str)
        if not both_states or comparison.operator not in ("==", "!="):
            return None
        return _same_state(comparison, str(left_value), str(right_value)) is (comparison.operator == "==")
    if ANY_UNIT not in (left_quantity, right_quantity) and left_quantity != right_quantity:
        return None
    return _OPERATORS[comparison.operator](left_value, right_value)


def _same_state(comparison: Comparison, left: str, right: str) -> bool:
    """Return whether two states are equal; ``running`` means every state of a drive that runs."""
    if RUNNING_WORD in (str(comparison.left), str(comparison.right)):
        return left in _RUNNING_STATES and right in _RUNNING_STATES
    return left == right


def _operand_value(operand: Operand, lookup: ValueLookup) -> tuple[float | str, str] | None:
    """Return a number in the first unit of its quantity, or the word of a state."""
    if isinstance(operand, StateLiteral):
        return operand.text, STATE_NAME
    value_and_unit = (
        (operand.value, operand.unit) if isinstance(operand, Quantity) else lookup(operand.drive, operand.name)
    )
    if value_and_unit is None:
        return None
    value, unit = value_and_unit
    if isinstance(value, str):
        return (value, STATE_NAME) if isinstance(operand, SignalReference) and operand.name == STATE_NAME else None
    if value != value or not (unit in UNIT_MEASURES or unit == ANY_UNIT):
        return None
    quantity, factor = UNIT_MEASURES.get(unit, (ANY_UNIT, 1.0))
    return value * factor, quantity


def requires_running(expression: Expression, drive: str) -> bool:
    """Return whether an expression cannot hold while this drive's output is off: the drive would have to run first."""
    return True not in _possible_results(expression, drive)


def _possible_results(expression: Expression, drive: str) -> frozenset[bool]:
    """Return the results that an expression can have while the drive's output is off."""
    if isinstance(expression, Comparison):
        return _results_at_standstill(expression, drive)
    if isinstance(expression, Not):
        return frozenset(not result for result in _possible_results(expression.inner, drive))
    parts = [_possible_results(part, drive) for part in expression.parts]
    decides = isinstance(expression, Or)
    decided = {decides} if any(decides in part for part in parts) else set()
    undecided = {not decides} if all((not decides) in part for part in parts) else set()
    return frozenset(decided | undecided)


def _results_at_standstill(comparison: Comparison, drive: str) -> frozenset[bool]:
    results = {compare(comparison, _standstill_lookup(drive, state)) for state in DriveState if state.output_off}
    return _BOTH_RESULTS if None in results else frozenset(result for result in results if result is not None)


def _standstill_lookup(drive: str, state: DriveState) -> ValueLookup:
    def lookup(of: str, name: str) -> tuple[float | str, str] | None:
        if of != drive:
            return None
        if name == STATE_NAME:
            return str(state), ""
        return (0.0, ANY_UNIT) if name in ZERO_AT_STANDSTILL else None

    return lookup
