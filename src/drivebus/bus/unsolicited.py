"""Unsolicited bytes: received while no transaction was open, or in one but no part of its reply; never applied.

A frame is a late reply, a second reply, another master's request with its reply, or not attributable. Bytes outside a
transaction are classified once the bus is silent.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

from drivebus.bus.failure_reason import late_reply, late_reply_to_last_request
from drivebus.bus.scheduler import Scheduler
from drivebus.bus.station import Station
from drivebus.bus.statistics import Counters
from drivebus.bus.trace import TraceEvent, TraceKind
from drivebus.bus.transaction import Transaction
from drivebus.errors import AddressError, NoReply, ProtocolError, TrailingError
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


class UnsolicitedFrame(NamedTuple):
    """Classification of the first ``size`` unsolicited bytes."""

    kind: TraceKind
    station: Station | None
    """The station that sent it, where known."""
    message: Any
    size: int


class UnsolicitedBytes:
    """Bytes that belong to no reply: their buffer, and the request of another master whose reply is due.

    Each classified frame is counted, its station is marked suspect where a reply may still come, and it is returned as
    a trace event.
    """

    __slots__ = (
        "_counters",
        "_foreign_request_times",
        "_fragment",
        "_fragment_at",
        "_scheduler",
        "_settings",
        "_stations",
        "buffer",
        "foreign_request",
        "last_byte_at",
    )

    def __init__(
        self, stations: Mapping[int, Station], scheduler: Scheduler, counters: Counters, settings: SerialSettings
    ) -> None:
        """``stations``: those registered now, by address."""
        self._stations = stations
        self._scheduler = scheduler
        self._counters = counters
        self._settings = settings
        self.buffer = bytearray()
        self.last_byte_at = 0.0
        self.foreign_request: ForeignRequest | None = None
        """The foreign request whose reply is due."""
        self._foreign_request_times: list[float] = []
        self._fragment = b""
        """Last bytes that were no frame; what follows soon may complete them."""
        self._fragment_at = float("-inf")

    def add(self, data: bytes, now: float) -> None:
        """Add bytes received while no transaction is open; those beyond the limit are dropped."""
        self.buffer += data
        del self.buffer[MAX_UNSOLICITED_BYTES:]
        self.last_byte_at = now

    def reset(self) -> None:
        """Drop the bytes and the foreign request from before the port was opened."""
        self.buffer.clear()
        self.foreign_request = None

    def has_foreign_master(self, now: float) -> bool:
        """Return whether two foreign requests were received within the window that ends ``now``."""
        recent = [at for at in self._foreign_request_times if now - at <= FOREIGN_MASTER_WINDOW_S]
        return len(recent) >= FOREIGN_REQUESTS_REQUIRED

    # --- outside a transaction -----------------------------------------------------------------------------------

    def classify_buffer(self, now: float) -> list[TraceEvent]:
        """Classify and count the bytes in the buffer, the bus being silent."""
        received_at = self.last_byte_at
        data = self._join_split_request(bytes(self.buffer), received_at)
        self.buffer.clear()
        foreign = self.foreign_request
        if foreign is not None and received_at > foreign.reply_until:
            self.end_foreign_request(now)
        events = []
        while data:
            frame = classify(data, self._stations.values(), self.foreign_request)
            if frame.kind is TraceKind.FOREIGN_REQUEST:
                self._begin_foreign_request(data, received_at, now)
            elif frame.kind is TraceKind.FOREIGN:
                self.foreign_request = None
            elif frame.kind is TraceKind.UNSOLICITED:
                self._fragment, self._fragment_at = data, received_at
            events.append(self._record(frame, data, received_at, now))
            data = data[frame.size :]
        return events

    def _join_split_request(self, data: bytes, received_at: float) -> bytes:
        """Return the bytes, with those before them where only both together are a request of another master."""
        joined = self._join_fragment(data, received_at)
        kinds = [classify(part, self._stations.values()).kind for part in (data, joined)]
        return joined if kinds == [TraceKind.UNSOLICITED, TraceKind.FOREIGN_REQUEST] else data

    def _join_fragment(self, data: bytes, now: float) -> bytes:
        """Return the bytes with the fragment before them, empty where none came shortly before."""
        return self._fragment + data if now - self._fragment_at <= MAX_FRAGMENT_PAUSE_S else b""

    def end_foreign_request(self, now: float) -> None:
        """Mark the station suspect that may still reply to another master."""
        foreign, self.foreign_request = self.foreign_request, None
        if foreign is not None and (station := self._stations.get(foreign.address)) is not None:
            station.remember_unanswered(foreign.request, foreign.received_at, now, is_foreign=True)
            self._scheduler.mark_suspect(station, now)

    def _begin_foreign_request(self, data: bytes, received_at: float, now: float) -> None:
        """Record the request of another master at the start of ``data``, whose reply is due from now on."""
        self.end_foreign_request(now)
        self._record_foreign_master(received_at)
        requests = (
            foreign_request_to(station, data, received_at, self._settings) for station in self._stations.values()
        )
        self.foreign_request = next((request for request in requests if request is not None), None)

    def _record_foreign_master(self, at: float) -> None:
        """Record that another master has sent a request."""
        self._foreign_request_times = [*self._foreign_request_times[-1:], at]

    # --- in a transaction ----------------------------------------------------------------------------------------

    def record_foreign_frames(self, transaction: Transaction, now: float) -> list[TraceEvent]:
        """Count the frames of other stations that were received before the reply."""
        events = []
        for data, error in transaction.foreign_frames or ():
            assert transaction.last_byte_at is not None
            events.append(self._record_foreign_frame(data, error, transaction.last_byte_at, now))
        return events

    def _record_foreign_frame(self, data: bytes, error: AddressError, received_at: float, now: float) -> TraceEvent:
        """Count a complete frame of another station: late where a reply is due, else the reply to a foreign master."""
        station = self._stations.get(error.found) if isinstance(error.found, int) else None
        late = station is not None and station.state.is_suspect
        if station is None:
            self._record_foreign_master(now)
        kind = TraceKind.LATE if late else TraceKind.FOREIGN
        return self._record(UnsolicitedFrame(kind, station, None, len(data)), data, received_at, now)

    def detect_overlapping_request(self, transaction: Transaction, now: float) -> list[TraceEvent]:
        """Count a request of another master whose end was received while we sent: the reply may be that to it."""
        data = self._join_fragment(transaction.bytes_before_tx_end, transaction.sent_at)
        request = decode_request_prefix(transaction.prepared.station.codec, data)
        if request is None:
            return []
        self._begin_foreign_request(data, transaction.sent_at, now)
        self.end_foreign_request(now)
        frame = UnsolicitedFrame(TraceKind.FOREIGN_REQUEST, None, request.message, request.size)
        return [self._record(frame, data, transaction.sent_at, now)]

    def detect_foreign_request(self, transaction: Transaction, error: Exception, now: float) -> list[TraceEvent]:
        """Count a request of another master that was received in place of a reply, or right after it.

        Our own frame is excluded.
        """
        data, prepared, received_at = transaction.buffer, transaction.prepared, transaction.last_byte_at
        if received_at is None:
            return []
        if isinstance(error, TrailingError) and isinstance(error.expected, int):
            data = data[error.expected :]
        request = decode_request_prefix(prepared.station.codec, data)
        if request is None:
            data = self._join_fragment(data, transaction.sent_at)
            request = decode_request_prefix(prepared.station.codec, data)
        if request is None or data[: request.size] == prepared.data:
            return []
        if prepared.station.decode_reply_to(prepared.request, data) is not None:
            return []  # its own reply, with stray bytes or not trusted: one of Huanyang HY has the form of a request
        kind, station, frame = TraceKind.FOREIGN_REQUEST, None, data[: request.size]
        if is_late_reply(prepared.station, request.message, frame):
            kind, station = TraceKind.LATE, prepared.station
        elif frame == prepared.station.last_frame:
            kind, station = TraceKind.DUPLICATE, prepared.station
        else:
            self._begin_foreign_request(data, received_at, now)
        if len(data) > request.size:  # bytes after it may have come after a pause: this time overstates no delay
            received_at = transaction.tx_end_at
        return [self._record(UnsolicitedFrame(kind, station, request.message, request.size), data, received_at, now)]

    # --- each frame ----------------------------------------------------------------------------------------------

    def _record(self, frame: UnsolicitedFrame, data: bytes, received_at: float, now: float) -> TraceEvent:
        """Count the frame at the start of ``data``; a second or a foreign reply makes its station suspect."""
        kind, station, data = frame.kind, frame.station, data[: frame.size]
        self._counters.count_event(kind.value)
        if station is not None:
            station.counters.count_event(kind.value)
            # A late reply after a complete one counts as a duplicate where the station has sent a duplicate before.
            late_duplicate = (
                kind is TraceKind.LATE and station.last_request_answered and station.has_duplicate_address(now, 1)
            )
            if kind is TraceKind.DUPLICATE or late_duplicate:
                station.record_duplicate_reply(now)
            if kind is TraceKind.LATE and (
                reason := late_reply(station, data, received_at)
                or late_reply_to_last_request(station, data, received_at)
            ):  # else it is a wrong value, which may answer each request
                station.last_frame, station.failure_reason = data, reason
            if kind is TraceKind.DUPLICATE or (kind is TraceKind.FOREIGN and frame.message is None):
                self._scheduler.mark_suspect(station, now)
        elif kind is TraceKind.UNSOLICITED:
            self._attribute_to_suspects(data, received_at)
        address = None if station is None else station.address
        return TraceEvent(time=received_at, kind=kind, data=data, station=address, message=frame.message)

    def _attribute_to_suspects(self, data: bytes, received_at: float) -> None:
        """Record bytes of an unknown sender as the failure of each suspect station, which may have sent them late."""
        for station in self._stations.values():
            if not station.state.is_suspect:
                continue
            late = late_reply(station, data, received_at)
            if late is not None:
                station.failure_reason = late
            elif station.failure_reason is None:
                station.failure_reason = NoReply("bus.offline_bytes", station=station.address)


def classify(
    data: bytes, stations: Iterable[Station], foreign_request: ForeignRequest | None = None
) -> UnsolicitedFrame:
    """Classify the beginning of ``data``.

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
            return UnsolicitedFrame(kind, station, reply.message, reply.size)
    for codec in dict.fromkeys(station.codec for station in known):
        request = decode_request_prefix(codec, data)
        if request is not None:
            frame = data[: request.size]
            candidates = (station for station in known if station.codec.family == codec.family)
            late = next((station for station in candidates if is_late_reply(station, request.message, frame)), None)
            kind = TraceKind.FOREIGN_REQUEST if late is None else TraceKind.LATE
            return UnsolicitedFrame(kind, late, request.message, request.size)
    return UnsolicitedFrame(TraceKind.UNSOLICITED, None, None, len(data))


def is_late_reply(station: Station, request: Any, frame: bytes) -> bool:
    """Return whether ``frame``, decoded as ``request``, is the late mirrored reply of a suspect station.

    Such a reply must not block its own drive as the request of a foreign master would.
    """
    request = _without_operation(request)
    return (
        station.state.is_suspect
        and station.codec.address_of(request) == station.address
        and isinstance(station.decode_reply_to(request, frame), Complete)
    )


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
