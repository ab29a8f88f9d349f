"""What follows a transaction that brought no believable answer: doubt, retry, silence. Pure.

Two kinds of failure. *Damage* (a checksum, a parity mark, on exactly an answer's worth of bytes, while nobody on this
line owes a late answer): the answer has come and is spoiled, so it can't come later; a read may be repeated at once.
*Anything else* (nothing, too little, too much, another item, or garbage that a late answer may have made): the true
answer may still be on its way, so the station is suspect: quarantine, then a fence (5.3).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivebus.bus import unasked
from drivebus.bus.listener import fits
from drivebus.bus.planner import PollJob
from drivebus.bus.trace import Kind, TraceEvent
from drivebus.errors import AlphabetError, ChecksumError, LineFault, NoReply, ProtocolError, TrailingError
from drivebus.message import Lane

if TYPE_CHECKING:
    from drivebus.bus.core import BusCore
    from drivebus.bus.job import Job
    from drivebus.bus.stations import Station
    from drivebus.bus.transaction import Transaction


FENCE_REFUSALS = 3
"""A refusal echoes too little to prove that it answers this fence (DF800: only the function). So many in a row do:
a station owes fewer late answers than that, and one that knows no such request must not be lost for ever."""


LONGEST_LATENESS_S = 5.0
"""G04: no answer is ever later than this."""


class NotBelieved(NoReply):
    """A reply came, and may be our own echo or an older one: it counts as none, and sending again would not help."""

    retryable = False


def disbelief(core: BusCore, flight: Transaction) -> Exception | None:
    """Why a reply that the codec took must not be believed."""
    job = flight.job
    if not core.echo.believes(flight):
        return NotBelieved("bus.mirrored", station=job.station.address)
    if job.station.suspect and not job.fence:
        return NotBelieved("bus.suspect", station=job.station.address)
    if not job.fence:
        return None
    if flight.size < job.reply_bytes:
        few = job.station.refusals < FENCE_REFUSALS - 1
        return NotBelieved("bus.fence_refused", station=job.station.address) if few else None
    if _fits_older(flight):
        return NotBelieved("bus.fence_older", station=job.station.address, seconds=LONGEST_LATENESS_S)
    return None


def _fits_older(flight: Transaction) -> bool:
    """Could this be the late answer to an older question as well?

    A nonce or an item tells a fence from everything else; where only a count does (DF800), any unanswered question of
    that count, a fence or somebody's own, makes a fence worthless until its answer can no longer be on its way.
    """
    data = bytes(flight.buffer)
    return any(flight.sent_at < until and fits(older, data) for until, older in flight.job.station.unanswered)


def failed(core: BusCore, flight: Transaction, error: Exception, now: float) -> None:
    """Count it, draw the consequences for the station, and try again or tell."""
    job, station = flight.job, flight.job.station
    _count(core, flight, error, now)
    _owed(flight, now)
    unasked.overheard(core, flight, now)
    if core.stations.get(station.address) is not station:  # removed meanwhile
        core.finish(job, error, flight)
        return
    if isinstance(error, NotBelieved):
        if error.key == "bus.fence_refused":
            station.refusals += 1
        elif error.key == "bus.fence_older":
            station.quarantined_until = (
                now + LONGEST_LATENESS_S
            )  # it may have been the older one's: then its own is due
        elif job.fence:
            core.believe(station, now, really=False)
        core.finish(job, error, flight)
        return
    if not _damaged(core, error, flight, now):
        station.doubt(now)
        core.scheduler.doubts(station)
    if job.fence:
        _unfenced(core, flight, now)
        return
    if not station.seen and isinstance(error, NoReply):
        station.give_up(now)
        core.scheduler.doubts(station)
    if _again(job, station):
        core.counters.kind("retry")
        core.scheduler.again(job)
    else:
        core.finish(job, error, flight)


def _owed(flight: Transaction, now: float) -> None:
    """Its true answer may still come, also where something else was taken for it and not believed."""
    station = flight.job.station
    waiting = [one for one in station.unanswered if one[0] > now]
    station.unanswered = [*waiting, (now + LONGEST_LATENESS_S, flight.job)]


def _unfenced(core: BusCore, flight: Transaction, now: float) -> None:
    """A fence failed: the station is silent, and what waited for the fence is told so."""
    station = flight.job.station
    station.doubt(now)
    if station.dead:
        core.scheduler.budget.spend(now - flight.sent_at + station.gap_s, now)
    station.give_up(now)
    for waiting in core.scheduler.withdraw(lambda job: job.station is station and job.lane is not Lane.STOP):
        core.finish(waiting, NoReply("bus.silent", station=station.address))
    core.scheduler.doubts(station)


def _again(job: Job, station: Station) -> bool:
    """One retry for a read, two for what is absolute; never for a station that is not there (F11)."""
    if job.attempts >= job.attempts_allowed or station.dead or not station.seen:
        return False
    if isinstance(job, PollJob):
        job.retrying = not job.cancelled
        return job.retrying
    return True


def _damaged(core: BusCore, error: Exception, flight: Transaction, now: float) -> bool:
    if flight.heard != flight.job.reply_bytes or not isinstance(error, ChecksumError | AlphabetError | LineFault):
        return False
    return all(now - station.doubted_at > LONGEST_LATENESS_S for station in core.stations.values())


def _count(core: BusCore, flight: Transaction, error: Exception, now: float) -> None:
    job, station = flight.job, flight.job.station
    core.counters.errors[type(error).__name__] = core.counters.errors.get(type(error).__name__, 0) + 1
    station.counters.failed(error, now)
    if isinstance(error, LineFault) and error.key != "bus.marks":  # those bytes were counted as they came
        core.counters.kind(error.key.partition(".")[2])
        station.counters.kind(error.key.partition(".")[2])
    if isinstance(error, TrailingError) and _second_answer(flight, error):
        core.counters.kind("duplicate")
        station.counters.kind("duplicate")
        station.answered_twice(now)
    if core.tracing:
        kind = Kind.SILENCE if isinstance(error, NoReply) and not flight.heard else Kind.VOID
        core.trace(TraceEvent(now, kind, bytes(flight.buffer), station.address, None, error, job.attempts))


def _second_answer(flight: Transaction, error: TrailingError) -> bool:
    """Do the bytes after the answer form another answer (F15: two drives at one address)?"""
    rest = bytes(flight.buffer[error.expected :]) if isinstance(error.expected, int) else b""
    try:
        verdict = flight.job.codec.decode_reply(flight.job.request, rest) if rest else None
    except ProtocolError:
        return False
    return getattr(verdict, "size", 0) > 0
