"""A station on the bus: its state, when it may be addressed, and the encoding of its requests.

State of a station, by event (``-``: the event does not occur in this state and changes nothing):

    state              | REPLY  | SYNC_CONFIRMED | SYNC_UNVERIFIED | SUSPICION          | NO_CONTACT
    -------------------+--------+----------------+-----------------+--------------------+-----------
    NEVER_SEEN         | ONLINE | -              | -               | NEVER_SEEN_SUSPECT | -
    NEVER_SEEN_SUSPECT | -      | ONLINE         | NEVER_SEEN      | NEVER_SEEN_SUSPECT | ABSENT
    ABSENT             | -      | ONLINE         | NEVER_SEEN      | ABSENT             | ABSENT
    ONLINE             | -      | -              | -               | SUSPECT            | -
    SUSPECT            | -      | ONLINE         | ONLINE          | SUSPECT            | OFFLINE
    OFFLINE            | -      | ONLINE         | ONLINE          | OFFLINE            | OFFLINE

In the four states other than NEVER_SEEN and ONLINE a late reply may still be on its way. Only stops are sent then,
and after the quarantine a sync probe: a harmless request whose reply cannot be the late reply to an older one.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, StrEnum
from typing import Any, NamedTuple

from drivebus.bus.messages import StationConfig
from drivebus.bus.statistics import Counters
from drivebus.bus.usual_delay import UsualDelay
from drivebus.errors import ProtocolError
from drivebus.protocols.codec import DecodedFrame, Effect, Incomplete
from drivebus.serial_settings import ANY_REPLY_LATENESS_S, SerialSettings

MIN_PROBE_INTERVAL_S = 1.0  # first pause between sync probes to a station that does not reply; doubles each time
MAX_PROBE_INTERVAL_S = 55.0  # with the wait for its turn on the slowest bus a returning drive is found within 60 s
DUPLICATE_REPLIES_REQUIRED = 2  # two drives at one address send a second reply to each read
DUPLICATE_WINDOW_S = 600.0  # a second reply is forgotten after ten minutes
MAX_DUPLICATE_WAIT_S = 0.25  # a quarter of the time that a frame waits for silence
MAX_UNANSWERED_S = 10.0  # a drive that has not answered for longer may have been switched off and set or exchanged
MAX_UNREQUESTED_S = 120.0  # a drive that was sent nothing for longer, too; polls of a slow bus are up to 60 s apart
PROBE_BUS_SHARE = 0.1  # share of the bus time that sync probes to all offline stations together may use
ENCODE_CACHE_SIZE = 512  # encoded reads cached for each station: a bus repeats the same requests


class Presence(StrEnum):
    """Whether a station replies, as reported to the user."""

    NEVER_SEEN = "never_seen"
    ONLINE = "online"
    OFFLINE = "offline"


class StationState(Enum):
    """State of a station; the transitions are drawn at the top of this module."""

    NEVER_SEEN = Presence.NEVER_SEEN, "trusted"
    """Never replied: may be addressed. Assumed: no late reply to an earlier process is on its way."""
    NEVER_SEEN_SUSPECT = Presence.NEVER_SEEN, "suspect"
    """Never replied correctly, but invalid bytes or bytes of unknown origin were received, or the port was lost."""
    ABSENT = Presence.NEVER_SEEN, "no contact"
    """Never replied, probed at growing intervals."""
    ONLINE = Presence.ONLINE, "trusted"
    """Replied last; may be addressed."""
    SUSPECT = Presence.ONLINE, "suspect"
    """A late reply may be on its way: quarantine, then a sync probe."""
    OFFLINE = Presence.OFFLINE, "no contact"
    """Replied once, but not to its last sync probe: probed at growing intervals."""

    def __init__(self, presence: Presence, trust: str) -> None:
        self.presence = presence
        self.is_suspect = trust != "trusted"
        """Whether a late reply may be on its way: then only the reply to a sync probe is accepted."""
        self.is_unreachable = trust == "no contact"
        """Whether it is probed at growing intervals, within the bus share of offline stations."""


class StationEvent(Enum):
    """Event that may change the state of a station."""

    REPLY = "reply"
    """A trusted reply to a data request, from a station that is not online; later ones are no event."""
    SYNC_CONFIRMED = "sync confirmed"
    """A sync probe was answered with its own, distinguishable reply."""
    SYNC_UNVERIFIED = "sync unverified"
    """A sync probe was answered, but the bytes may be our own echo: the station may only be addressed again."""
    SUSPICION = "suspicion"
    """A late reply may be on its way."""
    NO_CONTACT = "no contact"
    """A sync probe failed, or a station that was never seen did not reply."""


TRANSITIONS = {
    (StationState.NEVER_SEEN, StationEvent.REPLY): StationState.ONLINE,
    (StationState.NEVER_SEEN, StationEvent.SUSPICION): StationState.NEVER_SEEN_SUSPECT,
    (StationState.NEVER_SEEN_SUSPECT, StationEvent.SYNC_CONFIRMED): StationState.ONLINE,
    (StationState.NEVER_SEEN_SUSPECT, StationEvent.SYNC_UNVERIFIED): StationState.NEVER_SEEN,
    (StationState.NEVER_SEEN_SUSPECT, StationEvent.SUSPICION): StationState.NEVER_SEEN_SUSPECT,
    (StationState.NEVER_SEEN_SUSPECT, StationEvent.NO_CONTACT): StationState.ABSENT,
    (StationState.ABSENT, StationEvent.SYNC_CONFIRMED): StationState.ONLINE,
    (StationState.ABSENT, StationEvent.SYNC_UNVERIFIED): StationState.NEVER_SEEN,
    (StationState.ABSENT, StationEvent.SUSPICION): StationState.ABSENT,
    (StationState.ABSENT, StationEvent.NO_CONTACT): StationState.ABSENT,
    (StationState.ONLINE, StationEvent.SUSPICION): StationState.SUSPECT,
    (StationState.SUSPECT, StationEvent.SYNC_CONFIRMED): StationState.ONLINE,
    (StationState.SUSPECT, StationEvent.SYNC_UNVERIFIED): StationState.ONLINE,
    (StationState.SUSPECT, StationEvent.SUSPICION): StationState.SUSPECT,
    (StationState.SUSPECT, StationEvent.NO_CONTACT): StationState.OFFLINE,
    (StationState.OFFLINE, StationEvent.SYNC_CONFIRMED): StationState.ONLINE,
    (StationState.OFFLINE, StationEvent.SYNC_UNVERIFIED): StationState.ONLINE,
    (StationState.OFFLINE, StationEvent.SUSPICION): StationState.OFFLINE,
    (StationState.OFFLINE, StationEvent.NO_CONTACT): StationState.OFFLINE,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class StationHealth:
    """Health of a station and its bus. ``last_reply_at`` is monotonic seconds."""

    presence: Presence
    suspect: bool
    """A late reply may be on its way: reads wait for a sync probe."""
    reads_wait_until: float
    """Monotonic seconds before which a suspect station gets no read and no sync probe; 0.0 for any other station."""
    foreign_master: bool
    """Another master sends requests on this bus."""
    duplicate_address: bool
    """Two drives seem to reply at this address."""
    error_rate: float
    """Share of the last 5 minutes' transactions with this station that failed, 0 to 1."""
    damaged: int
    """Transactions of the last 5 minutes whose reply was damaged."""
    damage_rate: float
    """Share of damaged transactions, 0 to 1."""
    last_reply_at: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class EncodedRequest:
    """Encoded request, with the sizes and times of its transaction."""

    data: bytes
    effect: Effect
    reply_bytes: int
    """Bytes of the normal reply, 0 for a broadcast."""
    send_s: float
    reply_timeout_s: float
    """Time from our last bit to the end of the longest permitted reply; after a broadcast the turnaround delay."""
    cacheable: bool
    """A read addressed to this very station: it needs no further check."""


