"""Checks of groups, interlocks and alarms: names, expressions, units, thresholds, and cycles of drives."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from difflib import get_close_matches
from typing import Any

from drivebus.errors import ConfigurationError
from drivebus.profiles.diagnostics import Issue, KeyPath, issue
from drivebus.profiles.model import Signal
from drivebus.service.config.build import ParsedPlant, alarm_drives, polled_signals
from drivebus.service.config.check_buses import error_text, suggestions
from drivebus.service.config.schema import AlarmTable, GroupTable, InterlockTable
from drivebus.service.interlocks.evaluation import UNIT_MEASURES, requires_running
from drivebus.service.interlocks.expression import (
    STATE_NAME,
    STATE_WORDS,
    Comparison,
    Expression,
    Operand,
    Quantity,
    SignalReference,
    StateLiteral,
    comparisons,
    parse,
    references,
)
from drivebus.values import Text, bilingual_text


def rule_issues(parsed: ParsedPlant) -> Iterator[Issue]:
    """Yield the issues of groups, interlocks and alarms."""
    for id, group in parsed.file.group.items():
        yield from check_drive_names(parsed, group.drives, ("group", id, "drives"))
        yield from _check_group(id, group)
    for id, interlock in parsed.file.interlock.items():
        yield from check_drive_names(parsed, interlock.drives, ("interlock", id, "drives"))
    for id, alarm in parsed.file.alarm.items():
        yield from check_drive_names(parsed, alarm.drives, ("alarm", id, "drives"))
    yield from interlock_issues(parsed)
    yield from alarm_issues(parsed)


def check_drive_names(parsed: ParsedPlant, drives: Sequence[str], path: KeyPath) -> Iterator[Issue]:
    """Yield drives that do not exist or are listed twice."""
    known = parsed.known_ids("drive")
    for index, drive in enumerate(drives):
        if drive not in known:
            yield issue("unknown_drive", path, drive, **suggestions(drive, known))
        elif drive in drives[:index]:
            yield issue("drive_twice", path, drive)


def _check_group(id: str, group: GroupTable) -> Iterator[Issue]:
    path = ("group", id)
    if group.leader is not None and group.leader not in group.drives:
        yield issue("not_in_group", (*path, "leader"), group.leader, drives=tuple(group.drives))
    if group.ratios and group.leader is None:
        yield issue("no_leader", (*path, "ratios"), Text.join_names(group.ratios))
    for drive in group.ratios:
        if drive not in group.drives:
            yield issue("not_in_group", (*path, "ratios", drive), drive, drives=tuple(group.drives))
        elif drive == group.leader:
            yield issue("ratio_of_leader", (*path, "ratios", drive), drive)


def interlock_issues(parsed: ParsedPlant) -> Iterator[Issue]:
    """Yield faults of the expressions, comparisons that make no sense, and drives that wait for each other."""
    expressions: dict[str, Expression] = {}
    for id, interlock in parsed.file.interlock.items():
        path = ("interlock", id, "require")
        try:
            expressions[id] = parse(interlock.require)
        except ConfigurationError as error:
            yield issue("expression", path, interlock.require, why=error_text(error))
            continue
        yield from _check_names(parsed, expressions[id], path)
        for comparison in comparisons(expressions[id]):
            yield from _check_sides(parsed, comparison, path)
    yield from _check_cycles({id: parsed.file.interlock[id] for id in expressions}, expressions)


def _check_names(parsed: ParsedPlant, expression: Expression, path: KeyPath) -> Iterator[Issue]:
    known = parsed.known_ids("drive")
    for reference in references(expression):
        if reference.drive not in known:
            yield issue(
                "expression_drive", path, str(reference), column=reference.column, **suggestions(reference.drive, known)
            )
        elif reference.drive in parsed.profiles:
            yield from _check_signal(parsed, reference, path)


def _check_signal(parsed: ParsedPlant, reference: SignalReference, path: KeyPath) -> Iterator[Issue]:
    """Yield a reference to a signal that is not polled or never has good quality."""
    profile = parsed.profiles[reference.drive]
    if reference.name == STATE_NAME:
        if "status" not in profile.capabilities:
            yield issue("expression_no_state", path, str(reference), column=reference.column, model=profile.model)
        return
    polled = polled_signals(parsed, reference.drive, parsed.file.drive[reference.drive])
    if reference.name not in polled:
        names = suggestions(reference.name, list(dict.fromkeys((STATE_NAME, *polled))))
        yield issue("expression_signal", path, str(reference), column=reference.column, drive=reference.drive, **names)
    elif profile.signals[reference.name].uncertain:
        yield issue("expression_uncertain", path, str(reference), column=reference.column, model=profile.model)


def _check_sides(parsed: ParsedPlant, comparison: Comparison, path: KeyPath) -> Iterator[Issue]:
    """Yield comparisons whose sides differ in quantity, and states compared with anything but their words."""
    left, right = comparison.left, comparison.right
    if not any(isinstance(side, SignalReference) for side in (left, right)):
        yield issue("expression_constant", path, str(comparison), column=left.column)
        return
    for word in (side for side in (left, right) if isinstance(side, StateLiteral)):
        if word.text not in STATE_WORDS:
            close = tuple(get_close_matches(word.text, STATE_WORDS, 3, 0.5) or STATE_WORDS)
            yield issue("expression_state", path, word.text, column=word.column, known=tuple(STATE_WORDS), near=close)
    if any(_is_state(side) for side in (left, right)) and comparison.operator not in ("==", "!="):
        yield issue("expression_order", path, str(comparison), column=left.column)
    for number in (side for side in (left, right) if isinstance(side, Quantity) and side.unit not in UNIT_MEASURES):
        units = tuple(unit for unit in UNIT_MEASURES if unit)
        yield issue("expression_unit", path, number.unit, column=number.column, units=units)
    yield from _check_units(parsed, comparison, path)


def _check_units(parsed: ParsedPlant, comparison: Comparison, path: KeyPath) -> Iterator[Issue]:
    sides = [(side, quantity_of(parsed, side)) for side in (comparison.left, comparison.right)]
    if any(quantity is None for _, quantity in sides):
        return
    (left, left_quantity), (right, right_quantity) = sides
    if left_quantity != right_quantity:
        shown = str(comparison)
        units: dict[str, Any] = {"left": _with_unit(parsed, left), "right": _with_unit(parsed, right)}
        yield issue("expression_measures", path, shown, column=left.column, **units)


def _with_unit(parsed: ParsedPlant, operand: Operand) -> str:
    return (
        str(operand) if isinstance(operand, Quantity | StateLiteral) else f"{operand} [{_unit(parsed, operand) or '-'}]"
    )


def _is_state(operand: Operand) -> bool:
    return isinstance(operand, StateLiteral) or (isinstance(operand, SignalReference) and operand.name == STATE_NAME)


def quantity_of(parsed: ParsedPlant, operand: Operand) -> str | None:
    """Return the quantity of an operand; None if it is unknown and already reported."""
    if _is_state(operand):
        return STATE_NAME
    unit = _unit(parsed, operand)
    return None if unit is None or unit not in UNIT_MEASURES else UNIT_MEASURES[unit][0]


def _unit(parsed: ParsedPlant, operand: Operand) -> str | None:
    if isinstance(operand, Quantity):
        return operand.unit
    if _is_state(operand):
        return STATE_NAME
    assert isinstance(operand, SignalReference)
    profile = parsed.profiles.get(operand.drive)
    signal = None if profile is None else profile.signals.get(operand.name)
    return None if signal is None else signal.unit


def _check_cycles(interlocks: Mapping[str, InterlockTable], expressions: Mapping[str, Expression]) -> Iterator[Issue]:
    """Yield drives that must run before each other, so that none of them could ever start."""
    required: dict[str, list[tuple[str, str]]] = {}  # drive → drives that must run before it, each with the interlock
    for id, expression in expressions.items():
        wanted = {
            reference.drive: None
            for reference in references(expression)
            if requires_running(expression, reference.drive)
        }
        for drive in interlocks[id].drives:
            required.setdefault(drive, []).extend((other, id) for other in wanted)
    reported: set[frozenset[str]] = set()
    for drive in required:
        ring = _shortest_cycle(drive, required)
        if ring and frozenset(ring) not in reported:
            reported.add(frozenset(ring))
            last = next(id for other, id in required[ring[-1]] if other == drive)
            yield issue("cycle", ("interlock", last, "require"), " -> ".join([*ring, drive]))


def _shortest_cycle(start: str, required: Mapping[str, list[tuple[str, str]]]) -> list[str] | None:
    """Return the shortest cycle of required drives from ``start`` back to itself."""
    paths = [[start]]
    visited = {start}
    while paths:
        path = paths.pop(0)
        for other, _ in required.get(path[-1], ()):
            if other == start:
                return path
            if other not in visited:
                visited.add(other)
                paths.append([*path, other])
    return None


_THRESHOLD_KINDS = ("above", "below")
_SIGNAL_KINDS = (*_THRESHOLD_KINDS, "stale")


def alarm_issues(parsed: ParsedPlant) -> Iterator[Issue]:
    """Yield missing and unused keys, signals that are not polled, and thresholds that can't be crossed."""
    for id, alarm in parsed.file.alarm.items():
        path = ("alarm", id)
        yield from _check_keys(alarm, path)
        if alarm.signal is not None and alarm.kind in _SIGNAL_KINDS:
            yield from _check_alarm_signal(parsed, alarm, alarm.signal, path)


