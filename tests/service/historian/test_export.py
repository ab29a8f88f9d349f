"""Export as CSV and Parquet: every value with its quality, no spreadsheet formulas, bounded parts."""

from __future__ import annotations

import csv
import io
from base64 import b64decode
from typing import Any

import pytest

from drivebus.errors import InvalidParameters
from drivebus.service.api.operations.history import ExportParams
from drivebus.service.historian import Historian, export
from drivebus.values import Text
from fixtures.historian import NOON_MS, HistoryDatabase, compact_all, samples, trend
from peers import need_module

TAGS = ["fan-1.output_frequency", "fan-2.temperature"]


def export_params(**more: Any) -> ExportParams:
    return ExportParams(**{"tags": TAGS, "from_ms": NOON_MS - 1000, "to_ms": NOON_MS + 2 * 3_600_000, **more})


async def parts(historian: Historian, **more: Any) -> list[dict[str, Any]]:
    found = [await historian.queries.export(export_params(**more))]
    while found[-1]["next"] is not None:
        found.append(await historian.queries.export(export_params(cursor=found[-1]["next"], **more)))
    return found


async def rows(historian: Historian, **more: Any) -> list[dict[str, str]]:
    text = "".join(part["text"] for part in await parts(historian, **more))
    return list(csv.DictReader(io.StringIO(text, newline="")))


async def fill(historian: Historian) -> None:
    """Store an hour in blocks, then a sample in the journal only."""
    historian.set_labels({TAGS[1]: ("=cmd|'/C calc'!A0", Text("", ""))})
    historian.append(samples([-1.5, None, 3.25]))
    historian.append(samples([20.0, 21.0], TAGS[1], NOON_MS + 500))
    await compact_all(historian)
    historian.append(samples([9.0], TAGS[0], NOON_MS + 3_600_000))
    await historian.flush()


async def test_csv_has_time_value_unit_and_quality(database: HistoryDatabase) -> None:
    async with database.historian() as historian:
        await fill(historian)
        found = await rows(historian)
    values = [(row["time"], row["tag"], row["value"], row["quality"], row["number"]) for row in found]
    assert values == [
        ("2026-01-01T12:00:00.000Z", TAGS[0], "-1.5", "good", "0"),
        ("2026-01-01T12:00:00.500Z", TAGS[1], "20.0", "good", "0"),
        ("2026-01-01T12:00:01.000Z", TAGS[0], "", "bad", "1"),
        ("2026-01-01T12:00:01.500Z", TAGS[1], "21.0", "good", "1"),
        ("2026-01-01T12:00:02.000Z", TAGS[0], "3.25", "good", "2"),
        ("2026-01-01T13:00:00.000Z", TAGS[0], "9.0", "good", "3"),
    ]


async def test_no_text_of_a_drive_becomes_a_formula(database: HistoryDatabase) -> None:
    """A negative number stays a number."""
    async with database.historian() as historian:
        await fill(historian)
        found = await rows(historian)
    assert {row["unit"] for row in found} == {"", "'=cmd|'/C calc'!A0"}
    assert export.escape_formula("+1") == "'+1"
    assert export.escape_formula("＝1") == "'＝1"
    assert export.escape_formula("Hz") == "Hz"


@pytest.mark.parametrize("layout", ["long", "wide"])
async def test_the_name_of_a_file_has_nothing_but_a_resolution_and_a_day(
    database: HistoryDatabase, layout: str
) -> None:
    """It stands in a header: a name of a client or a drive could end the header or name a folder."""
    async with database.historian() as historian:
        await fill(historian)
        wanted = export_params(tags=[TAGS[1]], layout=layout, timezone="Asia/Shanghai")
        found = await historian.queries.export(wanted)
    assert found["file"] == f"history-raw{'-wide' * (layout == 'wide')}-2026-01-01.csv"


async def test_rollups_are_exported_with_their_number_of_values(database: HistoryDatabase) -> None:
    async with database.historian() as historian:
        await fill(historian)
        found = await rows(historian, resolution="1min", tags=TAGS[:1])
    values = [
        (row["time"], row["minimum"], row["mean"], row["maximum"], row["quality"], row["values"]) for row in found
    ]
    assert values == [
        ("2026-01-01T12:00:00.000Z", "-1.5", "0.875", "3.25", "uncertain", "2"),
        ("2026-01-01T13:00:00.000Z", "9.0", "9.0", "9.0", "good", "1"),
    ]


