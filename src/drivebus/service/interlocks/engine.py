"""Interlock engine: whether each interlock holds, since when not, and what it blocks. Pure; ``now`` is an argument.

An interlock that does not hold blocks every start of its drives at once. One whose action is ``stop`` trips when it has
not held for ``delay_s``, and is reset as soon as it holds; no drive is started by that. After the start of the service
an interlock whose values were never known trips only after ``STARTUP_GRACE_S``, so that a restart stops no drive merely
because it was not polled yet; one that is known not to hold trips at once.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from drivebus.profiles.diagnostics import bilingual_text
from drivebus.service.config.model import InterlockAction, InterlockConfig
from drivebus.service.interlocks.evaluation import ValueLookup, compare, evaluate
from drivebus.service.interlocks.expression import (
    STATE_NAME,
    Comparison,
    Expression,
    Operand,
    SignalReference,
    comparisons,
    parse,
)
from drivebus.service.live.views import DriveView
from drivebus.values import Quality, Text

STARTUP_GRACE_S = 10.0
"""Time in which a slow bus has polled every drive once."""


@dataclass(frozen=True, slots=True)
class Violation:
    """An interlock that does not hold, and the reasons."""

    config: InterlockConfig
    since_s: float
    """Monotonic second of the first evaluation at which it did not hold."""
    tripped: bool
    """It has not held for its delay: an interlock that stops has to stop now."""
    reasons: tuple[Text, ...]
    """Each comparison that is not met, with the value that was found."""

    @property
    def message_params(self) -> dict[str, Any]:
        """The places of the sentence ``interlocks.violated``, and which interlock it is for programs."""
        title, id = self.config.title, self.config.id
        why = Text("; ".join(one.en for one in self.reasons), "；".join(one.zh for one in self.reasons))
        names = Text(title.en or id, title.zh or id)
        return {"interlock": id, "require": self.config.require, "title": names, "why": why}


@dataclass(slots=True)
class _InterlockState:
    config: InterlockConfig
    expression: Expression
    was_known: bool = False
    """Its result was known once."""
    violation: Violation | None = None
    evaluated: bool = False
    """An interlock that was never evaluated blocks starts."""


class InterlockEngine:
    """Interlocks of a plant."""

    def __init__(self, settings: Iterable[InterlockConfig]) -> None:
        """Raises ConfigurationError for an expression that can't be read."""
        self._states = {one.id: _InterlockState(one, parse(one.require)) for one in settings}
        self._first_evaluation_at: float | None = None

    def replace(self, settings: Iterable[InterlockConfig]) -> None:
        """Other settings from now on; what has not changed keeps what it knows. Raises as the constructor does."""
        new = {one.id: _InterlockState(one, parse(one.require)) for one in settings}
        same = {id: old for id, old in self._states.items() if id in new and old.config == new[id].config}
        self._states = new | same

    def evaluate(self, views: Mapping[str, DriveView], now: float) -> list[tuple[str, bool]]:
        """Look at everything: the ids of what tripped (False) and of what holds again after it had (True)."""
        if self._first_evaluation_at is None:
            self._first_evaluation_at = now
        edges = [(id, self._evaluate_one(one, views, now)) for id, one in self._states.items()]
        return [(id, edge) for id, edge in edges if edge is not None]

    def _evaluate_one(self, one: _InterlockState, views: Mapping[str, DriveView], now: float) -> bool | None:
        look = value_lookup(views)
        certain = evaluate(one.expression, look)
        one.evaluated = True
        one.was_known = one.was_known or certain is not None
        before = one.violation
        was_tripped = before is not None and before.tripped
        if certain:
            one.violation = None
            return True if was_tripped else None
        since_s = now if before is None else before.since_s
        tripped = was_tripped or self._should_trip(one, since_s, now)
        one.violation = Violation(one.config, since_s, tripped, tuple(unmet_reasons(one.expression, look)))
        return False if tripped and not was_tripped else None

    def _should_trip(self, one: _InterlockState, since_s: float, now: float) -> bool:
        assert self._first_evaluation_at is not None
        if not one.was_known and now - self._first_evaluation_at < STARTUP_GRACE_S:
            return False
        return now - since_s >= one.config.delay_s

    def violations(self, drive: str) -> list[Violation]:
        """Why this drive may not be started now: every interlock of it that does not hold, whatever its action.

        Before ``evaluate`` has looked at it nothing is known to hold, also after a reload: it forbids.
        """
        mine = [one for one in self._states.values() if drive in one.config.drives]
        new = [
            Violation(one.config, 0.0, False, (bilingual_text("interlocks.not_looked"),))
            for one in mine
            if not one.evaluated
        ]
        return new + [one.violation for one in mine if one.evaluated and one.violation is not None]

    def tripped_stops(self, drive: str) -> list[InterlockConfig]:
        """Those that tripped and stop: this drive must not run, now and as long as they do not hold."""
        stop = InterlockAction.STOP
        return [one.config for one in self.violations(drive) if one.tripped and one.config.action is stop]


def value_lookup(views: Mapping[str, DriveView]) -> ValueLookup:
    """Values of a plant's drives, good ones only."""

    def look(drive: str, name: str) -> tuple[float | str, str] | None:
        view = views.get(drive)
        if view is None:
            return None
        if name == STATE_NAME:
            return (view.state, "") if view.state != "unknown" else None
        signal = view.signals.get(name)
        good = signal is not None and signal.quality is Quality.GOOD and isinstance(signal.value, int | float)
        return (signal.value, signal.unit) if good else None  # type: ignore[union-attr,return-value]

    return look


def unmet_reasons(expression: Expression, look: ValueLookup) -> list[Text]:
    """Each comparison that is not certainly met, with what was found; all of them where ``not`` turns one round."""
    unmet = [one for one in comparisons(expression) if not compare(one, look)]
    return [_comparison_text(one, look) for one in unmet or comparisons(expression)]


def _comparison_text(comparison: Comparison, look: ValueLookup) -> Text:
    found = [side for side in (comparison.left, comparison.right) if isinstance(side, SignalReference)]
    values = [_operand_text(side, look) for side in found]
    both_values = Text(", ".join(one.en for one in values), "、".join(one.zh for one in values))
    return bilingual_text("interlocks.reason", require=str(comparison), found=both_values)


def _operand_text(side: Operand, look: ValueLookup) -> Text:
    assert isinstance(side, SignalReference)
    value = look(side.drive, side.name)
    if value is None:
        return bilingual_text("interlocks.not_good", name=str(side))
    number, unit = value
    shown = f"{number:g} {unit}".rstrip() if not isinstance(number, str) else number
    return bilingual_text("interlocks.found", name=str(side), value=shown)
