"""Bytes that nobody asked for: heard while idle, told apart once the line is silent, counted, never applied. Pure.

A late answer (F01), a second answer (F15), a request of somebody else (F14), or bytes that nobody can place.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from drivebus.bus.trace import TraceKind
from drivebus.errors import ProtocolError
from drivebus.protocols.codec import Complete, Incomplete

if TYPE_CHECKING:
    from drivebus.bus.prepared_request import PreparedRequest
    from drivebus.bus.station import Station

MAX_UNSOLICITED_BYTES = 512
"""More unasked bytes than this without a pause are forgotten (I12); no frame of these families is longer."""
FOREIGN_REQUESTS_REQUIRED = 2
FOREIGN_MASTER_WINDOW_S = 60.0
"""Two requests of somebody else within a minute mean a second master (G18); a minute of peace ends it."""


class UnsolicitedBytes:
    """Collects unasked bytes and remembers foreign masters."""

    __slots__ = ("_foreign_request_times", "buffer", "last_byte_at")

    def __init__(self) -> None:
        self.buffer = bytearray()
        self.last_byte_at = 0.0
        self._foreign_request_times: list[float] = []

    def add(self, data: bytes, now: float) -> None:
        self.buffer += data
        del self.buffer[MAX_UNSOLICITED_BYTES:]
        self.last_byte_at = now

    def drain(self) -> bytes:
        data = bytes(self.buffer)
        self.buffer.clear()
        return data

    def record_foreign_request(self, now: float) -> None:
        self._foreign_request_times = [*self._foreign_request_times[-1:], now]

    def has_foreign_master(self, now: float) -> bool:
        """Were there two foreign requests within a minute, the last less than a minute ago?"""
        recent = [at for at in self._foreign_request_times if now - at <= FOREIGN_MASTER_WINDOW_S]
        return len(recent) >= FOREIGN_REQUESTS_REQUIRED


def classify(
    data: bytes, stations: Iterable[Station], after_foreign_request: bool
) -> tuple[TraceKind, Station | None, Any, int]:
    """What the beginning of ``data`` is: its kind, the station it came from, the message and its size.

    The mirrored answer of FC06 or FC08 is a valid request too, so what we asked last is looked at before anybody is
    called a foreign master. ``after_master``: a foreign request came just before, so an answer is the answer to that.
    """
    known = tuple(stations)
    for station in known:
        if station.last_request is not None and (found := _decode_reply_to(station.last_request, data)) is not None:
            kind = (
                TraceKind.FOREIGN
                if after_foreign_request
                else TraceKind.LATE
                if station.suspect
                else TraceKind.DUPLICATE
            )
            return kind, station, found[0], found[1]
    seen: list[object] = []
    for station in known:
        if not any(codec is station.codec for codec in seen):
            seen.append(station.codec)
            found = decode_request_prefix(station.codec, data)
            if found is not None:
                debtor = next((one for one in known if is_late_reply(one, found[0], data[: found[1]])), None)
                return TraceKind.FOREIGN_REQUEST if debtor is None else TraceKind.LATE, debtor, found[0], found[1]
    return TraceKind.UNSOLICITED, None, None, len(data)


def is_late_reply(station: Station, request: Any, frame: bytes) -> bool:
    """Is this the late answer of a station that owes us one? The answer of FC06 or FC08 is a valid request too, and
    must not block its own drive as a foreign master's would."""
    codec = station.codec
    request = getattr(request, "request", request)  # of a C320's request the operation is heard apart (T01)
    if not station.suspect or codec.address_of(request) != station.address:
        return False
    try:
        return isinstance(codec.decode_reply(request, frame), Complete)
    except ProtocolError:
        return False


def matches(job: PreparedRequest, data: bytes) -> bool:
    """Are these bytes an answer to that request?"""
    return _decode_reply_to(job, data) is not None


def _decode_reply_to(job: PreparedRequest, data: bytes) -> tuple[Any, int] | None:
    try:
        verdict = job.codec.decode_reply(job.request, data)
    except ProtocolError:
        return None
    return None if isinstance(verdict, Incomplete) else (verdict.message, verdict.size)


def decode_request_prefix(codec: Any, data: bytes) -> tuple[Any, int] | None:
    """The request that begins ``data``, with its size."""
    try:
        verdict = codec.decode_request(data)
    except ProtocolError:
        return None
    return None if isinstance(verdict, Incomplete) else (verdict.message, verdict.size)
