"""System suspend: the clock of a bus goes on, so that requests queued before have expired afterwards."""

from __future__ import annotations

import asyncio
import subprocess
import sys
import time
from pathlib import Path

import pytest

from drivebus.bus import Bus
from drivebus.errors import Expired
from drivebus.testing.bus_script import ScriptedPort
from fixtures.bus import FakeStation, read_request, start_request, station_config, wire_to

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="only Linux has a clock that goes on during suspend")


async def test_a_start_queued_before_a_suspend_is_not_sent_after_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """An hour passes only on the clock that includes suspend, while the previous frame is on the wire."""
    slept_s, kernel = 0.0, time.clock_gettime

    def clock(which: int) -> float:
        return kernel(which) + (slept_s if which == time.CLOCK_BOOTTIME else 0.0)

    monkeypatch.setattr(time, "clock_gettime", clock)
    station = FakeStation()
    port = ScriptedPort(wire_to(station))
    bus = Bus(port)
    bus.add_station(station_config())
    async with bus:
        sent = asyncio.Event()
        bus.trace(lambda _: sent.set())
        reading = asyncio.create_task(bus.transact(read_request()))
        await sent.wait()
        starting = asyncio.create_task(bus.transact(start_request(bus.core, until=bus.now() + 2.0)))
        await asyncio.sleep(0)
        slept_s = 3600.0
        result = await asyncio.wait_for(starting, 60)
        reading.cancel()
    assert isinstance(result.error, Expired) and result.error.params["late_ms"] > 3_590_000
    assert result.sent == b"" and len(port.sent) == 1 and station.start_count == 0


async def test_a_closed_bus_has_the_same_time_and_opens_nothing() -> None:
    bus, files = Bus(ScriptedPort(wire_to())), open_files()
    begin = time.clock_gettime(time.CLOCK_BOOTTIME)
    assert begin <= bus.now() < bus.now() <= time.clock_gettime(time.CLOCK_BOOTTIME)
    assert open_files() == files


def open_files() -> set[Path]:
    return set(Path("/proc/self/fd").iterdir())


AFTER_A_SLEEP = """
import asyncio, time
from drivebus.bus import Bus, Poll
from drivebus.testing.bus_script import ScriptedPort
from fixtures.bus import FakeStation, read, read_request, station_config, wire_to

async def main():
    bus = Bus(ScriptedPort(wire_to(FakeStation())))
    bus.add_station(station_config())
    before = bus.now()
    assert before - time.monotonic() > 3590, "not the clock that includes suspend"
    async with bus:
        answer = await bus.transact(read_request())
        assert answer.error is None and before <= answer.sent_at < answer.received_at <= bus.now() < before + 60
        results = asyncio.Queue()
        bus.start_polling(1, [Poll(read(), 0.02)], results.put_nowait)
        for _ in range(5):
            assert (await results.get()).error is None
asyncio.run(asyncio.wait_for(main(), 20))
"""


def test_after_a_suspend_timers_and_clock_agree() -> None:
    """A time namespace whose boot clock is an hour ahead of the monotonic one, as after an hour of suspend."""
    ahead = ["unshare", "--user", "--map-root-user", "--time", "--boottime", "3600", "--fork"]
    try:
        subprocess.run([*ahead, "true"], check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("no time namespace may be made here")
    script = f"import sys; sys.path[:] = {sys.path!r}\n{AFTER_A_SLEEP}"
    done = subprocess.run([*ahead, sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
