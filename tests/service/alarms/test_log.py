"""Alarm log: survives restarts, torn lines and full disks; bounded; read in pages."""

from __future__ import annotations

import asyncio
import json
import os
from pathlib import Path
from typing import Any

import pytest

from drivebus.errors import InvalidParameters
from drivebus.service.alarms import Alarm, AlarmEngine, SystemAlarm
from drivebus.service.alarms import log as logs
from drivebus.service.alarms.log import AlarmLog
from fixtures.alarms import FAN, OVERCURRENT, RecordingAlarmLog, view

ALL_TIME = {"from_ms": 0, "to_ms": 10**14}


def trips(log: AlarmLog, count: int, known: list[Alarm] | None = None) -> AlarmEngine:
    """Raise ``count`` faults and clear all but the last."""
    engine = AlarmEngine([], [FAN], log.put, known or (), first_number=log.next_number)
    for n in range(count):
        engine.observe(view(fault=OVERCURRENT), n, 1000 * n)
        if n < count - 1:
            engine.observe(view(), n + 0.5, 1000 * n + 500)
    return engine


def write_log(path: Path, count: int) -> AlarmEngine:
    async def go() -> AlarmEngine:
        log = AlarmLog(path)
        engine = trips(log, count, log.load())
        await log.close()
        return engine

    return asyncio.run(go())


def test_unacknowledged_alarms_survive_a_restart_and_numbers_continue(tmp_path: Path) -> None:
    before = write_log(tmp_path / "alarms.jsonl", 3)
    log = AlarmLog(tmp_path / "alarms.jsonl")
    after = AlarmEngine([], [FAN], log.put, log.load(), first_number=log.next_number)
    assert after.active() == before.active() and after.active()[0].count == 3
    assert log.next_number == 4
    assert AlarmLog(tmp_path / "nothing").load() == []


def test_an_acknowledgement_of_a_repeated_alarm_acknowledges_each_occurrence_also_after_a_restart(
    tmp_path: Path,
) -> None:
    path = tmp_path / "alarms.jsonl"
    write_log(path, 3)

    async def acknowledge() -> None:
        log = AlarmLog(path)
        AlarmEngine([], [FAN], log.put, log.load(), first_number=log.next_number).acknowledge("a2", "li", 9_000)
        await log.close()

    asyncio.run(acknowledge())
    log = AlarmLog(path)
    assert [alarm.id for alarm in log.load()] == ["a3"], "it is not cleared yet"
    found = [(alarm["id"], alarm["count"], alarm["acknowledged_by"]) for alarm in log.history(**ALL_TIME)["items"]]
    assert found == [("a3", 3, "li"), ("a2", 2, "li"), ("a1", 1, "li")]


def test_the_acknowledgement_of_one_fault_acknowledges_no_other_between(tmp_path: Path) -> None:
    async def go() -> AlarmLog:
        log = AlarmLog(tmp_path / "alarms.jsonl")
        engine = AlarmEngine([], [FAN], log.put)
        for n, code in enumerate([4, 5, 4]):
            engine.observe(view(fault={**OVERCURRENT, "code": code}), n, 1000 * n)
        engine.acknowledge("a3", "li", 9_000)
        await log.close()
        return log

    found = asyncio.run(go()).history(**ALL_TIME)["items"]
    assert [(alarm["id"], alarm["acknowledged_by"]) for alarm in found] == [("a3", "li"), ("a2", None), ("a1", "li")]


def test_the_alarms_of_a_version_without_counts_stay_entries_of_their_own(tmp_path: Path) -> None:
    path = tmp_path / "alarms.jsonl"
    write_log(path, 3)
    names = ("count", "first_id", "first_raised_ms")
    lines = [json.loads(line) for line in path.read_bytes().splitlines()]
    path.write_text("".join(json.dumps({k: v for k, v in line.items() if k not in names}) + "\n" for line in lines))
    found = AlarmEngine([], [FAN], RecordingAlarmLog().put, AlarmLog(path).load()).active()
    assert [(alarm.id, alarm.first_id, alarm.count) for alarm in found] == [
        ("a3", "a3", 1),
        ("a2", "a2", 1),
        ("a1", "a1", 1),
    ]


