"""Writer killed at random moments: flushed samples exist once and the file is valid (about 10 s).

``DRIVEBUS_KILLS=1000`` makes the long run.
"""

from __future__ import annotations

import json
import os
import random
import signal
import sqlite3
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from drivebus.service.api.operations.history import TimeRangeParams
from drivebus.service.config.model import HistoryConfig
from drivebus.service.historian import Historian
from drivebus.service.historian.points import DAY_MS
from fixtures.historian import NOON_MS, good_values, samples_of, trend

KILLS = int(os.environ.get("DRIVEBUS_KILLS", "20"))
CRASHER = Path(__file__).with_name("crasher.py")
WRITER_INTERVAL_MS = 10_000_000
"""Distance of the start times of two writers, so that their samples are distinguishable."""


class Writers:
    """Writer processes, one after another."""

    def __init__(self, folder: Path) -> None:
        command = [sys.executable, str(CRASHER), str(folder)]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self._process.stdin
        assert self._process.stdout
        self._to, self._from = self._process.stdin, self._process.stdout

    def run_and_kill(self, number: int, after_s: float) -> int:
        """Run a writer, kill it, and return the number of acknowledged samples per tag."""
        print(NOON_MS + number * WRITER_INTERVAL_MS, file=self._to, flush=True)
        pid = json.loads(self._from.readline())["ready"]
        time.sleep(after_s)
        os.kill(pid, signal.SIGKILL)
        acknowledged = 0
        while text := json.loads(self._from.readline()):
            acknowledged = text["flushed"]
        return acknowledged

    def close(self) -> None:
        self._process.communicate()
        assert self._process.returncode == 0


async def events_of(historian: Historian, from_ms: int, to_ms: int) -> list[str]:
    found: list[str] = []
    page: dict[str, Any] = {"next": None}
    while page["next"] is not None or not found:
        params = TimeRangeParams(from_ms=from_ms, to_ms=to_ms, cursor=page["next"], limit=1000)
        page = await historian.queries.events(params)
        found += [item["id"] for item in page["items"]]
        if not found:
            break
    return found


async def test_a_killed_writer_loses_nothing_that_it_acknowledged(tmp_path: Path) -> None:
    """The file is valid, and the acknowledged samples and events of every writer exist exactly once."""
    chance = random.Random(20)
    writers = Writers(tmp_path)
    acknowledged = [writers.run_and_kill(number, chance.uniform(0.0, 0.25)) for number in range(KILLS)]
    writers.close()
    database = sqlite3.connect(tmp_path / "history.db")
    assert database.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
    database.close()
    assert sum(acknowledged) > KILLS
    async with Historian(HistoryConfig(), tmp_path) as historian:
        for number, count in enumerate(acknowledged):
            start = NOON_MS + number * WRITER_INTERVAL_MS
            for tag in ("drive-0.speed", "drive-4.speed"):
                found = await samples_of(historian, tag, start, start + WRITER_INTERVAL_MS - 1)
                values = good_values(found.samples[1])
                assert values == [float(n) for n in range(len(values))]
                assert len(values) >= count
                assert len(found.number) - len(values) <= 1  # the gap of the next start
            events = await events_of(historian, start, start + WRITER_INTERVAL_MS - 1)
            assert len(events) == len(set(events))
            assert {f"{start}-{n}" for n in range(count)} <= set(events)
        everything = await samples_of(historian, "drive-0.speed", 0, 2**60)
        hours = await trend(historian, NOON_MS, NOON_MS + KILLS * WRITER_INTERVAL_MS + 60 * DAY_MS, tag="drive-0.speed")
    assert everything.number == list(range(len(everything.number)))
    assert max(hours["max"]) == max(good_values(everything.samples[1]))
