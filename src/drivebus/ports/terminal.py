"""The serial port on POSIX systems: a raw descriptor in the event loop, as each microsecond here is paid per byte.

Opening, locking and proving live in ``posix``; which device it is in ``device``; why not in ``diagnose``.
"""

# ruff: noqa: E402  # the assertion below must come first: type checkers stop there on Windows

from __future__ import annotations

import asyncio
import math
import os
import select
import sys
from collections.abc import Callable, Iterator

assert sys.platform != "win32"

from drivebus.errors import PortLost, PortUnavailable
from drivebus.ports.device import open_same
from drivebus.ports.link import Link
from drivebus.ports.marks import MarkDecoder
from drivebus.ports.port import Capabilities, Echo, Note, Receiver
from drivebus.ports.posix import Descriptor

READ_SIZE = 4096
"""The kernel's own buffer of a terminal."""
STALL_S = 2.0
"""Bytes that the kernel does not take for so long are given up with the port: a start expires after 2 s (ruling 12)."""


class SerialPort:
    """A serial device on a POSIX system."""

    def __init__(self, link: Link) -> None:
        link.only("echo", "rs485")
        self.settings = link.settings
        self.echo: Echo = link.echo()
        self.url = link.text
        self.capabilities = Capabilities()
        self.notes: tuple[Note, ...] = ()
        """Whether the adapter holds bytes back, and whether parity is real."""
        self._path = link.path
        self._rs485 = link.flag("rs485")
        self._identity = ""
        self._descriptor: Descriptor | None = None
        self._fd = -1
        self._waiting = select.poll()
        """Whether there is anything to read: a third of the price of an ``os.read`` that finds nothing."""
        self._receiver: Receiver | None = None
        self._deliver: Callable[[bytes], None] = _nowhere
        self._marks: MarkDecoder | None = None
        self._watching = False
        self._quiet = False
        self._timer: asyncio.TimerHandle | None = None
        self._unsent = bytearray()
        self._stall: asyncio.TimerHandle | None = None
        self._closed: asyncio.Future[None] | None = None

    @property
    def identity(self) -> str:
        """As ``listing.PortInfo.identity``; final once opened, and what a reopening looks for (F12)."""
        return self._identity or f"device:{self._path}"

    async def open(self, receiver: Receiver) -> None:
        """Open, or find the same device again. Raises PortUnavailable with why and what to do."""
        if self._fd >= 0:
            raise PortUnavailable("ports.already-open", port=self._path)
        if self._closed is not None:
            await asyncio.shield(self._closed)
        self._loop = asyncio.get_running_loop()
        opening = self._loop.run_in_executor(None, self._open)
        try:
            descriptor, self._identity = await asyncio.shield(opening)
        except asyncio.CancelledError:
            self._closed = _dropped(opening)
            raise
        self._begin(descriptor, receiver)

    def write(self, data: bytes, /) -> None:
        """At once, or as the kernel takes it; what it does not take within STALL_S costs the port. Raises PortLost."""
        if self._fd < 0:
            raise PortLost("ports.not-open", port=self._path)
        if self._unsent:
            self._unsent += data
            return
        try:
            sent = os.write(self._fd, data)
        except BlockingIOError:
            sent = 0
        except OSError as error:
            raise self._lost(error.strerror or str(error), tell_later=True) from error
        if sent != len(data):
            self._unsent += data[sent:]
            self._loop.add_writer(self._fd, self._writable)
            self._stall = self._loop.call_later(STALL_S, self._lost, "stalled")

    def quiet_until(self, when: float, /) -> None:
        """Leave bytes in the kernel until loop time ``when`` (inf: until called again), then deliver them.

        One epoll change for a whole reply instead of a wake-up for each of its bytes; none at all where the caller
        falls quiet again from within ``data_received``. A hang-up is noticed when the quiet ends.
        """
        if self._fd < 0:
            return
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if when != math.inf and when <= self._loop.time():
            if self._quiet or self._waiting.poll(0):
                self._wake()
            return
        self._quiet = True
        if self._watching:
            self._watching = False
            self._loop.remove_reader(self._fd)
        if when != math.inf:
            self._timer = self._loop.call_at(when, self._wake)

    async def close(self) -> None:
        """Release the device; what the kernel holds is still sent, what it did not take is dropped."""
        self._release()
        if self._closed is not None:
            await asyncio.shield(self._closed)

    def _open(self) -> tuple[Descriptor, str]:
        """In a thread: which device, then open it."""
        return open_same(self._path, self._identity, self.settings, rs485=self._rs485)

    def _begin(self, descriptor: Descriptor, receiver: Receiver) -> None:
        self._descriptor, self._fd = descriptor, descriptor.fd
        self._waiting = select.poll()
        self._waiting.register(self._fd, select.POLLIN)
        self.capabilities, self.notes = descriptor.capabilities, tuple(self._notes(descriptor))
        self._receiver, self._deliver = receiver, receiver.data_received
        self._marks = MarkDecoder() if descriptor.marks else None
        self._quiet = False
        self._watch()

    def _notes(self, descriptor: Descriptor) -> Iterator[Note]:
        if not descriptor.low_latency:
            yield Note("ports.note-latency", {"port": self._path, "device": os.path.basename(descriptor.device)})  # noqa: PTH119
        if self.settings.parity != "N" and not descriptor.capabilities.parity:
            yield Note("ports.note-parity", {"port": self._path, "format": self.settings.format})

    def _watch(self) -> None:
        self._watching = True
        self._loop.add_reader(self._fd, self._readable)

    def _wake(self) -> None:
        """The quiet is over: deliver, and watch again at the loop's next turn unless it is quiet again by then."""
        self._timer = None
        self._quiet = False
        self._readable()
        if not self._watching:
            self._loop.call_soon(self._watch_again)

    def _watch_again(self) -> None:
        if self._fd >= 0 and not self._quiet and not self._watching:
            self._watch()

    def _readable(self) -> None:
        try:
            chunk = os.read(self._fd, READ_SIZE)
        except BlockingIOError:
            return
        except OSError as error:
            self._lost(error.strerror or str(error))
            return
        if not chunk:
            self._lost("hang-up")
        elif self._marks is None:
            self._deliver(chunk)
        else:
            self._deliver_marked(chunk)

    def _deliver_marked(self, chunk: bytes) -> None:
        data, marks = self._marks.decode(chunk) if self._marks else (chunk, 0)
        if data and self._receiver is not None:
            self._receiver.data_received(data, marks)

    def _writable(self) -> None:
        try:
            del self._unsent[: os.write(self._fd, self._unsent)]
        except BlockingIOError:
            return
        except OSError as error:
            self._lost(error.strerror or str(error))
            return
        if not self._unsent:
            self._loop.remove_writer(self._fd)
            self._cancel_stall()

    def _lost(self, reason: str, *, tell_later: bool = False) -> PortLost:
        """Give up the device and tell the receiver, once; ``tell_later`` from within ``write``."""
        error = PortLost("ports.lost", port=self._path, reason=reason)
        receiver = self._receiver
        self._release()
        if receiver is not None and tell_later:
            self._loop.call_soon(receiver.port_lost, error)
        elif receiver is not None:
            receiver.port_lost(error)
        return error

    def _release(self) -> None:
        """Let go of the loop at once and of the device in a thread (closing may wait for the hardware)."""
        if self._fd < 0 or self._descriptor is None:
            return
        self._loop.remove_reader(self._fd)
        self._loop.remove_writer(self._fd)
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        self._cancel_stall()
        self._unsent.clear()
        self._receiver, self._deliver, self._watching, self._fd = None, _nowhere, False, -1
        self._closed = self._loop.run_in_executor(None, self._descriptor.close)
        self._descriptor = None

    def _cancel_stall(self) -> None:
        if self._stall is not None:
            self._stall.cancel()
            self._stall = None


def _nowhere(_: bytes) -> None:
    """Receives for a port that is not open."""


def _dropped(opening: asyncio.Future[tuple[Descriptor, str]]) -> asyncio.Future[None]:
    """Close what a cancelled opening still opens; done when that is done."""
    closed = opening.get_loop().create_future()

    def drop(opened: asyncio.Future[tuple[Descriptor, str]]) -> None:
        if not opened.cancelled() and opened.exception() is None:
            opened.result()[0].close()
        if not closed.done():
            closed.set_result(None)

    opening.add_done_callback(drop)
    return closed