def test_an_acknowledgement_is_written_once_however_often_the_alarm_was_raised(tmp_path: Path) -> None:
    """A line for each of thousands of occurrences would hold up the buses."""
    path = tmp_path / "alarms.jsonl"

    async def go() -> AlarmLog:
        log = AlarmLog(path)
        engine = trips(log, 50)
        await log._writer.flush()
        lines = path.read_bytes().count(b"\n")
        engine.acknowledge("a7", "li", 9_000)
        await log.close()
        assert path.read_bytes().count(b"\n") == lines + 1
        return log

    log = asyncio.run(go())
    assert {alarm["acknowledged_by"] for alarm in log.history(**ALL_TIME)["items"]} == {"li"}


@pytest.mark.parametrize("content", [b"\x80\x9f\xff\n", b"[]\n", b'{"id": 7}\n', b"[" * 100_000 + b"\n"])
def test_a_damaged_file_is_put_aside_and_what_could_be_read_is_kept(tmp_path: Path, content: bytes) -> None:
    """It was read around, and the next rewrite removed for good what a repair could have saved."""
    path = tmp_path / "alarms.jsonl"
    write_log(path, 2)
    whole = content + path.read_bytes()
    path.write_bytes(whole)
    write_log(path, 2)
    (copy,) = tmp_path.glob("alarms.jsonl.damaged-*")
    assert copy.read_bytes() == whole
    log = AlarmLog(path)
    assert log.load() and log.next_number > 3 and not log.damaged_copy


def test_a_directory_in_the_place_of_the_file_is_put_aside(tmp_path: Path) -> None:
    (tmp_path / "alarms.jsonl").mkdir()
    write_log(tmp_path / "alarms.jsonl", 1)
    assert len(AlarmLog(tmp_path / "alarms.jsonl").load()) == 1


def test_a_torn_end_is_no_damage(tmp_path: Path) -> None:
    """A power cut leaves it; it needs no attention."""
    path = tmp_path / "alarms.jsonl"
    write_log(path, 2)
    path.write_bytes(path.read_bytes() + b'{"id": "a9", "set')
    log = AlarmLog(path)
    assert log.load() and not log.damaged_copy and path.exists()


def test_a_damaged_line_affects_only_itself_until_the_file_is_rewritten(tmp_path: Path) -> None:
    path = tmp_path / "alarms.jsonl"
    write_log(path, 3)
    whole = path.read_bytes()
    path.write_bytes(b'{"id": 7}\nnonsense\n["a"]\n' + whole + whole[:70])
    log = AlarmLog(path)
    assert len(log.load()) == 3
    write_log(path, 2)
    assert all(line.startswith(b'{"id":"a') for line in path.read_bytes().splitlines())
    assert AlarmLog(path).load()


def test_the_history_is_read_in_pages_by_time_range_and_drive(tmp_path: Path) -> None:
    write_log(tmp_path / "alarms.jsonl", 12)
    log = AlarmLog(tmp_path / "alarms.jsonl")
    log.load()
    found, cursor = [], None
    while True:
        page = log.history(**ALL_TIME, drive="fan-1", cursor=cursor, limit=5)
        found += [item["id"] for item in page["items"]]
        if (cursor := page["next"]) is None:
            break
    assert found == [f"a{n}" for n in range(12, 0, -1)]
    assert [item["raised_ms"] for item in log.history(from_ms=3000, to_ms=5000)["items"]] == [4000, 3000]
    assert log.history(**ALL_TIME, drive="fan-2")["items"] == []
    for wrong in ("x", "LTE=", "é", "MDE="):
        with pytest.raises(InvalidParameters):
            log.history(**ALL_TIME, cursor=wrong)


