"""The processes that test_killed kills: each line read is a life's beginning (ms), lived in a fork: one start of the
interpreter for all. A life writes, says what is acknowledged, and goes on until it is killed or its output is closed.
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


def say(what: dict[str, int]) -> None:
    """One write: print's second, of the line's end, may be cut off by the kill (PYTHONUNBUFFERED)."""
    os.write(sys.stdout.fileno(), f"{json.dumps(what)}\n".encode())


async def main(folder: str, start_ms: int) -> None:
    writer.MAX_OPEN_SAMPLES, writer.MAX_OPEN_SAMPLES_PER_TAG = (
        300,
        0,
    )  # Blocks all the time: seals are killed as often as batches.
    async with Historian(HistoryConfig(), Path(folder), flush_s=0.01) as historian:
        say({"ready": os.getpid()})
        n = 0
        while True:
            samples = [Sample(tag, start_ms + 1000 * n, float(n), Quality.GOOD) for tag in TAGS]
            historian.append(samples)
            historian.put_event({"id": f"{start_ms}-{n}", "time_ms": start_ms + n, "kind": "command"})
            n += 1
            if n % 7 == 0:
                await historian.flush()
                say({"flushed": n})
            else:
                await asyncio.sleep(0.0002)


for line in sys.stdin:
    if child := os.fork():
        os.waitpid(child, 0)
        say({})
    else:
        asyncio.run(main(sys.argv[1], int(line)))
