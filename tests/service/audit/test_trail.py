"""Audit trail: durable records in a hash chain, without secrets; failures are reported."""

from __future__ import annotations

import asyncio
import json
import os
import re
import threading
import time
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

from drivebus.errors import AuditUnavailable, InvalidParameters, ServiceUnavailable
from drivebus.service.alarms import SystemAlarm
from drivebus.service.api.errors import failure_reason
from drivebus.service.audit import AuditEntry, AuditTrail
from drivebus.service.audit.chain import AuditPaths
from drivebus.service.audit.records import MAX_RECORD_LINE_BYTES, MAX_TEXT_LENGTH
from drivebus.service.audit.verify import verify
from drivebus.service.config.model import PlantConfig
from drivebus.service.storage import append_log, batch_writer
from drivebus.service.storage.storage import Storage
from drivebus.types import Json
from drivebus.values import Text
from fixtures.audit import LI, counting_clock, new_trail, problem_kinds, sample_entry, verify_report, written_trail
from fixtures.running_service import real_service

ALL_TIME = {"from_ms": 0, "to_ms": 10**14}


def lines(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_bytes().splitlines()]


def test_an_unchanged_trail_is_verified(tmp_path: Path) -> None:
    trail = written_trail(tmp_path)
    found = verify_report(trail)
    assert (found.ok, found.entries, found.covered, found.keyed) == (True, 10, 10, True)
    assert [record["n"] for record in lines(trail.paths.current)] == list(range(1, 11))


