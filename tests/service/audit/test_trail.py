"""The audit trail: durable, in a chain, without secrets, and telling when it can't be written."""

from __future__ import annotations

import asyncio
import json
import os
from pathlib import Path
from typing import Any

import pytest

from drivebus.errors import AuditUnavailable, InvalidParameters
from drivebus.service.api.errors import os_reason
from drivebus.service.audit import AuditEntry
from drivebus.service.audit.records import MAX_RECORD_LINE_BYTES, MAX_TEXT_LENGTH
from drivebus.service.config.model import PlantConfig
from drivebus.service.storage import append_log, batch_writer
from drivebus.service.storage.storage import Storage
from drivebus.values import Text
from fixtures.audit import LI, counting_clock, new_trail, problem_kinds, sample_entry, verify_report, written_trail

EVER = (0, 10**14)


def lines(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_bytes().splitlines()]


def test_an_untouched_trail_is_whole(tmp_path: Path) -> None:
    made = written_trail(tmp_path)
    found = verify_report(made)
    assert (found.ok, found.entries, found.covered, found.keyed) == (True, 10, 10, True)
    assert [one["n"] for one in lines(made.paths.current)] == list(range(1, 11))


def test_a_record_says_who_did_what_when_with_which_frames_and_outcome(tmp_path: Path) -> None:
    async def go() -> None:
        made = new_trail(tmp_path)
        await made.open()
        frame = {"sent": "01 06", "received": "01 06", "sent_at_s": 1.5, "received_at_s": 1.6, "error": None}
        asked = await made.record(sample_entry(1))
        assert asked == 2
        await made.record(AuditEntry.by(LI, "drive.run", target="fan-1", frames=[frame], outcome="confirmed", of=asked))
        (item, before), rest = (await made.query(*EVER, limit=2))["items"], None
        assert (item["n"], item["who"], item["what"]) == (
            3,
            {"name": "li", "session": "s-1", "address": "127.0.0.1"},
            "drive.run",
        )
        assert (item["target"], item["frames"], item["outcome"], item["of"]) == ("fan-1", [frame], "confirmed", 2)
        assert (before["params"], before["outcome"], len(before["hash"])) == ({"frequency_hz": 1.0}, "requested", 64)
        assert rest is None and (await made.verify())["ok"]
        await made.close()

    asyncio.run(go())


@pytest.mark.parametrize("name", ["a\nb", "\x1b[31mred", "x\x9b2J", "\u202egnp", 'q"},{"n":9', "\ud800", "汉字\r\n"])
def test_names_with_control_characters_stay_in_their_line_and_their_string(tmp_path: Path, name: str) -> None:
    async def go() -> None:
        made = new_trail(tmp_path)
        await made.open()
        await made.record(AuditEntry.by(LI, "login", target=name, params={name: name}, outcome="refused"))
        await made.close()
        data = made.paths.current.read_bytes()
        assert data.count(b"\n") == 2 and all(octet == 10 or 32 <= octet < 127 for octet in data)
        assert lines(made.paths.current)[1]["outcome"] == "refused"
        assert verify_report(made).ok

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
        made = new_trail(tmp_path)
        await made.open()
        await made.record(AuditEntry.by(LI, "login", params=text))
        await made.close()
        return made.paths.current.read_bytes()

    data = asyncio.run(go())
    assert b"hunter2" not in data
    params = json.loads(data.splitlines()[1])["params"]
    assert (params["url"], params["name"], params["token"]) == ("postgresql://***@db/plant", "li", None)


def test_a_long_text_is_replaced_by_its_hash(tmp_path: Path) -> None:
    async def go() -> list[dict[str, Any]]:
        made = new_trail(tmp_path)
        await made.open()
        await made.record(AuditEntry.by(LI, "x", params={"text": "x" * (MAX_TEXT_LENGTH + 1), "nan": float("nan")}))
        await made.record(
            AuditEntry.by(LI, "x", params={str(n): "y" * MAX_TEXT_LENGTH for n in range(100)}, outcome="done")
        )
        await made.record(AuditEntry.by(LI, "x", params={"deep": _nested(50), "many": range(9), "octets": b"\x01\xff"}))
        await made.close()
        assert verify_report(made).ok
        return lines(made.paths.current)

    _, first, second, third = asyncio.run(go())
    assert first["params"]["text"]["characters"] == MAX_TEXT_LENGTH + 1 and first["params"]["nan"] == "nan"
    assert set(second["params"]) == {"left_out"} and second["outcome"] == "done"
    assert second["params"]["left_out"]["octets"] > MAX_RECORD_LINE_BYTES
    assert third["params"]["octets"] == "01 FF"


