"""What an interlock requires, as a text: ``pump-1.state == running and not (fan-1.temperature >= 80 °C)``.

Comparisons ``< <= > >= == !=`` of signals (``drive.signal``) with numbers that carry their unit, with each other, and
of ``drive.state`` with a state's word; ``and``, ``or``, ``not``, parentheses. Pure: values come from a function.

A value that is not good makes its comparison neither true nor false but unknown, and what rests on it too, ``not``
included: only what certainly holds is True (fail safe).
"""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import NoReturn

from drivebus import i18n
from drivebus.drives.state import DriveState
from drivebus.errors import ConfigurationError

STATE = "state"
"""The name under which a drive's state is asked for; no signal's raw word (VC660 has one of that name)."""
WORDS = tuple(str(state) for state in DriveState if state is not DriveState.UNKNOWN)
"""States that can be required. An unknown one makes its comparison unknown, so it can't."""
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
DEEPEST = 50
"""Parentheses and ``not`` within each other."""
_COMPARE: Mapping[str, Callable[[float, float], bool]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "==": operator.eq,
    "!=": operator.ne,
}
_TOKEN = re.compile(
    r"(?P<reference>[a-z0-9][a-z0-9_-]*\.[a-z][a-z0-9_]*)|(?P<number>[+-]?[0-9]+(?:\.[0-9]+)?(?![0-9.]))"
    r"|(?P<operator><=|>=|==|!=|<|>)|(?P<paren>[()])|(?P<word>[A-Za-z_°℃%][A-Za-z0-9_·]*)",
)


@dataclass(frozen=True, slots=True)
class Reference:
    """A signal of a drive, or its ``state``."""

    drive: str
    name: str
    column: int

    def __str__(self) -> str:
        return f"{self.drive}.{self.name}"


@dataclass(frozen=True, slots=True)
class Number:
    value: float
    unit: str
    column: int

    def __str__(self) -> str:
        return f"{self.value:g} {self.unit}".rstrip()


@dataclass(frozen=True, slots=True)
class Word:
    """A state."""

    text: str
    column: int

    def __str__(self) -> str:
        return self.text


Operand = Reference | Number | Word


@dataclass(frozen=True, slots=True)
class Comparison:
    left: Operand
    sign: str
    right: Operand

    def __str__(self) -> str:
        return f"{self.left} {self.sign} {self.right}"


@dataclass(frozen=True, slots=True)
class Not:
    inner: Expression


@dataclass(frozen=True, slots=True)
class And:
    parts: tuple[Expression, ...]


@dataclass(frozen=True, slots=True)
class Or:
    parts: tuple[Expression, ...]


Expression = Comparison | Not | And | Or
Look = Callable[[str, str], tuple[float | str, str] | None]
"""Drive and name → value and unit; None where there is none that is good."""


# --- reading ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Token:
    kind: str
    text: str
    column: int
    """From 1."""


@lru_cache(256)
def parse(text: str) -> Expression:
    """Raises ConfigurationError ``expression.syntax``, ``.character`` or ``.deep``, each with its column from 1."""
    return _Parser(list(_tokens(text))).whole()


def _tokens(text: str) -> Iterator[_Token]:
    at = 0
    while at < len(text):
        if text[at].isspace():
            at += 1
            continue
        match = _TOKEN.match(text, at)
        if match is None:
            raise ConfigurationError("expression.character", column=at + 1, found=text[at])
        kind = str(match.lastgroup)
        if kind == "word" and match[0] in ("and", "or", "not"):
            kind = match[0]
        yield _Token(kind, match[0], at + 1)
        at = match.end()
    yield _Token("end", "", len(text) + 1)


class _Parser:
    """Recursive descent; ``or`` binds weakest, then ``and``, then ``not``."""

    def __init__(self, tokens: list[_Token]) -> None:
        self._tokens = tokens
        self._at = 0
        self._depth = 0

    def whole(self) -> Expression:
        found = self._or()
        if self._next.kind != "end":
            self._fail("expression.expected_end")
        return found

    @property
    def _next(self) -> _Token:
        return self._tokens[self._at]

    def _take(self) -> _Token:
        self._at += 1
        return self._tokens[self._at - 1]

    def _fail(self, expected: str) -> NoReturn:
        """``expected`` is an i18n key."""
        token = self._next
        found = token.text or _Said("expression.end")
        raise ConfigurationError("expression.syntax", column=token.column, found=found, expected=_Said(expected))

    def _or(self) -> Expression:
        parts = [self._and()]
        while self._next.kind == "or":
            self._take()
            parts.append(self._and())
        return parts[0] if len(parts) == 1 else Or(tuple(parts))

    def _and(self) -> Expression:
        parts = [self._not()]
        while self._next.kind == "and":
            self._take()
            parts.append(self._not())
        return parts[0] if len(parts) == 1 else And(tuple(parts))

    def _not(self) -> Expression:
        if self._next.kind == "not":
            return self._within(self._negation)
        if self._next.text == "(":
            return self._within(self._parenthesis)
        return self._comparison()

    def _within(self, read: Callable[[], Expression]) -> Expression:
        if self._depth == DEEPEST:
            raise ConfigurationError("expression.deep", column=self._next.column, most=DEEPEST)
        self._depth += 1
        found = read()
        self._depth -= 1
        return found

    def _negation(self) -> Expression:
        self._take()
        return Not(self._not())

    def _parenthesis(self) -> Expression:
        self._take()
        found = self._or()
        if self._next.text != ")":
            self._fail("expression.expected_closing")
        self._take()
        return found

    def _comparison(self) -> Expression:
        left = self._operand()
        if self._next.kind != "operator":
            self._fail("expression.expected_operator")
        return Comparison(left, self._take().text, self._operand())

    def _operand(self) -> Operand:
        token = self._next
        if token.kind == "reference":
            self._take()
            drive, _, name = token.text.partition(".")
            return Reference(drive, name, token.column)
        if token.kind == "number":
            self._take()
            unit = self._take().text if self._next.kind == "word" else ""
            return Number(float(token.text), unit, token.column)
        if token.kind != "word":
            self._fail("expression.expected_value")
        self._take()
        return Word(token.text, token.column)


class _Said:
    """A sentence of the catalogues that shows itself in the reader's language."""

    def __init__(self, key: str) -> None:
        self._key = key

    def text(self, language: str) -> str:
        return i18n.text(self._key, language)


# --- looking at it ----------------------------------------------------------------------------------------------


def comparisons(expression: Expression) -> Iterator[Comparison]:
    """Every comparison, from left to right."""
    if isinstance(expression, Comparison):
        yield expression
    elif isinstance(expression, Not):
        yield from comparisons(expression.inner)
    else:
        for part in expression.parts:
            yield from comparisons(part)


def references(expression: Expression) -> Iterator[Reference]:
    """Every signal and state that it looks at."""
    for comparison in comparisons(expression):
        yield from (side for side in (comparison.left, comparison.right) if isinstance(side, Reference))


def needs(expression: Expression, drive: str) -> bool:
    """It can't hold while this drive's output is off, whatever all other values are: the drive must run first."""
    return True not in _possible(expression, drive)


_EITHER = frozenset({True, False})


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


# --- working it out ---------------------------------------------------------------------------------------------


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
        return (one == other) is (comparison.sign == "==") if known else None
    if ANY not in (one_measures, other_measures) and one_measures != other_measures:
        return None
    return _COMPARE[comparison.sign](one, other)


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
