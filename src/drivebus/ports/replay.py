"""A capture played back as a port: what was received comes again, what is written is compared with what was sent.

``replay://FILE.dbcap`` keeps the capture's own clock from the opening on. With ``timing=request`` it waits at each
frame that was sent until the same frame is written, and goes on from there with the capture's delays: so a host that
is quicker or slower than the one that was recorded still gets each reply after its request.
"""

from __future__ import annotations

import asyncio
from collections import deque
from dataclasses import dataclass

from drivebus.capture.dbcap import BytesRecord, EventRecord, Record, read_capture
from drivebus.errors import PortLost, PortUnavailable
from drivebus.ports.base import Capabilities, EchoSetting, Receiver
from drivebus.ports.url import PortUrl
from drivebus.serial_settings import SerialSettings

REPLAY_END_DELAY_S = 1.0
"""The port is lost so long after the last record: a reply is believed only after a gap in silence, at any baud."""


@dataclass(frozen=True, slots=True)
class ReplayDifference:
    """A frame that was written otherwise than it was recorded."""

    time_s: float
    """On the capture's clock."""
    expected: bytes | None
    """None where the capture had nothing more to send."""
    found: bytes
    line_number: int = 0
    """Line of the capture that holds the expected frame."""


@dataclass(frozen=True, slots=True)
class ReplayReport:
    """How what was written compares with the capture."""

    matched: int
    differences: tuple[ReplayDifference, ...]
    unsent: int
    """Recorded frames that were not written (so far)."""


class ReplayPort:
    """Plays a capture. Loses the port where the capture did, and a second after its end."""

    def __init__(
        self,
        records: tuple[Record, ...],
        settings: SerialSettings,
        url: str,
        *,
        wait_for_request: bool = False,
        echo: EchoSetting = "off",
    ) -> None:
        """``waits``: timing=request."""
        self.settings = settings
        self.capabilities = Capabilities()
        self.echo: EchoSetting = echo
        self.url = url
        self.identity = url.partition("?")[0]
        self._records = [record for record in records if isinstance(record, BytesRecord) or record.name == "lost"]
        self._unsent = deque(
            record for record in records if isinstance(record, BytesRecord) and record.direction == "tx"
        )
        self._wait_for_request = wait_for_request
        self._position = 0
        self._started_at = 0.0
        self._last_s = 0.0
        self._written: deque[bytes] = deque()
        self._matched = 0
        self._differences: list[ReplayDifference] = []
        self._receiver: Receiver | None = None
        self._handle: asyncio.Handle | None = None

    @property
    def report(self) -> ReplayReport:
        return ReplayReport(self._matched, tuple(self._differences), len(self._unsent))

    async def open(self, receiver: Receiver) -> None:
        """Begin, or go on after a recorded loss. Raises PortUnavailable at the end of the capture."""
        if self._receiver is not None:
            raise PortUnavailable("ports.already-open", port=self.url)
        if self._records and self._position == len(self._records):
            raise PortUnavailable("ports.replay-end", port=self.url)
        self._loop = asyncio.get_running_loop()
        self._receiver = receiver
        self._started_at = self._loop.time() - self._last_s
        self._handle = self._loop.call_soon(self._play)

    def write(self, data: bytes, /) -> None:
        """Compare with what was sent. Raises PortLost where the port is not open."""
        if self._receiver is None:
            raise PortLost("ports.not-open", port=self.url)
        if self._wait_for_request and self._unsent:
            self._written.append(bytes(data))
            self._set_handle(self._loop.call_soon(self._play))
        else:
            self._compare(bytes(data))

    async def close(self) -> None:
        self._receiver = None
        self._set_handle(None)

    def _play(self) -> None:
        """Deliver all that is due, then sleep until the next record, a written frame, or the end."""
        self._set_handle(None)
        while self._receiver is not None:
            if self._position == len(self._records):
                end = self._started_at + self._last_s + REPLAY_END_DELAY_S
                self._set_handle(self._loop.call_at(end, self._lose, "end of the capture"))
                return
            record = self._records[self._position]
            if isinstance(record, BytesRecord) and record.direction == "tx":
                if self._wait_for_request and not self._request_written(record):
                    return
            elif self._started_at + record.time_s > self._loop.time():
                self._set_handle(self._loop.call_at(self._started_at + record.time_s, self._play))
                return
            self._position += 1
            self._last_s = record.time_s
            self._deliver(record)

    def _deliver(self, record: Record) -> None:
        if isinstance(record, EventRecord):
            self._lose(str(record.details.get("reason", record.name)))
        elif record.direction == "rx" and self._receiver is not None:
            self._receiver.data_received(record.data, record.line_errors)

    def _request_written(self, record: BytesRecord) -> bool:
        """Whether the recorded frame has been written; anything else that was written is a difference."""
        while self._written:
            if self._written[0] == record.data:
                self._started_at = self._loop.time() - record.time_s
                self._compare(self._written.popleft())
                return True
            self._differences.append(
                ReplayDifference(self._now_s(), record.data, self._written.popleft(), record.line_number)
            )
        return False

    def _compare(self, data: bytes) -> None:
        expected = self._unsent.popleft() if self._unsent else None
        if expected is not None and expected.data == data:
            self._matched += 1
        elif expected is not None:
            self._differences.append(ReplayDifference(self._now_s(), expected.data, data, expected.line_number))
        else:
            self._differences.append(ReplayDifference(self._now_s(), None, data))

    def _now_s(self) -> float:
        return self._loop.time() - self._started_at

    def _lose(self, reason: str) -> None:
        receiver, self._receiver = self._receiver, None
        if receiver is not None:
            receiver.port_lost(PortLost("ports.lost", port=self.url, reason=reason))

    def _set_handle(self, handle: asyncio.Handle | None) -> None:
        if self._handle is not None:
            self._handle.cancel()
        self._handle = handle


def open_port(link: PortUrl) -> ReplayPort:
    """``replay://FILE.dbcap?timing=clock|request``. Raises PortUrlError, or CaptureError with file and line."""
    link.reject_unknown_options("echo", "timing")
    capture = read_capture(link.path)
    recorded = capture.header.settings
    baud = link.settings.baud if "baud" in link.explicit else recorded.baud
    settings = SerialSettings.parse(baud, (link.settings if "format" in link.explicit else recorded).format)
    echo: EchoSetting = link.echo() if "echo" in link.options else "off"
    waits = link.choice("timing", ("clock", "request"), "clock") == "request"
    return ReplayPort(capture.records, settings, link.text, wait_for_request=waits, echo=echo)
