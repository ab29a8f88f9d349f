"""Unsolicited bytes: received while no transaction was open, classified once the bus is silent, never applied.

A frame is a late reply, a second reply, another master's request with its reply, or not attributable.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

from drivebus.bus.station import Station
from drivebus.bus.trace import TraceKind
from drivebus.errors import ProtocolError
from drivebus.protocols.codec import Codec, Complete, DecodedFrame, Incomplete
from drivebus.serial_settings import SerialSettings

MAX_UNSOLICITED_BYTES = 512  # buffered until the bus is silent; the longest frame, of Modbus ASCII, has one more
FOREIGN_REQUESTS_REQUIRED = 2  # one may be a corrupted frame, two make a second master
FOREIGN_MASTER_WINDOW_S = 60.0  # a minute without a foreign request ends the foreign master
MAX_FRAGMENT_PAUSE_S = 0.05  # between the two pieces of a frame: 16 ms of an FTDI adapter, up to 50 ms of a TCP server
MAX_FOREIGN_REPLY_WAIT_S = 0.5  # longest wait for the reply to a foreign request; half the time to wait for silence


class ForeignRequest(NamedTuple):
    """Request of another master to a station of ours. Its reply, still due, could pass for one to a request of ours."""

    address: int
    request: Any
    received_at: float
    reply_until: float


class UnsolicitedBytes:
    """Buffer of unsolicited bytes, and the times of foreign requests."""

    __slots__ = ("_foreign_request_times", "_fragment", "_fragment_at", "buffer", "foreign_request", "last_byte_at")

    def __init__(self) -> None:
        self.buffer = bytearray()
        self.last_byte_at = 0.0
        self.foreign_request: ForeignRequest | None = None
        """The foreign request whose reply is due."""
        self._foreign_request_times: list[float] = []
        self._fragment = b""
        """Last bytes that were no frame; what follows soon may complete them."""
        self._fragment_at = 0.0

    def add(self, data: bytes, now: float) -> None:
        """Add bytes; those beyond the limit are dropped."""
        self.buffer += data
        del self.buffer[MAX_UNSOLICITED_BYTES:]
        self.last_byte_at = now

    def drain(self) -> bytes:
        """Return the bytes and empty the buffer."""
        data = bytes(self.buffer)
        self.buffer.clear()
        return data

    def keep_fragment(self, data: bytes, received_at: float) -> None:
        """Keep bytes that are no frame, and may be the beginning of one."""
        self._fragment, self._fragment_at = data, received_at

    def join_fragment(self, data: bytes, now: float) -> bytes:
        """Return the bytes with the fragment before them, empty where none came shortly before."""
        recent = self._fragment and now - self._fragment_at <= MAX_FRAGMENT_PAUSE_S
        return self._fragment + data if recent else b""

    def record_foreign_request(self, now: float) -> None:
        """Record a request of another master."""
        self._foreign_request_times = [*self._foreign_request_times[-1:], now]

    def has_foreign_master(self, now: float) -> bool:
        """Return whether two foreign requests were received within the window that ends ``now``."""
        recent = [at for at in self._foreign_request_times if now - at <= FOREIGN_MASTER_WINDOW_S]
        return len(recent) >= FOREIGN_REQUESTS_REQUIRED


class UnsolicitedFrame(NamedTuple):
    """Classification of the first ``size`` unsolicited bytes."""

    kind: TraceKind
    station: Station | None
    """The station that sent it, where known."""
    message: Any
    size: int


def classify(
    data: bytes,
    stations: Iterable[Station],
    *,
    after_foreign_request: bool,
    foreign_request: ForeignRequest | None = None,
) -> UnsolicitedFrame:
    """Classify the beginning of ``data``. ``after_foreign_request``: a reply is the reply to that request.

    The mirrored reply of FC06 or FC08 is a valid request too, so the foreign request whose reply is due and our own
    last requests are compared first.
    """
    known = tuple(stations)
    for station in known:
        if foreign_request is None or foreign_request.address != station.address:
            continue
        reply = station.decode_reply_to(foreign_request.request, data)
        if reply is not None:
            return UnsolicitedFrame(TraceKind.FOREIGN, station, reply.message, reply.size)
    for station in known:
        reply = None if station.last_request is None else station.decode_reply_to(station.last_request, data)
        if reply is not None:
            kind = TraceKind.LATE if station.state.is_suspect else TraceKind.DUPLICATE
            kind = TraceKind.FOREIGN if after_foreign_request else kind
            return UnsolicitedFrame(kind, station, reply.message, reply.size)
    tried: list[object] = []
    for station in known:
        if any(codec is station.codec for codec in tried):
            continue
        tried.append(station.codec)
        request = decode_request_prefix(station.codec, data)
        if request is not None:
            frame = data[: request.size]
            late = next((other for other in known if is_late_reply(other, request.message, frame)), None)
            kind = TraceKind.FOREIGN_REQUEST if late is None else TraceKind.LATE
            return UnsolicitedFrame(kind, late, request.message, request.size)
    return UnsolicitedFrame(TraceKind.UNSOLICITED, None, None, len(data))


def is_late_reply(station: Station, request: Any, frame: bytes) -> bool:
    """Return whether ``frame``, decoded as ``request``, is the late mirrored reply of a suspect station.

    Such a reply must not block its own drive as the request of a foreign master would.
    """
    codec = station.codec
    request = _without_operation(request)
    if not station.state.is_suspect or codec.address_of(request) != station.address:
        return False
    try:
        return isinstance(codec.decode_reply(request, frame), Complete)
    except ProtocolError:
        return False


def decode_request_prefix(codec: Codec, data: bytes) -> DecodedFrame | None:
    """Return the request at the start of ``data``, None where there is none."""
    try:
        result = codec.decode_request(data)
    except ProtocolError:
        return None
    return None if isinstance(result, Incomplete) else result


def foreign_request_to(
    station: Station, data: bytes, received_at: float, settings: SerialSettings
) -> ForeignRequest | None:
    """Return the request at the start of ``data`` if it addresses this station, with the time of the latest reply."""
    codec, frame = station.codec, decode_request_prefix(station.codec, data)
    if frame is None:
        return None
    request = _without_operation(frame.message)
    if codec.address_of(request) != station.address:
        return None
    wait_s = min(station.config.timing.timeout_s(settings, codec.largest_reply(request)), MAX_FOREIGN_REPLY_WAIT_S)
    return ForeignRequest(station.address, request, received_at, received_at + wait_s)


def _without_operation(request: Any) -> Any:
    """Return a decoded request; that of a C320 has its operation beside it."""
    return getattr(request, "request", request)
