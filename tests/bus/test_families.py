"""C320, DZB100, VC660 and DF800 in virtual time: at every line quality each poll gets its own reply."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from drivebus import profiles
from drivebus.bus import Bus, Poll, Presence
from drivebus.bus.messages import BusResult
from drivebus.drives.dialects.create import create_dialect
from drivebus.ports import open_port
from drivebus.testing.virtual_time import run

MODELS = ("c320", "dzb100", "vc660", "df800")
LINE_QUALITIES = ("clean", "bytes", "lossy", "late", "batches", "echo", "echo,bytes")


def reads(dialect: Any) -> list[Any]:
    """Return two typical polls of the model."""
    sync_requests = [dialect.station_config.sync_request(n) for n in range(4)]
    return sync_requests[:2] if not dialect.state_reads() else list(dialect.state_reads())


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("line_quality", LINE_QUALITIES)
def test_every_model_is_polled_at_every_line_quality(model: str, line_quality: str) -> None:
    async def main() -> None:
        profile = profiles.load(model)
        port = open_port(f"sim://{model}@1-3?line_quality={line_quality}&seed=5&echo=detect")
        bus = Bus(port)
        results: dict[int, list[BusResult]] = {}
        async with bus:
            for address in (1, 2, 3):
                dialect = create_dialect(profile, address)
                bus.add_station(dialect.station_config)
                polls = [Poll(request, 1.0) for request in reads(dialect)]
                bus.start_polling(address, polls, results.setdefault(address, []).append)
            await asyncio.sleep(60)
            statistics = bus.statistics()
            for address in (1, 2, 3):
                answers = results[address]
                accepted = [result for result in answers if result.error is None]
                assert len(accepted) > 0.5 * len(answers) and len(accepted) > 25, statistics
                assert all(result.reply is not None for result in accepted)
                assert bus.presence(address) is not Presence.NEVER_SEEN
                assert not bus.health(address).foreign_master, statistics.counters
            if line_quality in ("clean", "bytes", "echo", "echo,bytes"):
                assert statistics.errors == {}, (statistics.errors, statistics.counters)
            if "echo" in line_quality:
                assert statistics.counters["echo"] == statistics.replies

    run(main())
