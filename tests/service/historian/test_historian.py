"""Samples that were stored come back: at every resolution, after a restart, late, out of order, with gaps."""

from __future__ import annotations

import asyncio
import contextlib
import math
import random
import re
import sqlite3
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from drivebus.errors import InvalidParameters, NotFound, ServiceUnavailable
from drivebus.service.api.operations.history import TimeRangeParams, TrendParams
from drivebus.service.api.paging import encode_cursor
from drivebus.service.config.model import HistoryConfig
from drivebus.service.historian import FLUSH_INTERVAL_S, Historian
from drivebus.service.historian.postgres import PostgresConnection
from drivebus.service.historian.sqlite import SqliteConnection
from drivebus.service.historian.store import EventQuery, EventRow
from drivebus.service.live.views import Sample
from drivebus.testing import virtual_time
from drivebus.values import Quality, Text
from fixtures.historian import NOON_MS, HistoryDatabase, compact_all, file_names, samples, samples_of, trend
from peers import need_program

HOUR = 3_600_000


async def test_samples_come_back_as_they_were_given(database: HistoryDatabase) -> None:
    async with database.historian() as historian:
        historian.append(samples([1.0, 2.5, None, 4.0]))
        await historian.flush()
        found = await trend(historian, NOON_MS, NOON_MS + 10_000)
    assert found["resolution"] == "raw"
    assert found["t"] == [NOON_MS, NOON_MS + 1000, NOON_MS + 2000, NOON_MS + 3000]
    assert found["min"] == found["mean"] == found["max"] == [1.0, 2.5, None, 4.0]
    assert found["q"] == [0, 0, 2, 0]


async def test_samples_are_the_same_in_the_journal_in_blocks_and_in_both(database: HistoryDatabase) -> None:
    async with database.historian() as historian:
        historian.append(samples(range(50)))
        await historian.flush()
        before = await trend(historian, NOON_MS, NOON_MS + HOUR)
        await compact_all(historian)
        assert await trend(historian, NOON_MS, NOON_MS + HOUR) == before
        historian.append(samples(range(50, 60), start_ms=NOON_MS + 50_000))
        await historian.flush()
        both = await trend(historian, NOON_MS, NOON_MS + 59_000)
    assert both["mean"] == list(range(60))


async def test_a_restart_loses_and_doubles_nothing_that_was_flushed(database: HistoryDatabase) -> None:
    for turn in range(4):
        async with database.historian() as historian:
            historian.append(samples(range(10 * turn, 10 * turn + 10), start_ms=NOON_MS + turn * 10_000))
            if turn == 1:
                await compact_all(historian)
    async with database.historian() as historian:
        before = (await trend(historian, NOON_MS, NOON_MS + 100_000))["mean"]
        await compact_all(historian)
        after = (await trend(historian, NOON_MS, NOON_MS + 100_000))["mean"]
    # each restart is a gap, but where every sample before it was compacted
    assert before == after == [*range(10), None, *range(10, 30), None, *range(30, 40), None]


async def test_rollups_have_minimum_mean_maximum_and_quality(database: HistoryDatabase) -> None:
    async with database.historian() as historian:
        historian.append(samples([float(n % 60) for n in range(3600)]))
        historian.append(samples([100.0, None, 200.0], start_ms=NOON_MS + HOUR))
        historian.append(samples([None, None], start_ms=NOON_MS + HOUR + 60_000))
        await compact_all(historian)
        minutes = await trend(historian, NOON_MS, NOON_MS + 2 * HOUR, points=100)
    assert minutes["resolution"] == "1min"
    assert minutes["t"] == [NOON_MS + n * 60_000 for n in range(62)]
    assert minutes["min"] == [0.0] * 60 + [100.0, None]
    assert minutes["mean"] == [29.5] * 60 + [150.0, None]
    assert minutes["max"] == [59.0] * 60 + [200.0, None]
    assert minutes["q"] == [0] * 60 + [1, 2]


async def test_a_late_sample_changes_its_minute_and_its_hour(database: HistoryDatabase) -> None:
    async with database.historian() as historian:
        historian.append(samples([10.0] * 3600))
        await compact_all(historian)
        historian.append(samples([70.0], start_ms=NOON_MS + 90_500))
        await compact_all(historian)
        minutes = await trend(historian, NOON_MS, NOON_MS + HOUR, points=60)
        hours = await trend(historian, NOON_MS, NOON_MS + 48 * HOUR, points=40)
    assert minutes["resolution"] == "1min"
    assert (minutes["max"][1], minutes["min"][1], minutes["max"][2]) == (70.0, 10.0, 10.0)
    assert minutes["mean"][1] == pytest.approx((60 * 10 + 70) / 61)
    assert hours["resolution"] == "1h"
    assert (hours["max"], hours["mean"]) == ([70.0], [pytest.approx((3600 * 10 + 70) / 3601)])


