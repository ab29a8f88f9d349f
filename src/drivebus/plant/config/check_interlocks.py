"""Interlocks before they run: expressions that can be read, names, units, and no drive that waits for itself."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from difflib import get_close_matches
from typing import Any

from drivebus.errors import ConfigurationError
from drivebus.plant.config.build import polled
from drivebus.plant.config.check_buses import said
from drivebus.plant.config.check_drives import near
from drivebus.plant.config.draft import Draft
from drivebus.plant.config.schema import InterlockTable
from drivebus.plant.evaluation import UNITS, needs
from drivebus.plant.expression import (
    STATE,
    WORDS,
    Comparison,
    Expression,
    Number,
    Operand,
    Reference,
    Word,
    comparisons,
    parse,
    references,
)
from drivebus.profiles.complaint import Path, Problem, problem


def problems(draft: Draft) -> Iterator[Problem]:
    read: dict[str, Expression] = {}
    for id, interlock in draft.file.interlock.items():
        path = ("interlock", id, "require")
        try:
            read[id] = parse(interlock.require)
        except ConfigurationError as error:
            yield problem("expression", path, interlock.require, why=said(error))
            continue
        yield from _names(draft, read[id], path)
        for comparison in comparisons(read[id]):
            yield from _sides(draft, comparison, path)
    yield from _cycles({id: draft.file.interlock[id] for id in read}, read)


def _names(draft: Draft, expression: Expression, path: Path) -> Iterator[Problem]:
    known = draft.known("drive")
    for one in references(expression):
        if one.drive not in known:
            yield problem("expression_drive", path, str(one), column=one.column, **near(one.drive, known))
        elif one.drive in draft.profiles:
            yield from _signal(draft, one, path)


def _signal(draft: Draft, one: Reference, path: Path) -> Iterator[Problem]:
    """It is asked for, and its values can be good."""
    profile = draft.profiles[one.drive]
    if one.name == STATE:
        if "status" not in profile.capabilities:
            yield problem("expression_no_state", path, str(one), column=one.column, model=profile.model)
        return
    asked = polled(draft, one.drive, draft.file.drive[one.drive])
    if one.name not in asked:
        names = near(one.name, list(dict.fromkeys((STATE, *asked))))
        yield problem("expression_signal", path, str(one), column=one.column, drive=one.drive, **names)
    elif profile.signals[one.name].uncertain:
        yield problem("expression_uncertain", path, str(one), column=one.column, model=profile.model)


def _sides(draft: Draft, comparison: Comparison, path: Path) -> Iterator[Problem]:
    """Both sides measure the same; states are compared with their words."""
    left, right = comparison.left, comparison.right
    if not any(isinstance(side, Reference) for side in (left, right)):
        yield problem("expression_constant", path, str(comparison), column=left.column)
        return
    for word in (side for side in (left, right) if isinstance(side, Word)):
        if word.text not in WORDS:
            close = ", ".join(get_close_matches(word.text, WORDS, 3, 0.5) or WORDS)
            yield problem("expression_state", path, word.text, column=word.column, known=", ".join(WORDS), near=close)
    if any(_is_state(side) for side in (left, right)) and comparison.sign not in ("==", "!="):
        yield problem("expression_order", path, str(comparison), column=left.column)
    for number in (side for side in (left, right) if isinstance(side, Number) and side.unit not in UNITS):
        units = ", ".join(unit for unit in UNITS if unit)
        yield problem("expression_unit", path, number.unit, column=number.column, units=units)
    yield from _measures(draft, comparison, path)


def _measures(draft: Draft, comparison: Comparison, path: Path) -> Iterator[Problem]:
    sides = [(side, measures(draft, side)) for side in (comparison.left, comparison.right)]
    if any(what is None for _, what in sides):
        return
    (left, one), (right, other) = sides
    if one != other:
        shown = str(comparison)
        units: dict[str, Any] = {"left": _with_unit(draft, left), "right": _with_unit(draft, right)}
        yield problem("expression_measures", path, shown, column=left.column, **units)


def _with_unit(draft: Draft, side: Operand) -> str:
    return str(side) if isinstance(side, Number | Word) else f"{side} [{_unit(draft, side) or '-'}]"


def _is_state(side: Operand) -> bool:
    return isinstance(side, Word) or (isinstance(side, Reference) and side.name == STATE)


def measures(draft: Draft, side: Operand) -> str | None:
    """What a side measures; None where that is not known (and has been complained about)."""
    if _is_state(side):
        return STATE
    unit = _unit(draft, side)
    return None if unit is None or unit not in UNITS else UNITS[unit][0]


def _unit(draft: Draft, side: Operand) -> str | None:
    if isinstance(side, Number):
        return side.unit
    if _is_state(side):
        return STATE
    assert isinstance(side, Reference)
    profile = draft.profiles.get(side.drive)
    signal = None if profile is None else profile.signals.get(side.name)
    return None if signal is None else signal.unit


def _cycles(interlocks: Mapping[str, InterlockTable], read: Mapping[str, Expression]) -> Iterator[Problem]:
    """Drives that could only start after each other: none of them ever would."""
    first: dict[str, list[tuple[str, str]]] = {}
    for id, expression in read.items():
        wanted = {one.drive: None for one in references(expression) if needs(expression, one.drive)}
        for drive in interlocks[id].drives:
            first.setdefault(drive, []).extend((other, id) for other in wanted)
    told: set[frozenset[str]] = set()
    for drive in first:
        ring = _ring(drive, first)
        if ring and frozenset(ring) not in told:
            told.add(frozenset(ring))
            last = next(id for other, id in first[ring[-1]] if other == drive)
            yield problem("cycle", ("interlock", last, "require"), " -> ".join([*ring, drive]))


def _ring(start: str, first: Mapping[str, list[tuple[str, str]]]) -> list[str] | None:
    """The shortest way from a drive over those that must run before it back to itself."""
    ways = [[start]]
    seen = {start}
    while ways:
        way = ways.pop(0)
        for other, _ in first.get(way[-1], ()):
            if other == start:
                return way
            if other not in seen:
                seen.add(other)
                ways.append([*way, other])
    return None
