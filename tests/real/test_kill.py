"""``kill -9`` of a process that owns a running drive: the drive's own timer trips it, the next host only looks.

F18, I10, G10, RELIABILITY 6.6. The timer is the C320's (F9.3, F9.4); no other family of ours publishes one.
Any frame restarts it: who polls an orphaned drive keeps it running, which is why the second story is told.
"""

from __future__ import annotations

import asyncio
import json
import os
import random
import subprocess
import time
from collections.abc import Callable

import pytest

from drivebus.bus import Bus
from drivebus.drives.state import DriveState
from drivebus.ports import open_port
from real.conftest import Start
from real.host_process import made
from real.recorded_bench import (
    COMM_LOSS_TIMER_S,
    PROCESS_TIMEOUT_S,
    STEP_S,
    RecordedPlant,
    c320,
    slow_machine_c320,
    wait_until,
)
from verification.reference.request_effects import RequestEffect

Plants = Callable[..., RecordedPlant]


def events(process: subprocess.Popen[str], last: str) -> None:
    """Read what a host tells, up to that event."""
    assert process.stdout is not None
    for line in process.stdout:
        if json.loads(line)["event"] == last:
            return
    assert process.stderr is not None
    raise AssertionError(process.stderr.read())


def kill(process: subprocess.Popen[str], plant: RecordedPlant) -> float:
    """kill -9. When it is dead and all that it wrote is in the record, this second."""
    process.kill()
    process.wait()
    plant.settle()
    return time.monotonic()


def check_trips(plant: RecordedPlant, line: int) -> None:
    """The drive runs until its own timer ends it, 2 s after the last frame, neither sooner nor later."""
    wait_until(lambda: not plant.on(line), "the trip")
    off = plant.motor_changes(line)[-1]
    assert off.trip == "COMM_LOSS"
    silent_s = off.t - plant.last_frame_received(line, off.t)
    assert COMM_LOSS_TIMER_S - 1e-6 <= silent_s <= COMM_LOSS_TIMER_S + STEP_S + 1e-6


async def monitored_states(plant: RecordedPlant, line: int, seconds: float) -> list[DriveState]:
    """A restarted host: bus, drive, monitor. The states that it saw."""
    seen: list[DriveState] = []
    async with Bus(open_port(plant.url(line))) as bus:
        with made(bus, "c320").monitor(on_change=lambda status: seen.append(status.state), period_s=0.2):
            await asyncio.sleep(seconds)
    return seen


@pytest.mark.parametrize("seed", range(int(os.environ.get("DRIVEBUS_REAL_KILLS", "2"))))
async def test_whenever_the_host_is_killed_a_drive_that_runs_trips_by_itself_and_the_next_host_sends_no_command(
    plants: Plants, started: Start, seed: int
) -> None:
    """Four lines whose starts are at four different points when it dies."""
    chance = random.Random(seed)
    plant = plants(*(c320() for _ in range(4)))
    host = started("host_process.py", "run", "c320", *(plant.url(line) for line in range(4)))
    events(host, "open")
    wait_until(lambda: plant.requests(0), "the first frame")
    await asyncio.sleep(chance.uniform(0.0, 1.2))
    back = kill(host, plant)
    for line in range(4):
        moves = [one for one in plant.requests(line) if one.effect is RequestEffect.MOTION]
        assert len(moves) <= 1
        if any(turn.on for turn in plant.motor_changes(line)):
            assert moves
            check_trips(plant, line)
    for line, seen in enumerate(await asyncio.gather(*(monitored_states(plant, line, 0.8) for line in range(4)))):
        tripped = any(turn.on for turn in plant.motor_changes(line))
        assert seen and seen[-1] is (DriveState.FAULT if tripped else DriveState.STOPPED)
    plant.settle()
    for line in range(4):
        after = plant.requests(line, since=back)
        assert after and {one.effect for one in after} == {RequestEffect.READ}
        assert not any(turn.on for turn in plant.motor_changes(line, since=back))


async def test_a_host_that_is_back_in_time_adopts_by_looking_only_and_keeps_the_drive_running_by_it(
    plants: Plants, started: Start
) -> None:
    """Polling feeds the drive's timer: it runs on for as long as somebody looks, and trips when the last one leaves."""
    plant = plants(c320(), c320(), c320())
    host = started("host_process.py", "run", "c320", *(plant.url(line) for line in range(3)))
    events(host, "all")
    back = kill(host, plant)
    drive = ("--model", slow_machine_c320(plant.record.parent), "--address", "1", "--json")
    verbs = [
        started("monitor", plant.url(1), *drive, "--period", "0.3", "--duration", "1.5"),
        started("status", plant.url(2), *drive),
    ]
    seen = await monitored_states(plant, 0, 2.2 * COMM_LOSS_TIMER_S)
    assert [verb.wait(PROCESS_TIMEOUT_S) for verb in verbs] == [0, 0]
    assert seen[-1] is DriveState.RUNNING and set(seen) <= {DriveState.UNKNOWN, DriveState.RUNNING}
    for line in range(3):
        check_trips(plant, line)
        after = plant.requests(line, since=back)
        assert after and {one.effect for one in after} == {RequestEffect.READ}
    assert plant.motor_changes(0)[-1].t - back > 2 * COMM_LOSS_TIMER_S, (
        "longer than its timer, because it was looked at"
    )
