"""Retention of the history: by age at each level and by size, independent of jumps of the wall clock."""

from __future__ import annotations

from dataclasses import replace

import pytest

from drivebus.service.api.operations.history import TimeRangeParams
from drivebus.service.config.model import HistoryConfig, RetentionConfig
from drivebus.service.historian import Historian, compaction, writer
from drivebus.service.historian.points import DAY_MS, HOUR_MS, ResolutionLevel
from fixtures.historian import NOON_MS, FakeWallClock, HistoryDatabase, compact_all, samples, trend

TEN_YEARS = 3650 * DAY_MS


def with_retention(database: HistoryDatabase, **days: float) -> HistoryConfig:
    """Return the configuration of the database with another retention."""
    return replace(database.setting, retention=RetentionConfig(**days))


class Clocks:
    """Wall and monotonic clock of a historian, set by a test."""

    def __init__(self, historian: Historian, wall: FakeWallClock) -> None:
        self._writer, self._wall, self.now_s = historian.writer, wall, 0.0
        historian.writer._monotonic_s = lambda: self.now_s
        historian.writer._clock_s = historian.writer._retention_s = 0.0
        self._historian = historian

    async def advance(self, wall_ms: int, monotonic_ms: int) -> None:
        """Advance both clocks, then apply the retention."""
        self._wall.now_ms += wall_ms
        self.now_s += monotonic_ms / 1000 + writer.RETENTION_INTERVAL_S
        for _ in range(20):
            await self._historian._on_writer_thread(self._historian.writer.run_cycle)


async def count(historian: Historian, level: ResolutionLevel) -> int:
    found = await historian.queries._on_reader_thread(
        lambda: historian.queries._reader.store.read_blocks(
            level, [tag.id for tag in historian.writer.tags.values()], 0, 2**60
        )
    )
    return len(found[1])


async def stored_levels(historian: Historian) -> list[bool]:
    return [await count(historian, level) > 0 for level in ResolutionLevel]


async def test_each_level_is_kept_for_its_configured_time(
    database: HistoryDatabase, monkeypatch: pytest.MonkeyPatch
) -> None:
    setting = with_retention(database, raw_days=2, rollup_1s_days=7, rollup_1min_days=30, rollup_1h_days=90)
    wall = FakeWallClock()
    async with database.historian(setting, wall_ms=wall) as historian:
        clocks = Clocks(historian, wall)
        historian.append(samples(range(10)))
        for n in range(3):
            historian.put_event({"id": n, "time_ms": NOON_MS, "kind": "command"})
        await compact_all(historian)
        day = 86_400_000
        monkeypatch.setattr(compaction, "MAX_EVENTS", 1)
        levels = []
        for days in (1, 1.5, 5, 23, 61):
            await clocks.advance(round(days * day), round(days * day))
            levels.append(await stored_levels(historian))
        events = (await historian.queries.events(TimeRangeParams()))["items"]
    assert levels == [
        [True, True, True, True],
        [False, True, True, True],
        [False, False, True, True],
        [False, False, False, True],
        [False, False, False, False],
    ]
    assert [event["id"] for event in events] == [2]


async def test_a_time_range_deleted_at_a_fine_level_is_shown_from_a_coarse_one(database: HistoryDatabase) -> None:
    setting = with_retention(database, raw_days=2, rollup_1s_days=7)
    wall = FakeWallClock()
    async with database.historian(setting, wall_ms=wall) as historian:
        clocks = Clocks(historian, wall)
        historian.append(samples([5.0, 7.0]))
        await compact_all(historian)
        assert (await trend(historian, NOON_MS, NOON_MS + 9000))["resolution"] == "raw"
        await clocks.advance(3 * DAY_MS, 3 * DAY_MS)
        found = await trend(historian, NOON_MS, NOON_MS + 9000)
        await clocks.advance(6 * DAY_MS, 6 * DAY_MS)
        later = await trend(historian, NOON_MS, NOON_MS + 9000)
    assert (found["resolution"], found["mean"]) == ("1s", [5.0, 7.0])
    assert (later["resolution"], later["min"], later["max"]) == ("1min", [5.0], [7.0])


