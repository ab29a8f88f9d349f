"""Polling a full line in virtual time: exact durations, fairness to the living, values that grow old."""

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
    every_reporting_drive,
    on_four_lines,
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
"""Characters of a poll and of its answer, by the manuals: class 1 and its reply, a Q, FC03 of four registers."""


def request(kind: SystemVariant, address: int) -> Any:
    """One poll: d.0, Q01, 3001H-3004H, F0.00-F0.03."""
    if kind.model == "c320":
        return sunfar.ReadMonitor(address, 0)
    if kind.model == "dzb100":
        return dzb100.Dzb100Query(address, 1)
    return modbus.ReadRegisters(address, 0x3001 if kind.model == "vc660" else 0, 4)


class PollRound:
    """Polls every drive as often as the bus allows and writes down when each answered."""

    def __init__(self, here: SystemBench) -> None:
        self.answers: dict[int, list[BusResult]] = defaultdict(list)
        self.times: dict[int, list[float]] = defaultdict(list)
        for address in here.drives:
            here.bus.start_polling(
                address, [Poll(request(here.kind, address), 0.0)], lambda a, n=address: self._on_answer(n, a)
            )

    def _on_answer(self, address: int, answer: BusResult) -> None:
        if answer.error is None:
            assert answer.received_at is not None
            self.answers[address].append(answer)
            self.times[address].append(answer.received_at)

    def cycle_s(self, address: int, since: float, until: float) -> float:
        """Mean time between two answers of one drive."""
        times = [at for at in self.times[address] if since <= at <= until]
        return (times[-1] - times[0]) / (len(times) - 1)


def transaction_s(kind: SystemVariant, here: SystemBench) -> float:
    """Gap, request, the drive's own delay, answer: what the manuals' arithmetic says."""
    character = here.bench.settings.character_s
    asked, answered = POLL_LENGTHS[kind.name]
    gap = max(kind.gap_characters * character, kind.gap_floor_s)
    return gap + (asked + answered) * character + max(kind.station_s, kind.station_characters * character)


@every_family
def test_polling_31_drives_takes_the_computed_time(kind: SystemVariant) -> None:
    async def scenario() -> None:
        async with system_bench(kind, ADDRESSES[kind.model]) as here:
            await asyncio.sleep(1.0)
            polls = PollRound(here)
            await asyncio.sleep(20.0)
            expected = transaction_s(kind, here)
            first = here.tap.requests_sent[0].start
            ends = [one.end for one in here.tap.replies_sent]
            gap = max(kind.gap_characters * here.bench.settings.character_s, kind.gap_floor_s)
            assert first == 1.0, "the line had been silent: nothing to wait for"
            for number, end in enumerate(ends, start=1):
                assert end == pytest.approx(first - gap + number * expected, abs=1e-6)
            assert (
                len(ends)
                == len(here.tap.requests_sent) - (len(here.tap.requests_sent) > len(ends))
                >= int(20.0 / expected)
            )
            counts = [len(polls.answers[address]) for address in here.drives]
            assert sum(counts) == sum(end + gap <= 21.0 for end in ends), "every answer was credited after its gap"
            assert max(counts) - min(counts) <= 2
            here.tap.check(kind)

    run_virtual(scenario())


@on_four_lines
@every_family
def test_every_drive_of_a_full_bus_stays_online_at_any_line_quality(kind: SystemVariant, weather: str) -> None:
    async def scenario() -> None:
        async with system_bench(kind, ADDRESSES[kind.model], weather) as here:
            polls = PollRound(here)
            await asyncio.sleep(40.0)
            counts = {address: len(polls.answers[address]) for address in here.drives}
            assert all(count >= 5 for count in counts.values()), counts
            assert max(counts.values()) <= 2 * min(counts.values()), counts
            here.tap.check(kind)
            if kind.model != "dzb100" and "late" not in weather:  # its manual gives no gap; the pretend one is stricter
                assert not any(station.gap_violations for station in here.bench.stations)

    run_virtual(scenario())


