"""Wrapper that records every byte of another port in the format of ``drivebus.capture.dbcap``."""

from __future__ import annotations

import asyncio
from importlib.metadata import version
from pathlib import Path

from drivebus import clock
from drivebus.capture.dbcap import CaptureHeader, CaptureWriter
from drivebus.errors import PortLost
from drivebus.ports.base import Capabilities, EchoSetting, PausableReader, Port, PortNote, Receiver, port_notes
from drivebus.serial_settings import SerialSettings


class RecordingPort:
    """Passes everything on, and writes it to a new capture file from the first opening on.

    Bytes get the loop's monotonic time at which they were written or delivered. ``error`` tells if the disk failed:
    the bus goes on, the capture ends (G14).
    """

    def __init__(self, port: Port, path: str | Path) -> None:
        self._port = port
        self._path = path
        self._writer: CaptureWriter | None = None
        self._receiver: Receiver | None = None
        if isinstance(port, PausableReader):
            self.pause_until = port.pause_until

    def continue_on(self, port: Port) -> RecordingPort:
        """The same capture, going on around another port: the next line setting of a scan. Opened before this."""
        other = RecordingPort(port, self._path)
        other._writer = self._writer
        return other

    @property
    def settings(self) -> SerialSettings:
        return self._port.settings

    @property
    def capabilities(self) -> Capabilities:
        return self._port.capabilities

    @property
    def identity(self) -> str:
        return self._port.identity

    @property
    def url(self) -> str:
        return self._port.url

    @property
    def echo(self) -> EchoSetting:
        return self._port.echo

    @property
    def notes(self) -> tuple[PortNote, ...]:
        return port_notes(self._port)

    @property
    def error(self) -> OSError | None:
        """Why the capture ended early, None while it is whole."""
        return None if self._writer is None else self._writer.error

    async def open(self, receiver: Receiver) -> None:
        """Raises CaptureError where the file can't be created, else as the port does."""
        self._loop = asyncio.get_running_loop()
        if self._writer is None:
            writer = f"drivebus {version('drivebus')}"
            header = CaptureHeader(self.settings, self.url, clock.wall_clock().isoformat(), writer)
            self._writer = CaptureWriter(self._path, header, now=self._loop.time())
        self._receiver = receiver
        await self._port.open(self)
        line, can = self.settings, self.capabilities
        self._record_event(
            "opened",
            baud=line.baud,
            format=line.format,
            identity=self.identity,
            paced=can.has_line_timing,
            parity=can.parity,
        )

    def write(self, data: bytes, /) -> None:
        now = self._loop.time()
        self._port.write(data)
        if self._writer is not None:
            self._writer.write_bytes(now, "tx", data)

    async def close(self) -> None:
        """Closes the port; the capture stays open for another opening until ``end_capture``."""
        await self._port.close()
        self._record_event("closed")

    def end_capture(self) -> None:
        """Close the capture file. Idempotent."""
        if self._writer is not None:
            self._writer.close()

    def data_received(self, data: bytes, line_errors: int = 0) -> None:
        if self._writer is not None:
            self._writer.write_bytes(self._loop.time(), "rx", data, line_errors)
        if self._receiver is not None:
            self._receiver.data_received(data, line_errors)

    def port_lost(self, error: PortLost) -> None:
        self._record_event("lost", reason=str(error.params.get("reason", error.key)))
        if self._receiver is not None:
            self._receiver.port_lost(error)

    def _record_event(self, name: str, **details: object) -> None:
        if self._writer is not None:
            self._writer.write_event(self._loop.time(), name, **details)
