"""Parser of interlock expressions: ``pump-1.state == running and not (fan-1.temperature >= 80 °C)``.

Comparisons ``< <= > >= == !=`` of signals (``drive.signal``) with numbers that carry their unit, with each other, and
of ``drive.state`` with the word of a state; ``and``, ``or``, ``not``, parentheses. ``evaluation`` evaluates them.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import NoReturn

from drivebus import i18n
from drivebus.drives.state import DriveState
from drivebus.errors import ConfigurationError

STATE_NAME = "state"
"""Name of the state of a drive in expressions. It hides a signal of that name (VC660 has one)."""
STATE_WORDS = tuple(str(state) for state in DriveState if state is not DriveState.UNKNOWN)
"""States that an expression can require; an unknown state makes its comparison unknown."""
MAX_NESTING = 50
"""Greatest depth of nested parentheses and ``not``."""
_TOKEN = re.compile(
    r"(?P<reference>[a-z0-9][a-z0-9_-]*\.[a-z][a-z0-9_]*)|(?P<number>[+-]?[0-9]+(?:\.[0-9]+)?(?![0-9.]))"
    r"|(?P<operator><=|>=|==|!=|<|>)|(?P<paren>[()])|(?P<word>[A-Za-z_°℃%][A-Za-z0-9_·]*)",
)


@dataclass(frozen=True, slots=True)
class SignalReference:
    """A signal of a drive, or its ``state``."""

    drive: str
    name: str
    column: int

    def __str__(self) -> str:
        return f"{self.drive}.{self.name}"


@dataclass(frozen=True, slots=True)
class Quantity:
    """Number with its unit."""

    value: float
    unit: str
    column: int

    def __str__(self) -> str:
        return f"{self.value:g} {self.unit}".rstrip()


@dataclass(frozen=True, slots=True)
class StateLiteral:
    """Name of a drive's state, written in an expression."""

    text: str
    column: int

    def __str__(self) -> str:
        return self.text


Operand = SignalReference | Quantity | StateLiteral


@dataclass(frozen=True, slots=True)
class Comparison:
    """Comparison of two operands."""

    left: Operand
    operator: str
    right: Operand

    def __str__(self) -> str:
        return f"{self.left} {self.operator} {self.right}"


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
# --- parsing ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Token:
    kind: str
    text: str
    column: int
    """Counted from 1."""


@lru_cache(256)
def parse(text: str) -> Expression:
    """Return the expression of a text.

    Raises ConfigurationError ``expression.syntax``, ``.character`` or ``.deep``, each with its column from 1.
    """
    return _Parser(list(_tokens(text))).parse()


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
    """Recursive-descent parser; ``or`` binds weakest, then ``and``, then ``not``."""

    def __init__(self, tokens: list[_Token]) -> None:
        self._tokens = tokens
        self._position = 0
        self._depth = 0

    def parse(self) -> Expression:
        expression = self._or()
        if self._next.kind != "end":
            self._syntax_error("expression.expected_end")
        return expression

    @property
    def _next(self) -> _Token:
        return self._tokens[self._position]

    def _advance(self) -> _Token:
        self._position += 1
        return self._tokens[self._position - 1]

    def _syntax_error(self, expected: str) -> NoReturn:
        """Raise the error of an unexpected token; ``expected`` is an i18n key."""
        token = self._next
        token_text = token.text or _CatalogueText("expression.end")
        raise ConfigurationError(
            "expression.syntax", column=token.column, found=token_text, expected=_CatalogueText(expected)
        )

    def _or(self) -> Expression:
        parts = [self._and()]
        while self._next.kind == "or":
            self._advance()
            parts.append(self._and())
        return parts[0] if len(parts) == 1 else Or(tuple(parts))

    def _and(self) -> Expression:
        parts = [self._not()]
        while self._next.kind == "and":
            self._advance()
            parts.append(self._not())
        return parts[0] if len(parts) == 1 else And(tuple(parts))

    def _not(self) -> Expression:
        if self._next.kind == "not":
            return self._nested(self._negation)
        if self._next.text == "(":
            return self._nested(self._parenthesis)
        return self._comparison()

    def _nested(self, read: Callable[[], Expression]) -> Expression:
        if self._depth == MAX_NESTING:
            raise ConfigurationError("expression.deep", column=self._next.column, most=MAX_NESTING)
        self._depth += 1
        expression = read()
        self._depth -= 1
        return expression

    def _negation(self) -> Expression:
        self._advance()
        return Not(self._not())

    def _parenthesis(self) -> Expression:
        self._advance()
        expression = self._or()
        if self._next.text != ")":
            self._syntax_error("expression.expected_closing")
        self._advance()
        return expression

    def _comparison(self) -> Expression:
        left = self._operand()
        if self._next.kind != "operator":
            self._syntax_error("expression.expected_operator")
        return Comparison(left, self._advance().text, self._operand())

    def _operand(self) -> Operand:
        token = self._next
        if token.kind == "reference":
            self._advance()
            drive, _, name = token.text.partition(".")
            return SignalReference(drive, name, token.column)
        if token.kind == "number":
            self._advance()
            unit = self._advance().text if self._next.kind == "word" else ""
            return Quantity(float(token.text), unit, token.column)
        if token.kind != "word":
            self._syntax_error("expression.expected_value")
        self._advance()
        return StateLiteral(token.text, token.column)


class _CatalogueText:
    """Sentence of the catalogues, translated when it is shown."""

    def __init__(self, key: str) -> None:
        self._key = key

    def text(self, language: str) -> str:
        return i18n.text(self._key, language)


# --- contents ---------------------------------------------------------------------------------------------------


def comparisons(expression: Expression) -> Iterator[Comparison]:
    """Yield every comparison, from left to right."""
    if isinstance(expression, Comparison):
        yield expression
    elif isinstance(expression, Not):
        yield from comparisons(expression.inner)
    else:
        for part in expression.parts:
            yield from comparisons(part)


def references(expression: Expression) -> Iterator[SignalReference]:
    """Yield every signal and state that an expression refers to."""
    for comparison in comparisons(expression):
        yield from (side for side in (comparison.left, comparison.right) if isinstance(side, SignalReference))