def _check_keys(alarm: AlarmTable, path: KeyPath) -> Iterator[Issue]:
    """Yield keys that a kind of alarm needs, and keys that it does not use."""
    for name in ("signal", "threshold") if alarm.kind in _THRESHOLD_KINDS else ():
        if getattr(alarm, name) is None:
            yield issue("alarm_needs", (*path, "kind"), alarm.kind, name=name)
    idle = () if alarm.kind in _THRESHOLD_KINDS else ("threshold", "hysteresis")
    for name in (*idle, *(() if alarm.kind in _SIGNAL_KINDS else ("signal",))):
        if name in alarm.model_fields_set:
            yield issue("alarm_idle", (*path, name), getattr(alarm, name), kind=alarm.kind)


def _check_alarm_signal(parsed: ParsedPlant, alarm: AlarmTable, name: str, path: KeyPath) -> Iterator[Issue]:
    drives = [drive for drive in alarm_drives(parsed, alarm) if drive in parsed.profiles]
    if not alarm.drives and not drives:
        known = {signal for id, table in parsed.file.drive.items() for signal in polled_signals(parsed, id, table)}
        yield issue(
            "alarm_signal",
            (*path, "signal"),
            name,
            drive=bilingual_text("plant_config.any_drive"),
            **suggestions(name, sorted(known)),
        )
        return
    signals: dict[str, Signal] = {}
    for drive in drives:
        polled = polled_signals(parsed, drive, parsed.file.drive[drive])
        if name not in polled:
            yield issue("alarm_signal", (*path, "signal"), name, drive=drive, **suggestions(name, polled))
        elif name in parsed.profiles[drive].signals:
            signals[drive] = parsed.profiles[drive].signals[name]
    units = {signal.unit: drive for drive, signal in signals.items()}
    if alarm.kind in _THRESHOLD_KINDS and len(units) > 1:
        shown = tuple(f"{drive}: {unit or '-'}" for unit, drive in units.items())
        yield issue("alarm_units", (*path, "signal"), name, units=shown)
    elif alarm.threshold is not None:
        yield from _check_threshold(alarm, alarm.threshold, signals, path)


def _check_threshold(alarm: AlarmTable, threshold: float, signals: dict[str, Signal], path: KeyPath) -> Iterator[Issue]:
    """Yield a threshold that can never be crossed, and a hysteresis that never clears."""
    for drive, signal in signals.items():
        low, high = signal.minimum, signal.maximum
        bounds = f"{_bound_text(low)} … {_bound_text(high)} {signal.unit}".rstrip()
        if _outside(threshold, low, high):
            yield issue("alarm_threshold", (*path, "threshold"), threshold, drive=drive, range=bounds)
            return
        back = threshold - alarm.hysteresis if alarm.kind == "above" else threshold + alarm.hysteresis
        if alarm.hysteresis and _outside(back, low, high):
            hysteresis = alarm.hysteresis
            yield issue(
                "alarm_hysteresis", (*path, "hysteresis"), hysteresis, back=f"{back:g}", drive=drive, range=bounds
            )
            return


def _outside(value: float, low: float | None, high: float | None) -> bool:
    return (low is not None and value < low) or (high is not None and value > high)


def _bound_text(bound: float | None) -> str:
    return "-" if bound is None else f"{bound:g}"
