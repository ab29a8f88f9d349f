"""Hosts that the tests kill, stop and freeze: real Bus and Drive on real ptys, in their own process.

    host_process.py WHAT MODEL URL...

``run``: start address 1 of every line, one after the other, and keep polling. ``start N``: print "queued" as soon as
runs of addresses 1 to N of the first line are commanded, then the result of each. ``queue N``: the same with permits
granted and all frames in the bus's queue while a read is on the line; the process then stops itself like a frozen
machine.
"""

from __future__ import annotations

import asyncio
import json
import os
import signal
import sys
from dataclasses import replace
from typing import Any

from drivebus import profiles
from drivebus.bus import Bus
from drivebus.bus.messages import BusRequest, RequestPriority
from drivebus.bus.trace import TraceKind
from drivebus.drives import Drive, MemoryStore, permissives
from drivebus.drives.operations.steps import BusConditions
from drivebus.drives.state import DerivedState, DriveState
from drivebus.errors import DrivebusError
from drivebus.ports import open_port
from drivebus.protocols.codec import Effect


def print_event(**event: Any) -> None:
    print(json.dumps(event), flush=True)


def slow_machine_drive(bus: Bus, model: str, address: int = 1) -> Drive:
    """Return a drive whose replies may be 0.3 s late, because the machine may be busy."""
    timing = replace(profiles.load(model).timing, adapter_latency_s=0.3)
    options = {"setpoint_step": "0.01"} if model == "c320" else {}
    return Drive(bus, model, address, options=options, store=MemoryStore(), timing=timing)


async def run(model: str, urls: list[str]) -> None:
    buses = [Bus(open_port(url)) for url in urls]
    for bus in buses:
        await bus.open()
    drives = [slow_machine_drive(bus, model) for bus in buses]
    print_event(event="open")
    for number, drive in enumerate(drives):
        outcome = await drive.run(20.0)
        drive.monitor(period_s=0.2)
        print_event(event="started", line=number, outcome=outcome.status)
    print_event(event="all")
    await asyncio.sleep(3600)


async def run_drive(drive: Drive) -> dict[str, Any]:
    try:
        outcome = await drive.run(20.0)
        return {"address": drive.address, "outcome": outcome.status}
    except DrivebusError as error:
        return {"address": drive.address, "error": type(error).__name__, "text": str(error)}


async def start(model: str, url: str, count: int) -> None:
    async with Bus(open_port(url)) as bus:
        drives = [slow_machine_drive(bus, model, address) for address in range(1, count + 1)]
        commands = [asyncio.create_task(run_drive(drive)) for drive in drives]
        await asyncio.sleep(0)
        print_event(event="queued")
        for done in commands:
            print_event(event="ended", **await done)


def start_of(bus: Bus, drive: Drive) -> BusRequest:
    """Return a start request with a permit of the start permissives, as after all checks."""
    now, stop_epoch = bus.now(), bus.stop_epoch(drive.address)
    command = permissives.DriveCommand("test", permissives.CommandKind.START, now, stop_epoch)
    stopped = DerivedState(DriveState.STOPPED)
    evidence = permissives.DriveEvidence(
        derived=stopped,
        state_at=now,
        reports_run_state=True,
        preflight_passed=True,
        limits_checked=True,
        is_prepared=True,
        motion_seen=False,
        run_seen=False,
    )
    conditions = BusConditions(now=now, stop_epoch=stop_epoch)
    frame = drive.dialect.start(None, 2000)[0]
    permit = permissives.grant_permit(
        permissives.PermitInputs(
            command=command,
            station=drive.address,
            effect=Effect.MOTION,
            retry_policy=frame.retry_policy,
            conditions=conditions,
            evidence=evidence,
            family="sunfar",
        )
    )
    return BusRequest(
        station=drive.address,
        request=frame.request,
        priority=RequestPriority.COMMAND,
        permit=permit,
    )


async def queue(model: str, url: str, count: int) -> None:
    async with Bus(open_port(url)) as bus:
        drives = [slow_machine_drive(bus, model, address) for address in range(1, count + 1)]
        occupied = asyncio.Event()
        bus.trace(lambda event: occupied.set() if event.kind is TraceKind.SENT else None)
        first = asyncio.create_task(bus.transact(BusRequest(station=1, request=drives[0].dialect.echo_test_read())))
        await occupied.wait()  # a read that waited for silence after the opening would go after the starts
        starts = [asyncio.create_task(bus.transact(start_of(bus, drive))) for drive in drives]
        await asyncio.sleep(0)
        print_event(event="queued")
        os.kill(os.getpid(), signal.SIGSTOP)
        await first
        for drive, answer in zip(drives, await asyncio.gather(*starts), strict=True):
            print_event(
                event="ended", address=drive.address, error=answer.error and answer.error.key, sent=answer.sent.hex()
            )


def main() -> None:
    what, model, *rest = sys.argv[1:]
    if what == "run":
        asyncio.run(run(model, rest))
    else:
        scenario = start if what == "start" else queue
        asyncio.run(scenario(model, rest[0], int(rest[1])))


if __name__ == "__main__":
    main()
