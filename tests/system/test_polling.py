"""Polling of a full bus in virtual time: exact durations, fairness to online drives, ageing of values."""

from __future__ import annotations

import asyncio
from collections import Counter, defaultdict
from typing import Any

import pytest

from drivebus.bus import Poll, Presence
from drivebus.bus.messages import BusResult
from drivebus.protocols import dzb100, modbus, sunfar
from drivebus.values import Quality
from fixtures.system_bench import (
    C320,
    FAMILIES,
    VC660,
    SystemBench,
    SystemVariant,
    every_family,
    every_line_quality,
    every_reporting_drive,
    run_virtual,
    system_bench,
)

ADDRESSES = {"c320": "0-30", "dzb100": "1-31", "vc660": "1-31", "df800": "1-31"}
POLL_LENGTHS = {
    "c320-ascii": (14, 18),
    "c320-hex": (14, 18),
    "dzb100": (11, 11),
    "vc660": (8, 13),
    "df800-rtu": (8, 13),
    "df800-ascii": (17, 27),
}
"""Characters of a poll and of its reply, by the manuals: class 1, Q, FC03 of four registers."""


def request(variant: SystemVariant, address: int) -> Any:
    """Return the poll of a family: d.0, Q01, 3001H-3004H, F0.00-F0.03."""
    if variant.model == "c320":
        return sunfar.ReadMonitor(address, 0)
    if variant.model == "dzb100":
        return dzb100.Dzb100Query(address, 1)
    return modbus.ReadRegisters(address, 0x3001 if variant.model == "vc660" else 0, 4)


class PollRound:
    """Polls of every drive without a pause, with the times of their replies."""

    def __init__(self, bench: SystemBench) -> None:
        self.results: dict[int, list[BusResult]] = defaultdict(list)
        self.times: dict[int, list[float]] = defaultdict(list)
        for address in bench.drives:
            bench.bus.start_polling(
                address,
                [Poll(request(bench.variant, address), 0.0)],
                lambda result, n=address: self._on_result(n, result),
            )

    def _on_result(self, address: int, result: BusResult) -> None:
        if result.error is None:
            assert result.received_at is not None
            self.results[address].append(result)
            self.times[address].append(result.received_at)

    def cycle_s(self, address: int, since: float, until: float) -> float:
        """Return the mean time between two replies of one drive."""
        times = [at for at in self.times[address] if since <= at <= until]
        return (times[-1] - times[0]) / (len(times) - 1)


def transaction_s(variant: SystemVariant, bench: SystemBench) -> float:
    """Return the time of a transaction by the manuals: gap, request, delay of the drive, reply."""
    character = bench.simulated_bus.settings.character_s
    request_size, reply_size = POLL_LENGTHS[variant.name]
    gap = max(variant.gap_characters * character, variant.gap_floor_s)
    return (
        gap + (request_size + reply_size) * character + max(variant.station_s, variant.station_characters * character)
    )


@every_family
def test_polling_31_drives_takes_the_computed_time(variant: SystemVariant) -> None:
    async def scenario() -> None:
        async with system_bench(variant, ADDRESSES[variant.model]) as bench:
            await asyncio.sleep(1.0)
            polls = PollRound(bench)
            await asyncio.sleep(20.0)
            expected = transaction_s(variant, bench)
            first = bench.tap.requests_sent[0].start
            ends = [frame.end for frame in bench.tap.replies_sent]
            gap = max(variant.gap_characters * bench.simulated_bus.settings.character_s, variant.gap_floor_s)
            assert first == 1.0, "after silence the first request is sent at once"
            for number, end in enumerate(ends, start=1):
                assert end == pytest.approx(first - gap + number * expected, abs=1e-6)
            assert (
                len(ends)
                == len(bench.tap.requests_sent) - (len(bench.tap.requests_sent) > len(ends))
                >= int(20.0 / expected)
            )
            counts = [len(polls.results[address]) for address in bench.drives]
            assert sum(counts) == sum(end + gap <= 21.0 for end in ends), "every reply is accepted after its gap"
            assert max(counts) - min(counts) <= 2
            bench.tap.check(variant)

    run_virtual(scenario())


@every_line_quality
@every_family
def test_every_drive_of_a_full_bus_stays_online_at_any_line_quality(variant: SystemVariant, line_quality: str) -> None:
    async def scenario() -> None:
        async with system_bench(variant, ADDRESSES[variant.model], line_quality) as bench:
            polls = PollRound(bench)
            await asyncio.sleep(40.0)
            counts = {address: len(polls.results[address]) for address in bench.drives}
            assert all(count >= 5 for count in counts.values()), counts
            assert max(counts.values()) <= 2 * min(counts.values()), counts
            bench.tap.check(variant)
            if variant.model != "dzb100" and "late" not in line_quality:  # its manual has no gap, the simulation has
                assert not any(station.gap_violations for station in bench.simulated_bus.stations)

    run_virtual(scenario())


