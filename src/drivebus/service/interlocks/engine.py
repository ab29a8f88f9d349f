"""Interlock engine: whether each interlock holds, since when not, and what it blocks. Pure; ``now`` is an argument.

An interlock that does not hold blocks every start of its drives at once. One whose action is ``stop`` trips when it has
not held for ``delay_s``, and is reset as soon as it holds; no drive is started by that. After the start of the service,
and after a reload where it reads a drive whose polls have started again, an interlock whose values are not known yet
trips only after ``FIRST_POLL_GRACE_S``, so that no drive is stopped merely because it was not polled yet; one that is
known not to hold trips at once.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from drivebus.service.config.model import InterlockAction, InterlockConfig, title_of
from drivebus.service.interlocks.evaluation import ValueLookup, compare, evaluate
from drivebus.service.interlocks.expression import (
    STATE_NAME,
    Comparison,
    Expression,
    Operand,
    SignalReference,
    comparisons,
    parse,
    references,
)
from drivebus.service.live.views import DriveView
from drivebus.values import Quality, Text, bilingual_text

FIRST_POLL_GRACE_S = 10.0
"""Time in which a slow bus polls every drive once."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Violation:
    """Interlock that does not hold, with the reasons."""

    config: InterlockConfig
    since_s: float
    """Monotonic second of the first evaluation at which it did not hold."""
    tripped: bool
    """Whether it has not held for its delay; an interlock with the action ``stop`` then stops its drives."""
    reasons: tuple[Text, ...]
    """Each comparison that does not hold, with the value found."""

    @property
    def message_params(self) -> dict[str, Any]:
        """Parameters of the sentence ``interlocks.violated``; ``interlock`` and ``require`` are for programs."""
        why, title = Text.join(self.reasons, "clauses"), title_of(self.config)
        return {"interlock": self.config.id, "require": self.config.require, "title": title, "why": why}


@dataclass(slots=True)
class _InterlockState:
    config: InterlockConfig
    expression: Expression
    was_known: bool = False
    """Whether its result was known since the start, and since the polls of a drive that it reads have started again."""
    violation: Violation | None = None
    evaluated: bool = False
    """Whether it was evaluated since the start, and since those polls have started again; else it blocks starts."""


class InterlockEngine:
    """Interlocks of a plant."""

    def __init__(self, settings: Iterable[InterlockConfig]) -> None:
        """Parse the expressions. Raises ConfigurationError for an invalid one."""
        self._states = {setting.id: _InterlockState(setting, parse(setting.require)) for setting in settings}

    def replace(self, settings: Iterable[InterlockConfig], unread_drives: Collection[str] = ()) -> None:
        """Apply a configuration; unchanged interlocks keep their state. Raises as the constructor does.

        One that reads a drive of ``unread_drives``, whose polls start again, blocks starts until it is evaluated again,
        because the values may be of another motor.
        """
        # ``was_known``: for an interlock that reads no such drive, an unknown value is a lost one.
        new = {setting.id: _InterlockState(setting, parse(setting.require), was_known=True) for setting in settings}
        same = {id: old for id, old in self._states.items() if id in new and old.config == new[id].config}
        self._states = new | same
        for state in self._states.values():
            if any(reference.drive in unread_drives for reference in references(state.expression)):
                state.evaluated = state.was_known = False

    def evaluate(self, views: Mapping[str, DriveView], now: float) -> list[tuple[str, bool]]:
        """Evaluate every interlock at ``now``, in monotonic seconds, and return the edges.

        An edge is an id with False (it tripped now) or True (it holds again after a trip).
        """
        edges = [(id, self._evaluate(state, views, now)) for id, state in self._states.items()]
        return [(id, edge) for id, edge in edges if edge is not None]

    def _evaluate(self, state: _InterlockState, views: Mapping[str, DriveView], now: float) -> bool | None:
        lookup = value_lookup(views)
        certain = evaluate(state.expression, lookup)
        state.evaluated = True
        state.was_known = state.was_known or certain is not None
        before = state.violation
        was_tripped = before is not None and before.tripped
        if certain:
            state.violation = None
            return True if was_tripped else None
        since_s = now if before is None else before.since_s
        tripped = was_tripped or self._should_trip(state, since_s, now)
        reasons = tuple(unmet_reasons(state.expression, lookup))
        state.violation = Violation(config=state.config, since_s=since_s, tripped=tripped, reasons=reasons)
        return False if tripped and not was_tripped else None

    def _should_trip(self, state: _InterlockState, since_s: float, now: float) -> bool:
        if not state.was_known and now - since_s < FIRST_POLL_GRACE_S:
            return False
        return now - since_s >= state.config.delay_s

    def violations(self, drive: str) -> list[Violation]:
        """Return every interlock of a drive that does not hold, whatever its action; each blocks a start.

        An interlock counts as violated until its first evaluation, also after a reload.
        """
        states = [state for state in self._states.values() if drive in state.config.drives]
        reasons = (bilingual_text("interlocks.not_looked"),)
        new = [
            Violation(config=state.config, since_s=0.0, tripped=False, reasons=reasons)
            for state in states
            if not state.evaluated
        ]
        return new + [state.violation for state in states if state.evaluated and state.violation is not None]

    def tripped_stops(self, drive: str) -> list[InterlockConfig]:
        """Return the tripped interlocks with the action ``stop``: this drive must not run until they hold."""
        stop = InterlockAction.STOP
        return [found.config for found in self.violations(drive) if found.tripped and found.config.action is stop]


def value_lookup(views: Mapping[str, DriveView]) -> ValueLookup:
    """Return a lookup of the values of good quality in these views."""

    def lookup(drive: str, name: str) -> tuple[float | str, str] | None:
        view = views.get(drive)
        if view is None:
            return None
        if name == STATE_NAME:
            return (view.state, "") if view.state != "unknown" else None
        signal = view.signals.get(name)
        good = signal is not None and signal.quality is Quality.GOOD and isinstance(signal.value, int | float)
        return (signal.value, signal.unit) if good else None  # type: ignore[union-attr,return-value]

    return lookup


def unmet_reasons(expression: Expression, lookup: ValueLookup) -> list[Text]:
    """Return each comparison that does not certainly hold with the value found; all where a ``not`` decides."""
    unmet = [comparison for comparison in comparisons(expression) if not compare(comparison, lookup)]
    return [_comparison_text(comparison, lookup) for comparison in unmet or comparisons(expression)]


def _comparison_text(comparison: Comparison, lookup: ValueLookup) -> Text:
    references = [side for side in (comparison.left, comparison.right) if isinstance(side, SignalReference)]
    values = [_operand_text(side, lookup) for side in references]
    return bilingual_text("interlocks.reason", require=str(comparison), found=Text.join(values, "items"))


def _operand_text(operand: Operand, lookup: ValueLookup) -> Text:
    assert isinstance(operand, SignalReference)
    value = lookup(operand.drive, operand.name)
    if value is None:
        return bilingual_text("interlocks.not_good", name=str(operand))
    number, unit = value
    shown = f"{number:g} {unit}".rstrip() if not isinstance(number, str) else number
    return bilingual_text("interlocks.found", name=str(operand), value=shown)
