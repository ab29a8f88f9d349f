"""COM port on Windows, by serialx's own transport (overlapped I/O on a proactor loop).

Not verified on Windows. The Windows driver reports parity errors only in counters that belong to no byte, so
``parity`` is False here and DZB100 drives lose their only check (shown in the capabilities).
"""

from __future__ import annotations

import asyncio

from drivebus.errors import PortLost, PortUnavailable, SystemReason
from drivebus.ports import open_errors, serialx_adapter
from drivebus.ports.url import PortUrl
from drivebus.types import Capabilities, EchoSetting, Receiver

MAX_UNSENT_BYTES = 512  # more than two frames waiting means that the driver does not send


class WindowsPort(asyncio.Protocol):
    """A COM port. Needs the proactor loop, the default on Windows."""

    def __init__(self, url: PortUrl) -> None:
        """Raises PortUrlError for an unknown option."""
        url.reject_unknown_options("echo")
        self.settings = url.settings
        self.echo: EchoSetting = url.echo()
        self.url = url.text
        self.capabilities = Capabilities(has_line_timing=True)
        self._path = url.path
        self._transport: asyncio.WriteTransport | None = None
        self._receiver: Receiver | None = None

    @property
    def identity(self) -> str:
        """The COM number, which Windows keeps for a USB adapter by its serial number."""
        return "device:" + self._path.upper().removeprefix("\\\\.\\")

    async def open(self, receiver: Receiver) -> None:
        """Raises PortUnavailable with the reason and the remedy."""
        if self._transport is not None:
            raise PortUnavailable("ports.already_open", port=self._path)
        try:
            self._transport = await serialx_adapter.connect_windows(self._path, self.settings, self)
        except OSError as error:
            raise open_errors.open_error(self._path, error) from error
        self._receiver = receiver

    def write(self, data: bytes, /) -> None:
        """Raises PortLost where the port is not open or the driver accepts nothing any more."""
        if self._transport is None:
            raise PortLost("ports.not_open", port=self._path)
        if self._transport.get_write_buffer_size() > MAX_UNSENT_BYTES:
            self._transport.abort()
            raise PortLost("ports.lost", port=self._path, reason=PortLost("ports.stalled"))
        self._transport.write(data)

    async def close(self) -> None:
        self._receiver = None
        transport, self._transport = self._transport, None
        if transport is not None:
            transport.close()

    def data_received(self, data: bytes) -> None:
        if self._receiver is not None:
            self._receiver.data_received(data)

    def connection_lost(self, exc: Exception | None) -> None:
        receiver, self._receiver = self._receiver, None
        self._transport = None
        if receiver is not None:
            reason = PortLost("ports.closed") if exc is None else SystemReason(exc)
            receiver.port_lost(PortLost("ports.lost", port=self._path, reason=reason))