@pytest.mark.parametrize("dead", [1, 5, 15, 30])
@pytest.mark.parametrize("kind", [C320, VC660], ids=lambda kind: kind.name)
def test_silent_drives_take_at_most_a_tenth_of_the_bus_and_come_back(kind: SystemVariant, dead: int) -> None:
    """The cycle of the living stretches by 11.2 % at most for any number of dead drives."""

    async def scenario() -> None:
        async with system_bench(kind, ADDRESSES[kind.model]) as here:
            addresses = list(here.drives)
            silent, living = addresses[:dead], addresses[dead:]
            for address in silent:
                here.station(address).faults.silent = True
            polls = PollRound(here)
            await asyncio.sleep(20.0)
            begun = here.bus.now()
            await asyncio.sleep(60.0)
            limit = 1.112 * len(living) * transaction_s(kind, here)
            for address in living:
                assert polls.cycle_s(address, begun, here.bus.now()) <= limit
            assert {here.bus.presence(address) for address in silent} == {Presence.NEVER_SEEN}
            for address in silent:
                here.station(address).faults.silent = False
            probe_s = 2 * transaction_s(kind, here) + 0.05
            await asyncio.sleep(max(60.0, dead * probe_s / 0.1) + 1.0)
            assert {here.bus.presence(address) for address in addresses} == {Presence.ONLINE}
            here.tap.check(kind)

    run_virtual(scenario())


@every_reporting_drive
def test_a_silenced_drive_has_no_good_value_and_no_state_any_more(kind: SystemVariant) -> None:
    """I4, G17: within three periods (1 s at least) and a timeout nothing of it is good; it all comes back with it."""

    async def scenario() -> None:
        async with system_bench(kind) as here, _closing(here.drive.monitor()) as monitor:
            await asyncio.sleep(8.0)
            fresh = monitor.status()
            assert fresh.state == "stopped"
            good = {name for name, reading in fresh.readings.items() if reading.quality is Quality.GOOD}
            assert "output_frequency" in good
            here.station().faults.silent = True
            longest = max(3 * signal.period_s for signal in here.drive.profile.signals.values())
            timeout = here.link().timing.timeout_s(here.bus.settings, 18)
            await asyncio.sleep(max(longest, 1.0) + timeout + 0.01)
            stale = monitor.status()
            assert stale.state == "unknown" and stale.reason == "drives.stale"
            assert not [name for name, reading in stale.readings.items() if reading.quality is Quality.GOOD]
            assert stale.readings["output_frequency"].value == 0.0, "the old value stays to be seen, as old"
            here.station().faults.silent = False
            await asyncio.sleep(70.0)
            back = monitor.status()
            assert back.state == "stopped"
            assert {name for name, reading in back.readings.items() if reading.quality is Quality.GOOD} >= good

    run_virtual(scenario())


@every_family
def test_a_monitor_with_a_period_of_its_own_polls_no_more_often_and_calls_its_values_good_as_long(
    kind: SystemVariant,
) -> None:
    """For lines with more drives than the profile's own periods allow; good for three periods."""

    async def scenario() -> None:
        async with system_bench(kind) as here:
            monitor = here.drive.monitor(period_s=5.0)
            await asyncio.sleep(60.0)
            often = Counter(one.data for one in here.tap.requests_sent)
            assert max(often.values()) <= 13
            assert max(often.values()) >= 12
            here.station().faults.silent = True
            await asyncio.sleep(9.0)
            quick = [name for name, signal in here.drive.profile.signals.items() if signal.period_s <= 5.0]
            found = monitor.status().readings
            good = [name for name in quick if name in found and found[name].quality is not Quality.BAD]
            await asyncio.sleep(9.0)
            found = monitor.status().readings
            assert good
            assert {found[name].quality for name in good} == {Quality.BAD}
            monitor.close()

    run_virtual(scenario())


def _closing(monitor: Any) -> Any:
    class Both:
        async def __aenter__(self) -> Any:
            return monitor

        async def __aexit__(self, *_: object) -> None:
            monitor.close()

    return Both()


def test_the_table_of_frames_covers_every_family() -> None:
    assert set(POLL_LENGTHS) == {kind.name for kind in FAMILIES}
