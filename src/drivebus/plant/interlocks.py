"""Interlocks at work: what is required, whether it holds, since when, and what that forbids. Pure; ``now`` is given.

An interlock that does not hold forbids every start of its drives at once. One whose action is ``stop`` trips when it
has not held for ``delay_s``, and is met again as soon as it holds; nothing starts by itself then.

Right after the service began nothing has been read: what is unknown from the first look on trips only after
``GRACE_S``, so that a restart stops no drive merely because it has not asked yet (ruling 7). What is known not to hold
trips at once.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from drivebus.plant.evaluation import Look, compared, holds
from drivebus.plant.expression import STATE, Comparison, Expression, Operand, Reference, comparisons, parse
from drivebus.plant.model import InterlockAction, InterlockSetting
from drivebus.plant.view import DriveView
from drivebus.profiles.complaint import both
from drivebus.profiles.model import Text
from drivebus.reading import Quality

GRACE_S = 10.0
"""As long as a slow line may take to ask every drive once."""


@dataclass(frozen=True, slots=True)
class Violation:
    """An interlock that does not hold now, and why."""

    setting: InterlockSetting
    since_s: float
    """Monotonic second of the first look at which it did not hold."""
    tripped: bool
    """It has not held for its delay: an interlock that stops has to stop now."""
    reasons: tuple[Text, ...]
    """Each comparison that is not met, with the value that was found."""

    @property
    def params(self) -> dict[str, Any]:
        """The places of the sentence ``interlocks.violated``, and which interlock it is for programs."""
        title, id = self.setting.title, self.setting.id
        why = Text("; ".join(one.en for one in self.reasons), "；".join(one.zh for one in self.reasons))
        names = Text(title.en or id, title.zh or id)
        return {"interlock": id, "require": self.setting.require, "title": names, "why": why}


@dataclass(slots=True)
class _Watched:
    setting: InterlockSetting
    expression: Expression
    known: bool = False
    """It was certain once."""
    violation: Violation | None = None
    looked: bool = False
    """Nobody knows yet whether it holds: it forbids."""


class Interlocks:
    """All interlocks of a plant."""

    def __init__(self, settings: Iterable[InterlockSetting]) -> None:
        """Raises ConfigurationError for an expression that can't be read."""
        self._all = {one.id: _Watched(one, parse(one.require)) for one in settings}
        self._begun: float | None = None

    def replace(self, settings: Iterable[InterlockSetting]) -> None:
        """Other settings from now on; what has not changed keeps what it knows. Raises as the constructor does."""
        new = {one.id: _Watched(one, parse(one.require)) for one in settings}
        same = {id: old for id, old in self._all.items() if id in new and old.setting == new[id].setting}
        self._all = new | same

    def evaluate(self, views: Mapping[str, DriveView], now: float) -> list[tuple[str, bool]]:
        """Look at everything: the ids of what tripped (False) and of what holds again after it had (True)."""
        if self._begun is None:
            self._begun = now
        edges = [(id, self._looked(one, views, now)) for id, one in self._all.items()]
        return [(id, edge) for id, edge in edges if edge is not None]

    def _looked(self, one: _Watched, views: Mapping[str, DriveView], now: float) -> bool | None:
        look = look_in(views)
        certain = holds(one.expression, look)
        one.looked = True
        one.known = one.known or certain is not None
        before = one.violation
        was_tripped = before is not None and before.tripped
        if certain:
            one.violation = None
            return True if was_tripped else None
        since_s = now if before is None else before.since_s
        tripped = was_tripped or self._trips(one, since_s, now)
        one.violation = Violation(one.setting, since_s, tripped, tuple(reasons(one.expression, look)))
        return False if tripped and not was_tripped else None

    def _trips(self, one: _Watched, since_s: float, now: float) -> bool:
        assert self._begun is not None
        if not one.known and now - self._begun < GRACE_S:
            return False
        return now - since_s >= one.setting.delay_s

    def violations(self, drive: str) -> list[Violation]:
        """Why this drive may not be started now: every interlock of it that does not hold, whatever its action.

        Before ``evaluate`` has looked at it nothing is known to hold, also after a reload: it forbids.
        """
        mine = [one for one in self._all.values() if drive in one.setting.drives]
        new = [Violation(one.setting, 0.0, False, (both("interlocks.not_looked"),)) for one in mine if not one.looked]
        return new + [one.violation for one in mine if one.looked and one.violation is not None]

    def stopping(self, drive: str) -> list[InterlockSetting]:
        """Those that tripped and stop: this drive must not run, now and as long as they do not hold."""
        stop = InterlockAction.STOP
        return [one.setting for one in self.violations(drive) if one.tripped and one.setting.action is stop]


def look_in(views: Mapping[str, DriveView]) -> Look:
    """Values of a plant's drives, good ones only."""

    def look(drive: str, name: str) -> tuple[float | str, str] | None:
        view = views.get(drive)
        if view is None:
            return None
        if name == STATE:
            return (view.state, "") if view.state != "unknown" else None
        signal = view.signals.get(name)
        good = signal is not None and signal.quality is Quality.GOOD and isinstance(signal.value, int | float)
        return (signal.value, signal.unit) if good else None  # type: ignore[union-attr,return-value]

    return look


def reasons(expression: Expression, look: Look) -> list[Text]:
    """Each comparison that is not certainly met, with what was found; all of them where ``not`` turns one round."""
    unmet = [one for one in comparisons(expression) if not compared(one, look)]
    return [_reason(one, look) for one in unmet or comparisons(expression)]


def _reason(comparison: Comparison, look: Look) -> Text:
    found = [side for side in (comparison.left, comparison.right) if isinstance(side, Reference)]
    values = [_shown(side, look) for side in found]
    both_values = Text(", ".join(one.en for one in values), "、".join(one.zh for one in values))
    return both("interlocks.reason", require=str(comparison), found=both_values)


def _shown(side: Operand, look: Look) -> Text:
    assert isinstance(side, Reference)
    value = look(side.drive, side.name)
    if value is None:
        return both("interlocks.not_good", name=str(side))
    number, unit = value
    shown = f"{number:g} {unit}".rstrip() if not isinstance(number, str) else number
    return both("interlocks.found", name=str(side), value=shown)
