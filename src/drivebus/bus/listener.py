"""Bytes that nobody asked for: heard while idle, told apart once the line is silent, counted, never applied. Pure.

A late answer (F01), a second answer (F15), a request of somebody else (F14), or bytes that nobody can place.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from drivebus.bus.trace import Kind
from drivebus.errors import ProtocolError
from drivebus.message import Complete, Incomplete

if TYPE_CHECKING:
    from drivebus.bus.job import Job
    from drivebus.bus.stations import Station

LONGEST = 512
"""More unasked bytes than this without a pause are forgotten (I12); no frame of these families is longer."""
FOREIGN_FRAMES = 2
FOREIGN_MEMORY_S = 60.0
"""Two requests of somebody else within a minute mean a second master (G18); a minute of peace ends it."""


class Listener:
    """Collects unasked bytes and remembers foreign masters."""

    __slots__ = ("_foreign", "buffer", "heard_at")

    def __init__(self) -> None:
        self.buffer = bytearray()
        self.heard_at = 0.0
        self._foreign: list[float] = []

    def heard(self, data: bytes, now: float) -> None:
        self.buffer += data
        del self.buffer[LONGEST:]
        self.heard_at = now

    def take(self) -> bytes:
        data = bytes(self.buffer)
        self.buffer.clear()
        return data

    def foreign_request(self, now: float) -> None:
        self._foreign = [*self._foreign[-1:], now]

    def foreign_master(self, now: float) -> bool:
        """Were there two foreign requests within a minute, the last less than a minute ago?"""
        recent = [at for at in self._foreign if now - at <= FOREIGN_MEMORY_S]
        return len(recent) >= FOREIGN_FRAMES


def classify(data: bytes, stations: Iterable[Station], after_master: bool) -> tuple[Kind, Station | None, Any, int]:
    """What the beginning of ``data`` is: its kind, the station it came from, the message and its size.

    The mirrored answer of FC06 or FC08 is a valid request too, so what we asked last is looked at before anybody is
    called a foreign master. ``after_master``: a foreign request came just before, so an answer is the answer to that.
    """
    known = tuple(stations)
    for station in known:
        if station.asked is not None and (found := _answer(station.asked, data)) is not None:
            kind = Kind.FOREIGN if after_master else Kind.LATE if station.suspect else Kind.DUPLICATE
            return kind, station, found[0], found[1]
    seen: list[object] = []
    for station in known:
        if not any(codec is station.codec for codec in seen):
            seen.append(station.codec)
            found = request_in(station.codec, data)
            if found is not None:
                debtor = next((one for one in known if owes(one, found[0], data[: found[1]])), None)
                return Kind.MASTER if debtor is None else Kind.LATE, debtor, found[0], found[1]
    return Kind.UNSOLICITED, None, None, len(data)


def owes(station: Station, request: Any, frame: bytes) -> bool:
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


def fits(job: Job, data: bytes) -> bool:
    """Are these bytes an answer to that request?"""
    return _answer(job, data) is not None


def _answer(job: Job, data: bytes) -> tuple[Any, int] | None:
    try:
        verdict = job.codec.decode_reply(job.request, data)
    except ProtocolError:
        return None
    return None if isinstance(verdict, Incomplete) else (verdict.message, verdict.size)


def request_in(codec: Any, data: bytes) -> tuple[Any, int] | None:
    """The request that begins ``data``, with its size."""
    try:
        verdict = codec.decode_request(data)
    except ProtocolError:
        return None
    return None if isinstance(verdict, Incomplete) else (verdict.message, verdict.size)
