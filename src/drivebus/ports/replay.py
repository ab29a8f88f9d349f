"""A capture played back as a port: what was received comes again, what is written is compared with what was sent.

``replay://FILE.dbcap`` keeps the capture's own clock from the opening on. With ``timing=request`` it waits at each
frame that was sent until the same frame is written, and goes on from there with the capture's delays: so a host that
is quicker or slower than the one that was recorded still gets each reply after its request.
"""

from __future__ import annotations

import asyncio
from collections import deque
from dataclasses import dataclass

from drivebus.capture import Bytes, Event, Record, read_capture
from drivebus.errors import PortLost, PortUnavailable
from drivebus.line import LineSettings
from drivebus.ports.link import Link
from drivebus.ports.port import Capabilities, Echo, Receiver

END_S = 1.0
"""The port is lost so long after the last record: a reply is believed only after a gap in silence, at any baud."""


@dataclass(frozen=True, slots=True)
class Difference:
    """A frame that was written otherwise than it was recorded."""

    time_s: float
    """On the capture's clock."""
    expected: bytes | None
    """None where the capture had nothing more to send."""
    found: bytes
    line: int = 0
    """Line of the capture that holds the expected frame."""


@dataclass(frozen=True, slots=True)
class ReplayReport:
    """How what was written compares with the capture."""

    matched: int
    differences: tuple[Difference, ...]
    unsent: int
    """Recorded frames that were not written (so far)."""


class ReplayPort:
    """Plays a capture. Loses the port where the capture did, and a second after its end."""

    def __init__(
        self, records: tuple[Record, ...], settings: LineSettings, url: str, *, waits: bool = False, echo: Echo = "off"
    ) -> None:
        """``waits``: timing=request."""
        self.settings = settings
        self.capabilities = Capabilities()
        self.echo: Echo = echo
        self.url = url
        self.identity = url.partition("?")[0]
        self._records = [record for record in records if isinstance(record, Bytes) or record.name == "lost"]
        self._unsent = deque(record for record in records if isinstance(record, Bytes) and record.direction == "tx")
        self._waits = waits
        self._at = 0
        self._zero = 0.0
        self._last_s = 0.0
        self._written: deque[bytes] = deque()
        self._matched = 0
        self._differences: list[Difference] = []
        self._receiver: Receiver | None = None
        self._handle: asyncio.Handle | None = None

    @property
    def report(self) -> ReplayReport:
        return ReplayReport(self._matched, tuple(self._differences), len(self._unsent))

    async def open(self, receiver: Receiver) -> None:
        """Begin, or go on after a recorded loss. Raises PortUnavailable at the end of the capture."""
        if self._receiver is not None:
            raise PortUnavailable("ports.already-open", port=self.url)
        if self._records and self._at == len(self._records):
            raise PortUnavailable("ports.replay-end", port=self.url)
        self._loop = asyncio.get_running_loop()
        self._receiver = receiver
        self._zero = self._loop.time() - self._last_s
        self._handle = self._loop.call_soon(self._play)

    def write(self, data: bytes, /) -> None:
        """Compare with what was sent. Raises PortLost where the port is not open."""
        if self._receiver is None:
            raise PortLost("ports.not-open", port=self.url)
        if self._waits and self._unsent:
            self._written.append(bytes(data))
            self._again(self._loop.call_soon(self._play))
        else:
            self._compare(bytes(data))

    async def close(self) -> None:
        self._receiver = None
        self._again(None)

    def _play(self) -> None:
        """Deliver all that is due, then sleep until the next record, a written frame, or the end."""
        self._again(None)
        while self._receiver is not None:
            if self._at == len(self._records):
                end = self._zero + self._last_s + END_S
                self._again(self._loop.call_at(end, self._lose, "end of the capture"))
                return
            record = self._records[self._at]
            if isinstance(record, Bytes) and record.direction == "tx":
                if self._waits and not self._asked(record):
                    return
            elif self._zero + record.time_s > self._loop.time():
                self._again(self._loop.call_at(self._zero + record.time_s, self._play))
                return
            self._at += 1
            self._last_s = record.time_s
            self._deliver(record)

    def _deliver(self, record: Record) -> None:
        if isinstance(record, Event):
            self._lose(str(record.details.get("reason", record.name)))
        elif record.direction == "rx" and self._receiver is not None:
            self._receiver.data_received(record.data, record.marks)

    def _asked(self, record: Bytes) -> bool:
        """Whether the recorded frame has been written; anything else that was written is a difference."""
        while self._written:
            if self._written[0] == record.data:
                self._zero = self._loop.time() - record.time_s
                self._compare(self._written.popleft())
                return True
            self._differences.append(Difference(self._now_s(), record.data, self._written.popleft(), record.line))
        return False

    def _compare(self, data: bytes) -> None:
        expected = self._unsent.popleft() if self._unsent else None
        if expected is not None and expected.data == data:
            self._matched += 1
        elif expected is not None:
            self._differences.append(Difference(self._now_s(), expected.data, data, expected.line))
        else:
            self._differences.append(Difference(self._now_s(), None, data))

    def _now_s(self) -> float:
        return self._loop.time() - self._zero

    def _lose(self, reason: str) -> None:
        receiver, self._receiver = self._receiver, None
        if receiver is not None:
            receiver.port_lost(PortLost("ports.lost", port=self.url, reason=reason))

    def _again(self, handle: asyncio.Handle | None) -> None:
        if self._handle is not None:
            self._handle.cancel()
        self._handle = handle


def open_port(link: Link) -> ReplayPort:
    """``replay://FILE.dbcap?timing=clock|request``. Raises LinkError, or CaptureError with file and line."""
    link.only("echo", "timing")
    capture = read_capture(link.path)
    recorded = capture.header.settings
    baud = link.settings.baud if "baud" in link.given else recorded.baud
    settings = LineSettings.parse(baud, (link.settings if "format" in link.given else recorded).format)
    echo: Echo = link.echo() if "echo" in link.options else "off"
    waits = link.choice("timing", ("clock", "request"), "clock") == "request"
    return ReplayPort(capture.records, settings, link.text, waits=waits, echo=echo)
