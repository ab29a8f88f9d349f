"""A bench behind a pseudo-terminal, for programs that open serial ports. Real time, paced at the line's own baud rate.

Unplugging the bench closes the pty as pulling an adapter does; replugging makes a new one under the same link. The
baud rate that the program sets is compared with the drives'; parity can't be (kernels drop it on ptys).
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import termios
import tty
from pathlib import Path

from drivebus.serial_settings import SerialSettings
from drivebus.simulator.bus import SimulatedBus

PTY_JITTER_S = 0.0005
"""By how much the operating system may shorten a silence that a host kept."""

_BAUDS = {getattr(termios, name): int(name[1:]) for name in dir(termios) if name.startswith("B") and name[1:].isdigit()}


class PtyServer:
    """The far end of one pty. ``path`` is what a program opens. Made by ``serve_pty``."""

    def __init__(self, bench: SimulatedBus, link_path: str | os.PathLike[str] | None, check_baud: bool) -> None:
        self.simulated_bus = bench
        self.settings: SerialSettings | None = None
        self._link = None if link_path is None else Path(link_path)
        self._check_baud = check_baud
        self._loop = asyncio.get_running_loop()
        self._descriptors: tuple[int, int] | None = None
        self._slave = ""
        bench.set_jitter_tolerance(PTY_JITTER_S)
        bench.on_replug.append(self._open)
        self._open()

    @property
    def path(self) -> str:
        """The link where one was asked for, else the device."""
        return str(self._link) if self._link is not None else self._slave

    @property
    def url(self) -> str:
        return (
            f"serial://{self.path}?baud={self.simulated_bus.settings.baud}&format={self.simulated_bus.settings.format}"
        )

    async def close(self) -> None:
        """Take it away. Idempotent."""
        if self._open in self.simulated_bus.on_replug:
            self.simulated_bus.on_replug.remove(self._open)
        self.simulated_bus.detach(self)
        self.on_unplugged()

    def receive(self, data: bytes, marks: int) -> None:
        """Bytes for the program; what it does not read is lost, as on a UART. The kernel shows no parity marks."""
        if self._descriptors is not None:
            with contextlib.suppress(OSError):
                os.write(self._descriptors[0], data)

    def on_unplugged(self) -> None:
        """The bench was unplugged: the program's file descriptor reports a hang-up."""
        ends, self._descriptors = self._descriptors, None
        if ends is None:
            return
        self._loop.remove_reader(ends[0])
        for end in ends:
            os.close(end)
        if self._link is not None:
            self._link.unlink(missing_ok=True)

    def _open(self) -> None:
        master, slave = os.openpty()
        tty.setraw(slave, termios.TCSANOW)
        os.set_blocking(master, False)
        self._descriptors, self._slave = (master, slave), os.ttyname(slave)
        if self._link is not None:
            self._update_link()
        self.simulated_bus.attach(self)
        self._loop.add_reader(master, self._readable)

    def _update_link(self) -> None:
        """The link changes in one step. Raises FileExistsError where it would replace something that is no link."""
        assert self._link is not None
        if self._link.exists() and not self._link.is_symlink():
            raise FileExistsError(str(self._link))
        fresh = self._link.with_name(f".{self._link.name}.{os.getpid()}")
        fresh.unlink(missing_ok=True)
        fresh.symlink_to(self._slave)
        fresh.replace(self._link)

    def _readable(self) -> None:
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
        """A wrong baud rate; None where it is right (or is not checked)."""
        if not self._check_baud or self._descriptors is None:
            return None
        baud = _BAUDS.get(termios.tcgetattr(self._descriptors[0])[5], self.simulated_bus.settings.baud)
        if baud == self.simulated_bus.settings.baud or not baud:
            return None
        line = self.simulated_bus.settings
        return SerialSettings(baud, line.data_bits, line.parity, line.stop_bits)


async def serve_pty(
    bench: SimulatedBus, link_path: str | os.PathLike[str] | None = None, *, check_baud: bool = True
) -> PtyServer:
    """Put a bench behind a new pty (and ``link_path`` as a symbolic link to it). Raises FileExistsError, OSError."""
    return PtyServer(bench, link_path, check_baud)
