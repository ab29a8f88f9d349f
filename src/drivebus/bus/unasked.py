"""Counts the bytes that nobody asked for, by kind; none of them is ever applied. Pure."""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivebus.bus.listener import classify, owes, request_in
from drivebus.bus.trace import Kind, TraceEvent
from drivebus.errors import AddressError

if TYPE_CHECKING:
    from drivebus.bus.core import BusCore
    from drivebus.bus.stations import Station
    from drivebus.bus.transaction import Transaction


def sort_out(core: BusCore, now: float) -> None:
    """The line is silent: what were the bytes heard while nobody was asked?"""
    data = core.listener.take()
    heard_at = core.listener.heard_at
    after_master = False
    while data:
        kind, station, message, size = classify(data, core.stations.values(), after_master)
        after_master = kind is Kind.MASTER
        if after_master:
            core.listener.foreign_request(heard_at)
        core.echo.came_again(data[:size])
        _note(core, kind, station, data[:size], message, heard_at, now)
        data = data[size:]


def during(core: BusCore, flight: Transaction, now: float) -> None:
    """What came within a transaction and was no part of its answer."""
    if flight.early:
        core.counters.kind("early", len(flight.early))
        if core.tracing:
            core.trace(TraceEvent(flight.sent_end, Kind.EARLY, flight.early))
    for data, error in flight.foreign or ():
        _from_another(core, data, error, now)


def overheard(core: BusCore, flight: Transaction, now: float) -> None:
    """Was what came instead of an answer a whole request of somebody else (F14)? Our own frame is not."""
    data = bytes(flight.buffer)
    if not data or data == flight.job.data:
        return
    found = request_in(flight.job.codec, data)
    if found is None or data[: found[1]] == flight.job.data:
        return
    station, frame = flight.job.station, data[: found[1]]
    if owes(station, found[0], frame):
        _note(core, Kind.LATE, station, frame, found[0], now, now)
    else:
        core.listener.foreign_request(now)
        _note(core, Kind.MASTER, None, frame, found[0], now, now)


def _from_another(core: BusCore, data: bytes, error: AddressError, now: float) -> None:
    """A whole frame of another station (F02): late where it still owes us one; else somebody else asked for it."""
    station = core.stations.get(error.found) if isinstance(error.found, int) else None
    late = station is not None and station.suspect
    if station is None:
        core.listener.foreign_request(now)
    _note(core, Kind.LATE if late else Kind.FOREIGN, station, data, None, now, now)


def _note(
    core: BusCore, kind: Kind, station: Station | None, data: bytes, message: object, heard_at: float, now: float
) -> None:
    core.counters.kind(kind.value)
    if station is not None:
        station.counters.kind(kind.value)
        again = kind is Kind.LATE and station.answered and station.duplicate(now, 1)
        if kind is Kind.DUPLICATE or again:  # a late answer that follows another's: F15, where there was a sign before
            station.answered_twice(now)
        if kind is Kind.DUPLICATE or (kind is Kind.FOREIGN and message is None):
            station.doubt(now)
            core.scheduler.doubts(station)
    if core.tracing:
        core.trace(TraceEvent(heard_at, kind, data, None if station is None else station.address, message))
