"""Steps with hands: the adapter pulled and put back, the drive switched off and on."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from drivebus.bus import Presence
from drivebus.cli.acceptance.bus_steps import StepOutcome, replies_now

if TYPE_CHECKING:
    from drivebus.bus import Bus
    from drivebus.cli.acceptance.session import AcceptanceSession
    from drivebus.drives import Drive

PERSON_TIMEOUT_S = 60.0
STEP_S = 0.02
REPLUG_POLL_MAX_S = 2.0
"""G09: polling goes on within 2 s after the port is back."""
OFFLINE_DETECTED_MAX_S = 60.0
"""G08: a drive that comes back is found within 60 s."""


async def check_unplug(rig: AcceptanceSession) -> StepOutcome:
    """G09: the loss is noticed, the port is found again by its identity, polling goes on, nothing is replayed."""
    async with rig.drive() as (bus, drive):
        with drive.monitor():
            if not await rig.race(_wait_until(lambda: not bus.is_open)):
                return False, {"noticed": False}
            lost = bus.now()
            if not await rig.race(_wait_until(lambda: bus.is_open)):
                return False, {"noticed": True, "back": False}
            back = bus.now()
            answered = await rig.race(_wait_until(lambda: _replied_since(bus, drive, back)))
            figures: dict[str, Any] = {"away_s": round(back - lost, 3), "polling_after_s": round(bus.now() - back, 3)}
            return answered and bus.now() - back <= REPLUG_POLL_MAX_S, figures


async def check_power_loss(rig: AcceptanceSession) -> StepOutcome:
    """G08, G17: a drive without power is called silent, and found again."""
    async with rig.drive() as (bus, drive):
        with drive.monitor():
            if not await rig.race(_wait_until(lambda: bus.presence(drive.address) is Presence.OFFLINE)):
                return False, {"silent": False}
            gone = bus.now()
            answered = await rig.race(
                _wait_until(lambda: _replied_since(bus, drive, gone), PERSON_TIMEOUT_S + OFFLINE_DETECTED_MAX_S)
            )
            await rig.race(replies_now(bus, drive))
            return answered, {"silent": True, "away_s": round(bus.now() - gone, 3)}


def _replied_since(bus: Bus, drive: Drive, when: float) -> bool:
    heard = bus.health(drive.address).last_reply_at
    return heard is not None and heard > when


async def _wait_until(condition: Callable[[], bool], longest_s: float = PERSON_TIMEOUT_S) -> bool:
    for _ in range(int(longest_s / STEP_S)):
        if condition():
            return True
        await asyncio.sleep(STEP_S)
    return False
