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

from drivebus.bus.prepared_request import EncodedRequest, PreparedRequest
from drivebus.bus.statistics import Counters
from drivebus.protocols.codec import BusRequest, RequestPriority, StationConfig

if TYPE_CHECKING:
    from drivebus.bus.poll_schedule import PreparedPoll
    from drivebus.serial_settings import SerialSettings

MIN_PROBE_INTERVAL_S = 1.0
MAX_PROBE_INTERVAL_S = 55.0
"""G08: found within 60 s also by a probe that waits for its turn, on the slowest line."""
DUPLICATE_REPLIES_REQUIRED = 2
DUPLICATE_WINDOW_S = 600.0
"""So many second answers within ten minutes mean two drives at one address (F15): real ones show it at each read."""
MAX_DUPLICATE_WAIT_S = 0.25
"""A station that answers twice is listened to for no longer than this, a quarter of what a frame waits for silence."""
PROBE_BUS_SHARE = 0.1
"""Silent stations together get at most this share of the bus (RELIABILITY 5.2, G08)."""


class Presence(StrEnum):
    """Is somebody there?"""

    NEVER_SEEN = "never_seen"
    ONLINE = "online"
    OFFLINE = "silent"


@dataclass(frozen=True, slots=True)
class StationHealth:
    """How far a station and its line can be trusted now. ``last_heard_at`` is monotonic seconds."""

    presence: Presence
    suspect: bool
    """A reply is overdue: data wait for a fence."""
    foreign_master: bool
    """Somebody else sends requests on this line (F14): for the whole bus."""
    duplicate_address: bool
    """Two drives seem to answer to this address (F15)."""
    error_rate: float
    """Share of the last 5 minutes' transactions with this station that failed, 0 to 1."""
    damaged: int
    """How many of them came and were spoiled, and their share, 0 to 1 (link-quality gate)."""
    damage_rate: float
    last_reply_at: float | None


class Station:
    """One registered address and its state."""

    __slots__ = (
        "address",
        "codec",
        "config",
        "counters",
        "dead",
        "duplicate_reply_times",
        "encode_cache",
        "gap_s",
        "last_reply_at",
        "last_request",
        "last_request_answered",
        "last_request_sent_at",
        "next_probe_at",
        "pending_sync_probe",
        "probe_backoff_s",
        "quarantined_until",
        "seen",
        "start_inhibited",
        "stop_epoch",
        "suspect",
        "suspect_since",
        "suspended_polls",
        "sync_probe_count",
        "sync_rejections",
        "unanswered_requests",
    )

    def __init__(self, config: StationConfig, settings: SerialSettings) -> None:
        self.config = config
        self.address = config.address
        self.codec = config.codec
        self.gap_s = config.timing.gap_s(settings)
        self.stop_epoch = 0
        self.start_inhibited = False
        self.seen = False
        self.dead = False
        self.suspect = False
        self.quarantined_until = 0.0
        self.suspect_since = float("-inf")
        self.probe_backoff_s = 0.0
        self.next_probe_at = 0.0
        self.sync_probe_count = 0
        self.sync_rejections = 0
        """Fences in a row that were answered with a refusal."""
        self.pending_sync_probe: PreparedRequest | None = None
        self.unanswered_requests: list[tuple[float, PreparedRequest]] = []
        """Questions without an answer that was believed, and until when theirs may still come."""
        self.last_request: PreparedRequest | None = None
        """The last request sent: what an unsolicited frame may be the answer to."""
        self.last_request_answered = False
        """Its last request brought an answer's worth of bytes, believed or not."""
        self.last_request_sent_at = 0.0
        """When its last bit was out."""
        self.suspended_polls: list[PreparedPoll] = []
        """Polls that wait until it answers again."""
        self.last_reply_at: float | None = None
        self.duplicate_reply_times: list[float] = []
        self.counters = Counters()
        self.encode_cache: dict[Any, EncodedRequest] = {}

    def inherit(self, gone: Station) -> None:
        """The same address again: what forbade the one before to move forbids this one too (6.5, F15, link quality)."""
        self.stop_epoch, self.start_inhibited = gone.stop_epoch, gone.start_inhibited
        self.duplicate_reply_times = gone.duplicate_reply_times
        self.counters.error_window = gone.counters.error_window

    @property
    def presence(self) -> Presence:
        if not self.seen:
            return Presence.NEVER_SEEN
        return Presence.OFFLINE if self.dead else Presence.ONLINE

    def sync_probe(self, settings: SerialSettings) -> PreparedRequest:
        """The fence that is to be sent next; the same one until it was sent."""
        if self.pending_sync_probe is None:
            ask = BusRequest(self.address, self.config.sync_request(self.sync_probe_count), RequestPriority.PROBE)
            self.sync_probe_count += 1
            self.pending_sync_probe = PreparedRequest(ask, None, self, settings, is_sync_probe=True)
        return self.pending_sync_probe

    def mark_suspect(self, now: float) -> None:
        """A reply may still be on its way: quarantine from ``now``."""
        self.suspect = True
        self.suspect_since = now
        self.quarantined_until = max(self.quarantined_until, now + self.config.timing.max_reply_lateness_s)

    def record_duplicate_reply(self, now: float) -> None:
        """A second answer came where one was asked for."""
        self.duplicate_reply_times[:] = [
            *self.duplicate_reply_times[1 - DUPLICATE_REPLIES_REQUIRED :],
            now,
        ]  # its follower's too

    def has_duplicate_address(self, now: float, replies_required: int = DUPLICATE_REPLIES_REQUIRED) -> bool:
        """Do two drives seem to answer to this address (F15)?"""
        recent = [at for at in self.duplicate_reply_times if now - at <= DUPLICATE_WINDOW_S]
        return len(recent) >= replies_required

    def next_allowed_at(self, now: float) -> float:
        """When it may be asked again, as it has answered twice: not before the answer to its last request has had its
        time, whatever was taken for it. Else that one would be taken for the next, and so on for ever (F01, F15)."""
        if now - self.duplicate_reply_times[-1] > DUPLICATE_WINDOW_S:
            return 0.0
        return self.last_request_sent_at + min(max(self.counters.reply_times_s, default=0.0), MAX_DUPLICATE_WAIT_S)

    def mark_offline(self, now: float) -> None:
        """It did not answer its fence (or never answered at all): probe it with a growing pause, 1 to 55 s."""
        self.dead = True
        self.probe_backoff_s = min(MAX_PROBE_INTERVAL_S, max(MIN_PROBE_INTERVAL_S, 2 * self.probe_backoff_s))
        self.next_probe_at = now + self.probe_backoff_s

    def mark_online(self, *, verified: bool) -> None:
        """Its fence was answered. Not ``really``: by what might be our own echo, so it may be asked, no more."""
        self.suspect = self.dead = False
        self.sync_rejections = 0
        if verified:
            self.seen = True
            self.probe_backoff_s = 0.0

    def sync_due_at(self, budget_at: float) -> float:
        """When its fence may be sent without anybody waiting for it."""
        return max(self.next_probe_at, budget_at, self.quarantined_until) if self.dead else self.quarantined_until


class ProbeBudget:
    """Keeps what silent stations cost to their share of the bus."""

    __slots__ = ("allowed_at",)

    def __init__(self) -> None:
        self.allowed_at = 0.0

    def spend(self, cost_s: float, now: float) -> None:
        """A probe took ``cost_s`` of bus time up to ``now``: the living get nine times that first."""
        self.allowed_at = now + cost_s * (1.0 / PROBE_BUS_SHARE - 1.0)
