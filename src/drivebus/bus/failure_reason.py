"""Reason of a failed transaction: names what was received in place of the reply. Nothing is accepted here.

A codec reports the first byte that does not fit; the reason reports the cause that a user can mend: stray bytes, a
second reply, a late reply, a reply from another address.
"""

from __future__ import annotations

from drivebus.bus.station import Station
from drivebus.bus.transaction import Transaction
from drivebus.errors import AddressError, DrivebusError, HeaderError, LineError, NoReply, TrailingError

MAX_STRAY_BYTES = 4  # more bytes before a reply are another frame and not a glitch


def failure_reason(transaction: Transaction, error: Exception) -> Exception:
    """Return the error that names what was received, ``error`` itself where nothing more is known."""
    station, data = transaction.prepared.station, transaction.buffer
    if isinstance(error, LineError):
        return error
    if isinstance(error, TrailingError):
        return second_reply(station) if transaction.ends_with_second_reply(error) else error
    received = transaction.bytes_before_tx_end + data
    if received and _repeats(station.last_frame, received):
        return second_reply(station)
    if not data or transaction.last_byte_at is None:
        return _other_station_replied(transaction) or error
    return late_reply(station, data, transaction.last_byte_at) or _stray_bytes_before(transaction, data) or error


def copy_error(error: Exception) -> Exception:
    """Return an equal error: each request has its own, because its receiver adds the outcome of its command."""
    return type(error)(error.key, **error.params) if isinstance(error, DrivebusError) else error


def second_reply(station: Station) -> TrailingError:
    """Return the error of a reply that came twice."""
    return TrailingError("bus.second_reply", station=station.address)


def _repeats(frame: bytes, received: bytes) -> bool:
    """Return whether ``received`` begins with ``frame``, or is the end of it, which began before our request."""
    return (len(frame) > 0 and received.startswith(frame)) or frame.endswith(received)


def late_reply(station: Station, data: bytes, received_at: float) -> NoReply | None:
    """Return the error of a reply to an older unanswered request of ours, None where ``data`` is none.

    Replies of some families fit several requests: the newest one gives the shortest lateness that is possible.
    """
    for unanswered in reversed(station.unanswered_requests):
        if unanswered.is_foreign or received_at >= unanswered.until:
            continue
        reply = station.decode_reply_to(unanswered.request, data)
        if reply is not None and reply.size == len(data):
            return _late_error(station, unanswered.tx_end_at, received_at)
    return None


def late_reply_to_last_request(station: Station, data: bytes, received_at: float) -> NoReply | None:
    """Return the error of a reply to the last request, however long ago that was, None where ``data`` is none."""
    reply = None if station.last_request is None else station.decode_reply_to(station.last_request, data)
    if reply is None or reply.size != len(data):
        return None
    return _late_error(station, station.last_request_sent_at, received_at)


def _late_error(station: Station, tx_end_at: float, received_at: float) -> NoReply:
    late_ms = round((received_at - tx_end_at) * 1000)
    return NoReply("bus.late_reply", station=station.address, milliseconds=late_ms)


def shows_a_reply(error: Exception | None) -> bool:
    """Return whether the named bytes may come from the station; our own frame alone may be the adapter's echo."""
    return error is not None and getattr(error, "key", "") != "bus.only_own_frame"


def _other_station_replied(transaction: Transaction) -> AddressError | None:
    """Return the error of one reply under another address, a rejection too, with nothing else received."""
    match transaction.foreign_frames:
        case [(frame, error)] if len(frame) <= transaction.prepared.reply_bytes:
            station = transaction.prepared.station.address
            return AddressError("bus.other_station_replied", station=station, expected=station, found=error.found)
    return None


def _stray_bytes_before(transaction: Transaction, data: bytes) -> HeaderError | None:
    """Return the error of a whole reply that begins after a few other bytes."""
    prepared = transaction.prepared
    for count in range(1, MAX_STRAY_BYTES + 1):
        reply = prepared.station.decode_reply_to(prepared.request, data[count:])
        if reply is not None and reply.size == len(data) - count:
            stray = data[:count].hex(" ").upper()
            return HeaderError("bus.stray_before", station=prepared.station.address, count=count, bytes=stray)
    return None