@pytest.mark.skipif(not hasattr(os, "getpgid"), reason="process groups of POSIX")
def test_ctrl_z_in_the_terminal_of_the_service_does_not_suspend_a_verification(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    trail, start, groups = written_trail(tmp_path), asyncio.create_subprocess_exec, list[bool]()

    async def record_group(*command: str, **options: Any) -> asyncio.subprocess.Process:
        child = await start(*command, **options)
        groups.append(os.getpgid(child.pid) == child.pid)
        return child

    monkeypatch.setattr(asyncio, "create_subprocess_exec", record_group)
    assert asyncio.run(trail.verify())["ok"]
    assert groups == [True]


def test_a_record_has_actor_operation_time_frames_and_outcome(tmp_path: Path) -> None:
    async def go() -> None:
        trail = new_trail(tmp_path)
        await trail.open()
        frame = {"sent": "01 06", "received": "01 06", "sent_at_s": 1.5, "received_at_s": 1.6, "error": None}
        requested = await trail.record(sample_entry(1))
        assert requested == 2
        await trail.record(
            AuditEntry.by(LI, "drive.run", target="fan-1", frames=[frame], outcome="confirmed", of=requested)
        )
        (item, before), rest = (await trail.query(**ALL_TIME, limit=2))["items"], None
        assert (item["n"], item["who"], item["what"]) == (
            3,
            {"name": "li", "session": "s-1", "address": "127.0.0.1"},
            "drive.run",
        )
        assert (item["target"], item["frames"], item["outcome"], item["of"]) == ("fan-1", [frame], "confirmed", 2)
        assert (before["params"], before["outcome"], len(before["hash"])) == ({"frequency_hz": 1.0}, "requested", 64)
        assert rest is None and (await trail.verify())["ok"]
        await trail.close()

    asyncio.run(go())


@pytest.mark.parametrize("name", ["a\nb", "\x1b[31mred", "x\x9b2J", "\u202egnp", 'q"},{"n":9', "\ud800", "汉字\r\n"])
def test_control_characters_in_names_cannot_forge_a_line(tmp_path: Path, name: str) -> None:
    async def go() -> None:
        trail = new_trail(tmp_path)
        await trail.open()
        await trail.record(AuditEntry.by(LI, "login", target=name, params={name: name}, outcome="refused"))
        await trail.close()
        data = trail.paths.current.read_bytes()
        assert data.count(b"\n") == 2 and all(byte == 10 or 32 <= byte < 127 for byte in data)
        assert lines(trail.paths.current)[1]["outcome"] == "refused"
        assert verify_report(trail).ok

    asyncio.run(go())


def test_no_secret_is_written(tmp_path: Path) -> None:
    text = {
        "password": "hunter2",
        "new_password": ["hunter2"],
        "deep": {"Api-Token": "hunter2", "l": [{"arm_token": "hunter2"}]},
        "url": "postgresql://plant:hunter2@db/plant",
        "header": "Bearer hunter2",
        "token": None,
        "name": "li",
    }

    async def go() -> bytes:
        trail = new_trail(tmp_path)
        await trail.open()
        await trail.record(AuditEntry.by(LI, "login", params=text))
        await trail.close()
        return trail.paths.current.read_bytes()

    data = asyncio.run(go())
    assert b"hunter2" not in data
    params = json.loads(data.splitlines()[1])["params"]
    assert (params["url"], params["name"], params["token"]) == ("postgresql://***@db/plant", "li", None)


def test_a_long_text_is_replaced_by_its_hash(tmp_path: Path) -> None:
    async def go() -> list[dict[str, Any]]:
        trail = new_trail(tmp_path)
        await trail.open()
        await trail.record(AuditEntry.by(LI, "x", params={"text": "x" * (MAX_TEXT_LENGTH + 1), "nan": float("nan")}))
        await trail.record(
            AuditEntry.by(LI, "x", params={str(n): "y" * MAX_TEXT_LENGTH for n in range(100)}, outcome="done")
        )
        await trail.record(
            AuditEntry.by(LI, "x", params={"deep": _nested(50), "many": range(9), "octets": b"\x01\xff"})
        )
        await trail.close()
        assert verify_report(trail).ok
        return lines(trail.paths.current)

    _, first, second, third = asyncio.run(go())
    assert first["params"]["text"]["characters"] == MAX_TEXT_LENGTH + 1 and first["params"]["nan"] == "nan"
    assert set(second["params"]) == {"left_out"} and second["outcome"] == "done"
    assert second["params"]["left_out"]["octets"] > MAX_RECORD_LINE_BYTES
    assert third["params"]["octets"] == "01 FF"


def test_a_result_of_many_drives_keeps_the_status_of_each_without_their_frames(tmp_path: Path) -> None:
    """Regression: the record of the start of thirty drives kept neither values nor outcomes."""
    params = {"group": "air", "frequency_hz": 20.5, "outcomes": {f"fan-{n}": "confirmed" for n in range(300)}}

    async def go() -> Any:
        trail = new_trail(tmp_path)
        await trail.open()
        frames = [{"bytes": "01 06 20 00 00 01 43 CA ", "explanation": "x" * 200}] * 300
        await trail.record(AuditEntry.by(LI, "group.start", params=params, outcome="confirmed", frames=frames))
        await trail.close()
        assert verify_report(trail).ok
        return lines(trail.paths.current)[1]

    found = asyncio.run(go())
    assert (found["frames"], found["params"].pop("left_out")["octets"] > MAX_RECORD_LINE_BYTES) == ([], True)
    assert found["params"] == params


def _nested(depth: int) -> Any:
    return {"more": _nested(depth - 1)} if depth else "end"


def test_concurrent_records_are_written_in_one_batch_in_order(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synced: list[int] = []
    real = os.fsync

    def counted(fd: int) -> None:
        synced.append(fd)
        real(fd)

    monkeypatch.setattr(os, "fsync", counted)

    async def go() -> None:
        trail = new_trail(tmp_path)
        await trail.open()
        synced.clear()
        numbers = await asyncio.gather(*(trail.record(sample_entry(n)) for n in range(300)))
        assert numbers == list(range(2, 302))
        assert len(synced) <= 3
        await trail.close()

    asyncio.run(go())


def test_full_files_are_rotated_and_the_chain_continues(tmp_path: Path) -> None:
    trail = written_trail(tmp_path, 40, max_file_bytes=2_000)
    files = trail.paths.files()
    assert len(files) > 3 and [path.name for path in files][:1] == ["audit-000000000001.jsonl"]
    assert verify_report(trail).ok and verify_report(trail).entries == 40
    again = written_trail(tmp_path, 5, max_file_bytes=2_000)
    assert verify_report(again).ok and verify_report(again).entries == 45


def test_pages_reach_the_first_record_without_repetition(tmp_path: Path) -> None:
    trail = written_trail(tmp_path, 40, max_file_bytes=2_000)

    async def go(drive: str | None) -> list[int]:
        found, cursor = [], None
        while True:
            page = await trail.query(**ALL_TIME, drive=drive, cursor=cursor, limit=7)
            found += [item["n"] for item in page["items"]]
            if (cursor := page["next"]) is None:
                return found

    assert asyncio.run(go(None)) == list(range(40, 0, -1))
    assert asyncio.run(go("fan-1")) == [n for n in range(40, 1, -1) if n % 3 == 1]
    for wrong in ("x", "LTE=", "MDE=", "é"):
        with pytest.raises(InvalidParameters):
            asyncio.run(trail.query(**ALL_TIME, cursor=wrong))


def test_a_query_by_drive_returns_commands_that_affected_it(tmp_path: Path) -> None:
    """Such as the start of its group."""

    async def go() -> None:
        trail = new_trail(tmp_path)
        await trail.open()
        await trail.record(AuditEntry.by(LI, "group.start", target="fans", params={"drives": ["fan-1", "fan-2"]}))
        await trail.record(AuditEntry.by(LI, "user.add", target="fan-2", params={"drives": "fan-1"}))
        found = [(await trail.query(**ALL_TIME, drive=drive))["items"] for drive in ("fan-1", "fan-2", "fan-3")]
        what = [[item["what"] for item in items] for items in found]
        assert what == [["group.start"], ["user.add", "group.start"], []]
        await trail.close()

    asyncio.run(go())


def test_pages_respect_the_time_range_and_omit_changed_lines(tmp_path: Path) -> None:
    trail = written_trail(tmp_path)
    times = [record["time_ms"] for record in lines(trail.paths.current)]
    trail.paths.current.write_bytes(
        trail.paths.current.read_bytes().replace(b'"frequency_hz":5.0', b'"frequency_hz":6.0')
    )
    items = asyncio.run(trail.query(from_ms=times[3], to_ms=times[7]))["items"]
    assert [item["n"] for item in items] == [7, 6, 4]


@pytest.mark.parametrize("operation", ["audit.list", "alarms.history"])
def test_a_list_takes_range_drive_cursor_and_page_size_each_from_its_own_parameter(
    operation: str, tmp_path: Path
) -> None:
    """Five values went through by position, two pairs of them of the same type."""

    async def scenario() -> None:
        async with real_service(tmp_path) as kit:
            for _ in range(3):
                for drive in ("fan-1", "fan-2"):
                    kit.service.plant.raise_alarm(SystemAlarm.RUNNING_AT_START, drive)
                    kit.service.plant.clear_alarm(SystemAlarm.RUNNING_AT_START, drive)
                    ids = [alarm.id for alarm in kit.service.plant.alarms.active()]
                    await kit.call("alarms.acknowledge", alarms=ids)
                await asyncio.sleep(0.01)
            whole = (await kit.call(operation, drive="fan-1"))["items"]
            time = "raised_ms" if operation == "alarms.history" else "time_ms"
            newest, oldest = whole[0][time], whole[-1][time]
            assert len(whole) >= 3 and oldest < newest
            older = await kit.call(operation, drive="fan-1", from_ms=oldest, to_ms=newest, limit=1)
            assert older["items"] == [item for item in whole if item[time] < newest][:1]
            rest = await kit.call(operation, drive="fan-1", cursor=older["next"])
            assert rest["items"] == whole[whole.index(older["items"][0]) + 1 :]

    asyncio.run(scenario())


def write_half_and_fail(fd: int, data: bytes, real: Callable[[int, bytes], int] = os.write) -> int:
    """Write as a full disk does: a part of the data, then an error."""
    real(fd, data[: len(data) // 2])
    raise OSError(28, "No space left on device")


def test_a_failed_disk_rejects_awaited_records_and_queues_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def go() -> None:
        trail = new_trail(tmp_path)
        await trail.open()
        with monkeypatch.context() as context:
            context.setattr(os, "write", write_half_and_fail)
            with pytest.raises(AuditUnavailable) as rejected:
                await trail.record(sample_entry(1))
            trail.record_nowait(AuditEntry.by(LI, "drive.stop", target="fan-1", outcome="confirmed"))
            await trail.checkpoint()
            assert not trail.ok and "No space" in str(rejected.value)
        assert await trail.record(sample_entry(2)) == 3
        assert trail.ok
        await trail.close()
        what = [record["what"] for record in lines(trail.paths.current)]
        assert what == ["audit.opened", "drive.stop", "drive.run"]
        assert verify_report(trail).ok

    asyncio.run(go())


def test_a_service_that_ends_on_a_full_disk_leaves_no_half_record(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`audit verify` took it for a kill or a cut."""

    async def go() -> None:
        trail = new_trail(tmp_path)
        await trail.open()
        await trail.record(sample_entry(1))
        await trail.checkpoint()
        monkeypatch.setattr(os, "write", write_half_and_fail)
        trail.record_nowait(AuditEntry.by(LI, "drive.stop", target="fan-1", outcome="confirmed"))
        await trail.close()
        assert verify_report(trail).ok and [record["n"] for record in lines(trail.paths.current)] == [1, 2]

    asyncio.run(go())


def test_a_recovered_disk_is_noticed_without_a_request(tmp_path: Path) -> None:
    from drivebus.testing.virtual_time import run

    async def go() -> None:
        blocked = tmp_path / "plant"
        blocked.write_text("a file where the folder should be")
        trail = new_trail(tmp_path)
        await trail.open()
        assert not trail.ok
        with pytest.raises(AuditUnavailable):
            await trail.record(sample_entry(1))
        await asyncio.sleep(1.0)
        blocked.unlink()
        await asyncio.sleep(1.0)
        assert not trail.ok
        await asyncio.sleep(6.0)
        assert trail.ok
        await trail.close()
        assert [record["what"] for record in lines(trail.paths.current)] == ["audit.opened"]

    run(go())


def test_the_alarm_about_the_trail_names_the_reason_and_clears_without_a_request(tmp_path: Path) -> None:
    """It is checked every five seconds."""
    from drivebus.testing.virtual_time import run

    async def go() -> None:
        blocked = tmp_path / "plant"
        blocked.write_text("a file where the folder should be")
        storage = Storage.of(
            PlantConfig(id="p", title=Text("P", "P"), directory=blocked, buses=(), drives=()), wall_ms=lambda: 0
        )
        await storage.audit.open()
        found = storage.errors()["audit.jsonl"]
        assert found is not None and str(failure_reason(found)) == "Not a directory"
        blocked.unlink()
        await asyncio.sleep(6.0)
        assert storage.errors()["audit.jsonl"] is None
        await storage.audit.close()

    run(go())


def test_records_beyond_the_limit_of_a_failed_disk_are_dropped_oldest_first_and_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from drivebus.testing.virtual_time import run

    async def go() -> None:
        monkeypatch.setattr(batch_writer, "MAX_UNATTENDED_ITEMS", 5)
        blocked = tmp_path / "plant"
        blocked.write_text("a file where the folder should be")
        trail = new_trail(tmp_path)
        for n in range(8):
            trail.record_nowait(sample_entry(n))
        await trail.open()
        await asyncio.sleep(1.0)
        blocked.unlink()
        await asyncio.sleep(20.0)
        await trail.close()
        written = lines(trail.paths.current)
        assert [record["params"].get("frequency_hz") for record in written[:4]] == [4.0, 5.0, 6.0, 7.0]
        assert [(record["what"], record["params"]) for record in written[5:]] == [("audit.lost", {"records": 4})]

    run(go())


def test_a_checkpoint_is_written_at_the_start_each_minute_and_at_the_end(tmp_path: Path) -> None:
    from drivebus.testing.virtual_time import run

    async def go() -> None:
        trail = new_trail(tmp_path)
        await trail.open()
        assert [record["n"] for record in lines(trail.paths.checkpoints)] == [1]
        await trail.record(sample_entry(1))
        await asyncio.sleep(59.0)
        assert len(lines(trail.paths.checkpoints)) == 1
        await asyncio.sleep(2.0)
        assert [record["n"] for record in lines(trail.paths.checkpoints)] == [1, 2]
        await asyncio.sleep(120.0)
        await trail.record(sample_entry(1))
        assert len(lines(trail.paths.checkpoints)) == 2, "no checkpoint without a new record"
        await trail.close()
        assert [record["n"] for record in lines(trail.paths.checkpoints)] == [1, 2, 3]

    run(go())


def test_a_torn_record_of_a_killed_writer_is_quarantined_and_reported(tmp_path: Path) -> None:
    trail = written_trail(tmp_path)
    whole = trail.paths.current.read_bytes()
    trail.paths.current.write_bytes(whole + whole[:100])
    assert problem_kinds(trail) == ["unfinished"]
    trail.paths.checkpoints.write_bytes(trail.paths.checkpoints.read_bytes() + b'{"checkp')
    again = written_trail(tmp_path, 3)
    assert verify_report(again).ok
    found = lines(again.paths.current)[10]
    assert (found["what"], found["params"]["octets"]) == ("audit.recovered", 100)
    assert (again.paths.folder / found["params"]["file"]).read_bytes() == whole[:100]


def test_a_record_has_its_own_number_after_recovery_entries(tmp_path: Path) -> None:
    trail = written_trail(tmp_path)
    trail.paths.current.write_bytes(trail.paths.current.read_bytes() + b"half")

    async def go() -> int:
        again = new_trail(tmp_path)
        number = await again.record(sample_entry(1))
        assert again._writer.error is None
        return number

    assert asyncio.run(go()) == 12


def test_recovery_reads_only_the_end_of_a_long_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    trail = written_trail(tmp_path)
    trail.paths.checkpoints.unlink()
    trail.paths.head.unlink()
    monkeypatch.setattr(append_log, "TAIL_BYTES", 1_500)
    assert trail.paths.current.stat().st_size > 2 * append_log.TAIL_BYTES
    again = written_trail(tmp_path, 2)
    assert [record["what"] for record in lines(again.paths.current)][10:] == ["audit.opened", "drive.run"]


def test_holes_after_the_last_checkpoint_are_quarantined(tmp_path: Path) -> None:
    """Blocks of the last batch may reach the disk in any order."""
    paths = written_trail(tmp_path).paths
    checkpoints, head = paths.checkpoints.read_bytes(), paths.head.read_bytes()
    trail = written_trail(tmp_path, 3)
    trail.paths.checkpoints.write_bytes(checkpoints)
    trail.paths.head.write_bytes(head)
    complete = trail.paths.current.read_bytes().splitlines(True)
    trail.paths.current.write_bytes(b"".join([*complete[:11], b"\0" * 50 + b"\n", complete[12]]))
    again = written_trail(tmp_path, 3)
    assert verify_report(again).ok
    assert [record["what"] for record in lines(again.paths.current)[10:13]] == [
        "audit.opened",
        "audit.recovered",
        "audit.opened",
    ]


def test_a_line_edited_before_the_last_checkpoint_is_never_quarantined(tmp_path: Path) -> None:
    trail = written_trail(tmp_path)
    data = trail.paths.current.read_bytes()
    trail.paths.current.write_bytes(data.replace(b'"frequency_hz":5.0', b'"frequency_hz":9.0'))
    again = written_trail(tmp_path, 3)
    assert problem_kinds(again) == ["changed"] and verify_report(again).entries == 13


def test_a_cut_end_is_still_detected_after_the_service_continued(tmp_path: Path) -> None:
    trail = written_trail(tmp_path)
    complete = trail.paths.current.read_bytes().splitlines(True)[:6]
    trail.paths.current.write_bytes(b"".join(complete))
    again = written_trail(tmp_path, 3)
    assert lines(again.paths.current)[6]["what"] == "audit.cut"
    assert set(problem_kinds(again)) == {"rewritten", "checkpoint_broken"}


def reopened_trail(folder: Path) -> AuditTrail:
    """Return the trail of a folder after it was opened and closed again."""

    async def go() -> AuditTrail:
        trail = new_trail(folder)
        await trail.open()
        await trail.close()
        return trail

    return asyncio.run(go())


def test_opening_a_trail_reports_that_its_end_was_cut_off(tmp_path: Path) -> None:
    trail = written_trail(tmp_path)
    assert reopened_trail(tmp_path).records_missing is False
    trail.paths.current.write_bytes(b"".join(trail.paths.current.read_bytes().splitlines(True)[:4]))
    assert reopened_trail(tmp_path).records_missing is True


def roll_back(trail: AuditTrail, checkpoints: int) -> None:
    """Keep the first checkpoints and the records up to the last of them, as if the rest had never been written."""
    kept = trail.paths.checkpoints.read_bytes().splitlines(True)[:checkpoints]
    trail.paths.checkpoints.write_bytes(b"".join(kept))
    records = trail.paths.current.read_bytes().splitlines(True)[: json.loads(kept[-1])["n"]]
    trail.paths.current.write_bytes(b"".join(records))


def test_records_and_checkpoints_that_were_cut_back_together_are_detected(tmp_path: Path) -> None:
    trail = written_trail(tmp_path)
    roll_back(trail, 2)
    assert problem_kinds(trail) == ["cut", "checkpoints_missing"]
    trail.paths.head.unlink()
    assert verify_report(trail).ok and verify_report(trail).head is None
    assert [problem.kind for problem in verify(trail.paths, at_least=10).problems] == ["fewer"]


def test_removed_checkpoints_are_detected_although_every_record_is_there(tmp_path: Path) -> None:
    trail = written_trail(tmp_path)
    trail.paths.checkpoints.write_bytes(b"".join(trail.paths.checkpoints.read_bytes().splitlines(True)[:-1]))
    assert problem_kinds(trail) == ["checkpoints_missing"]


def test_no_file_is_not_a_complete_trail(tmp_path: Path) -> None:
    trail = written_trail(tmp_path)
    trail.paths.current.unlink()
    trail.paths.checkpoints.unlink()
    assert problem_kinds(trail) == ["absent", "cut", "checkpoints_missing"]
    trail.paths.head.unlink()
    assert problem_kinds(trail) == ["absent"]


def test_a_head_of_another_key_is_detected(tmp_path: Path) -> None:
    trail, other = written_trail(tmp_path), written_trail(tmp_path / "other")
    trail.paths.head.write_bytes(other.paths.head.read_bytes())
    assert problem_kinds(trail) == ["head_changed"]


@pytest.mark.parametrize("removed", ["newest records and checkpoints", "newest checkpoint", "all files"])
def test_opening_a_trail_that_was_rolled_back_reports_it_and_never_hides_it(tmp_path: Path, removed: str) -> None:
    trail = written_trail(tmp_path)
    if removed == "all files":
        trail.paths.current.unlink()
        trail.paths.checkpoints.unlink()
    elif removed == "newest checkpoint":
        trail.paths.checkpoints.write_bytes(b"".join(trail.paths.checkpoints.read_bytes().splitlines(True)[:-1]))
    else:
        roll_back(trail, 2)
    again = reopened_trail(tmp_path)
    assert again.records_missing and not again.key_replaced
    assert {"checkpoint_broken", "checkpoints_missing"} <= set(problem_kinds(again))


def test_opening_a_trail_that_was_rolled_back_without_its_head_reports_the_missing_head(tmp_path: Path) -> None:
    """The next start made a new head of the shorter trail, and the missing one was reported nowhere."""
    trail = written_trail(tmp_path)
    assert not reopened_trail(tmp_path).head_missing
    roll_back(trail, 2)
    trail.paths.head.unlink()
    again = reopened_trail(tmp_path)
    assert again.head_missing and "audit.head_missing" in [record["what"] for record in lines(again.paths.current)]
    assert not reopened_trail(tmp_path).head_missing


def test_a_missing_head_is_reported_once_where_the_trail_could_not_be_opened_at_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise OSError("no space")

    trail = written_trail(tmp_path)
    reopened_trail(tmp_path)
    trail.paths.head.unlink()
    again = new_trail(tmp_path)
    with monkeypatch.context() as context:
        context.setattr(type(again._chain._records), "open", fail)
        for _ in range(3):
            with pytest.raises(OSError, match="no space"):
                again._chain.open()
    assert [entry.what for entry in again._chain.open()] == ["audit.head_missing"]


def test_opening_a_trail_reports_that_its_key_was_replaced(tmp_path: Path) -> None:
    trail = written_trail(tmp_path)
    trail.paths.key.unlink()
    again = reopened_trail(tmp_path)
    assert again.key_replaced and "audit.key_replaced" in [record["what"] for record in lines(again.paths.current)]


def test_an_archived_trail_is_verified_with_its_own_key_and_the_next_one_has_a_new_key_without_an_alarm(
    tmp_path: Path,
) -> None:
    """The page on securing a plant renews the key in this way."""
    trail, archive, elsewhere = written_trail(tmp_path), tmp_path / "archive", tmp_path / "elsewhere"
    old_key = trail.paths.read_key()
    moved = AuditPaths.of(archive, key=elsewhere / "audit.key", head=elsewhere / "audit.head")
    archive.mkdir()
    elsewhere.mkdir()
    trail.paths.current.rename(moved.current)
    trail.paths.checkpoints.rename(moved.checkpoints)
    trail.paths.key.rename(moved.key)
    trail.paths.head.rename(moved.head)
    again = reopened_trail(tmp_path)
    assert not again.key_replaced and not again.records_missing and again.paths.read_key() != old_key
    assert verify_report(again).ok and verify(moved).ok and verify(moved).covered == 10


async def test_a_head_that_cannot_be_written_is_an_error_until_it_can(tmp_path: Path) -> None:
    trail = new_trail(tmp_path)
    trail.paths.head.mkdir()
    await trail.open()
    assert trail.head_error is not None and trail.checkpoint_error is None and trail.ok
    trail.paths.head.rmdir()
    await trail.checkpoint()
    assert trail.head_error is None and verify_report(trail).head == 1
    await trail.close()


@pytest.mark.parametrize(
    ("language", "pattern"),
    [
        ("en", r"audit trail: record (\d+), checkpoint \d+, [0-9a-f]{64}"),
        ("zh", "审计记录：第 (\\d+) 条，检查点 \\d+，[0-9a-f]{64}"),
    ],
)
async def test_the_log_names_a_checkpoint_at_the_start_each_hour_and_at_the_end(
    language: str, pattern: str, tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DRIVEBUS_LANG", language)
    now = datetime(2026, 11, 21, tzinfo=UTC)
    trail = new_trail(tmp_path, wall_clock=lambda: now)

    def logged() -> list[int]:
        return [int(found[1]) for text in caplog.messages if (found := re.fullmatch(pattern, text))]

    async def logged_after_a_record() -> list[int]:
        await trail.record(sample_entry(1))
        await trail.checkpoint()
        return logged()

    with caplog.at_level("INFO", logger="drivebus.service"):
        await trail.open()
        assert await logged_after_a_record() == [1]
        now += timedelta(hours=1)
        assert await logged_after_a_record() == [1, 3]
        await trail.record(sample_entry(1))
        await trail.close()
    assert logged() == [1, 3, 4]
    assert [record.__dict__["event"]["kind"] for record in caplog.records] == ["checkpoint"] * 3


def test_an_unreadable_trail_cannot_be_verified(tmp_path: Path) -> None:
    trail = written_trail(tmp_path)
    trail.paths.current.unlink()
    trail.paths.current.mkdir()
    with pytest.raises(AuditUnavailable) as rejected:
        asyncio.run(trail.verify())
    assert "Is a directory" in str(rejected.value)


def test_many_verifications_run_one_after_another(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Sixty requests of one user were sixty processes, and a stop was sent half a minute late."""
    trail, noted = written_trail(tmp_path), tmp_path / "noted"
    script = f"echo begins >> {noted}; sleep 0.05; echo ends >> {noted}; echo '{{}}'"
    monkeypatch.setattr("drivebus.service.audit.trail.module_command", lambda *_: ["sh", "-c", script])

    async def go() -> None:
        abandoned, *others = [asyncio.create_task(trail.verify()) for _ in range(6)]
        await asyncio.sleep(0)
        abandoned.cancel()
        assert await asyncio.gather(*others) == [{}] * 5

    asyncio.run(go())
    assert noted.read_text().split()[-10:] == ["begins", "ends"] * 5


def test_many_queries_are_read_one_after_another(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two dozen queries of a long trail delayed the buses, and a change of limits by 27 s."""
    noted: list[str] = []

    def slow_query(*_: object, **params: object) -> Json:
        noted.append("begins")
        time.sleep(0.02)
        noted.append("ends")
        return {}

    monkeypatch.setattr("drivebus.service.audit.trail.query_records", slow_query)

    async def go() -> None:
        trail = new_trail(tmp_path)
        await trail.open()
        await asyncio.gather(*(trail.query(from_ms=0, to_ms=1) for _ in range(5)))
        await trail.close()

    asyncio.run(go())
    assert noted == ["begins", "ends"] * 5


@pytest.mark.parametrize("asked", ["query", "verify"])
def test_requests_that_wait_for_a_hung_disk_do_not_pile_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, asked: str
) -> None:
    """A request that hangs, and all behind it, took the thousand places of the requests of a connection."""
    trail, released = new_trail(tmp_path), threading.Event()

    def hang(*_: object, **params: object) -> Json:
        released.wait(10.0)
        return {}

    async def hang_in_process(*_: object) -> Json:
        return await asyncio.to_thread(hang)

    monkeypatch.setattr("drivebus.service.audit.trail.query_records", hang)
    monkeypatch.setattr(AuditTrail, "_verify_in_process", hang_in_process)

    async def go() -> None:
        ask: Callable[[], Any] = trail.verify if asked == "verify" else lambda: trail.query(**ALL_TIME)
        requests = [asyncio.create_task(ask()) for _ in range(21)]
        await asyncio.sleep(0.05)
        with pytest.raises(ServiceUnavailable) as refused:
            await asyncio.wait_for(ask(), 1.0)
        assert refused.value.key == "plant.too_busy"
        requests.pop().cancel()
        await asyncio.sleep(0.05)
        requests.append(asyncio.create_task(ask()))  # in the place of the one that has gone
        released.set()
        assert await asyncio.gather(*requests) == [{}] * 21

    asyncio.run(go())


def test_a_query_begins_when_the_thread_of_an_abandoned_one_has_ended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Clients that vanish and ask again would occupy a thread each."""
    noted: list[str] = []

    def slow_query(*_: object, **params: object) -> Json:
        noted.append("begins")
        time.sleep(0.2)
        noted.append("ends")
        return {}

    monkeypatch.setattr("drivebus.service.audit.trail.query_records", slow_query)

    async def go() -> None:
        trail = new_trail(tmp_path)
        abandoned = asyncio.create_task(trail.query(**ALL_TIME))
        await asyncio.sleep(0.05)
        abandoned.cancel()
        await asyncio.wait([abandoned])
        assert noted == ["begins"], "the caller does not wait for the thread"
        await trail.query(**ALL_TIME)

    asyncio.run(go())
    assert noted == ["begins", "ends"] * 2


def test_a_removed_trail_is_continued_and_the_gap_is_detected(tmp_path: Path) -> None:
    async def go() -> None:
        trail = new_trail(tmp_path)
        await trail.open()
        await trail.record(sample_entry(1))
        trail.paths.current.unlink()
        assert await trail.record(sample_entry(2)) == 3
        await trail.close()
        assert problem_kinds(trail) == ["broken"]

    asyncio.run(go())


def test_a_concurrent_edit_of_the_file_damages_no_record(tmp_path: Path) -> None:
    """Verification detects it, and acknowledged records are on lines of their own."""

    async def go() -> None:
        trail = new_trail(tmp_path)
        await trail.open()
        path = trail.paths.current
        path.write_bytes(path.read_bytes() + b"half a li")
        await trail.record(sample_entry(1))
        assert problem_kinds(trail) == ["changed", "broken"]
        path.rename(path.with_suffix(".1"))
        await trail.record(sample_entry(2))
        os.truncate(path, 0)
        await trail.record(sample_entry(3))
        await trail.close()
        assert [record["n"] for record in lines(path)] == [4]
        assert "broken" in problem_kinds(trail)

    asyncio.run(go())


def test_files_and_key_are_private_and_the_key_is_outside_the_folder(tmp_path: Path) -> None:
    trail = written_trail(tmp_path)
    for path in (trail.paths.current, trail.paths.checkpoints, trail.paths.key):
        assert path.stat().st_mode & 0o777 == 0o600
    assert trail.paths.folder not in trail.paths.key.parents
    assert trail.paths.key.read_bytes().strip() not in b"".join(p.read_bytes() for p in trail.paths.folder.iterdir())


def _shorten_key(paths: AuditPaths) -> Path:
    paths.key.write_text("short")
    return paths.key


def _put_folder_for_checkpoints(paths: AuditPaths) -> Path:
    paths.checkpoints.mkdir(parents=True)
    return paths.checkpoints


@pytest.mark.parametrize("damage", [_shorten_key, _put_folder_for_checkpoints])
def test_a_trail_that_can_t_be_opened_names_the_file_that_prevents_it(
    damage: Callable[[AuditPaths], Path], tmp_path: Path
) -> None:
    async def go() -> None:
        trail = new_trail(tmp_path)
        damaged = damage(trail.paths)
        await trail.open()
        assert not trail.ok
        with pytest.raises(AuditUnavailable) as raised:
            await trail.record(sample_entry(1))
        assert raised.value.params["file"] == str(damaged)
        await trail.close()

    asyncio.run(go())


def test_any_entry_of_another_process_is_recorded(tmp_path: Path) -> None:
    async def go() -> None:
        trail = new_trail(tmp_path)
        await trail.open()
        login = {"what": "login", "who": "eve", "outcome": "refused", "why": "password", "target": None}
        await trail.record(AuditEntry.from_json(login, LI))
        await trail.record(AuditEntry.from_json({"params": [1], "frames": None, "of": {"no": "number"}, "who": 7}, LI))
        await trail.close()
        _, first, odd = lines(trail.paths.current)
        assert (first["who"]["name"], first["params"], first["target"]) == ("li", {"why": "password"}, "")
        assert (odd["what"], odd["params"], odd["frames"], odd["who"]["name"]) == ("", {"params": [1]}, [], "li")
        assert verify_report(trail).ok

    asyncio.run(go())


def test_a_wall_clock_that_is_set_back_is_no_problem(tmp_path: Path) -> None:
    written_trail(tmp_path)
    assert verify_report(written_trail(tmp_path, wall_clock=counting_clock())).ok