async def test_the_parts_concatenated_are_the_whole_file(
    database: HistoryDatabase, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with database.historian() as historian:
        await fill(historian)
        whole = await rows(historian)
        monkeypatch.setattr(export, "CSV_ROWS_PER_PART", 2)
        found = await parts(historian)
        assert len(found) == 3
        assert {part["file"] for part in found} == {"history-raw-2026-01-01.csv"}
        assert await rows(historian) == whole


async def test_a_range_without_history_is_a_header_alone(database: HistoryDatabase) -> None:
    async with database.historian() as historian:
        await fill(historian)
        assert await rows(historian, from_ms=NOON_MS - 10_000, to_ms=NOON_MS - 1) == []
        assert len(await parts(historian, from_ms=0, to_ms=253_402_300_799_999)) == 1


async def test_parquet_has_the_same_content(database: HistoryDatabase, monkeypatch: pytest.MonkeyPatch) -> None:
    need_module("pyarrow")
    import pyarrow.parquet as pq

    from drivebus.service.historian import parquet

    monkeypatch.setattr(parquet, "PARQUET_ROWS_PER_GROUP", 2)
    async with database.historian() as historian:
        await fill(historian)
        found = await parts(historian, format="parquet")
        minutes = await parts(historian, format="parquet", resolution="1min")
    table = pq.read_table(io.BytesIO(b"".join(b64decode(part["base64"]) for part in found))).to_pydict()
    assert table["value"] == [-1.5, 20.0, None, 21.0, 3.25, 9.0]
    assert [time.isoformat() for time in table["time"]][:2] == [
        "2026-01-01T12:00:00+00:00",
        "2026-01-01T12:00:00.500000+00:00",
    ]
    assert (table["tag"][1], table["quality"][2], table["number"][5]) == (TAGS[1], "bad", 3)
    rolled = pq.read_table(io.BytesIO(b"".join(b64decode(part["base64"]) for part in minutes))).to_pydict()
    assert (rolled["mean"], rolled["values"]) == ([0.875, 20.5, 9.0], [2, 2, 1])


async def test_a_parquet_export_continues_only_at_its_last_part(database: HistoryDatabase) -> None:
    need_module("pyarrow")
    async with database.historian() as historian:
        await fill(historian)
        first = await historian.queries.export(export_params(format="parquet"))
        await historian.queries.export(export_params(format="parquet", cursor=first["next"]))
        for cursor in (first["next"], "OS4x"):
            with pytest.raises(InvalidParameters):
                await historian.queries.export(export_params(format="parquet", cursor=cursor))
        started = [
            await historian.queries.export(export_params(format="parquet"))
            for _ in range(export.MAX_PARQUET_EXPORTS + 1)
        ]
        with pytest.raises(InvalidParameters):
            await historian.queries.export(export_params(format="parquet", cursor=started[0]["next"]))
        await historian.queries.export(export_params(format="parquet", cursor=started[-1]["next"]))


async def test_a_wide_export_has_one_column_a_tag_and_one_row_a_time(database: HistoryDatabase) -> None:
    """A sample of another time leaves the cell empty, and so does a value of bad quality."""
    async with database.historian() as historian:
        await fill(historian)
        found = await rows(historian, layout="wide")
    assert [[*row.values()] for row in found[:3]] == [
        ["2026-01-01T12:00:00.000Z", "-1.5", ""],
        ["2026-01-01T12:00:00.500Z", "", "20.0"],
        ["2026-01-01T12:00:01.000Z", "", ""],
    ]
    assert [*found[0]] == ["time", TAGS[0], f"{TAGS[1]} [=cmd|'/C calc'!A0]"]


async def test_a_wide_export_of_rollups_joins_the_means_of_one_time(database: HistoryDatabase) -> None:
    async with database.historian() as historian:
        await fill(historian)
        found = await rows(historian, layout="wide", resolution="1s")
    assert [[*row.values()] for row in found] == [
        ["2026-01-01T12:00:00.000Z", "-1.5", "20.0"],
        ["2026-01-01T12:00:01.000Z", "", "21.0"],
        ["2026-01-01T12:00:02.000Z", "3.25", ""],
        ["2026-01-01T13:00:00.000Z", "9.0", ""],
    ]


async def test_the_parts_of_a_wide_export_are_the_whole_file(
    database: HistoryDatabase, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with database.historian() as historian:
        await fill(historian)
        whole = await rows(historian, layout="wide")
        monkeypatch.setattr(export, "CSV_ROWS_PER_PART", 2)
        assert len(await parts(historian, layout="wide")) > 2
        assert await rows(historian, layout="wide") == whole


async def test_an_export_in_local_time_names_its_zone_in_the_heading(database: HistoryDatabase) -> None:
    async with database.historian() as historian:
        await fill(historian)
        found = await rows(historian, timezone="Asia/Shanghai")
        assert found[1]["time (Asia/Shanghai)"] == "2026-01-01 20:00:00.500"
        for wrong in ({"timezone": "Asia/Nowhere"}, {"format": "parquet", "layout": "wide"}):
            with pytest.raises(InvalidParameters):
                await parts(historian, **wrong)


async def test_the_time_in_which_the_service_did_not_run_is_a_gap_after_each_last_value(
    database: HistoryDatabase,
) -> None:
    """A kill, at which nothing is stored, leaves the same gap; a signal that was bad already needs no second one."""
    async with database.historian() as historian:
        historian.append([*samples([20.0, 21.0], TAGS[0]), *samples([50.0, None], TAGS[1])])
    for _ in range(2):
        async with database.historian():
            pass
    async with database.historian() as historian:
        historian.append(samples([0.0, 1.0], TAGS[0], NOON_MS + 600_000))
        await historian.flush()
        found = await rows(historian)
        shown = await trend(historian, NOON_MS, NOON_MS + 601_000)
    values = [(row["time"][14:], row["value"], row["quality"]) for row in found if row["tag"] == TAGS[0]]
    assert values == [
        ("00:00.000Z", "20.0", "good"),
        ("00:01.000Z", "21.0", "good"),
        ("00:01.001Z", "", "bad"),
        ("10:00.000Z", "0.0", "good"),
        ("10:01.000Z", "1.0", "good"),
    ]
    assert [row["quality"] for row in found if row["tag"] == TAGS[1]] == ["good", "bad"]
    assert None in shown["mean"]
