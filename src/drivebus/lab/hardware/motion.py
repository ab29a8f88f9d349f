"""Steps that turn the motor, a person watching. However a step ends, the drive is stopped first."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING, Any

from drivebus.errors import DrivebusError
from drivebus.lab.hardware.line import Found

if TYPE_CHECKING:
    from drivebus.drives import Drive
    from drivebus.lab.hardware.rig import Rig

RUN_S = 5.0
UNKNOWN_TIMER_S = 15.0
"""A drive whose timer nobody can read is left alone for so long."""
MARGIN_S = 3.0


async def run_and_stop(rig: Rig) -> Found:
    """Ruling 1, G07: it starts, it stops, the words are true; a person is the witness."""
    async with rig.drive() as (bus, drive), _stopped(drive) as told:
        begun = bus.now()
        told["run"] = str((await rig.race(drive.run(rig.frequency_hz))).word)
        told["started_s"] = round(bus.now() - begun, 3)
        await rig.race(asyncio.sleep(RUN_S))
        turned = await rig.agreed("hardware.ask.turns")
    stood = await rig.agreed("hardware.ask.stands")
    return turned and stood and told["stop"] in ("confirmed", "acknowledged"), told


async def host_dies(rig: Rig) -> Found:
    """F18: what the drive does when nobody speaks to it, against what it says that it does."""
    async with rig.drive() as (_, drive):
        report = await rig.race(drive.if_host_dies())
        async with _left_alone(drive):
            await rig.race(drive.run(rig.frequency_hz))
    value = report.time.value if report.time is not None else None
    alone_s = (float(value) if isinstance(value, int | float) else UNKNOWN_TIMER_S) + MARGIN_S
    await asyncio.sleep(alone_s)
    turns = await rig.agreed("hardware.ask.still_turns", seconds=round(alone_s))
    async with rig.drive() as (_, drive), _stopped(drive) as told:
        told |= {"says_it_trips": report.trips, "alone_s": alone_s, "still_turned": turns}
    return (None if report.trips is None else report.trips is not turns), told


@asynccontextmanager
async def _stopped(drive: Drive) -> AsyncIterator[dict[str, Any]]:
    """Whatever happens inside, a stop follows; its outcome is added to what is told."""
    told: dict[str, Any] = {}
    try:
        yield told
    finally:
        try:
            told["stop"] = str((await drive.stop()).word)
        except DrivebusError as error:
            told["stop"] = error.text("en")


@asynccontextmanager
async def _left_alone(drive: Drive) -> AsyncIterator[None]:
    """Where the start does not come through, a stop follows; else the drive is left running on purpose."""
    try:
        yield
    except BaseException:
        await drive.stop()
        raise