@pytest.mark.parametrize("silent_count", [1, 5, 15, 30])
@pytest.mark.parametrize("variant", [C320, VC660], ids=lambda variant: variant.name)
def test_silent_drives_take_at_most_a_tenth_of_the_bus_and_come_back(variant: SystemVariant, silent_count: int) -> None:
    """The cycle of the online drives grows by 11.2 % at most for any number of silent drives."""

    async def scenario() -> None:
        async with system_bench(variant, ADDRESSES[variant.model]) as bench:
            addresses = list(bench.drives)
            silent, online = addresses[:silent_count], addresses[silent_count:]
            for address in silent:
                bench.station(address).faults.silent = True
            polls = PollRound(bench)
            await asyncio.sleep(20.0)
            started_at = bench.bus.now()
            await asyncio.sleep(60.0)
            limit = 1.112 * len(online) * transaction_s(variant, bench)
            for address in online:
                assert polls.cycle_s(address, started_at, bench.bus.now()) <= limit
            assert {bench.bus.presence(address) for address in silent} == {Presence.NEVER_SEEN}
            for address in silent:
                bench.station(address).faults.silent = False
            probe_s = 2 * transaction_s(variant, bench) + 0.05
            await asyncio.sleep(max(60.0, silent_count * probe_s / 0.1) + 1.0)
            assert {bench.bus.presence(address) for address in addresses} == {Presence.ONLINE}
            bench.tap.check(variant)

    run_virtual(scenario())


@every_reporting_drive
def test_a_silenced_drive_has_no_good_value_and_no_state_any_more(variant: SystemVariant) -> None:
    """After three periods (at least 1 s) and a timeout no value is good; all are good again after it replies (I4)."""

    async def scenario() -> None:
        async with system_bench(variant) as bench, _closing(bench.drive.monitor()) as monitor:
            await asyncio.sleep(8.0)
            fresh = monitor.status()
            assert fresh.state == "stopped"
            good = {name for name, reading in fresh.readings.items() if reading.quality is Quality.GOOD}
            assert "output_frequency" in good
            bench.station().faults.silent = True
            longest = max(3 * signal.period_s for signal in bench.drive.profile.signals.values())
            timeout = bench.station_config().timing.timeout_s(bench.bus.settings, 18)
            await asyncio.sleep(max(longest, 1.0) + timeout + 0.01)
            stale = monitor.status()
            assert stale.state == "unknown" and stale.reason == "drives.stale"
            assert not [name for name, reading in stale.readings.items() if reading.quality is Quality.GOOD]
            assert stale.readings["output_frequency"].value == 0.0, "the old value is shown, marked as old"
            bench.station().faults.silent = False
            await asyncio.sleep(70.0)
            back = monitor.status()
            assert back.state == "stopped"
            assert {name for name, reading in back.readings.items() if reading.quality is Quality.GOOD} >= good

    run_virtual(scenario())


@every_family
def test_a_monitor_with_a_period_of_its_own_polls_no_more_often_and_calls_its_values_good_as_long(
    variant: SystemVariant,
) -> None:
    """A longer period is for buses with more drives than the profile's periods allow; values are good for three."""

    async def scenario() -> None:
        async with system_bench(variant) as bench:
            monitor = bench.drive.monitor(period_s=5.0)
            await asyncio.sleep(60.0)
            counts = Counter(frame.data for frame in bench.tap.requests_sent)
            assert max(counts.values()) <= 13
            assert max(counts.values()) >= 12
            bench.station().faults.silent = True
            await asyncio.sleep(9.0)
            polled = [name for name, signal in bench.drive.profile.signals.items() if signal.period_s <= 5.0]
            found = monitor.status().readings
            good = [name for name in polled if name in found and found[name].quality is not Quality.BAD]
            await asyncio.sleep(9.0)
            found = monitor.status().readings
            assert good
            assert {found[name].quality for name in good} == {Quality.BAD}
            monitor.close()

    run_virtual(scenario())


def _closing(monitor: Any) -> Any:
    class Closing:
        async def __aenter__(self) -> Any:
            return monitor

        async def __aexit__(self, *_: object) -> None:
            monitor.close()

    return Closing()


def test_the_table_of_frames_covers_every_family() -> None:
    assert set(POLL_LENGTHS) == {variant.name for variant in FAMILIES}