def _nested(depth: int) -> Any:
    return {"more": _nested(depth - 1)} if depth else "end"


def test_many_at_once_are_written_together_in_their_order(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synced: list[int] = []
    real = os.fsync

    def counted(fd: int) -> None:
        synced.append(fd)
        real(fd)

    monkeypatch.setattr(os, "fsync", counted)

    async def go() -> None:
        made = new_trail(tmp_path)
        await made.open()
        synced.clear()
        numbers = await asyncio.gather(*(made.record(sample_entry(n)) for n in range(300)))
        assert numbers == list(range(2, 302))
        assert len(synced) <= 3
        await made.close()

    asyncio.run(go())


def test_full_files_are_put_away_and_the_chain_goes_on(tmp_path: Path) -> None:
    made = written_trail(tmp_path, 40, max_file_bytes=2_000)
    files = made.paths.files()
    assert len(files) > 3 and [path.name for path in files][:1] == ["audit-000000000001.jsonl"]
    assert verify_report(made).ok and verify_report(made).entries == 40
    again = written_trail(tmp_path, 5, max_file_bytes=2_000)
    assert verify_report(again).ok and verify_report(again).entries == 45


def test_pages_go_back_to_the_first_record_and_take_none_twice(tmp_path: Path) -> None:
    made = written_trail(tmp_path, 40, max_file_bytes=2_000)

    async def go(drive: str | None) -> list[int]:
        found, cursor = [], None
        while True:
            page = await made.query(*EVER, drive, cursor, 7)
            found += [item["n"] for item in page["items"]]
            if (cursor := page["next"]) is None:
                return found

    assert asyncio.run(go(None)) == list(range(40, 0, -1))
    assert asyncio.run(go("fan-1")) == [n for n in range(40, 1, -1) if n % 3 == 1]
    for wrong in ("x", "LTE=", "MDE=", "é"):
        with pytest.raises(InvalidParameters):
            asyncio.run(made.query(*EVER, cursor=wrong))


def test_a_drives_page_shows_what_was_done_to_it_with_others_too(tmp_path: Path) -> None:
    """A group's start, the share of a leader's new frequency."""

    async def go() -> None:
        made = new_trail(tmp_path)
        await made.open()
        await made.record(AuditEntry.by(LI, "group.start", target="fans", params={"drives": ["fan-1", "fan-2"]}))
        await made.record(AuditEntry.by(LI, "user.add", target="fan-2", params={"drives": "fan-1"}))
        found = [(await made.query(*EVER, drive))["items"] for drive in ("fan-1", "fan-2", "fan-3")]
        what = [[item["what"] for item in items] for items in found]
        assert what == [["group.start"], ["user.add", "group.start"], []]
        await made.close()

    asyncio.run(go())


def test_pages_heed_the_span_and_leave_out_a_line_that_was_changed(tmp_path: Path) -> None:
    made = written_trail(tmp_path)
    times = [one["time_ms"] for one in lines(made.paths.current)]
    made.paths.current.write_bytes(
        made.paths.current.read_bytes().replace(b'"frequency_hz":5.0', b'"frequency_hz":6.0')
    )
    items = asyncio.run(made.query(times[3], times[7]))["items"]
    assert [item["n"] for item in items] == [7, 6, 4]


def test_a_failed_disk_refuses_waiting_records_and_keeps_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = os.write

    def full(fd: int, data: bytes) -> int:
        real(fd, data[: len(data) // 2])
        raise OSError(28, "No space left on device")

    async def go() -> None:
        made = new_trail(tmp_path)
        await made.open()
        with monkeypatch.context() as context:
            context.setattr(os, "write", full)
            with pytest.raises(AuditUnavailable) as rejected:
                await made.record(sample_entry(1))
            made.record_nowait(AuditEntry.by(LI, "drive.stop", target="fan-1", outcome="confirmed"))
            await made.checkpoint()
            assert not made.ok and "No space" in str(rejected.value)
        assert await made.record(sample_entry(2)) == 3
        assert made.ok
        await made.close()
        what = [one["what"] for one in lines(made.paths.current)]
        assert what == ["audit.opened", "drive.stop", "drive.run"]
        assert verify_report(made).ok

    asyncio.run(go())


def test_a_recovered_disk_is_noticed_without_a_request(tmp_path: Path) -> None:
    from drivebus.testing.virtual_time import run

    async def go() -> None:
        blocked = tmp_path / "plant"
        blocked.write_text("a file where the folder should be")
        made = new_trail(tmp_path)
        await made.open()
        assert not made.ok
        with pytest.raises(AuditUnavailable):
            await made.record(sample_entry(1))
        await asyncio.sleep(1.0)
        blocked.unlink()
        await asyncio.sleep(1.0)
        assert not made.ok
        await asyncio.sleep(6.0)
        assert made.ok
        await made.close()
        assert [one["what"] for one in lines(made.paths.current)] == ["audit.opened"]

    run(go())


def test_the_alarm_about_the_trail_names_the_reason_and_clears_without_a_request(tmp_path: Path) -> None:
    """Looked at every five seconds, as every store is."""
    from drivebus.testing.virtual_time import run

    async def go() -> None:
        blocked = tmp_path / "plant"
        blocked.write_text("a file where the folder should be")
        storage = Storage.of(PlantConfig("p", Text("P", "P"), blocked, (), ()), wall_ms=lambda: 0)
        await storage.audit.open()
        found = storage.errors()["audit.jsonl"]
        assert found is not None and os_reason(found) == "Not a directory"
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
        made = new_trail(tmp_path)
        for n in range(8):
            made.record_nowait(sample_entry(n))
        await made.open()
        await asyncio.sleep(1.0)
        blocked.unlink()
        await asyncio.sleep(20.0)
        await made.close()
        kept = lines(made.paths.current)
        assert [one["params"].get("frequency_hz") for one in kept[:4]] == [4.0, 5.0, 6.0, 7.0]
        assert [(one["what"], one["params"]) for one in kept[5:]] == [("audit.lost", {"records": 4})]

    run(go())


def test_a_checkpoint_is_written_at_the_start_each_minute_and_at_the_end(tmp_path: Path) -> None:
    from drivebus.testing.virtual_time import run

    async def go() -> None:
        made = new_trail(tmp_path)
        await made.open()
        assert [one["n"] for one in lines(made.paths.checkpoints)] == [1]
        await made.record(sample_entry(1))
        await asyncio.sleep(59.0)
        assert len(lines(made.paths.checkpoints)) == 1
        await asyncio.sleep(2.0)
        assert [one["n"] for one in lines(made.paths.checkpoints)] == [1, 2]
        await asyncio.sleep(120.0)
        await made.record(sample_entry(1))
        assert len(lines(made.paths.checkpoints)) == 2, "none where nothing happened"
        await made.close()
        assert [one["n"] for one in lines(made.paths.checkpoints)] == [1, 2, 3]

    run(go())


def test_a_torn_record_of_a_killed_writer_is_quarantined_and_reported(tmp_path: Path) -> None:
    made = written_trail(tmp_path)
    whole = made.paths.current.read_bytes()
    made.paths.current.write_bytes(whole + whole[:100])
    assert problem_kinds(made) == ["unfinished"]
    made.paths.checkpoints.write_bytes(made.paths.checkpoints.read_bytes() + b'{"checkp')
    again = written_trail(tmp_path, 3)
    assert verify_report(again).ok
    found = lines(again.paths.current)[10]
    assert (found["what"], found["params"]["octets"]) == ("audit.recovered", 100)
    assert (again.paths.folder / found["params"]["file"]).read_bytes() == whole[:100]


def test_a_record_has_its_own_number_after_recovery_entries(tmp_path: Path) -> None:
    made = written_trail(tmp_path)
    made.paths.current.write_bytes(made.paths.current.read_bytes() + b"half")

    async def go() -> int:
        again = new_trail(tmp_path)
        number = await again.record(sample_entry(1))
        assert again._writer.error is None
        return number

    assert asyncio.run(go()) == 12


def test_only_the_end_of_a_long_file_is_looked_at_and_its_beginning_is_left_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = written_trail(tmp_path)
    made.paths.checkpoints.unlink()
    monkeypatch.setattr(append_log, "TAIL_BYTES", 1_500)
    assert made.paths.current.stat().st_size > 2 * append_log.TAIL_BYTES
    again = written_trail(tmp_path, 2)
    assert [one["what"] for one in lines(again.paths.current)][10:] == ["audit.opened", "drive.run"]


def test_holes_that_a_power_cut_left_behind_the_last_checkpoint_are_put_aside(tmp_path: Path) -> None:
    """Blocks of the last batch may reach the disk in any order."""
    marks = written_trail(tmp_path).paths.checkpoints.read_bytes()
    made = written_trail(tmp_path, 3)
    made.paths.checkpoints.write_bytes(marks)
    kept = made.paths.current.read_bytes().splitlines(True)
    made.paths.current.write_bytes(b"".join([*kept[:11], b"\0" * 50 + b"\n", kept[12]]))
    again = written_trail(tmp_path, 3)
    assert verify_report(again).ok
    assert [one["what"] for one in lines(again.paths.current)[10:13]] == [
        "audit.opened",
        "audit.recovered",
        "audit.opened",
    ]


def test_a_line_edited_before_the_last_checkpoint_is_never_quarantined(tmp_path: Path) -> None:
    made = written_trail(tmp_path)
    data = made.paths.current.read_bytes()
    made.paths.current.write_bytes(data.replace(b'"frequency_hz":5.0', b'"frequency_hz":9.0'))
    again = written_trail(tmp_path, 3)
    assert problem_kinds(again) == ["changed"] and verify_report(again).entries == 13


def test_a_cut_end_is_still_detected_after_the_service_continued(tmp_path: Path) -> None:
    made = written_trail(tmp_path)
    kept = made.paths.current.read_bytes().splitlines(True)[:6]
    made.paths.current.write_bytes(b"".join(kept))
    again = written_trail(tmp_path, 3)
    assert lines(again.paths.current)[6]["what"] == "audit.cut"
    assert set(problem_kinds(again)) == {"rewritten", "checkpoint_broken"}


def test_the_service_can_tell_that_an_end_was_cut_off(tmp_path: Path) -> None:
    async def opened() -> bool:
        made = new_trail(tmp_path)
        await made.open()
        await made.close()
        return made.records_missing

    made = written_trail(tmp_path)
    assert asyncio.run(opened()) is False
    made.paths.current.write_bytes(b"".join(made.paths.current.read_bytes().splitlines(True)[:4]))
    assert asyncio.run(opened()) is True


def test_a_trail_that_can_not_be_read_is_no_good_trail(tmp_path: Path) -> None:
    made = written_trail(tmp_path)
    made.paths.current.unlink()
    made.paths.current.mkdir()
    with pytest.raises(AuditUnavailable) as rejected:
        asyncio.run(made.verify())
    assert "Is a directory" in str(rejected.value)


def test_a_removed_trail_is_started_again_and_the_gap_is_detected(tmp_path: Path) -> None:
    async def go() -> None:
        made = new_trail(tmp_path)
        await made.open()
        await made.record(sample_entry(1))
        made.paths.current.unlink()
        assert await made.record(sample_entry(2)) == 3
        await made.close()
        assert problem_kinds(made) == ["broken"]

    asyncio.run(go())


def test_a_concurrent_edit_of_the_file_damages_no_record(tmp_path: Path) -> None:
    """A log rotation, an editor: it is found, and what is acknowledged stands on lines of its own."""

    async def go() -> None:
        made = new_trail(tmp_path)
        await made.open()
        path = made.paths.current
        path.write_bytes(path.read_bytes() + b"half a li")
        await made.record(sample_entry(1))
        assert problem_kinds(made) == ["changed", "broken"]
        path.rename(path.with_suffix(".1"))
        await made.record(sample_entry(2))
        os.truncate(path, 0)
        await made.record(sample_entry(3))
        await made.close()
        assert [one["n"] for one in lines(path)] == [4]
        assert "broken" in problem_kinds(made)

    asyncio.run(go())


def test_files_and_key_are_readable_by_their_owner_only_and_the_key_is_not_in_the_folder(tmp_path: Path) -> None:
    made = written_trail(tmp_path)
    for path in (made.paths.current, made.paths.checkpoints, made.paths.key):
        assert path.stat().st_mode & 0o777 == 0o600
    assert made.paths.folder not in made.paths.key.parents
    assert made.paths.key.read_bytes().strip() not in b"".join(p.read_bytes() for p in made.paths.folder.iterdir())


def test_a_key_that_is_too_short_writes_no_checkpoint_and_refuses_starts(tmp_path: Path) -> None:
    async def go() -> None:
        made = new_trail(tmp_path)
        made.paths.key.write_text("short")
        await made.open()
        assert not made.ok
        await made.close()

    asyncio.run(go())


def test_what_another_process_sends_is_recorded_whatever_it_is(tmp_path: Path) -> None:
    async def go() -> None:
        made = new_trail(tmp_path)
        await made.open()
        login = {"what": "login", "who": "eve", "outcome": "refused", "why": "password", "target": None}
        await made.record(AuditEntry.from_json(login, LI))
        await made.record(AuditEntry.from_json({"params": [1], "frames": None, "of": {"no": "number"}, "who": 7}, LI))
        await made.close()
        _, first, odd = lines(made.paths.current)
        assert (first["who"]["name"], first["params"], first["target"]) == ("li", {"why": "password"}, "")
        assert (odd["what"], odd["params"], odd["frames"], odd["who"]["name"]) == ("", {"params": [1]}, [], "li")
        assert verify_report(made).ok

    asyncio.run(go())


def test_the_clock_may_jump_back_without_harm(tmp_path: Path) -> None:
    written_trail(tmp_path)
    assert verify_report(written_trail(tmp_path, wall_clock=counting_clock())).ok