def test_the_oldest_alarms_are_dropped_and_the_file_is_rewritten(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(logs, "MAX_LOGGED_ALARMS", 10)
    monkeypatch.setattr(logs, "MAX_LOG_LINES", 40)
    path = tmp_path / "alarms.jsonl"
    for _ in range(10):
        write_log(path, 6)
    assert len(path.read_bytes().splitlines()) <= 40
    log = AlarmLog(path)
    log.load()
    assert len(log.history(**ALL_TIME, limit=1000)["items"]) <= 10


def test_an_alarm_that_chatters_pushes_no_active_one_out_of_the_log(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After a restart the older alarm was missing, though its fault was still there."""
    monkeypatch.setattr(logs, "MAX_LOGGED_ALARMS", 10)
    path = tmp_path / "alarms.jsonl"

    async def go() -> None:
        log = AlarmLog(path)
        engine = AlarmEngine([], [FAN], log.put)
        engine.raise_alarm(SystemAlarm.PORT_LOST, "", 0, subject="a", bus="a")
        for n in range(1, 30):
            engine.observe(view(fault=OVERCURRENT), n, 1000 * n)
            engine.observe(view(), n + 0.5, 1000 * n + 500)
        await log.close()

    asyncio.run(go())
    log = AlarmLog(path)
    engine = AlarmEngine([], [FAN], RecordingAlarmLog().put, log.load(), first_number=log.next_number)
    assert [(alarm.id, alarm.kind, alarm.count) for alarm in engine.active()] == [
        ("a30", "fault", 29),
        ("a1", "port_lost", 1),
    ]
    assert len(log.history(**ALL_TIME)["items"]) == 10


def test_the_alarm_of_a_replaced_motor_is_repeated_by_no_later_one_also_after_a_restart(tmp_path: Path) -> None:
    path = tmp_path / "alarms.jsonl"

    async def go() -> None:
        log = AlarmLog(path)
        engine = trips(log, 1)
        engine.configure([], [FAN], 1, replaced_drives=["fan-1"])
        await log.close()

    asyncio.run(go())
    engine = AlarmEngine([], [FAN], RecordingAlarmLog().put, AlarmLog(path).load(), first_number=2)
    engine.observe(view(fault=OVERCURRENT), 2, 2000)
    assert [(alarm.id, alarm.count) for alarm in engine.active()] == [("a2", 1), ("a1", 1)]


def test_alarms_go_on_while_the_disk_is_full_and_are_written_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: Any) -> int:
        raise OSError(28, "No space left on device")

    async def go() -> None:
        log = AlarmLog(tmp_path / "alarms.jsonl")
        with monkeypatch.context() as context:
            context.setattr(os, "write", full)
            trips(log, 3)
            await log._writer.flush()
            assert log.error is not None
        log.retry()
        await log.close()
        assert log.error is None

    asyncio.run(go())
    assert len(AlarmLog(tmp_path / "alarms.jsonl").load()) == 3


WRONG_FIELDS: list[dict[str, Any]] = [
    {"raised_ms": "noon"},
    {"raised_ms": 1e300},
    {"cleared_ms": "noon"},
    {"shelved_until_ms": "soon"},
    {"value": [1]},
    {"value": float("nan")},
    {"value": float("inf")},
    {"drive": 5},
    {"subject": None},
    {"incident": 7},
    {"count": "many"},
    {"first_id": "x"},
    {"first_raised_ms": None},
    {"drive_replaced": 1},
    {"text": {"en": 5, "zh": None}},
]


@pytest.mark.parametrize("wrong", WRONG_FIELDS, ids=str)
def test_an_alarm_with_a_field_of_another_type_is_damage_and_no_end_of_the_service(
    tmp_path: Path, wrong: dict[str, Any]
) -> None:
    """With a text as the end of a shelving the service did not start: no poll, and no stop."""
    path = tmp_path / "alarms.jsonl"
    write_log(path, 1)
    lines = path.read_text().splitlines()
    path.write_text("".join(f"{line}\n" for line in [*lines, json.dumps(json.loads(lines[0]) | {"id": "a7"} | wrong)]))
    log = AlarmLog(path)
    found = log.load()
    assert [alarm.id for alarm in found] == ["a1"] and log.damaged_copy is not None
    AlarmEngine([], [FAN], log.put, found).active()


def test_an_alarm_whose_end_is_missing_in_the_log_is_cleared_where_a_later_one_is_raised(tmp_path: Path) -> None:
    """It was shown as active for ever: only the newest alarm of a key is cleared by its condition."""
    path = tmp_path / "alarms.jsonl"
    write_log(path, 1)
    first = json.loads(path.read_text().splitlines()[0])
    path.write_text("".join(json.dumps(first | {"id": id, "cleared_ms": None}) + "\n" for id in ("a1", "a2")))
    log = RecordingAlarmLog()
    engine = AlarmEngine([], [FAN], log.put, AlarmLog(path).load(), now_ms=9)
    assert [(alarm.id, alarm.cleared_ms, alarm.count) for alarm in engine.active()] == [("a2", None, 2)]
    assert [(alarm.id, alarm.cleared_ms) for alarm in log.alarms] == [("a1", 9)]