async def test_a_clock_that_is_set_back_loses_and_reorders_nothing(database: HistoryDatabase) -> None:
    """Numbers follow the order of arrival, times the wall clock."""
    jumps = [0, 1000, -HOUR, -HOUR + 1000, 2000, 10 * 365 * 24 * HOUR, 3000, 3000]
    async with database.historian() as historian:
        historian.append([Sample("a.b", NOON_MS + jump, float(n), Quality.GOOD) for n, jump in enumerate(jumps)])
        await compact_all(historian)
        ids = historian.queries.tag_ids(["a.b"])
        far = 20 * 365 * 24 * HOUR
        stored = await historian.queries._on_reader_thread(
            lambda: historian.queries._reader.samples([ids["a.b"]], NOON_MS - far, NOON_MS + far)
        )
        shown = await trend(historian, NOON_MS - 2 * HOUR, NOON_MS + 10_000, tag="a.b")
    assert stored[ids["a.b"]].number == list(range(8))
    assert stored[ids["a.b"]].samples[0] == [NOON_MS + jump for jump in jumps]
    assert stored[ids["a.b"]].samples[1] == [float(n) for n in range(8)]
    assert shown["t"] == sorted(shown["t"])


async def test_tags_keep_their_unit_and_text(database: HistoryDatabase) -> None:
    async with database.historian() as historian:
        label = ("Hz", Text("Output frequency", "输出频率"))
        historian.set_labels({"fan-1.output_frequency": label, "fan-1.never_read": ("A", Text("", ""))})
        await historian.flush()
        assert historian.queries.tags() == {"tags": []}
        historian.append(samples([1.0]))
        await historian.flush()
    async with database.historian() as historian:
        historian.set_labels({"fan-1.output_frequency": ("1/s", label[1])})
        await historian.flush()
        assert historian.queries.tags()["tags"][0]["unit"] == "1/s"
        historian.set_labels({"fan-1.output_frequency": label})
    async with database.historian() as historian:
        assert historian.queries.tags() == {
            "tags": [
                {
                    "tag": "fan-1.output_frequency",
                    "drive": "fan-1",
                    "signal": "output_frequency",
                    "unit": "Hz",
                    "text": {"en": "Output frequency", "zh": "输出频率"},
                }
            ]
        }