class UnansweredRequest(NamedTuple):
    """Request whose reply may still come. Times are monotonic seconds."""

    until: float
    """Time after which its reply can no longer come."""
    request: Any
    tx_end_at: float
    """Its last bit on the wire."""
    is_foreign: bool = False
    """Whether it seems to be of another master: a wrong mirrored reply looks like such a request."""


class Station:
    """Registered address with its state, timing and counters. Times are monotonic seconds."""

    __slots__ = (
        "address",
        "codec",
        "config",
        "contact_losses",
        "counters",
        "duplicate_reply_times",
        "earlier_failure_reason",
        "encode_cache",
        "failure_reason",
        "gap_s",
        "last_frame",
        "last_reply_at",
        "last_request",
        "last_request_answered",
        "last_request_sent_at",
        "motions_sent",
        "next_probe_at",
        "probe_backoff_s",
        "quarantined_until",
        "start_inhibited",
        "state",
        "stop_epoch",
        "suspect_since",
        "sync_probe_count",
        "sync_rejections",
        "unanswered_requests",
        "unusable_reply",
        "usual_delay",
    )

    def __init__(self, config: StationConfig, settings: SerialSettings) -> None:
        self.config = config
        self.address = config.address
        self.codec = config.codec
        self.gap_s = config.timing.gap_s(settings)
        self.state = StationState.NEVER_SEEN
        self.stop_epoch = 0
        """Number of stops so far; a permit of an older epoch is void."""
        self.motions_sent = 0
        """Number of frames so far that may have moved the motor."""
        self.start_inhibited = False
        self.contact_losses = 0
        """Number of times after which another drive, or one with other settings, may have answered."""
        self.quarantined_until = 0.0
        self.suspect_since = float("-inf")
        """Time of the last suspicion that no sync probe of its own has refuted: a late reply may be due on the bus."""
        self.probe_backoff_s = 0.0
        self.next_probe_at = 0.0
        self.sync_probe_count = 0
        self.sync_rejections = 0
        """Sync probes in a row that were answered with an error reply."""
        self.unanswered_requests: list[UnansweredRequest] = []
        """Requests without a trusted reply."""
        self.failure_reason: Exception | None = None
        """Names the bytes that made the station suspect or came since, for requests whose sync probe gets no reply."""
        self.earlier_failure_reason: Exception | None = None
        """``failure_reason`` of the time before the last failed sync probe: a reply may come after the next one."""
        self.unusable_reply: Exception | None = None
        """Names what was received in place of its last replies, None after an accepted one and while nothing comes."""
        self.usual_delay = UsualDelay()
        """Usual delay of its replies to requests other than polls; each poll has its own."""
        self.last_request: Any = None
        """Last sent request; an unsolicited frame may be its reply."""
        self.last_request_answered = False
        """Whether at least as many bytes as its reply has came after the last request, trusted or not."""
        self.last_request_sent_at = 0.0
        """Time of its last bit on the wire."""
        self.last_reply_at: float | None = None
        self.last_frame = b""
        """Last whole reply that was received, accepted or not; its bytes again are a second reply."""
        self.duplicate_reply_times: list[float] = []
        self.counters = Counters()
        self.encode_cache: dict[Any, EncodedRequest] = {}

    def inherit(self, removed: Station) -> None:
        """Inherit stop epoch, start inhibit, second replies and error rates of the removed station."""
        self.stop_epoch, self.start_inhibited = removed.stop_epoch, removed.start_inhibited
        self.duplicate_reply_times = removed.duplicate_reply_times
        self.counters.error_window = removed.counters.error_window

    # --- state ---------------------------------------------------------------------------------------------------

    def _change(self, event: StationEvent) -> None:
        self.state = TRANSITIONS.get((self.state, event), self.state)

    def record_reply_time(self, at: float) -> None:
        """Record the time of a trusted reply. After a long time without one the drive may have been without power."""
        if self.last_reply_at is not None:
            limit_s = MAX_UNANSWERED_S if self.suspect_since > self.last_reply_at else MAX_UNREQUESTED_S
            if at - self.last_reply_at > limit_s:
                self.contact_losses += 1
        self.last_reply_at = at

    def mark_replied(self) -> None:
        """Change the state after the first trusted reply to a data request."""
        self._change(StationEvent.REPLY)

    def mark_suspect(self, now: float) -> None:
        """Begin a quarantine: a late reply may be on its way."""
        self._change(StationEvent.SUSPICION)
        self.suspect_since = now
        self.quarantined_until = max(self.quarantined_until, now + self.config.timing.max_reply_lateness_s)

    def mark_offline(self, now: float) -> None:
        """Set the next sync probe after a pause that doubles from 1 to 55 s."""
        self._change(StationEvent.NO_CONTACT)
        self.probe_backoff_s = min(MAX_PROBE_INTERVAL_S, max(MIN_PROBE_INTERVAL_S, 2 * self.probe_backoff_s))
        self.next_probe_at = now + self.probe_backoff_s

    def mark_online(self, *, verified: bool) -> None:
        """End the quarantine after a sync probe; not ``verified`` where its reply may be our own echo."""
        self._change(StationEvent.SYNC_CONFIRMED if verified else StationEvent.SYNC_UNVERIFIED)
        self.sync_rejections = 0
        if verified:
            self.probe_backoff_s = 0.0
            if not self.duplicate_reply_times:  # of two drives at one address only one has answered the sync probe
                self.suspect_since = float("-inf")

    def sync_due_at(self, budget_at: float) -> float:
        """Return the time at which a sync probe may be sent without a request that waits for it."""
        if self.state.is_unreachable:
            return max(self.next_probe_at, budget_at, self.quarantined_until)
        return self.quarantined_until

    # --- two drives at one address -------------------------------------------------------------------------------

    def record_duplicate_reply(self, now: float) -> None:
        """Record a second reply to one request; the list is shared with a station that inherits this address."""
        self.duplicate_reply_times[:] = [*self.duplicate_reply_times[1 - DUPLICATE_REPLIES_REQUIRED :], now]

    def has_duplicate_address(self, now: float, replies_required: int = DUPLICATE_REPLIES_REQUIRED) -> bool:
        """Return whether two drives seem to reply at this address."""
        recent = [at for at in self.duplicate_reply_times if now - at <= DUPLICATE_WINDOW_S]
        return len(recent) >= replies_required

    def next_allowed_at(self, now: float) -> float:
        """Return the time at which a station that has replied twice may be addressed again.

        A second reply must have arrived by then, or it would be taken for the reply to the next request.
        """
        if now - self.duplicate_reply_times[-1] > DUPLICATE_WINDOW_S:
            return 0.0
        return self.last_request_sent_at + min(max(self.counters.reply_times_s, default=0.0), MAX_DUPLICATE_WAIT_S)

    # --- bytes ---------------------------------------------------------------------------------------------------

    def encode(self, request: Any, settings: SerialSettings) -> EncodedRequest:
        """Return the encoded request, cached for reads. Raises ValueError for a field out of range."""
        try:
            encoded = self.encode_cache.get(request)
        except TypeError:  # a request that can't be hashed
            return self._encode(request, settings)
        if encoded is None:
            encoded = self._encode(request, settings)
            if encoded.cacheable:
                if len(self.encode_cache) >= ENCODE_CACHE_SIZE:
                    self.encode_cache.clear()
                self.encode_cache[request] = encoded
        return encoded

    def _encode(self, request: Any, settings: SerialSettings) -> EncodedRequest:
        codec, timing = self.codec, self.config.timing
        data = codec.encode_request(request)
        reply_bytes = codec.reply_size(request)
        effect = self.config.effect_of(data)
        return EncodedRequest(
            data=data,
            effect=effect,
            reply_bytes=reply_bytes,
            send_s=settings.seconds(len(data)),
            reply_timeout_s=timing.timeout_s(settings, codec.largest_reply(request))
            if reply_bytes
            else timing.turnaround_s,
            cacheable=effect is Effect.NONE and reply_bytes > 0 and codec.address_of(request) == self.address,
        )

    def next_sync_request(self, now: float) -> Any:
        """Return the next sync probe, or the one after it where only the reply to the latter differs in length from all
        replies that are still due.
        """
        request = self.config.sync_request(self.sync_probe_count)
        self.sync_probe_count += 1
        due = {self.codec.reply_size(entry.request) for entry in self.unanswered_requests if entry.until > now}
        if self.codec.reply_size(request) not in due:
            return request
        other = self.config.sync_request(self.sync_probe_count)
        if self.codec.reply_size(other) in due:
            return request
        self.sync_probe_count += 1
        return other

    def remember_unanswered(self, request: Any, tx_end_at: float, now: float, *, is_foreign: bool = False) -> None:
        """Record that the reply may still come, also where another frame was received and rejected in its place."""
        pending = [entry for entry in self.unanswered_requests if entry.until > now]
        self.unanswered_requests = [
            *pending,
            UnansweredRequest(now + ANY_REPLY_LATENESS_S, request, tx_end_at, is_foreign),
        ]

    def decode_reply_to(self, request: Any, data: bytes) -> DecodedFrame | None:
        """Return the reply to ``request`` at the start of ``data``, None where there is none."""
        try:
            result = self.codec.decode_reply(request, data)
        except ProtocolError:
            return None
        return None if isinstance(result, Incomplete) else result


class ProbeBudget:
    """Budget of bus time for sync probes to offline stations."""

    __slots__ = ("allowed_at",)

    def __init__(self) -> None:
        self.allowed_at = 0.0

    def spend(self, cost_s: float, now: float) -> None:
        """Charge a probe of ``cost_s`` of bus time up to ``now``; then other frames get nine times as much."""
        self.allowed_at = now + cost_s * (1.0 / PROBE_BUS_SHARE - 1.0)
