"""``kill -9`` of a process that owns a running drive: the drive's own timer trips it, the next host only reads.

The timer is the C320's (F9.3, F9.4); no other supported family documents one. Any frame restarts it, so polling an
orphaned drive keeps it running, which the second test shows.
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
from fixtures.child_process import SLOW_MACHINE_C320
from real.conftest import Start
from real.host_process import slow_machine_drive
from real.recorded_bench import (
    COMM_LOSS_TIMER_S,
    PROCESS_TIMEOUT_S,
    STEP_S,
    RecordedPlant,
    c320,
    wait_until,
)
from verification.reference.effects import RequestEffect

Plants = Callable[..., RecordedPlant]


def events(process: subprocess.Popen[str], last: str) -> None:
    """Read the events of a host up to ``last``."""
    assert process.stdout is not None
    for line in process.stdout:
        if json.loads(line)["event"] == last:
            return
    assert process.stderr is not None
    raise AssertionError(process.stderr.read())


def kill(process: subprocess.Popen[str], plant: RecordedPlant) -> float:
    """Kill a host; returns the second at which it was dead and all its frames were recorded."""
    process.kill()
    process.wait()
    plant.settle()
    return time.monotonic()


def check_trips(plant: RecordedPlant, line: int) -> None:
    """Check that the drive's own timer trips it exactly 2 s after the last frame."""
    wait_until(lambda: not plant.on(line), "the trip")
    off = plant.motor_changes(line)[-1]
    assert off.trip == "COMM_LOSS"
    silent_s = off.t - plant.last_frame_received(line, off.t)
    assert COMM_LOSS_TIMER_S - 1e-6 <= silent_s <= COMM_LOSS_TIMER_S + STEP_S + 1e-6


async def monitored_states(plant: RecordedPlant, line: int, seconds: float) -> list[DriveState]:
    """Run bus, drive and monitor of a restarted host until it knows the state; returns the states that it reported."""
    states: list[DriveState] = []
    async with Bus(open_port(plant.url(line))) as bus:
        with slow_machine_drive(bus, "c320").monitor(
            on_change=lambda status: states.append(status.state), period_s=0.2
        ):
            await asyncio.sleep(seconds)
            async with asyncio.timeout(PROCESS_TIMEOUT_S):
                while not states or states[-1] is DriveState.UNKNOWN:  # noqa: ASYNC110  the monitor has no event
                    await asyncio.sleep(STEP_S)
    return states


@pytest.mark.parametrize("seed", range(int(os.environ.get("DRIVEBUS_REAL_KILLS", "2"))))
async def test_a_running_drive_of_a_killed_host_trips_by_itself_and_the_next_host_sends_no_command(
    plants: Plants, started: Start, seed: int
) -> None:
    """Four lines are at four different points of their starts when the host is killed."""
    chance = random.Random(seed)
    plant = plants(*(c320() for _ in range(4)))
    host = started("host_process.py", "run", "c320", *(plant.url(line) for line in range(4)))
    events(host, "open")
    wait_until(lambda: plant.requests(0), "the first frame")
    await asyncio.sleep(chance.uniform(0.0, 1.2))
    killed_at = kill(host, plant)
    for line in range(4):
        moves = [request for request in plant.requests(line) if request.effect is RequestEffect.MOTION]
        assert len(moves) <= 1
        if any(change.on for change in plant.motor_changes(line)):
            assert moves
            check_trips(plant, line)
    for line, states in enumerate(await asyncio.gather(*(monitored_states(plant, line, 0.8) for line in range(4)))):
        tripped = any(change.on for change in plant.motor_changes(line))
        assert states and states[-1] is (DriveState.FAULT if tripped else DriveState.STOPPED)
    plant.settle()
    for line in range(4):
        after = plant.requests(line, since=killed_at)
        assert after and {request.effect for request in after} == {RequestEffect.READ}
        assert not any(change.on for change in plant.motor_changes(line, since=killed_at))


async def test_a_host_that_restarts_in_time_only_reads_and_thereby_keeps_the_drive_running(
    plants: Plants, started: Start
) -> None:
    """Polling restarts the drive's timer: it runs while a host polls it and trips after the last host has ended."""
    plant = plants(c320(), c320(), c320())
    host = started("host_process.py", "run", "c320", *(plant.url(line) for line in range(3)))
    events(host, "all")
    killed_at = kill(host, plant)
    drive = ("--model", SLOW_MACHINE_C320, "--address", "1", "--json")
    commands = [
        started("monitor", plant.url(1), *drive, "--period", "0.3", "--duration", "1.5"),
        started("status", plant.url(2), *drive),
    ]
    states = await monitored_states(plant, 0, 2.2 * COMM_LOSS_TIMER_S)
    assert [command.wait(PROCESS_TIMEOUT_S) for command in commands] == [0, 0]
    assert states[-1] is DriveState.RUNNING and set(states) <= {DriveState.UNKNOWN, DriveState.RUNNING}
    for line in range(3):
        check_trips(plant, line)
        after = plant.requests(line, since=killed_at)
        assert after and {request.effect for request in after} == {RequestEffect.READ}
    assert plant.motor_changes(0)[-1].t - killed_at > 2 * COMM_LOSS_TIMER_S, (
        "longer than its timer, because it was polled"
    )
