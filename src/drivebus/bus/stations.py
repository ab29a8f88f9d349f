"""What the bus knows of each station: is it there, can its replies be believed, when may it be asked. Pure.

    never seen ──answer──▶ online ──no reply──▶ suspect ──quarantine, then a fence answered──▶ online
        │                                          └──fence unanswered──▶ silent ──probe answered──▶ online
        └──no reply──▶ probed like a silent one, still never seen

Suspect (RELIABILITY 5.3): a reply may still be on its way, so nothing but stops goes there for the family's longest
lateness, and then a fence must be answered before any data count.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Any

from drivebus.bus.job import Job, Prepared
from drivebus.bus.statistics import Counters
from drivebus.message import Ask, Lane, StationLink

if TYPE_CHECKING:
    from drivebus.bus.planner import PollJob
    from drivebus.line import LineSettings

FIRST_PROBE_S = 1.0
LAST_PROBE_S = 55.0
"""G08: found within 60 s also by a probe that waits for its turn, on the slowest line."""
DUPLICATE_HINTS = 2
DUPLICATE_MEMORY_S = 600.0
"""So many second answers within ten minutes mean two drives at one address (F15): real ones show it at each read."""
LISTEN_S = 0.25
"""A station that answers twice is listened to for no longer than this, a quarter of what a frame waits for silence."""
PROBE_SHARE = 0.1
"""Silent stations together get at most this share of the bus (RELIABILITY 5.2, G08)."""


class Presence(StrEnum):
    """Is somebody there?"""

    NEVER_SEEN = "never_seen"
    ONLINE = "online"
    SILENT = "silent"


@dataclass(frozen=True, slots=True)
class Health:
    """How far a station and its line can be trusted now. ``last_heard_at`` is monotonic seconds."""

    presence: Presence
    suspect: bool
    """A reply is overdue: data wait for a fence."""
    foreign_master: bool
    """Somebody else sends requests on this line (F14): for the whole bus."""
    duplicate: bool
    """Two drives seem to answer to this address (F15)."""
    error_rate: float
    """Share of the last 5 minutes' transactions with this station that failed, 0 to 1."""
    damaged: int
    """How many of them came and were spoiled, and their share, 0 to 1 (link-quality gate)."""
    damage_rate: float
    last_heard_at: float | None


class Station:
    """One registered address and its state."""

    __slots__ = (
        "address", "answered", "asked", "asked_at", "backoff_s", "codec", "counters", "dead", "doubted_at",
        "fence_waiting", "fences", "gap_s", "generation", "last_heard_at", "latched", "link", "parked", "prepared",
        "probe_at", "quarantined_until", "refusals", "second_answers", "seen", "suspect", "unanswered",
    )  # fmt: skip

    def __init__(self, link: StationLink, line: LineSettings) -> None:
        self.link = link
        self.address = link.address
        self.codec = link.codec
        self.gap_s = link.timing.gap_s(line)
        self.generation = 0
        self.latched = False
        self.seen = False
        self.dead = False
        self.suspect = False
        self.quarantined_until = 0.0
        self.doubted_at = float("-inf")
        self.backoff_s = 0.0
        self.probe_at = 0.0
        self.fences = 0
        self.refusals = 0
        """Fences in a row that were answered with a refusal."""
        self.fence_waiting: Job | None = None
        self.unanswered: list[tuple[float, Job]] = []
        """Questions without an answer that was believed, and until when theirs may still come."""
        self.asked: Job | None = None
        """The last request sent: what an unsolicited frame may be the answer to."""
        self.answered = False
        """Its last request brought an answer's worth of bytes, believed or not."""
        self.asked_at = 0.0
        """When its last bit was out."""
        self.parked: list[PollJob] = []
        """Polls that wait until it answers again."""
        self.last_heard_at: float | None = None
        self.second_answers: list[float] = []
        self.counters = Counters()
        self.prepared: dict[Any, Prepared] = {}

    def follow(self, gone: Station) -> None:
        """The same address again: what forbade the one before to move forbids this one too (6.5, F15, link quality)."""
        self.generation, self.latched = gone.generation, gone.latched
        self.second_answers = gone.second_answers
        self.counters.window = gone.counters.window

    @property
    def presence(self) -> Presence:
        if not self.seen:
            return Presence.NEVER_SEEN
        return Presence.SILENT if self.dead else Presence.ONLINE

    def fence_job(self, line: LineSettings) -> Job:
        """The fence that is to be sent next; the same one until it was sent."""
        if self.fence_waiting is None:
            ask = Ask(self.address, self.link.fence(self.fences), Lane.PROBE)
            self.fences += 1
            self.fence_waiting = Job(ask, None, self, line, fence=True)
        return self.fence_waiting

    def doubt(self, now: float) -> None:
        """A reply may still be on its way: quarantine from ``now``."""
        self.suspect = True
        self.doubted_at = now
        self.quarantined_until = max(self.quarantined_until, now + self.link.timing.lateness_s)

    def answered_twice(self, now: float) -> None:
        """A second answer came where one was asked for."""
        self.second_answers[:] = [*self.second_answers[1 - DUPLICATE_HINTS :], now]  # its follower's too

    def duplicate(self, now: float, hints: int = DUPLICATE_HINTS) -> bool:
        """Do two drives seem to answer to this address (F15)?"""
        recent = [at for at in self.second_answers if now - at <= DUPLICATE_MEMORY_S]
        return len(recent) >= hints

    def again_at(self, now: float) -> float:
        """When it may be asked again, as it has answered twice: not before the answer to its last request has had its
        time, whatever was taken for it. Else that one would be taken for the next, and so on for ever (F01, F15)."""
        if now - self.second_answers[-1] > DUPLICATE_MEMORY_S:
            return 0.0
        return self.asked_at + min(max(self.counters.recent, default=0.0), LISTEN_S)

    def give_up(self, now: float) -> None:
        """It did not answer its fence (or never answered at all): probe it with a growing pause, 1 to 55 s."""
        self.dead = True
        self.backoff_s = min(LAST_PROBE_S, max(FIRST_PROBE_S, 2 * self.backoff_s))
        self.probe_at = now + self.backoff_s

    def revive(self, *, really: bool) -> None:
        """Its fence was answered. Not ``really``: by what might be our own echo, so it may be asked, no more."""
        self.suspect = self.dead = False
        self.refusals = 0
        if really:
            self.seen = True
            self.backoff_s = 0.0

    def fence_at(self, budget_at: float) -> float:
        """When its fence may be sent without anybody waiting for it."""
        return max(self.probe_at, budget_at, self.quarantined_until) if self.dead else self.quarantined_until


class ProbeBudget:
    """Keeps what silent stations cost to their share of the bus."""

    __slots__ = ("allowed_at",)

    def __init__(self) -> None:
        self.allowed_at = 0.0

    def spend(self, cost_s: float, now: float) -> None:
        """A probe took ``cost_s`` of bus time up to ``now``: the living get nine times that first."""
        self.allowed_at = now + cost_s * (1.0 / PROBE_SHARE - 1.0)