@pytest.mark.parametrize("jump", [-TEN_YEARS, -HOUR_MS, HOUR_MS, TEN_YEARS])
async def test_a_clock_that_jumps_deletes_nothing(database: HistoryDatabase, jump: int) -> None:
    """That holds at run time and over a restart; samples under a wrong clock are kept as long."""
    wall = FakeWallClock()
    async with database.historian(wall_ms=wall) as historian:
        clocks = Clocks(historian, wall)
        historian.append(samples(range(10)))
        await compact_all(historian)
        await clocks.advance(jump, 0)
        historian.append(samples(range(10), start_ms=wall.now_ms))
        await compact_all(historian)
        assert await count(historian, ResolutionLevel.RAW) == (2 if abs(jump) > DAY_MS or jump else 1)
    async with database.historian(wall_ms=wall) as historian:
        await Clocks(historian, wall).advance(-jump, 0)
        assert await count(historian, ResolutionLevel.RAW) == 2


def test_a_pause_counts_as_a_day_at_most_and_never_backwards() -> None:
    assert compaction.age_clock_at_start(None, NOON_MS) == 0
    assert compaction.age_clock_at_start((5000, NOON_MS), NOON_MS + 300) == 5300
    assert compaction.age_clock_at_start((5000, NOON_MS), NOON_MS + TEN_YEARS) == 5000 + DAY_MS
    assert compaction.age_clock_at_start((5000, NOON_MS), NOON_MS - TEN_YEARS) == 5000


async def test_the_age_clock_continues_over_a_restart(database: HistoryDatabase) -> None:
    setting = with_retention(database, raw_days=2)
    wall = FakeWallClock()
    for day in range(4):
        async with database.historian(setting, wall_ms=wall) as historian:
            if day == 0:
                historian.append(samples(range(10)))
                await compact_all(historian)
            await Clocks(historian, wall).advance(DAY_MS // 2, DAY_MS // 2)
            assert (await count(historian, ResolutionLevel.RAW) == 0) is (day >= 2)
        wall.now_ms += DAY_MS // 3


async def test_the_size_limit_deletes_the_finest_level_first_and_never_the_newest_rows(
    database: HistoryDatabase,
) -> None:
    wall = FakeWallClock()
    setting = replace(with_retention(database, raw_days=1000, rollup_1s_days=1000), max_size_mb=1e-6)
    async with database.historian(setting, wall_ms=wall) as historian:
        clocks = Clocks(historian, wall)
        historian.append(samples([0.3 * n for n in range(3000)]))
        await compact_all(historian)
        await clocks.advance(0, 0)
        assert await stored_levels(historian) == [True, True, True, True]
        order = []
        for _ in range(4):
            clocks.now_s += 3 * HOUR_MS / 1000
            await historian._on_writer_thread(historian.writer._delete_some)
            order.append(await stored_levels(historian))
    assert order == [
        [False, True, True, True],
        [False, False, True, True],
        [False, False, False, True],
        [False, False, False, False],
    ]


async def test_below_the_size_limit_nothing_is_deleted(database: HistoryDatabase) -> None:
    wall = FakeWallClock()
    async with database.historian(wall_ms=wall) as historian:
        historian.append(samples(range(10)))
        await compact_all(historian)
        later = 10 * HOUR_MS
        assert not await historian._on_writer_thread(
            lambda: compaction.delete_oversize(historian.writer._store, database.setting, later)
        )
        assert await stored_levels(historian) == [True] * 4


async def test_deleted_rows_free_space_in_the_file(database: HistoryDatabase) -> None:
    wall = FakeWallClock()
    async with database.historian(with_retention(database, raw_days=1), wall_ms=wall) as historian:
        clocks = Clocks(historian, wall)
        for hour in range(30):
            values = [float(hash((hour, n)) % 10_007) for n in range(3600)]
            historian.append(samples(values, start_ms=NOON_MS + hour * HOUR_MS))
            await historian._on_writer_thread(historian.writer.run_cycle)
        await compact_all(historian)
        before = await historian._on_writer_thread(historian.writer._store.size_bytes)
        await clocks.advance(2 * DAY_MS, 2 * DAY_MS)
        after = await historian._on_writer_thread(historian.writer._store.size_bytes)
        assert await stored_levels(historian) == [False, True, True, True]
    assert after < 0.75 * before
