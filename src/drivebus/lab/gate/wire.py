"""The gate campaign's second part: strangers and doubles are heard on the wire itself, by the real bus.

In the first part the evidence is chosen; here it comes from bytes: requests of another master, and two answers where
one was asked for. Removing the station, adding it again, losing and opening the port do not make them unheard.
"""

from __future__ import annotations

from collections import deque
from typing import Any, Self

from drivebus.lab.gate import question as gate_question
from drivebus.lab.gate.question import Shown, good
from drivebus.lab.gate.subject import OURS, Subject, reply_to
from drivebus.lab.gate.world import World

STRANGER_S, DOUBLE_S = 60.0, 600.0
"""A second master is over after a minute of peace (G18), two drives at one address after ten (F15)."""
TWICE = 2
"""Once may be a slip; two make a second master, or a second drive."""

ELSEWHERE = frozenset({"raw", "latch", "release", "hang", "stop", "sleep", "wish"})
"""What the first part tries."""

SILENCE_TICKS = 3
"""The bus looks at what it heard once the line is silent: the gap, after the last bit of a frame of its own."""


class WireWorld(World):
    """A world in which somebody else may be on the line."""

    __slots__ = ("doubles", "strangers")

    def __init__(self, subject: Subject) -> None:
        super().__init__(subject)
        self.strangers: tuple[float, ...] = ()
        self.doubles: tuple[float, ...] = ()
        self._unmeasured()

    def copy(self) -> Self:
        made = super().copy()
        made.strangers, made.doubles = self.strangers, self.doubles
        return made

    def name(self) -> tuple[Any, ...]:
        core, station = self.core, self.core.stations.get(OURS)
        owed = (max(0.0, station.asked_at - self.now), station.answered) if station is not None else None
        heard = core.listener.foreign_master(self.now), len(station.second_answers) if station is not None else 0
        doubted = self.now - station.doubted_at <= 5.0 if station is not None else False
        return (*super().name(), heard, doubted, owed, self.lacks())

    def _add(self, rest: str) -> None:
        super()._add(rest)
        self._unmeasured()

    def _unmeasured(self) -> None:
        """How long a station that answers twice is listened to follows its reply times, which all states share."""
        self.core.stations[OURS].counters.recent = deque(maxlen=0)

    def lacks(self) -> tuple[str, ...]:
        """What the line itself forbids now."""
        strangers = sum(self.now - at <= STRANGER_S for at in self.strangers[-TWICE:]) >= TWICE
        doubles = sum(self.now - at <= DOUBLE_S for at in self.doubles[-TWICE:]) >= TWICE
        return ("no foreign master",) * strangers + ("no duplicate",) * doubles

    def events(self, slots: int, rare: bool) -> list[str]:
        found = [one for one in super().events(slots, False) if one not in ELSEWHERE]
        flight = self.core.flight
        if flight is None and self.core.is_open and OURS in self.core.stations:
            found.append("stranger")
        elif flight is not None and flight.job.token == "read" and "reply" in found:
            found.append("double")
        found += ["command"] * (OURS in self.core.stations and not self.leaves)
        return found + ["peace"] * bool(self.strangers or self.doubles)

    def happens(self, event: str) -> Self:
        if event not in ("stranger", "double", "peace", "command"):
            return super().happens(event)
        self.subject.shadow = self.shadow
        if event == "command":
            self._command()
        elif event == "peace":
            self.now += STRANGER_S + 1.0 if self.strangers else DOUBLE_S + 1.0
            self.strangers = ()
            self.doubles = tuple(at for at in self.doubles if self.now - at <= DOUBLE_S)
        else:
            self._heard(event)
        self.shadow = self.subject.shadow
        return self

    def _command(self) -> None:
        """Wished for, asked for and submitted at once, with everything in order but for the line."""
        self._make("")
        assert self.command is not None
        shown = Shown(state=good(self.subject).state, foreign=None, duplicate=None)
        seen, lacks = gate_question.around(self.core, self.now), self.lacks()
        if gate_question.ask(self.subject, self.command, 0, seen, shown) is not None:
            self.grant(0, shown, lacks)._submit("")
        elif lacks:
            self.seen.denied.append(lacks)
        else:
            self.seen.bad.append("refused with everything in order")
        self.command = self.wish = self.held = None

    def _heard(self, event: str) -> None:
        """Bytes, the silence after them, and the bus's chance to look at them."""
        flight = self.core.flight
        if flight is not None:
            data = 2 * reply_to(flight.job.request, flight.job.codec)
        else:
            data = self.subject.other.codec.encode_request(self.subject.other.plain_read())
        self._perform(self._touched().received(data, self.now))
        for _ in range(SILENCE_TICKS):
            self.now += self.subject.grid.tick_s
            self._perform(self._touched().woke(self.now))
            if not self.core.listener.buffer:
                break
        if event == "double":
            self.doubles = (*self.doubles[-1:], self.now)
        else:
            self.strangers = (*self.strangers[-1:], self.now)
