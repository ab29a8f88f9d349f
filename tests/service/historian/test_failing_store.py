"""Database that fails at any call, before or after it took effect: acknowledged data stay and nothing counts twice.

Lost samples are counted and marked, and appending never waits.
"""

from __future__ import annotations

import errno
import logging
import re
import socket
import sqlite3
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from drivebus import i18n
from drivebus.errors import ServiceUnavailable
from drivebus.service.api.operations.history import TimeRangeParams
from drivebus.service.config.model import HistoryConfig
from drivebus.service.historian import historian as historian_module
from drivebus.service.historian.sqlite import SqliteConnection
from drivebus.service.historian.store import EventRow, HistoryStore, StoreError
from drivebus.service.historian.writer import MAX_QUEUED_SAMPLES, WriteQueue
from drivebus.values import Text
from fixtures.historian import NOON_MS, HistoryDatabase, compact_all, samples, samples_of, trend

HOUR = 3_600_000


def store_error(words: str) -> StoreError:
    return StoreError(Text(words, words))


class FailingStore:
    """Store whose ``n``-th call fails, before or after it took effect."""

    def __init__(self, store: HistoryStore, n: int, *, done: bool) -> None:
        self._store, self._left, self._done = store, n, done

    def __getattr__(self, name: str) -> Callable[..., Any]:
        method: Callable[..., Any] = getattr(self._store, name)
        if name == "close":
            return method

        def called(*args: Any, **kwargs: Any) -> Any:
            self._left -= 1
            if self._left == 0 and not self._done:
                raise store_error("planned failure before the call")
            found = method(*args, **kwargs)
            if self._left == 0:
                raise store_error("planned failure after the call")
            return found

        return called

    @property
    def has_failed(self) -> bool:
        return self._left <= 0


@pytest.mark.parametrize("other_file", [False, True], ids=["removed", "replaced"])
async def test_a_file_that_is_removed_or_replaced_while_it_is_written_is_a_failure(
    tmp_path: Path, other_file: bool
) -> None:
    """The history went on into the removed file, without an alarm, and was lost at the end of the service."""
    file, away = tmp_path / "history.db", tmp_path / "away.db"
    async with historian_module.Historian(HistoryConfig(), tmp_path) as historian:
        historian.append(samples(range(10)))
        await historian.flush()
        file.rename(away)
        if other_file:
            file.touch()
        for first in (10, 20):
            historian.append(samples(range(10), start_ms=NOON_MS + 1000 * first))
            with pytest.raises(
                ServiceUnavailable, match="removed or replaced: put the same file back, or restart the service"
            ):
                await historian.flush()
            assert not historian.ok and historian.problem is not None
        away.replace(file)
        await historian.flush()
        assert historian.ok
        found = await samples_of(historian, "fan-1.output_frequency", NOON_MS, NOON_MS + 60_000)
        assert found.number == list(range(30))


