"""Keeps a drive's readings current by polls on its bus, and says when they are not (I4, G17). A thin shell."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from types import TracebackType
from typing import Any

from drivebus.bus import Bus, Poll, Watch
from drivebus.drives.book import Book, Facts
from drivebus.drives.dialect import Dialect, fault_of
from drivebus.drives.state import UNKNOWN, DriveState, DriveStatus, Verdict
from drivebus.drives.statusread import complete
from drivebus.message import Answer
from drivebus.reading import Reading

FAULT_PERIOD_S = 1.0
LEAST_FRESH_S = 1.0
PERIODS = 3.0
"""Ruling 12: good for max(3 x period, 1 s) + timeout."""


def wanted(dialect: Dialect, names: tuple[str, ...], fastest_s: float = 0.0) -> list[Poll]:
    """The polls that keep these signals, the state and the fault current, none more often than every ``fastest_s``."""
    polls = dialect.polls(names)
    known = {request for request, _ in polls}
    faults = tuple((request, FAULT_PERIOD_S) for request in dialect.fault_reads() if request not in known)
    return [Poll(request, max(period, fastest_s)) for request, period in (*polls, *faults)]


class Monitor:
    """The newest status of one drive. ``close`` (or the end of the block) ends its polls."""

    def __init__(
        self,
        bus: Bus,
        dialect: Dialect,
        signals: Iterable[str] | None = None,
        on_change: Callable[[DriveStatus], None] | None = None,
        period_s: float = 0.0,
        readers: list[Callable[[Answer], None]] | None = None,
    ) -> None:
        """``readers``: whom the drive tells of every read of its commands; this one is among them until closed."""
        self._bus, self._dialect = bus, dialect
        self._names = tuple(dialect.profile.signals if signals is None else signals)
        self._book = Book()
        self._verdict: Verdict = UNKNOWN
        self._verdict_at: float | None = None
        self._on_change = on_change
        self.last_error: Exception | None = None
        self._fresh_s: dict[str, float] = {}
        polls = wanted(dialect, self._names, period_s)
        self._limits: dict[Any, float] = {poll.request: self._limit(poll) for poll in polls}
        self._state_fresh_s = min(self._limits.values(), default=LEAST_FRESH_S)
        self._watch: Watch | None = bus.watch(dialect.address, polls, self._heard)
        self._readers = [] if readers is None else readers
        self._readers.append(self._hear)

    def _limit(self, poll: Poll) -> float:
        timing, codec = self._dialect.link.timing, self._dialect.codec
        timeout = timing.timeout_s(self._bus.line, codec.largest_reply(poll.request))
        return max(PERIODS * poll.period_s, LEAST_FRESH_S) + timeout

    def _heard(self, answer: Answer) -> None:
        self.last_error = answer.error
        if answer.error is None and answer.reply is not None:
            self._take(answer)
        self._changed()

    def _changed(self) -> None:
        if self._on_change is not None:
            self._on_change(self.status())

    def _hear(self, answer: Answer) -> None:
        """A command's own read: of what the polls bring, it is as good as theirs, and newer. So the outcome of a stop
        and the state that is shown beside it are one.
        """
        if self._watch is not None:
            facts = self._dialect.facts(answer.ask.request, answer.reply, answer.received_at)
            self._note({name: reading for name, reading in facts.items() if self._is_news(name, reading)})
            self._changed()

    def _is_news(self, name: str, reading: Reading) -> bool:
        known = self._book.latest.get(name)
        return known is not None and known.source_time is not None and (reading.source_time or 0.0) > known.source_time

    def _take(self, answer: Answer) -> None:
        request = answer.ask.request
        facts = self._dialect.facts(request, answer.reply, answer.received_at)
        limit = self._limits.get(request, LEAST_FRESH_S)
        self._fresh_s |= {name: limit for name in facts if name in self._names or name not in self._fresh_s}
        self._note(facts)

    def _note(self, facts: Facts) -> None:
        self._book.note(facts)
        verdict = self._dialect.judge(self._book)
        if verdict is not None:
            self._verdict = verdict
            self._verdict_at = self._book.time_of(*self._dialect.state_names)

    def status(self) -> DriveStatus:
        """The newest readings; what is too old is marked bad, and an old state is UNKNOWN."""
        now = self._bus.now()
        verdict = self._current(now)
        aged = self._book.aged(now, self._fresh_s)
        readings = {name: reading for name, reading in aged.items() if name in self._dialect.profile.signals}
        code = verdict.fault_code
        fault = None if code is None else fault_of(self._dialect.profile, code)
        found = DriveStatus(verdict.state, verdict.direction, fault, readings, verdict.reason, self._verdict_at)
        return complete(self._dialect, found, self._names)

    def _current(self, now: float) -> Verdict:
        if not self._dialect.can_tell:
            return Verdict(DriveState.UNKNOWN, reason="drives.no_run_status")
        if self._verdict_at is None:
            return UNKNOWN
        if now - self._verdict_at > self._state_fresh_s:
            return Verdict(DriveState.UNKNOWN, reason="drives.stale")
        return self._verdict

    def close(self) -> None:
        """No more polls. Idempotent."""
        if self._watch is not None:
            self._watch.cancel()
            self._watch = None
            self._readers.remove(self._hear)

    def __enter__(self) -> Monitor:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
