"""Recording of the bytes of any port into a capture file (format: ``drivebus.capture``)."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

from drivebus import clock
from drivebus.capture.dbcap import CaptureError, CaptureHeader, CaptureWriter
from drivebus.errors import PortLost
from drivebus.ports.base import PausableReader, PendingReader, Port, PortNote, port_notes
from drivebus.serial_settings import SerialSettings
from drivebus.types import Capabilities, EchoSetting, Receiver


class RecordingPort:
    """Port around another port that writes all its bytes to a new capture file, from the first opening on.

    Bytes get the loop's monotonic time at which they were written or delivered. A disk failure ends the capture, not
    the bus: it is in ``error``.
    """

    def __init__(self, port: Port, path: str | Path, *, required: bool = True) -> None:
        """``required`` False: the port also opens where the file can't be created."""
        self._port = port
        self._path = path
        self._is_required = required
        self._writer: CaptureWriter | None = None
        self._creation_error: CaptureError | None = None
        self._receiver: Receiver | None = None
        if isinstance(port, PendingReader):
            self.read_pending = port.read_pending
        if isinstance(port, PausableReader):
            self.pause_reading, self.resume_reading = port.pause_reading, port.resume_reading

    def continue_on(self, port: Port) -> RecordingPort:
        """Return a port that continues this capture on another port: a scan's next serial settings."""
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
    def drive_options(self) -> Mapping[int, Mapping[str, Any]]:
        return getattr(self._port, "drive_options", {})

    @property
    def error(self) -> OSError | CaptureError | None:
        """Error that prevented the capture or ended it early, None while it is complete."""
        return self._creation_error if self._writer is None else self._writer.error

    async def open(self, receiver: Receiver) -> None:
        """Raises CaptureError where a required file can't be created, and what the port raises."""
        self._loop = asyncio.get_running_loop()
        if self._writer is None and self._creation_error is None:
            header = CaptureHeader(
                settings=self.settings,
                port=self.url,
                started=clock.wall_clock().isoformat(),
                writer=f"drivebus {version('drivebus')}",
            )
            try:
                self._writer = CaptureWriter(self._path, header, now=self._loop.time())
            except CaptureError as error:
                if self._is_required:
                    raise
                self._creation_error = error
        self._receiver = receiver
        await self._port.open(self)
        self._record_event(
            "opened",
            baud=self.settings.baud,
            format=self.settings.format,
            identity=self.identity,
            line_timing=self.capabilities.has_line_timing,
            parity=self.capabilities.parity,
        )

    def write(self, data: bytes, /) -> None:
        now = self._loop.time()
        self._port.write(data)
        if self._writer is not None:
            self._writer.write_bytes(now, "tx", data)

    async def close(self) -> None:
        """Close the port; the capture stays open for another opening until ``end_capture``."""
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
