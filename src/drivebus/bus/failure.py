"""What follows a transaction that brought no believable answer: doubt, retry, silence. Pure.

Two kinds of failure. *Damage* (a checksum, a parity mark, on exactly an answer's worth of bytes, while nobody on this
line owes a late answer): the answer has come and is spoiled, so it can't come later; a read may be repeated at once.
*Anything else* (nothing, too little, too much, another item, or garbage that a late answer may have made): the true
answer may still be on its way, so the station is suspect: quarantine, then a fence (5.3).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivebus.bus import classify
from drivebus.bus.poll_schedule import PreparedPoll
from drivebus.bus.trace import TraceEvent, TraceKind
from drivebus.bus.unsolicited import matches
from drivebus.errors import AlphabetError, ChecksumError, LineError, NoReply, ProtocolError, TrailingError
from drivebus.protocols.codec import RequestPriority

if TYPE_CHECKING:
    from drivebus.bus.core import BusCore
    from drivebus.bus.prepared_request import PreparedRequest
    from drivebus.bus.station import Station
    from drivebus.bus.transaction import Transaction


SYNC_REJECTIONS_REQUIRED = 3
"""A refusal echoes too little to prove that it answers this fence (DF800: only the function). So many in a row do:
a station owes fewer late answers than that, and one that knows no such request must not be lost for ever."""


MAX_REPLY_LATENESS_S = 5.0
"""G04: no answer is ever later than this."""


class UntrustedReply(NoReply):
    """A reply came, and may be our own echo or an older one: it counts as none, and sending again would not help."""

    retryable = False


def reject_reason(core: BusCore, transaction: Transaction) -> Exception | None:
    """Why a reply that the codec took must not be believed."""
    job = transaction.prepared
    if not core.echo.accepts(transaction):
        return UntrustedReply("bus.mirrored", station=job.station.address)
    if job.station.suspect and not job.is_sync_probe:
        return UntrustedReply("bus.suspect", station=job.station.address)
    if not job.is_sync_probe:
        return None
    if transaction.message_size < job.reply_bytes:
        few = job.station.sync_rejections < SYNC_REJECTIONS_REQUIRED - 1
        return UntrustedReply("bus.fence_refused", station=job.station.address) if few else None
    if _matches_older_request(transaction):
        return UntrustedReply("bus.fence_older", station=job.station.address, seconds=MAX_REPLY_LATENESS_S)
    return None


def _matches_older_request(transaction: Transaction) -> bool:
    """Could this be the late answer to an older question as well?

    A nonce or an item tells a fence from everything else; where only a count does (DF800), any unanswered question of
    that count, a fence or somebody's own, makes a fence worthless until its answer can no longer be on its way.
    """
    data = bytes(transaction.buffer)
    return any(
        transaction.sent_at < until and matches(older, data)
        for until, older in transaction.prepared.station.unanswered_requests
    )


def handle_failure(core: BusCore, transaction: Transaction, error: Exception, now: float) -> None:
    """Count it, draw the consequences for the station, and try again or tell."""
    job, station = transaction.prepared, transaction.prepared.station
    _count_failure(core, transaction, error, now)
    _remember_unanswered(transaction, now)
    classify.detect_foreign_master(core, transaction, now)
    if core.stations.get(station.address) is not station:  # removed meanwhile
        core.complete(job, error, transaction)
        return
    if isinstance(error, UntrustedReply):
        if error.key == "bus.fence_refused":
            station.sync_rejections += 1
        elif error.key == "bus.fence_older":
            station.quarantined_until = (
                now + MAX_REPLY_LATENESS_S
            )  # it may have been the older one's: then its own is due
        elif job.is_sync_probe:
            core.trust_station(station, now, verified=False)
        core.complete(job, error, transaction)
        return
    if not _is_damaged_reply(core, error, transaction, now):
        station.mark_suspect(now)
        core.scheduler.mark_suspect(station)
    if job.is_sync_probe:
        _handle_sync_failure(core, transaction, now)
        return
    if not station.seen and isinstance(error, NoReply):
        station.mark_offline(now)
        core.scheduler.mark_suspect(station)
    if _may_retry(job, station):
        core.counters.count_event("retry")
        core.scheduler.requeue(job)
    else:
        core.complete(job, error, transaction)


def _remember_unanswered(transaction: Transaction, now: float) -> None:
    """Its true answer may still come, also where something else was taken for it and not believed."""
    station = transaction.prepared.station
    waiting = [one for one in station.unanswered_requests if one[0] > now]
    station.unanswered_requests = [*waiting, (now + MAX_REPLY_LATENESS_S, transaction.prepared)]


def _handle_sync_failure(core: BusCore, transaction: Transaction, now: float) -> None:
    """A fence failed: the station is silent, and what waited for the fence is told so."""
    station = transaction.prepared.station
    station.mark_suspect(now)
    if station.dead:
        core.scheduler.probe_budget.spend(now - transaction.sent_at + station.gap_s, now)
    station.mark_offline(now)
    for waiting in core.scheduler.remove_if(
        lambda job: job.station is station and job.priority is not RequestPriority.STOP
    ):
        core.complete(waiting, NoReply("bus.silent", station=station.address))
    core.scheduler.mark_suspect(station)


def _may_retry(job: PreparedRequest, station: Station) -> bool:
    """One retry for a read, two for what is absolute; never for a station that is not there (F11)."""
    if job.attempts >= job.max_attempts or station.dead or not station.seen:
        return False
    if isinstance(job, PreparedPoll):
        job.retry_queued = not job.cancelled
        return job.retry_queued
    return True


def _is_damaged_reply(core: BusCore, error: Exception, transaction: Transaction, now: float) -> bool:
    if transaction.received_count != transaction.prepared.reply_bytes or not isinstance(
        error, ChecksumError | AlphabetError | LineError
    ):
        return False
    return all(now - station.suspect_since > MAX_REPLY_LATENESS_S for station in core.stations.values())


def _count_failure(core: BusCore, transaction: Transaction, error: Exception, now: float) -> None:
    job, station = transaction.prepared, transaction.prepared.station
    core.counters.errors[type(error).__name__] = core.counters.errors.get(type(error).__name__, 0) + 1
    station.counters.record_failure(error, now)
    if isinstance(error, LineError) and error.key != "bus.marks":  # those bytes were counted as they came
        core.counters.count_event(error.key.partition(".")[2])
        station.counters.count_event(error.key.partition(".")[2])
    if isinstance(error, TrailingError) and _ends_with_duplicate_reply(transaction, error):
        core.counters.count_event("duplicate")
        station.counters.count_event("duplicate")
        station.record_duplicate_reply(now)
    if core.tracing:
        kind = (
            TraceKind.NO_REPLY if isinstance(error, NoReply) and not transaction.received_count else TraceKind.INVALID
        )
        core.trace(TraceEvent(now, kind, bytes(transaction.buffer), station.address, None, error, job.attempts))


def _ends_with_duplicate_reply(transaction: Transaction, error: TrailingError) -> bool:
    """Do the bytes after the answer form another answer (F15: two drives at one address)?"""
    rest = bytes(transaction.buffer[error.expected :]) if isinstance(error.expected, int) else b""
    try:
        verdict = transaction.prepared.codec.decode_reply(transaction.prepared.request, rest) if rest else None
    except ProtocolError:
        return False
    return getattr(verdict, "size", 0) > 0
