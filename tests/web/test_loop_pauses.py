"""Pauses of the event loop: how long after one a motion is refused, because it may have waited as long."""

from __future__ import annotations

import asyncio

import pytest

from drivebus.testing.virtual_time import VirtualLoop
from drivebus.web.loop_pauses import LoopPauses


@pytest.mark.parametrize(("pause_s", "counted_for_s"), [(0.4, 1.0), (2.5, 2.5), (10.0, 10.0), (3600.0, 30.0)])
def test_requests_that_waited_during_a_long_pause_are_found_until_they_are_worked_off(
    pause_s: float, counted_for_s: float
) -> None:
    """After 10 s at 200 requests/s there are 2,000 to work off; a motion read after more than 1 s of that passed."""
    loop = VirtualLoop()
    pauses = LoopPauses()

    async def scenario() -> None:
        measuring = asyncio.create_task(pauses.run())
        await asyncio.sleep(10.1)
        assert pauses.recent_pause_s() == pytest.approx(0.0)
        loop._now += pause_s  # the loop does not run meanwhile
        assert pauses.recent_pause_s() == pytest.approx(pause_s, abs=0.25)
        await asyncio.sleep(counted_for_s - 0.3)
        assert pauses.recent_pause_s() == pytest.approx(pause_s, abs=0.25)
        await asyncio.sleep(0.5)
        assert pauses.recent_pause_s() == pytest.approx(0.0)
        measuring.cancel()

    loop.run_until_complete(scenario())


def test_a_pause_soon_after_a_longer_one_counts_for_its_own_length_too() -> None:
    loop = VirtualLoop()
    pauses = LoopPauses()

    async def scenario() -> None:
        measuring = asyncio.create_task(pauses.run())
        await asyncio.sleep(0.1)
        for pause_s, then_s in ((10.0, 6.0), (3.0, 2.5)):
            loop._now += pause_s  # the loop does not run meanwhile
            await asyncio.sleep(then_s)
        assert pauses.recent_pause_s() == pytest.approx(3.0, abs=0.25)
        await asyncio.sleep(0.8)
        assert pauses.recent_pause_s() == pytest.approx(0.0)
        measuring.cancel()

    loop.run_until_complete(scenario())
