"""Steps that turn the motor, a person watching. However a step ends, the drive is stopped first."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING, Any

from drivebus.cli.acceptance.bus_steps import StepOutcome
from drivebus.errors import DrivebusError

if TYPE_CHECKING:
    from drivebus.cli.acceptance.session import AcceptanceSession
    from drivebus.drives import Drive

RUN_DURATION_S = 5.0
UNKNOWN_COMM_LOSS_S = 15.0
"""A drive whose timer nobody can read is left alone for so long."""
COMM_LOSS_MARGIN_S = 3.0


async def check_run_and_stop(rig: AcceptanceSession) -> StepOutcome:
    """Ruling 1, G07: it starts, it stops, the words are true; a person is the witness."""
    async with rig.drive() as (bus, drive), _stopped_afterwards(drive) as told:
        begun = bus.now()
        told["run"] = str((await rig.race(drive.run(rig.frequency_hz))).status)
        told["started_s"] = round(bus.now() - begun, 3)
        await rig.race(asyncio.sleep(RUN_DURATION_S))
        turned = await rig.confirm("hardware.ask.turns")
    stood = await rig.confirm("hardware.ask.stands")
    return turned and stood and told["stop"] in ("confirmed", "acknowledged"), told


async def check_communication_loss(rig: AcceptanceSession) -> StepOutcome:
    """F18: what the drive does when nobody speaks to it, against what it says that it does."""
    async with rig.drive() as (_, drive):
        report = await rig.race(drive.comm_loss_behaviour())
        async with _left_running(drive):
            await rig.race(drive.run(rig.frequency_hz))
    value = report.time.value if report.time is not None else None
    alone_s = (float(value) if isinstance(value, int | float) else UNKNOWN_COMM_LOSS_S) + COMM_LOSS_MARGIN_S
    await asyncio.sleep(alone_s)
    turns = await rig.confirm("hardware.ask.still_turns", seconds=round(alone_s))
    async with rig.drive() as (_, drive), _stopped_afterwards(drive) as told:
        told |= {"says_it_trips": report.stops_on_comm_loss, "alone_s": alone_s, "still_turned": turns}
    return (None if report.stops_on_comm_loss is None else report.stops_on_comm_loss is not turns), told


@asynccontextmanager
async def _stopped_afterwards(drive: Drive) -> AsyncIterator[dict[str, Any]]:
    """Whatever happens inside, a stop follows; its outcome is added to what is told."""
    told: dict[str, Any] = {}
    try:
        yield told
    finally:
        try:
            told["stop"] = str((await drive.stop()).status)
        except DrivebusError as error:
            told["stop"] = error.text("en")


@asynccontextmanager
async def _left_running(drive: Drive) -> AsyncIterator[None]:
    """Where the start does not come through, a stop follows; else the drive is left running on purpose."""
    try:
        yield
    except BaseException:
        await drive.stop()
        raise
