"""Simulated bus behind a pseudo-terminal, for programs that open serial ports; paced at its baud rate.

Unplugging the bus closes the pseudo-terminal as unplugging an adapter does; plugging it in opens a new one under the
same path. The program's baud rate is compared with the stations'; its parity can't be (kernels drop it on ptys).
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import termios
import tty
from dataclasses import replace
from pathlib import Path

from drivebus.serial_settings import SerialSettings
from drivebus.simulator.bus import SimulatedBus

PTY_JITTER_S = 0.0005
"""Time by which the operating system may shorten a silence."""

_BAUDS = {getattr(termios, name): int(name[1:]) for name in dir(termios) if name.startswith("B") and name[1:].isdigit()}


class PtyServer:
    """Server of one pseudo-terminal; ``path`` is what a program opens. Created by ``serve_pty``."""

    def __init__(self, bus: SimulatedBus, link_path: str | os.PathLike[str] | None) -> None:
        self.simulated_bus = bus
        self.settings: SerialSettings | None = None
        self._link = None if link_path is None else Path(link_path)
        self._loop = asyncio.get_running_loop()
        self._descriptors: tuple[int, int] | None = None
        self._slave = ""
        bus.set_jitter_tolerance(PTY_JITTER_S)
        bus.on_replug.append(self._open)
        self._open()

    @property
    def path(self) -> str:
        """Path of the symbolic link if there is one, else of the device."""
        return str(self._link) if self._link is not None else self._slave

    @property
    def url(self) -> str:
        return (
            f"serial://{self.path}?baud={self.simulated_bus.settings.baud}&format={self.simulated_bus.settings.format}"
        )

    async def close(self) -> None:
        """Close the pseudo-terminal. Idempotent."""
        if self._open in self.simulated_bus.on_replug:
            self.simulated_bus.on_replug.remove(self._open)
        self.simulated_bus.detach(self)
        self.on_unplugged()

    def receive(self, data: bytes, line_errors: int) -> None:
        """Deliver bytes to the program; bytes that it does not read are lost, as on a UART."""
        if self._descriptors is not None:
            with contextlib.suppress(OSError):
                os.write(self._descriptors[0], data)

    def on_unplugged(self) -> None:
        """Remove the link, then close the descriptors, which is a hang-up for the program."""
        ends, self._descriptors = self._descriptors, None
        if ends is None:
            return
        self._loop.remove_reader(ends[0])
        if self._link is not None:
            self._link.unlink(missing_ok=True)
        for end in ends:
            os.close(end)

    def _open(self) -> None:
        master, slave = os.openpty()
        tty.setraw(slave, termios.TCSANOW)
        os.set_blocking(master, False)
        self._descriptors, self._slave = (master, slave), os.ttyname(slave)
        if self._link is not None:
            self._update_link()
        self.simulated_bus.attach(self)
        self._loop.add_reader(master, self._on_readable)

    def _update_link(self) -> None:
        """Replace the symbolic link in one step. Raises FileExistsError where the path is no symbolic link."""
        assert self._link is not None
        if self._link.exists() and not self._link.is_symlink():
            raise FileExistsError(str(self._link))
        fresh = self._link.with_name(f".{self._link.name}.{os.getpid()}")
        fresh.unlink(missing_ok=True)
        fresh.symlink_to(self._slave)
        fresh.replace(self._link)

    def _on_readable(self) -> None:
        if self._descriptors is None:
            return
        try:
            data = os.read(self._descriptors[0], 4096)
        except OSError:
            return
        if data:
            self.settings = self._program_settings()
            self.simulated_bus.transmit(self, data)

    def _program_settings(self) -> SerialSettings | None:
        """Return the program's settings where its baud rate is wrong, else None."""
        if self._descriptors is None:
            return None
        settings = self.simulated_bus.settings
        baud = _BAUDS.get(termios.tcgetattr(self._descriptors[0])[5], settings.baud)
        return None if baud == settings.baud or not baud else replace(settings, baud=baud)


async def serve_pty(bus: SimulatedBus, link_path: str | os.PathLike[str] | None = None) -> PtyServer:
    """Serve a simulated bus on a new pseudo-terminal. Raises FileExistsError, OSError."""
    return PtyServer(bus, link_path)
