"""Telling systemd: ready, stopping, and that the buses' loops go on. Nothing happens where nobody asked for it."""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Iterable, Mapping

from drivebus.service.runtime.bus import BusRuntime

MAX_BUS_LATENESS_S = 5.0
"""A bus that is so late with what was due is not alive."""


class SystemdNotifier:
    """``Type=notify`` with ``WatchdogSec``: see ``sd_notify(3)``."""

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        address = environment.get("NOTIFY_SOCKET", "")
        self._address = "\0" + address[1:] if address.startswith("@") else address
        watchdog_us = int(environment.get("WATCHDOG_USEC", "0") or "0")
        self.watchdog_interval_s = watchdog_us / 2e6
        """How often the watchdog is to be fed; 0: there is none."""
        self._watchdog_fed_at: float | None = None

    def send(self, message: str) -> None:
        """One message. A manager that is gone, or so busy that it takes none, must not hold up a bus."""
        if not self._address:
            return
        kind = socket.SOCK_DGRAM | socket.SOCK_CLOEXEC | socket.SOCK_NONBLOCK
        with socket.socket(socket.AF_UNIX, kind) as manager, contextlib.suppress(OSError):
            manager.sendto(message.encode(), self._address)

    def feed_watchdog(self, lines: Iterable[BusRuntime], now: float) -> None:
        """Feed the watchdog, if the loop of every bus goes on: called from that very loop (6.6)."""
        due = self._watchdog_fed_at is None or now - self._watchdog_fed_at >= self.watchdog_interval_s
        if self.watchdog_interval_s and due and all(is_bus_alive(line) for line in lines):
            self._watchdog_fed_at = now
            self.send("WATCHDOG=1")


def is_bus_alive(line: BusRuntime) -> bool:
    """It does what is due, or is known to be lost and is being opened again."""
    return line.bus.is_closed or not line.bus.is_open or line.bus.overdue_s < MAX_BUS_LATENESS_S
