"""Counts the bytes that nobody asked for, by kind; none of them is ever applied. Pure."""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivebus.bus.trace import TraceEvent, TraceKind
from drivebus.bus.unsolicited import classify, decode_request_prefix, is_late_reply
from drivebus.errors import AddressError

if TYPE_CHECKING:
    from drivebus.bus.core import BusCore
    from drivebus.bus.station import Station
    from drivebus.bus.transaction import Transaction


def classify_idle(core: BusCore, now: float) -> None:
    """The line is silent: what were the bytes heard while nobody was asked?"""
    data = core.unsolicited.drain()
    heard_at = core.unsolicited.last_byte_at
    after_master = False
    while data:
        kind, station, message, size = classify(data, core.stations.values(), after_master)
        after_master = kind is TraceKind.FOREIGN_REQUEST
        if after_master:
            core.unsolicited.record_foreign_request(heard_at)
        core.echo.note_repeat(data[:size])
        _record(core, kind, station, data[:size], message, heard_at, now)
        data = data[size:]


def count_extra(core: BusCore, transaction: Transaction, now: float) -> None:
    """What came within a transaction and was no part of its answer."""
    if transaction.bytes_before_tx_end:
        core.counters.count_event("early", len(transaction.bytes_before_tx_end))
        if core.tracing:
            core.trace(TraceEvent(transaction.tx_end_at, TraceKind.BEFORE_TX_END, transaction.bytes_before_tx_end))
    for data, error in transaction.foreign_frames or ():
        _record_foreign_frame(core, data, error, now)


def detect_foreign_master(core: BusCore, transaction: Transaction, now: float) -> None:
    """Was what came instead of an answer a whole request of somebody else (F14)? Our own frame is not."""
    data = bytes(transaction.buffer)
    if not data or data == transaction.prepared.data:
        return
    found = decode_request_prefix(transaction.prepared.codec, data)
    if found is None or data[: found[1]] == transaction.prepared.data:
        return
    station, frame = transaction.prepared.station, data[: found[1]]
    if is_late_reply(station, found[0], frame):
        _record(core, TraceKind.LATE, station, frame, found[0], now, now)
    else:
        core.unsolicited.record_foreign_request(now)
        _record(core, TraceKind.FOREIGN_REQUEST, None, frame, found[0], now, now)


def _record_foreign_frame(core: BusCore, data: bytes, error: AddressError, now: float) -> None:
    """A whole frame of another station (F02): late where it still owes us one; else somebody else asked for it."""
    station = core.stations.get(error.found) if isinstance(error.found, int) else None
    late = station is not None and station.suspect
    if station is None:
        core.unsolicited.record_foreign_request(now)
    _record(core, TraceKind.LATE if late else TraceKind.FOREIGN, station, data, None, now, now)


def _record(
    core: BusCore,
    kind: TraceKind,
    station: Station | None,
    data: bytes,
    message: object,
    received_at: float,
    now: float,
) -> None:
    core.counters.count_event(kind.value)
    if station is not None:
        station.counters.count_event(kind.value)
        again = kind is TraceKind.LATE and station.last_request_answered and station.has_duplicate_address(now, 1)
        if (
            kind is TraceKind.DUPLICATE or again
        ):  # a late answer that follows another's: F15, where there was a sign before
            station.record_duplicate_reply(now)
        if kind is TraceKind.DUPLICATE or (kind is TraceKind.FOREIGN and message is None):
            station.mark_suspect(now)
            core.scheduler.mark_suspect(station)
    if core.tracing:
        core.trace(TraceEvent(received_at, kind, data, None if station is None else station.address, message))
