"""No late reply is taken for the reply to a newer request, whatever the family's replies repeat of their requests."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from drivebus import profiles
from drivebus.bus import Bus
from drivebus.bus.messages import BusRequest, RequestPriority
from drivebus.drives import create_dialect
from drivebus.families.huanyang.codec import read_status
from drivebus.families.mitsubishi.codec import READ_DIGITS, MitsubishiRequest
from drivebus.ports import open_port
from drivebus.testing.virtual_time import run

ADDRESS = 3
TRANSACTIONS = 1500


def huanyang_request(number: int) -> Any:
    return read_status(ADDRESS, number % 4)


def mitsubishi_request(number: int) -> Any:
    return MitsubishiRequest(ADDRESS, sorted(READ_DIGITS)[number % len(READ_DIGITS)])


def numbered(reply: Any, number: int) -> Any:
    """Return the reply with the number of its request as its value, as far as its bytes hold it."""
    if hasattr(reply, "width"):
        return replace(reply, value=number % (1 << 8 * reply.width))
    return replace(reply, data=number % 16**reply.digits) if reply.digits else reply


@pytest.mark.parametrize(("model", "request_of"), [("huanyang_hy", huanyang_request), ("fr_e500", mitsubishi_request)])
@pytest.mark.parametrize("quality", ["late=0.2:0.4", "late=0.3:3", "late=0.1:1,loss=0.1,duplicate=0.05"])
def test_an_accepted_reply_is_that_to_the_last_request(
    model: str, request_of: Callable[[int], Any], quality: str
) -> None:
    async def play() -> Counter[str]:
        port: Any = open_port(f"sim://{model}@{ADDRESS}?line_quality={quality}&seed=5")
        station, counts, last = port.simulated_bus.stations[0], Counter[str](), [0, None]
        answer = station.handle_request

        def numbering(message: Any, codec: Any) -> Any:
            last[0] += 1
            last[1] = numbered(answer(message, codec), last[0])
            return last[1]

        station.handle_request = numbering
        async with Bus(port) as bus:
            bus.add_station(create_dialect(profiles.load(model), ADDRESS).station_config)
            for number in range(TRANSACTIONS):
                result = await bus.transact(
                    BusRequest(station=ADDRESS, request=request_of(number), priority=RequestPriority.PARAMETER)
                )
                if result.error is None:
                    assert result.reply == last[1], f"transaction {number}: the reply to an older request"
                counts["accepted" if result.error is None else str(getattr(result.error, "key", ""))] += 1
        return counts

    counts = run(play())
    assert counts["accepted"] > 100 and sum(counts.values()) - counts["accepted"] > 20, counts