async def test_events_are_read_newest_first_in_pages(database: HistoryDatabase) -> None:
    def event(n: int, drive: str | None = None) -> dict[str, object]:
        return {"id": f"e-{n}", "time_ms": NOON_MS + n // 2, "kind": "command", "drive": drive}

    async with database.historian() as historian:
        for n in range(10):
            historian.put_event(event(n, "fan-1" if n % 3 else None))
        await historian.flush()
        found, cursor = [], None
        while True:
            page = await historian.queries.events(TimeRangeParams(limit=3, cursor=cursor))
            found += [item["id"] for item in page["items"]]
            cursor = page["next"]
            if cursor is None:
                break
        of_drive = await historian.queries.events(TimeRangeParams(drive="fan-1", from_ms=NOON_MS + 2))
    assert found == [f"e-{n}" for n in range(9, -1, -1)]
    assert [item["id"] for item in of_drive["items"]] == ["e-8", "e-7", "e-5", "e-4"]


@pytest.mark.parametrize("damaged", ["", "{", "[]", '{"time_ms": NaN}', "[" * 100_000])
async def test_a_damaged_event_hides_no_other(database: HistoryDatabase, damaged: str) -> None:
    """The list of events, and the markers of every trend, ended with an internal error."""
    async with database.historian() as historian:
        for n in (0, 2):
            historian.put_event({"id": f"e-{n}", "time_ms": NOON_MS + n, "kind": "command", "drive": None})
        historian.queue.put_event(EventRow(0, NOON_MS + 1, "command", None, damaged))
        await historian.flush()
        found = await historian.queries.events(TimeRangeParams())
    assert [item["id"] for item in found["items"]] == ["e-2", "e-0"]


async def test_documents_are_stored_replaced_and_deleted(database: HistoryDatabase) -> None:
    async with database.historian() as historian:
        historian.put_document("statistics", "fan-1", {"starts": 1})
        historian.put_document("statistics", "fan-2", {"starts": 7})
        await historian.flush()
        historian.put_document("statistics", "fan-1", {"starts": 2})
        historian.put_document("statistics", "fan-2", None)
        historian.put_document("cases", "fan-1", [])
    async with database.historian() as historian:
        assert await historian.documents("statistics") == {"fan-1": {"starts": 2}}


async def test_a_value_of_a_query_is_never_a_part_of_its_statement(
    database: HistoryDatabase, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Names with quotes come back as they were given, and no statement has one of them."""
    hostile = "fan'; DROP TABLE tag; --\" OR 1=1.\\"
    statements: list[str] = []

    def recorded(original: Any) -> Any:
        def call(self: Any, statement: str, *values: Any) -> Any:
            statements.append(statement)
            return original(self, statement, *values)

        return call

    for kind in (SqliteConnection, PostgresConnection):
        for name in ("fetch", "execute", "execute_many"):
            monkeypatch.setattr(kind, name, recorded(getattr(kind, name)))
    async with database.historian() as historian:
        historian.set_labels({hostile: ("Hz", Text(hostile, hostile))})
        historian.append(samples([1.0, 2.0], tag=hostile))
        event = {"id": hostile, "time_ms": NOON_MS, "kind": hostile, "drive": hostile}
        historian.put_event(event)
        for id in (hostile, "other"):
            historian.put_document(hostile, id, {"starts": 1})
        await historian.flush()
        historian.put_document(hostile, "other", None)
    async with database.historian() as historian:
        shown = await trend(historian, NOON_MS, NOON_MS + 10_000, tag=hostile)
        wanted = EventQuery(from_ms=0, to_ms=2 * NOON_MS, drive=hostile, before=None, limit=9)
        events = await historian.queries._on_reader_thread(lambda: historian.queries._reader.store.events(wanted))
        documents = await historian.documents(hostile)
    assert (shown["mean"], [found.drive for found in events]) == ([1.0, 2.0, None], [hostile])
    assert documents == {hostile: {"starts": 1}}
    assert len(statements) > 20 and [statement for statement in statements if "DROP TABLE tag" in statement] == []


async def test_unknown_and_invalid_values_are_refused(database: HistoryDatabase) -> None:
    async with database.historian() as historian:
        historian.append(samples([1.0]))
        await historian.flush()
        with pytest.raises(NotFound):
            await trend(historian, NOON_MS, NOON_MS + 1000, tag="fan-9.output_frequency")
        with pytest.raises(InvalidParameters):
            await trend(historian, NOON_MS, NOON_MS - 1)
        beyond = [encode_cursor(2**63, 0), encode_cursor(0, 2**70)]  # of a client: no database takes such a number
        for cursor in ("", "MQ==", "zzz", "LTEuMQ==", "MS4x\n", *beyond):
            with pytest.raises(InvalidParameters):
                await historian.queries.events(TimeRangeParams(cursor=cursor))
        assert await historian.queries.events(TimeRangeParams(cursor=encode_cursor(2**63 - 1, 2**63 - 1)))


async def test_a_trend_has_at_most_the_requested_points(database: HistoryDatabase) -> None:
    async with database.historian() as historian:
        historian.append(samples([float(n) for n in range(4000)], step_ms=250))
        await historian.flush()
        for span_ms in (1, 999, 30_000, 250_000, 1_000_000, HOUR, 100 * HOUR):
            for points in (2, 7, 1000):
                for from_ms in (NOON_MS, NOON_MS - 333):
                    params = TrendParams(
                        tags=["fan-1.output_frequency"], from_ms=from_ms, to_ms=from_ms + span_ms, points=points
                    )
                    found = (await historian.queries.trend(params))["series"]["fan-1.output_frequency"]
                    assert len(found["t"]) <= points
                    assert found["t"] == sorted(set(found["t"]))


async def test_a_copy_made_while_the_service_writes_is_whole(tmp_path: Path) -> None:
    """Run the command of docs/how-to/back-up-the-history.md, then open the copy."""
    page = (Path(__file__).parents[3] / "docs" / "how-to" / "back-up-the-history.md").read_text(encoding="utf-8")
    (program,) = re.findall(r'python3 -c "(.*)"', page)
    live, copy = tmp_path / "live", tmp_path / "copy"
    live.mkdir()
    copy.mkdir()
    async with Historian(HistoryConfig(), live) as historian:
        historian.append(samples(range(100)))
        await historian.flush()
        command = [sys.executable, "-c", program, live / "history.db", copy / "history.db"]
        await asyncio.to_thread(subprocess.run, command, check=True)
        historian.append(samples(range(100, 110), start_ms=NOON_MS + 100_000))
        await historian.flush()
    async with Historian(HistoryConfig(), copy) as restored:
        assert (await trend(restored, NOON_MS, NOON_MS + 200_000))["mean"] == [*range(100), None]


async def test_what_can_be_read_of_a_damaged_file_is_saved_by_the_command_on_the_page(tmp_path: Path) -> None:
    """The other pages of the file are read; docs/how-to/back-up-the-history.md has the command."""
    need_program("sqlite3", "sqlite3")
    page = (Path(__file__).parents[3] / "docs" / "how-to" / "back-up-the-history.md").read_text(encoding="utf-8")
    (command,) = re.findall(r"^sqlite3 history.db .dump .*$", page, re.MULTILINE)
    values = [math.sin(n) for n in range(40_000)]
    async with Historian(HistoryConfig(), tmp_path) as historian:
        historian.append(samples(values))
        await compact_all(historian)
    damaged = tmp_path / "history.db"
    content = bytearray(damaged.read_bytes())
    with contextlib.closing(sqlite3.connect(damaged)) as connection:
        block = connection.execute("SELECT data FROM block WHERE level = 0 ORDER BY start_ms").fetchone()[0]
    page_of_block = content.index(block[-64:]) // 4096 * 4096
    content[page_of_block : page_of_block + 4096] = bytes(range(256)) * 16
    damaged.write_bytes(content)
    await asyncio.to_thread(subprocess.run, command, shell=True, cwd=tmp_path, check=True)
    damaged.unlink()
    (tmp_path / "salvaged.db").rename(damaged)
    async with Historian(HistoryConfig(), tmp_path) as restored:
        assert restored.ok
        with pytest.raises(ServiceUnavailable, match=f"block 0 1 {NOON_MS}"):
            await trend(restored, NOON_MS, NOON_MS + 5000)
        later = await trend(restored, NOON_MS + 5 * HOUR, NOON_MS + 5 * HOUR + 2999)
        assert later["mean"] == pytest.approx(values[18_000:18_003], abs=1e-6)
        restored.append(samples([7.0], start_ms=NOON_MS + 24 * HOUR))
        await restored.flush()
        assert (await trend(restored, NOON_MS + 24 * HOUR, NOON_MS + 24 * HOUR + 999))["mean"] == [7.0]


async def test_after_a_regular_end_one_file_is_the_whole_history(tmp_path: Path) -> None:
    """Otherwise a copy made while the service is down would lack the newest samples."""
    async with Historian(HistoryConfig(), tmp_path) as historian:
        historian.append(samples([1.0, 2.0]))
        await historian.flush()
        await trend(historian, NOON_MS, NOON_MS + 5000)
    assert file_names(tmp_path) == ["history.db"]


async def test_an_import_may_be_larger_than_the_queue(
    database: HistoryDatabase, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("drivebus.service.historian.historian.IMPORT_BATCH_SAMPLES", 500)
    async with database.historian() as historian:
        historian.queue._max_samples = 600
        await historian.import_samples(iter(samples(range(2000))))
        assert historian.status()["lost_samples"] == 0
        found = await trend(historian, NOON_MS, NOON_MS + HOUR)
    assert (found["min"][0], found["max"][-1]) == (0, 1999)


def test_the_historian_works_in_virtual_time(tmp_path: Path) -> None:
    """Virtual time has no threads: the historian runs on the loop's thread."""

    async def scenario() -> list[float]:
        async with Historian(HistoryConfig(), tmp_path) as historian:
            historian.append(samples([1.0, 2.0]))
            await asyncio.sleep(FLUSH_INTERVAL_S + 0.1)
            return (await trend(historian, NOON_MS, NOON_MS + 5000))["mean"]  # type: ignore[no-any-return]

    assert virtual_time.run(scenario()) == [1.0, 2.0]


async def test_a_thousand_jumps_of_the_clock_lose_and_reorder_nothing(database: HistoryDatabase) -> None:
    """By a second, an hour or ten years in both directions at random moments, with compactions in between."""
    chance = random.Random(15)
    jumps = [sign * size for sign in (-1, 1) for size in (1000, HOUR, 10 * 365 * 24 * HOUR)]
    now_ms, times = NOON_MS + 30 * 365 * 24 * HOUR, []
    async with database.historian() as historian:
        for n in range(4000):
            now_ms += 1000
            if chance.random() < 0.25:
                back = max(now_ms - NOON_MS, 0)
                now_ms += chance.choice([jump for jump in jumps if jump > -back])
                now_ms -= (now_ms > 2**42) * 20 * 365 * 24 * HOUR
            times.append(now_ms)
            historian.append([Sample("a.b", now_ms, float(n), Quality.GOOD)])
            if n % 500 == 499:
                await (compact_all(historian) if chance.random() < 0.5 else historian.flush())
    async with database.historian() as historian:
        stored = await samples_of(historian, "a.b", 0, 2**60)
        assert stored.number == list(range(4000))
        assert stored.samples[0] == times
        assert stored.samples[1] == [float(n) for n in range(4000)]
        far = await trend(historian, min(times), max(times), tag="a.b")
    assert (min(value for value in far["min"] if value is not None), far["t"]) == (0.0, sorted(far["t"]))
