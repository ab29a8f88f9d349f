"""Process that test_killed kills. Each line that it reads is a start time (ms) and forks a writer.

A writer reports what is acknowledged and goes on until it is killed.
"""

from __future__ import annotations

import asyncio
import json
import os
import sys
from pathlib import Path

from drivebus.service.config.model import HistoryConfig
from drivebus.service.historian import Historian, writer
from drivebus.service.live.views import Sample
from drivebus.values import Quality

TAGS = [f"drive-{n}.speed" for n in range(5)]


def report(values: dict[str, int]) -> None:
    """Print a line in one write: the kill may cut off a second one."""
    os.write(sys.stdout.fileno(), f"{json.dumps(values)}\n".encode())


async def main(folder: str, start_ms: int) -> None:
    writer.MAX_OPEN_SAMPLES, writer.MAX_OPEN_SAMPLES_PER_TAG = 300, 0  # so that compactions are killed, too
    async with Historian(HistoryConfig(), Path(folder), flush_s=0.01) as historian:
        report({"ready": os.getpid()})
        n = 0
        while True:
            samples = [Sample(tag, start_ms + 1000 * n, float(n), Quality.GOOD) for tag in TAGS]
            historian.append(samples)
            historian.put_event({"id": f"{start_ms}-{n}", "time_ms": start_ms + n, "kind": "command"})
            n += 1
            if n % 7 == 0:
                await historian.flush()
                report({"flushed": n})
            else:
                await asyncio.sleep(0.0002)


for line in sys.stdin:
    if child := os.fork():
        os.waitpid(child, 0)
        report({})
    else:
        asyncio.run(main(sys.argv[1], int(line)))
