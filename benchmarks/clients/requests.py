"""Requests of the measured host's other work at a constant rate, independent of the answers' speed.

requests.py PORT PER_SECOND    (runs until killed)
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import sys
import time

CONNECTIONS = 4


async def request_periodically(port: int, period_s: float, phase_s: float) -> None:
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    due, number = time.monotonic() + phase_s, 0
    while True:
        await asyncio.sleep(due - time.monotonic())
        due += period_s
        number += 1
        writer.write(json.dumps({"n": number}).encode() + b"\n")
        if not await reader.readline():
            return


async def main() -> None:
    port, per_second = int(sys.argv[1]), float(sys.argv[2])
    period_s = CONNECTIONS / per_second
    await asyncio.gather(*(request_periodically(port, period_s, place / per_second) for place in range(CONNECTIONS)))


with contextlib.suppress(ConnectionError):  # the host has ended
    asyncio.run(main())
