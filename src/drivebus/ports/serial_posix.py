"""Serial port on POSIX systems: a raw descriptor in the event loop, because layers in between cost time for each byte.

Opening, locking and verifying are in ``tty``, the messages for failures in ``open_errors``.
"""

# ruff: noqa: E402  # the assertion below must come first: type checkers stop there on Windows

from __future__ import annotations

import asyncio
import os
import select
import sys
from collections.abc import Callable, Iterator

assert sys.platform != "win32"

from drivebus.errors import PortLost, PortUnavailable, SystemReason
from drivebus.ports.base import PortNote
from drivebus.ports.parmrk import ParityMarkDecoder
from drivebus.ports.tty import SerialDescriptor, open_by_identity
from drivebus.ports.url import PortUrl
from drivebus.types import Capabilities, EchoSetting, Receiver

READ_SIZE = 4096  # bytes, the kernel's own buffer of a terminal
WRITE_STALL_TIMEOUT_S = 2.0  # bytes that the kernel does not accept are dropped with the port: a start lives 2 s


class SerialPort:
    """A serial device on a POSIX system."""

    def __init__(self, url: PortUrl) -> None:
        """Raises PortUrlError for an unknown option."""
        url.reject_unknown_options("echo", "rs485")
        self.settings = url.settings
        self.echo: EchoSetting = url.echo()
        self.url = url.text
        self.capabilities = Capabilities()
        self.notes: tuple[PortNote, ...] = ()
        """Notes about an adapter that delays bytes and about parity that is not checked."""
        self._path = url.path
        self._rs485 = url.flag("rs485")
        self._identity = ""
        self._descriptor: SerialDescriptor | None = None
        self._fd = -1
        self._poller = select.poll()
        """Check for bytes to read, at a third of the cost of an ``os.read`` without any."""
        self._receiver: Receiver | None = None
        self._deliver: Callable[[bytes], None] = _discard
        self._mark_decoder: ParityMarkDecoder | None = None
        self._reading = False
        """Whether the descriptor is registered with the loop."""
        self._unsent = bytearray()
        self._stall: asyncio.TimerHandle | None = None
        self._closed: asyncio.Future[None] | None = None

    @property
    def identity(self) -> str:
        """Identity as in ``discovery.PortInfo``, final once opened, with which the device is found again."""
        return self._identity or f"device:{self._path}"

    async def open(self, receiver: Receiver) -> None:
        """Open, or find the same device again. Raises PortUnavailable with the reason and the remedy."""
        if self._fd >= 0:
            raise PortUnavailable("ports.already_open", port=self._path)
        if self._closed is not None:
            await asyncio.shield(self._closed)
        self._loop = asyncio.get_running_loop()
        opening = self._loop.run_in_executor(None, self._open)
        try:
            descriptor, self._identity = await asyncio.shield(opening)
        except asyncio.CancelledError:
            self._closed = _close_when_opened(opening)
            raise
        self._start(descriptor, receiver)

    def write(self, data: bytes, /) -> None:
        """Send at once, or as the kernel accepts it. Raises PortLost.

        The port is lost where the kernel does not accept the bytes within ``WRITE_STALL_TIMEOUT_S``.
        """
        if self._fd < 0:
            raise PortLost("ports.not_open", port=self._path)
        if self._unsent:
            self._unsent += data
            return
        try:
            sent = os.write(self._fd, data)
        except BlockingIOError:
            sent = 0
        except OSError as error:
            raise self._fail(SystemReason(error), notify_later=True) from error
        if sent != len(data):
            self._unsent += data[sent:]
            self._loop.add_writer(self._fd, self._writable)
            self._stall = self._loop.call_later(WRITE_STALL_TIMEOUT_S, self._fail, PortLost("ports.stalled"))

    def pause_reading(self) -> None:
        """Leave bytes in the kernel, as ``PausableReader`` describes."""
        if self._reading:
            self._reading = False
            self._loop.remove_reader(self._fd)

    def resume_reading(self) -> None:
        """Deliver bytes as they come."""
        if not self._reading and self._fd >= 0:
            self._reading = True
            self._loop.add_reader(self._fd, self._readable)

    def read_pending(self) -> None:
        """Deliver the bytes that the kernel holds now."""
        if self._fd >= 0 and self._poller.poll(0):
            self._readable()

    async def close(self) -> None:
        """Release the device; bytes that the kernel has accepted are still sent, all others dropped."""
        self._release()
        if self._closed is not None:
            await asyncio.shield(self._closed)

    def _open(self) -> tuple[SerialDescriptor, str]:
        """Find and open the device; runs in a thread."""
        return open_by_identity(self._path, self._identity, self.settings, rs485=self._rs485)

    def _start(self, descriptor: SerialDescriptor, receiver: Receiver) -> None:
        self._descriptor, self._fd = descriptor, descriptor.fd
        self._poller = select.poll()
        self._poller.register(self._fd, select.POLLIN)
        self.capabilities, self.notes = descriptor.capabilities, tuple(self._notes(descriptor))
        self._receiver, self._deliver = receiver, receiver.data_received
        self._mark_decoder = ParityMarkDecoder() if descriptor.marks_line_errors else None
        self.resume_reading()

    def _notes(self, descriptor: SerialDescriptor) -> Iterator[PortNote]:
        if not descriptor.low_latency:
            name = os.path.basename(descriptor.device)  # noqa: PTH119
            yield PortNote("ports.note_latency", {"port": self._path, "device": name})
        if self.settings.parity != "N" and not descriptor.capabilities.parity:
            yield PortNote("ports.note_parity", {"port": self._path, "format": self.settings.format})

    def _readable(self) -> None:
        try:
            chunk = os.read(self._fd, READ_SIZE)
        except BlockingIOError:
            return
        except OSError as error:
            self._fail(SystemReason(error))
            return
        if not chunk:
            self._fail(PortLost("ports.hang_up"))
        elif self._mark_decoder is None:
            self._deliver(chunk)
        else:
            self._deliver_marked(chunk, self._mark_decoder)

    def _deliver_marked(self, chunk: bytes, decoder: ParityMarkDecoder) -> None:
        data, line_errors = decoder.decode(chunk)
        if data and self._receiver is not None:
            self._receiver.data_received(data, line_errors)

    def _writable(self) -> None:
        try:
            del self._unsent[: os.write(self._fd, self._unsent)]
        except BlockingIOError:
            return
        except OSError as error:
            self._fail(SystemReason(error))
            return
        if not self._unsent:
            self._loop.remove_writer(self._fd)
            self._cancel_stall()

    def _fail(self, reason: SystemReason | PortLost, *, notify_later: bool = False) -> PortLost:
        """Release the device and notify the receiver, once; ``notify_later`` from within ``write``."""
        error = PortLost("ports.lost", port=self._path, reason=reason)
        receiver = self._receiver
        self._release()
        if receiver is not None and notify_later:
            self._loop.call_soon(receiver.port_lost, error)
        elif receiver is not None:
            receiver.port_lost(error)
        return error

    def _release(self) -> None:
        """Leave the loop at once, and close the device in a thread (closing may wait for the hardware)."""
        if self._fd < 0 or self._descriptor is None:
            return
        self._loop.remove_reader(self._fd)
        self._loop.remove_writer(self._fd)
        self._cancel_stall()
        self._unsent.clear()
        self._receiver, self._deliver, self._reading, self._fd = None, _discard, False, -1
        self._closed = self._loop.run_in_executor(None, self._descriptor.close)
        self._descriptor = None

    def _cancel_stall(self) -> None:
        if self._stall is not None:
            self._stall.cancel()
            self._stall = None


def _discard(_: bytes) -> None:
    """Discard the bytes of a port that is not open."""


def _close_when_opened(opening: asyncio.Future[tuple[SerialDescriptor, str]]) -> asyncio.Future[None]:
    """Close the descriptor that a cancelled opening still opens; return the future of its end."""
    closed = opening.get_loop().create_future()

    def close(opened: asyncio.Future[tuple[SerialDescriptor, str]]) -> None:
        if not opened.cancelled() and opened.exception() is None:
            opened.result()[0].close()
        if not closed.done():
            closed.set_result(None)

    opening.add_done_callback(close)
    return closed
