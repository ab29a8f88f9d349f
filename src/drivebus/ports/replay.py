"""Replay of a capture as a port: received bytes are delivered again, written bytes are compared with the sent ones.

``replay://FILE.dbcap`` keeps the capture's own times from the opening on. With ``timing=request`` it waits at each
recorded frame until the same frame is written, and continues with the capture's delays: a master that is faster or
slower than the recorded one still gets each reply after its request.
"""

from __future__ import annotations

import asyncio
from collections import deque
from dataclasses import dataclass

from drivebus.capture.dbcap import BytesRecord, EventRecord, Record, read_capture
from drivebus.errors import PortLost, PortUnavailable
from drivebus.ports.url import PortUrl
from drivebus.serial_settings import SerialSettings
from drivebus.types import Capabilities, EchoSetting, Receiver

REPLAY_END_DELAY_S = 1.0  # after the last record, then the port is lost: a last reply counts only after a gap


@dataclass(frozen=True, slots=True)
class ReplayDifference:
    """Difference between a written frame and the recorded one."""

    time_s: float
    """Time on the clock of the capture."""
    expected: bytes | None
    """Recorded frame, None after the last one."""
    found: bytes
    line_number: int = 0
    """Line of the capture that holds the expected frame."""


@dataclass(frozen=True, slots=True)
class ReplayReport:
    """Comparison of the written frames with the capture."""

    matched: int
    differences: tuple[ReplayDifference, ...]
    unsent: int
    """Recorded frames that have not been written yet."""


class ReplayPort:
    """Port that replays a capture; it is lost where the recorded port was lost, and a second after the end."""

    def __init__(
        self,
        records: tuple[Record, ...],
        settings: SerialSettings,
        url: str,
        *,
        wait_for_request: bool = False,
        echo: EchoSetting = "off",
    ) -> None:
        """``wait_for_request``: timing=request."""
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
        return ReplayReport(matched=self._matched, differences=tuple(self._differences), unsent=len(self._unsent))

    async def open(self, receiver: Receiver) -> None:
        """Begin, or continue after a recorded loss. Raises PortUnavailable at the end of the capture."""
        if self._receiver is not None:
            raise PortUnavailable("ports.already_open", port=self.url)
        if self._records and self._position == len(self._records):
            raise PortUnavailable("ports.replay_end", port=self.url)
        self._loop = asyncio.get_running_loop()
        self._receiver = receiver
        self._started_at = self._loop.time() - self._last_s
        self._handle = self._loop.call_soon(self._play)

    def write(self, data: bytes, /) -> None:
        """Compare bytes with the recorded frame. Raises PortLost where the port is not open."""
        if self._receiver is None:
            raise PortLost("ports.not_open", port=self.url)
        if self._wait_for_request and self._unsent:
            self._written.append(bytes(data))
            self._set_handle(self._loop.call_soon(self._play))
        else:
            self._compare(bytes(data))

    async def close(self) -> None:
        self._receiver = None
        self._set_handle(None)

    def _play(self) -> None:
        """Deliver all due records, then wait for the time of the next one, a written frame, or the end."""
        self._set_handle(None)
        while self._receiver is not None:
            if self._position == len(self._records):
                end = self._started_at + self._last_s + REPLAY_END_DELAY_S
                self._set_handle(self._loop.call_at(end, self._lose, PortLost("ports.capture_end")))
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
        """Return whether the recorded frame has been written; any other written frame is a difference."""
        while self._written:
            if self._written[0] == record.data:
                self._started_at = self._loop.time() - record.time_s
                self._compare(self._written.popleft())
                return True
            self._differ(record, self._written.popleft())
        return False

    def _compare(self, data: bytes) -> None:
        expected = self._unsent.popleft() if self._unsent else None
        if expected is not None and expected.data == data:
            self._matched += 1
        else:
            self._differ(expected, data)

    def _differ(self, expected: BytesRecord | None, found: bytes) -> None:
        self._differences.append(
            ReplayDifference(
                time_s=self._loop.time() - self._started_at,
                expected=None if expected is None else expected.data,
                found=found,
                line_number=0 if expected is None else expected.line_number,
            )
        )

    def _lose(self, reason: str | PortLost) -> None:
        receiver, self._receiver = self._receiver, None
        if receiver is not None:
            receiver.port_lost(PortLost("ports.lost", port=self.url, reason=reason))

    def _set_handle(self, handle: asyncio.Handle | None) -> None:
        """Replace the callback that is scheduled."""
        if self._handle is not None:
            self._handle.cancel()
        self._handle = handle


def open_port(url: PortUrl) -> ReplayPort:
    """Return the port of ``replay://FILE.dbcap?timing=clock|request``.

    Raises PortUrlError, or CaptureError with file and line.
    """
    url.reject_unknown_options("echo", "timing")
    capture = read_capture(url.path)
    recorded = capture.header.settings
    baud = url.settings.baud if "baud" in url.explicit else recorded.baud
    settings = SerialSettings.parse(baud, (url.settings if "format" in url.explicit else recorded).format)
    echo: EchoSetting = url.echo() if "echo" in url.options else "off"
    wait_for_request = url.choice("timing", ("clock", "request"), "clock") == "request"
    return ReplayPort(capture.records, settings, url.text, wait_for_request=wait_for_request, echo=echo)