@pytest.mark.parametrize("done", [False, True], ids=["before", "after"])
async def test_a_failure_of_any_call_loses_and_doubles_nothing(database: HistoryDatabase, done: bool) -> None:
    """Calls are failed one after another, each with its own tag, until a run has none left."""
    n, failing = 0, True
    while failing:
        n += 1
        tag, stores = f"drive-{n}.speed", []

        def made(setting: HistoryConfig, directory: Path, n: int = n, stores: list[FailingStore] = stores) -> Any:
            writing, reading = historian_module.open_stores(setting, directory)
            stores.append(FailingStore(writing, n, done=done))
            return stores[0], reading

        async with database.historian(open_stores=made) as historian:
            for turn in range(4):
                historian.append(samples(range(10 * turn, 10 * turn + 10), tag, NOON_MS + turn * 10_000))
                historian.put_event({"id": f"{n}-{turn}", "time_ms": NOON_MS, "kind": "command"})
                for attempt in range(3):
                    try:
                        await (compact_all(historian) if turn % 2 else historian.flush())
                        break
                    except (ServiceUnavailable, StoreError):
                        assert attempt < 2
            assert historian.ok
            assert historian.status()["lost_samples"] == 0
            found = await trend(historian, NOON_MS, NOON_MS + HOUR // 10, tag=tag)
            hours = await trend(historian, NOON_MS, NOON_MS + 48 * HOUR, points=40, tag=tag)
            failing = stores[0].has_failed
        assert found["mean"] == list(range(40)), n
        assert (hours["min"], hours["mean"], hours["max"]) == ([0.0], [19.5], [39.0]), n
    assert n > 15
    async with database.historian() as historian:
        ids = [item["id"] for item in (await historian.queries.events(TimeRangeParams(limit=1000)))["items"]]
        assert sorted(ids) == sorted(f"{m}-{turn}" for m in range(1, n + 1) for turn in range(4))


async def test_a_full_queue_drops_counts_and_marks_new_samples() -> None:
    """Appending never waits and never raises."""
    queue = WriteQueue(max_samples=5)
    queue.append(samples([1.0, 2.0, 3.0]))
    queue.append(samples([4.0, 5.0, 6.0], start_ms=NOON_MS + 3000))
    queue.append(samples([7.0], start_ms=NOON_MS + 6000))
    assert (queue.queued, queue.lost_samples) == (5, 3)
    taken = queue.take(100).samples
    assert [(sample.time_ms - NOON_MS, sample.value, str(sample.quality)) for sample in taken] == [
        (0, 1.0, "good"),
        (1000, 2.0, "good"),
        (2000, 3.0, "good"),
        (3000, None, "bad"),
        (6000, 7.0, "good"),
    ]


async def test_queued_events_and_documents_are_bounded() -> None:
    queue = WriteQueue(max_notes=2)
    for n in range(3):
        queue.put_event(EventRow(0, n, "command", None, "{}"))
    assert (len(queue.take(1).events), queue.lost_notes) == (2, 1)


async def test_a_full_disk_is_an_alarm_and_no_further_log_line_and_recovers_when_there_is_space(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """A page limit makes SQLite report a full disk. The log has the alarm of the service; one event is one line."""
    stores: list[Any] = []

    def made(setting: HistoryConfig, directory: Path) -> Any:
        stores.extend(historian_module.open_stores(setting, directory))
        connect = stores[0].connection.connect

        def limited() -> None:
            connect()
            if stores[0].connection.is_full:
                stores[0].connection.fetch("PRAGMA max_page_count = 1")

        stores[0].connection.is_full, stores[0].connection.connect = False, limited
        return stores[0], stores[1]

    async with historian_module.Historian(HistoryConfig(), tmp_path, open_stores=made) as historian:
        historian.append(samples(range(1000)))
        await historian.flush()
        stores[0].connection.is_full = True
        await historian._on_writer_thread(lambda: stores[0].connection.fetch("PRAGMA max_page_count = 1"))
        with caplog.at_level(logging.WARNING, "drivebus.history"):
            for turn in range(1, 40):
                historian.append(samples(range(1000), start_ms=NOON_MS + turn * 1_000_000))
                await historian._on_writer_thread(historian.writer.run_cycle)
            assert not historian.ok
            assert historian.status()["problem"] == {"en": "the disk is full", "zh": "磁盘空间已满"}
            with pytest.raises(ServiceUnavailable):
                await historian.flush()
            assert (await trend(historian, NOON_MS, NOON_MS + 2000))["mean"] == [0, 1, 2]
            stores[0].connection.is_full = False
            await historian.flush()
        assert historian.ok
        assert caplog.records == []
        far = await trend(historian, NOON_MS + 39 * 1_000_000, NOON_MS + 40 * 1_000_000 - 1)
        assert (far["min"][0], far["max"][-1]) == (0, 999)


async def test_a_read_only_file_is_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The service starts, drives run, and history begins when the disk can be written again."""
    stores: list[Any] = []

    def made(setting: HistoryConfig, directory: Path) -> Any:
        stores.extend(historian_module.open_stores(setting, directory))
        return stores[0], stores[1]

    async with historian_module.Historian(HistoryConfig(), tmp_path):
        pass
    historian = historian_module.Historian(HistoryConfig(), tmp_path, open_stores=made)
    stores[0].connection.connect = lambda: _read_only(stores[0].connection)
    async with historian:
        historian.append(samples([1.0, 2.0]))
        with pytest.raises(ServiceUnavailable):
            await historian.flush()
        assert historian.status()["problem"] == {"en": "history.db is read-only", "zh": "history.db 为只读"}
        del stores[0].connection.connect
        await historian.flush()
        assert (await trend(historian, NOON_MS, NOON_MS + 5000))["mean"] == [1.0, 2.0]


@pytest.mark.parametrize(
    ("result", "sentence"),
    [
        (sqlite3.SQLITE_IOERR_FSYNC, "history.db 所在磁盘读写出错"),
        (sqlite3.SQLITE_CANTOPEN, "history.db 无法打开"),
        (sqlite3.SQLITE_BUSY, "history.db 被其他程序锁定"),
        (sqlite3.SQLITE_MISUSE, "数据库报告：words"),
    ],
)
def test_the_reason_of_a_failure_of_sqlite_is_a_sentence_in_each_language(
    tmp_path: Path, result: int, sentence: str
) -> None:
    """Regression: the alarm of the history had the English words of SQLite in its Chinese sentence."""
    error = sqlite3.OperationalError("words")
    error.sqlite_errorcode = result
    assert SqliteConnection(tmp_path / "history.db").reason(error).zh == sentence


def test_the_reason_of_a_failure_of_the_operating_system_is_a_sentence_in_each_language(tmp_path: Path) -> None:
    found = SqliteConnection(tmp_path / "history.db").reason(OSError(errno.ENOSPC, "No space left on device"))
    assert found == Text("No space left on device", "磁盘空间已满")


async def test_the_reason_of_a_server_that_is_not_reached_is_a_sentence_in_each_language(
    request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    server = request.getfixturevalue("postgres")
    server.create("own")
    for url, sentence in (
        (server.url("absent"), "服务器上没有此数据库"),
        (_closed_port_url(), "无法连接服务器：连接被拒绝"),
    ):
        async with historian_module.Historian(HistoryConfig(url=url), tmp_path) as historian:
            with pytest.raises(ServiceUnavailable) as rejected:
                await historian.flush()
        assert sentence in rejected.value.text("zh")


def _closed_port_url() -> str:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return f"postgresql://nobody@127.0.0.1:{listener.getsockname()[1]}/none"


def _read_only(connection: Any) -> None:
    connection._connection = sqlite3.connect(f"{connection.path.as_uri()}?mode=ro", uri=True, isolation_level=None)


async def test_a_file_that_is_no_database_is_left_as_it_is(tmp_path: Path) -> None:
    (tmp_path / "history.db").write_bytes(b"no database" * 100)
    async with historian_module.Historian(HistoryConfig(), tmp_path) as historian:
        historian.append(samples([1.0]))
        assert not historian.ok
        with pytest.raises(ServiceUnavailable) as rejected:
            await historian.documents("statistics")
    assert "history.db 已损坏，或不是历史库" in rejected.value.text("zh")
    assert (tmp_path / "history.db").read_bytes() == b"no database" * 100


@pytest.mark.parametrize(("version", "named"), [(99, "later version"), (1, "earlier version")])
async def test_tables_of_another_version_are_left_alone(database: HistoryDatabase, version: int, named: str) -> None:
    """Blocks of another version would be misread, and blocks of this one mixed in with them."""
    async with database.historian() as historian:
        connection = historian.writer._store.connection  # type: ignore[attr-defined]
        change = f"UPDATE meta SET value = {version} WHERE key = 'schema'"
        await historian._on_writer_thread(lambda: connection.execute(change))
    async with database.historian() as historian:
        historian.append(samples([1.0]))
        with pytest.raises(ServiceUnavailable):
            await historian.flush()
        problem = historian.status()["problem"]
        assert named in problem["en"]
        assert re.search("[A-Za-z ]{8,}", problem["zh"].replace("drivebus", "")) is None


async def test_labels_of_the_version_with_two_languages_are_kept(database: HistoryDatabase) -> None:
    """The version had a column for each language; the samples beside them are as they are now."""
    async with database.historian() as historian:
        historian.append(samples([1.0, 2.0]))
        await historian.flush()
        connection = historian.writer._store.connection  # type: ignore[attr-defined]
        changes = (
            "ALTER TABLE tag DROP COLUMN text",
            "ALTER TABLE tag ADD COLUMN en TEXT NOT NULL DEFAULT 'speed'",
            "ALTER TABLE tag ADD COLUMN zh TEXT NOT NULL DEFAULT '转速'",
            "UPDATE meta SET value = 2 WHERE key = 'schema'",
        )
        for change in changes:
            await historian._on_writer_thread(partial(connection.execute, change))
    label = ("Hz", Text("speed", "转速", (("de", "Drehzahl"),)))
    async with database.historian() as historian:
        (tag,) = historian.queries.tags()["tags"]
        assert tag["text"] == {"en": "speed", "zh": "转速"}
        historian.set_labels({tag["tag"]: label})
        historian.append(samples([3.0]))
        await historian.flush()
    async with database.historian() as historian:
        (tag,) = historian.queries.tags()["tags"]
        assert (tag["unit"], tag["text"]) == ("Hz", label[1].by_language())


async def test_a_damaged_block_is_named_and_hides_nothing_else(database: HistoryDatabase) -> None:
    """A trend and an export of its hour fail with its place; the other tag and the other hour are still read."""
    hour = 3_600_000
    async with database.historian() as historian:
        for tag, start_ms in (("a.x", NOON_MS), ("a.x", NOON_MS + hour), ("b.x", NOON_MS)):
            historian.append(samples([1.0, 2.0], tag=tag, start_ms=start_ms))
        await compact_all(historian)
        connection = historian.writer._store.connection  # type: ignore[attr-defined]
        (id,) = historian.queries.tag_ids(["a.x"]).values()
        change = "UPDATE block SET data = ? WHERE tag = ? AND start_ms = ? AND level = 0"
        await historian._on_writer_thread(lambda: connection.execute(change, b"\4garbled", id, NOON_MS))
        with pytest.raises(ServiceUnavailable, match=f"block 0 {id} {NOON_MS}"):
            await trend(historian, NOON_MS, NOON_MS + 5000, tag="a.x")
        with pytest.raises(ServiceUnavailable, match=f"block 0 {id} {NOON_MS}"):
            await samples_of(historian, "a.x", NOON_MS, NOON_MS + 5000)
        assert (await trend(historian, NOON_MS, NOON_MS + 5000, tag="b.x"))["mean"] == [1.0, 2.0]
        later = await trend(historian, NOON_MS + hour, NOON_MS + hour + 5000, tag="a.x")
        assert later["mean"] == [1.0, 2.0]


async def test_a_server_that_restarts_loses_nothing(request: pytest.FixtureRequest, tmp_path: Path) -> None:
    """The connection ends under the writer and the reader; both come back."""
    server = request.getfixturevalue("postgres")
    server.create("restarting")
    async with historian_module.Historian(HistoryConfig(url=server.url("restarting")), tmp_path) as historian:
        historian.append(samples([1.0, 2.0]))
        await historian.flush()
        await trend(historian, NOON_MS, NOON_MS + 5000)
        server.stop()
        historian.append(samples([3.0], start_ms=NOON_MS + 2000))
        for read_or_write in (historian.flush, lambda: trend(historian, NOON_MS, NOON_MS + 5000)):
            with pytest.raises(ServiceUnavailable):
                await read_or_write()
        server.start()
        await historian.flush()
        assert (await trend(historian, NOON_MS, NOON_MS + 5000))["mean"] == [1.0, 2.0, 3.0]


async def test_a_second_service_may_not_write_to_the_same_tables(
    request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    server = request.getfixturevalue("postgres")
    server.create("shared")
    setting = HistoryConfig(url=server.url("shared"))
    async with (
        historian_module.Historian(setting, tmp_path) as first,
        historian_module.Historian(setting, tmp_path) as second,
    ):
        assert (first.ok, second.ok) == (True, False)
        statement = "SELECT to_regclass('drivebus.block') IS NOT NULL"
        assert await first._on_writer_thread(lambda: first.writer._store.connection.fetch(statement)) == [(True,)]  # type: ignore[attr-defined]
        assert second.status()["problem"]["zh"] == "另一个服务正在向此数据库写入历史数据"
        apart = HistoryConfig(url=server.url("shared") + "&search_path=north")
        async with historian_module.Historian(apart, tmp_path) as third:
            third.append(samples([5.0]))
            await third.flush()
            assert (first.queries.tags(), len(third.queries.tags()["tags"])) == ({"tags": []}, 1)


@pytest.mark.parametrize(
    ("language", "line"),
    [("en", "history is written again; samples lost: 7"), ("zh", "历史数据恢复写入；丢失样本 7 个")],
)
async def test_samples_that_an_outage_lost_are_logged_once_with_their_number(
    language: str, line: str, tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DRIVEBUS_LANG", language)
    async with historian_module.Historian(HistoryConfig(), tmp_path) as historian:
        historian.writer._record_failure(store_error("disk is full"))
        historian.queue.lost_samples = 7
        await historian.flush()
        historian.writer._record_failure(store_error("disk is full"))
        await historian.flush()
    assert [record.getMessage() for record in caplog.records] == [line]


async def test_a_reader_connection_that_the_database_cut_does_not_keep_the_service_from_ending(tmp_path: Path) -> None:
    """After a restart of PostgreSQL the end of the service failed with "Broken pipe", before the last checkpoint."""

    def made(setting: HistoryConfig, directory: Path) -> Any:
        writing, reading = historian_module.open_stores(setting, directory)

        def cut() -> None:
            raise store_error("[Errno 32] Broken pipe")

        reading.close = cut  # type: ignore[method-assign]
        return writing, reading

    historian = historian_module.Historian(HistoryConfig(), tmp_path, open_stores=made)
    await historian.open()
    historian.append(samples(range(3)))
    await historian.close()
    async with historian_module.Historian(HistoryConfig(), tmp_path) as again:
        assert (await trend(again, NOON_MS, NOON_MS + 2000))["mean"] == [0, 1, 2]


@pytest.mark.parametrize("language", ["en", "zh"])
def test_the_half_hour_that_a_broken_history_bridges_is_named_with_the_size_of_the_plant_for_which_it_is_true(
    language: str,
) -> None:
    """300 drives fill the queue within a minute or two: the page promised half an hour to them too."""
    assert 25 <= MAX_QUEUED_SAMPLES / (12 * 10) / 60 <= 35  # 12 drives with 10 signals a second
    for key in ("page.history_broken", "alarms.remedy.storage_failure"):
        assert {"en": "half an hour with 12 drives", "zh": "12 台变频器时约可存半小时"}[language] in i18n.text(
            key, language
        )
