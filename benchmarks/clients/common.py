"""Arguments, sequence of requests and printed figures of every measured client."""

from __future__ import annotations

import json
import os
import resource
import sys
import threading
import time
from typing import Any

PATH, STATIONS, SECONDS, BAUD = sys.argv[1], int(sys.argv[2]), float(sys.argv[3]), int(sys.argv[4])
REPLY_DELAY_S = float(sys.argv[6]) if len(sys.argv) > 6 else None
"""Longest reply delay of the stations; None: each client's own."""
REGISTERS = 4


def _compute_forever() -> None:
    while True:
        json.loads(json.dumps(list(range(100))))


if os.environ.get("BUSY_THREAD"):  # set by ``benchmarks.harness.run_client``
    threading.Thread(target=_compute_forever, daemon=True).start()


def is_wrong_reply(station: int, register: int, values: Any) -> bool:
    """Return whether the accepted values belong to another request."""
    return list(values) != [station << 8 | (register + n) & 255 for n in range(REGISTERS)]


class ClientMeter:
    """CPU and wall time from its creation to ``report``."""

    def __init__(self) -> None:
        self.done = self.failed = self.wrong = 0
        self.cpu, self.wall = self._cpu(), time.monotonic()

    @staticmethod
    def _cpu() -> float:
        used = resource.getrusage(resource.RUSAGE_SELF)
        return used.ru_utime + used.ru_stime

    def is_over(self) -> bool:
        return time.monotonic() - self.wall >= SECONDS

    def report(self, **more: Any) -> None:
        """Print the figures as one JSON line for the harness."""
        wall, cpu = time.monotonic() - self.wall, self._cpu() - self.cpu
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        figures = {"done": self.done, "failed": self.failed, "wrong": self.wrong, "cpu_s": cpu, "wall_s": wall}
        print(json.dumps(figures | {"peak_kib": peak} | more), flush=True)
