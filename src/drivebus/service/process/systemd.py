"""Notifications to systemd: ready, stopping, and the watchdog. Without ``NOTIFY_SOCKET`` nothing is sent."""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Iterable, Mapping

from drivebus.service.runtime.bus import BusRuntime

MAX_BUS_LATENESS_S = 5.0  # a bus that is later with due work counts as hanging


class SystemdNotifier:
    """Client of systemd for ``Type=notify`` with ``WatchdogSec``: see ``sd_notify(3)``."""

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        address = environment.get("NOTIFY_SOCKET", "")
        self._address = "\0" + address[1:] if address.startswith("@") else address
        watchdog_us = int(environment.get("WATCHDOG_USEC", "0") or "0")
        self.watchdog_interval_s = watchdog_us / 2e6
        """Interval of the watchdog; 0: there is none."""
        self._watchdog_fed_at: float | None = None

    def send(self, message: str) -> None:
        """Send a message without waiting: a busy systemd must not delay a bus."""
        if not self._address:
            return
        kind = socket.SOCK_DGRAM | socket.SOCK_CLOEXEC | socket.SOCK_NONBLOCK
        with socket.socket(socket.AF_UNIX, kind) as manager, contextlib.suppress(OSError):
            manager.sendto(message.encode(), self._address)

    def feed_watchdog(self, buses: Iterable[BusRuntime], now: float) -> None:
        """Feed the watchdog if every bus does its work; called from the loop of the buses."""
        due = self._watchdog_fed_at is None or now - self._watchdog_fed_at >= self.watchdog_interval_s
        if self.watchdog_interval_s and due and all(is_bus_alive(bus) for bus in buses):
            self._watchdog_fed_at = now
            self.send("WATCHDOG=1")


def is_bus_alive(runtime: BusRuntime) -> bool:
    """Return whether a bus does its due work, or is being opened again."""
    return runtime.bus.is_closed or not runtime.bus.is_open or runtime.bus.overdue_s < MAX_BUS_LATENESS_S
