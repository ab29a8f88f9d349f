"""Incident recorder: the minute before a trip, the newest frames and parameters; saved whole or not at all."""

from __future__ import annotations

import asyncio
import json
import os
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from threading import Barrier, BrokenBarrierError
from typing import Any

import pytest

from drivebus import profiles
from drivebus.bus.trace import TraceEvent, TraceKind
from drivebus.capture.dbcap import CaptureHeader, read_capture
from drivebus.errors import NoReply, NotFound, ServiceError, ServiceUnavailable
from drivebus.serial_settings import SerialSettings
from drivebus.service.alarms import Alarm, AlarmEngine, SystemAlarm
from drivebus.service.incidents import IncidentRecorder, IncidentStore
from drivebus.service.incidents.recorder import (
    INCIDENT_REPEAT_S,
    MAX_BUFFERED_SAMPLES,
    MAX_WAITING_INCIDENTS,
    SAVE_RETRY_INTERVAL_S,
    TRIP_ALARM_KINDS,
    BusSnapshot,
    RingBuffer,
    incident_parameters,
)
from drivebus.service.live.views import Sample
from drivebus.testing.virtual_time import run
from drivebus.values import Quality
from fixtures.alarms import FAN, OVERCURRENT, RecordingAlarmLog, view

ALL_TIME = (0, 10**14)
SERIAL = SerialSettings.parse(19200, "8E1")
SENT = TraceEvent(time=99.0, kind=TraceKind.SENT, data=b"\x01\x06\x20\x00", station=1)
RECEIVED = TraceEvent(time=99.5, kind=TraceKind.REPLY, data=b"\x01\x86", station=1)


def tripped(drive: str = "fan-1") -> Alarm:
    engine = AlarmEngine([], [FAN], RecordingAlarmLog().put)
    return engine.raise_alarm(SystemAlarm.INTERLOCK_TRIP, drive, 100_000)[0].alarm


def bus_snapshot(*events: TraceEvent) -> BusSnapshot:
    return BusSnapshot(
        "line-1", "sim://c320@1", SERIAL, [({"n": n, "hex": e.data.hex()}, e) for n, e in enumerate(events)]
    )


def sample(value: float | None, quality: Quality = Quality.GOOD) -> Sample:
    return Sample("fan-1.output_current", 0, value, quality)


async def save_incident(recorder: IncidentRecorder, alarm: Alarm | None = None, now: float = 100.0) -> str | None:
    return await recorder.capture(
        alarm or tripped(), view(fault=OVERCURRENT), bus_snapshot(RECEIVED, SENT), now, 1_795_219_200_000
    )


def test_an_incident_contains_the_last_minute_and_the_newest_frames(tmp_path: Path) -> None:
    async def go() -> dict[str, Any]:
        recorder = IncidentRecorder(IncidentStore(tmp_path / "incidents"))
        recorder.record_view(view(state="stopped"), 20.0)
        recorder.record_view(view(), 30.0)
        recorder.record_view(view(), 31.0)
        recorder.record_view(view(state="fault", fault=OVERCURRENT), 99.9)
        for at, value in ((39.0, 1.0), (40.0, 2.0), (99.0, 9.5)):
            recorder.record_samples("fan-1", [sample(value)], at)
        recorder.record_samples("fan-1", [sample(None, Quality.BAD)], 99.7)
        recorder.record_event({"drive": "fan-1", "kind": "command", "text": {"en": "run", "zh": "启动"}})
        recorder.record_event({"drive": None, "kind": "stop"})
        id = await save_incident(recorder)
        await recorder.close()
        assert id == "000001-fan-1"
        return IncidentStore(tmp_path / "incidents").get(id)

    incident = run(go())
    assert incident["signals"] == {"output_current": {"t": [-60.0, -1.0, -0.3], "v": [2.0, 9.5, None], "q": [0, 0, 2]}}
    assert [(item["t"], item["state"]) for item in incident["states"]] == [(-70.0, "running"), (-0.1, "fault")]
    assert [item["kind"] for item in incident["events"]] == ["command"]
    assert [(item["n"], item["t"]) for item in incident["frames"]] == [(0, -0.5), (1, -1.0)]
    assert (incident["why"], incident["raised"]["id"], incident["view"]["fault"]) == (
        "interlock_trip",
        "a1",
        OVERCURRENT,
    )
    assert incident["parameters"] is None


def test_the_frames_of_an_incident_are_a_capture_file(tmp_path: Path) -> None:
    async def go() -> str:
        recorder = IncidentRecorder(IncidentStore(tmp_path))
        return str(await save_incident(recorder))

    incident = IncidentStore(tmp_path).get(run(go()))
    path = tmp_path / incident["capture"]["name"]
    path.write_text(incident["capture"]["text"])
    capture = read_capture(path)
    assert (capture.header.settings, capture.header.port) == (SERIAL, "sim://c320@1")
    assert capture.header.started == "2026-11-20T23:59:59.000+00:00"
    assert [(record.time_s, record.direction, record.data) for record in capture.records] == [  # type: ignore[union-attr]
        (0.0, "tx", SENT.data),
        (0.5, "rx", RECEIVED.data),
    ]


def test_parameters_are_read_afterwards_and_may_be_missing(
    tmp_path: Path,
) -> None:
    async def go(read: Any) -> dict[str, Any]:
        recorder = IncidentRecorder(IncidentStore(tmp_path), read)
        id = await save_incident(recorder)
        await asyncio.sleep(1)
        await recorder.close()
        return IncidentStore(tmp_path).get(str(id))

    async def read(drive: str) -> dict[str, Any]:
        return {"F0.1": {"drive": drive, "raw": 2}}

    async def silent(drive: str) -> dict[str, Any]:
        raise NoReply("bus.no_reply", station=1)

    assert run(go(read))["parameters"] == {"F0.1": {"drive": "fan-1", "raw": 2}}
    assert run(go(silent))["parameters"] is None


def test_an_incident_that_is_saved_while_the_service_ends_is_complete_without_parameters(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """The drives are gone by then: a line that one of them does not exist would be untrue."""

    async def read(drive: str) -> dict[str, Any]:
        raise NotFound("plant.no_drive", id=drive, known="-")

    async def go() -> str | None:
        recorder = IncidentRecorder(IncidentStore(tmp_path), read)
        saving = asyncio.create_task(save_incident(recorder))
        await asyncio.sleep(0)
        await recorder.close()
        await asyncio.sleep(1)
        return await saving

    assert IncidentStore(tmp_path).get(str(run(go())))["parameters"] is None
    assert not caplog.records


def test_every_family_has_incident_parameters() -> None:
    for model in ("c320", "dzb100", "vc660", "df800"):
        profile = profiles.load(model)
        names = incident_parameters(profile)
        assert len(names) == len(set(names)) > 0
        assert {
            precondition.notation for precondition in profile.preconditions if precondition.unreadable is None
        } <= set(names)
    assert {"F9.3", "F9.4", "F0.1"} <= set(incident_parameters(profiles.load("c320")))


def test_a_repeated_trip_belongs_to_the_same_incident(tmp_path: Path) -> None:
    async def go() -> list[str | None]:
        recorder = IncidentRecorder(IncidentStore(tmp_path))
        return [
            await save_incident(recorder, now=at)
            for at in (100.0, 100.0 + INCIDENT_REPEAT_S - 0.1, 100.0 + INCIDENT_REPEAT_S)
        ]

    assert run(go()) == ["000001-fan-1", "000001-fan-1", "000002-fan-1"]


def test_a_trip_without_drive_or_samples_has_an_incident(tmp_path: Path) -> None:
    async def go() -> str | None:
        return await IncidentRecorder(IncidentStore(tmp_path)).capture(tripped(""), None, None, 5.0, 5)

    incident = IncidentStore(tmp_path).get(str(run(go())))
    assert (incident["id"], incident["bus"], incident["frames"], incident["signals"]) == ("000001-plant", None, [], {})


@pytest.mark.parametrize("nth", range(1, 40))
def test_a_disk_that_fails_at_any_call_leaves_a_whole_incident_or_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, nth: int
) -> None:
    calls = 0

    def failing(real: Any) -> Any:
        def call(*arguments: Any, **named: Any) -> Any:
            nonlocal calls
            calls += 1
            if calls == nth:
                raise OSError(28, "No space left on device")
            return real(*arguments, **named)

        return call

    store = IncidentStore(tmp_path / "incidents")
    with monkeypatch.context() as context:
        for name in ("write", "fsync", "open", "mkdir", "rename", "replace"):
            context.setattr(os, name, failing(getattr(os, name)))
        with suppress(OSError):
            store.write("fan-1", {"time_ms": 1, "drive": "fan-1"}, {}, CaptureHeader(SERIAL), [(1.0, True, b"\x01")])
    listed = store.query(*ALL_TIME)["items"]
    assert [item["id"] for item in listed] in ([], ["000001-fan-1"])
    for item in listed:
        store.get(item["id"])
    assert store.write("fan-1", {"time_ms": 2, "drive": "fan-1"}, {}, CaptureHeader(SERIAL), []).endswith("-fan-1")
    assert [item for item in (tmp_path / "incidents").iterdir() if item.name.startswith(".")] == []


def test_an_incident_on_a_failing_disk_is_reported_and_saved_once_the_disk_works_again(tmp_path: Path) -> None:
    """It was lost, and the incidents counted as not writable until a drive tripped again."""

    async def go() -> None:
        (tmp_path / "incidents").write_text("a file where the folder should be")
        recorder = IncidentRecorder(IncidentStore(tmp_path / "incidents"))
        saving = asyncio.create_task(save_incident(recorder))
        await asyncio.sleep(3 * SAVE_RETRY_INTERVAL_S)
        assert recorder.error is not None and not saving.done()
        (tmp_path / "incidents").unlink()
        assert (await saving, recorder.error) == ("000001-fan-1", None)

    run(go())


def test_incidents_beyond_those_that_wait_for_the_disk_are_lost_and_the_end_of_the_service_tries_once_more(
    tmp_path: Path,
) -> None:
    async def go() -> None:
        (tmp_path / "incidents").write_text("a file where the folder should be")
        recorder = IncidentRecorder(IncidentStore(tmp_path / "incidents"))
        times = [100.0 + INCIDENT_REPEAT_S * number for number in range(MAX_WAITING_INCIDENTS)]
        waiting = [asyncio.create_task(save_incident(recorder, now=now)) for now in times]
        await asyncio.sleep(1)
        assert await save_incident(recorder, now=times[-1] + INCIDENT_REPEAT_S) is None
        assert not any(task.done() for task in waiting)
        await recorder.close()
        assert await asyncio.gather(*waiting) == [None] * MAX_WAITING_INCIDENTS

    run(go())


@pytest.mark.parametrize("call", ["list", "note"])
def test_a_folder_of_incidents_that_can_not_be_used_is_an_error_with_its_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: str
) -> None:
    """It was an internal error that left open whether the note was added."""
    store = IncidentStore(tmp_path)
    id = store.write("fan-1", {"time_ms": 1, "drive": "fan-1"}, {}, CaptureHeader(SERIAL), [])

    def refuse(*arguments: Any, **named: Any) -> Any:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "iterdir", refuse)
    monkeypatch.setattr(os, "write", refuse)
    with pytest.raises(ServiceUnavailable, match="Permission denied"):
        if call == "list":
            store.query(*ALL_TIME)
        else:
            store.add_note(id, {"time_ms": 1, "by": "ann", "text": "bearing replaced"})


def test_an_incident_of_a_killed_writer_is_never_listed(tmp_path: Path) -> None:
    store = IncidentStore(tmp_path)
    (tmp_path / ".000001-fan-1").mkdir()
    (tmp_path / ".000001-fan-1" / "summary.json").write_text('{"id": "000001-fan-1"}')
    assert store.query(*ALL_TIME)["items"] == []
    with pytest.raises(NotFound):
        store.get("000001-fan-1")


def test_the_oldest_incidents_are_deleted_beyond_the_limits(tmp_path: Path) -> None:
    store = IncidentStore(tmp_path, max_incidents=3)
    for n in range(5):
        store.write("fan-1", {"time_ms": n, "drive": "fan-1"}, {}, CaptureHeader(SERIAL), [])
    assert [item["id"][:6] for item in store.query(*ALL_TIME)["items"]] == ["000005", "000004", "000003"]
    small = IncidentStore(tmp_path, max_bytes=10)
    small.write("fan-1", {"time_ms": 9, "drive": "fan-1"}, {}, CaptureHeader(SERIAL), [])
    assert [item["id"][:6] for item in store.query(*ALL_TIME)["items"]] == ["000006"]


def test_concurrent_trips_have_one_incident_each(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The clean-up must not delete an incident that another thread is writing."""
    store, together, real = IncidentStore(tmp_path), Barrier(2, timeout=0.2), os.fsync

    def slow(fd: int) -> None:
        with suppress(BrokenBarrierError):
            together.wait()
        real(fd)

    monkeypatch.setattr(os, "fsync", slow)
    with ThreadPoolExecutor(2) as threads:
        summaries = [(drive, {"time_ms": 1, "drive": drive}) for drive in ("fan-1", "pump-1")]
        done = [
            threads.submit(store.write, drive, summary, {}, CaptureHeader(SERIAL), []) for drive, summary in summaries
        ]
        assert sorted(future.result()[:6] for future in done) == ["000001", "000002"]
    assert len(store.query(*ALL_TIME)["items"]) == 2


def test_incidents_are_read_in_pages_by_time_range_and_drive(tmp_path: Path) -> None:
    store = IncidentStore(tmp_path)
    for n, drive in enumerate(("fan-1", "fan-1", "pump-1", "fan-1")):
        store.write(drive, {"time_ms": n, "drive": drive}, {}, CaptureHeader(SERIAL), [])
    first = store.query(*ALL_TIME, "fan-1", limit=2)
    second = store.query(*ALL_TIME, "fan-1", first["next"], 2)
    assert [item["time_ms"] for item in first["items"] + second["items"]] == [3, 1, 0]
    assert second["next"] is None
    assert [item["time_ms"] for item in store.query(1, 3)["items"]] == [2, 1]


@pytest.mark.parametrize("damaged", ["{}", '{"time_ms": "noon", "drive": "fan-1"}', '{"time_ms": 1, "drive": null}'])
def test_a_damaged_incident_hides_no_other_and_ends_no_recording(tmp_path: Path, damaged: str) -> None:
    store = IncidentStore(tmp_path)
    ids = [store.write("fan-1", {"time_ms": n, "drive": "fan-1"}, {}, CaptureHeader(SERIAL), []) for n in (1, 2)]
    (tmp_path / ids[0] / "summary.json").write_text(damaged)
    (tmp_path / ids[0] / "notes.json").write_text('{"notes": 5}')
    (tmp_path / "000009-fan-1").write_text("a file in the place of a folder")
    assert [item["id"] for item in store.query(*ALL_TIME)["items"]] == ids[1:]
    assert store.add_note(ids[0], {"text": "found"}) == [{"text": "found"}]
    assert store.write("fan-1", {"time_ms": 3, "drive": "fan-1"}, {}, CaptureHeader(SERIAL), []) == "000003-fan-1"


@pytest.mark.parametrize(
    "damaged", [b"", b'{"id": ', b"\xff\xfe", b"[]", b"{}", b'{"time_ms": 1, "drive": "fan-1", "value": NaN}', None]
)
def test_an_incident_whose_file_is_damaged_or_missing_is_not_called_unknown(
    tmp_path: Path, damaged: bytes | None
) -> None:
    """The error names the file, and where the frames are."""
    store = IncidentStore(tmp_path)
    id = store.write("fan-1", {"time_ms": 1, "drive": "fan-1"}, {}, CaptureHeader(SERIAL), [])
    file = tmp_path / id / "incident.json"
    file.unlink() if damaged is None else file.write_bytes(damaged)
    with pytest.raises(ServiceError, match=r"frames\.dbcap") as caught:
        store.get(id)
    assert not isinstance(caught.value, NotFound)
    assert str(file) in str(caught.value) and "backup" in str(caught.value)


def test_damaged_notes_and_parameters_of_an_incident_hide_nothing_else(tmp_path: Path) -> None:
    """A number that JSON does not have ended the answer with the whole incident."""
    store = IncidentStore(tmp_path)
    id = store.write("fan-1", {"time_ms": 1, "drive": "fan-1"}, {}, CaptureHeader(SERIAL), [])
    (tmp_path / id / "notes.json").write_text('{"notes": ["x", 5, {"text": "found"}]}')
    (tmp_path / id / "parameters.json").write_text('{"P0.01": NaN}')
    found = store.get(id)
    assert (found["notes"], found["parameters"], found["drive"]) == ([{"text": "found"}], None, "fan-1")


def test_an_incident_without_readable_frames_says_why(tmp_path: Path) -> None:
    store = IncidentStore(tmp_path)
    id = store.write("fan-1", {"time_ms": 1, "drive": "fan-1"}, {}, CaptureHeader(SERIAL), [])
    assert store.get(id)["capture_problem"] is None
    file = tmp_path / id / "frames.dbcap"
    file.unlink()
    incident = store.get(id)
    assert incident["capture"] is None
    assert str(file) in incident["capture_problem"]["en"] and str(file) in incident["capture_problem"]["zh"]


@pytest.mark.parametrize("id", ["../secret", "000009-fan-1", "", "000001-fan-1/../../x", ".000001-fan-1", "000001-FAN"])
def test_no_incident_id_reaches_outside_the_folder(tmp_path: Path, id: str) -> None:
    store = IncidentStore(tmp_path / "incidents")
    store.write("fan-1", {"time_ms": 1, "drive": "fan-1"}, {}, CaptureHeader(SERIAL), [])
    (tmp_path / "secret").mkdir()
    (tmp_path / "secret" / "incident.json").write_text("{}")
    with pytest.raises(NotFound):
        store.get(id)


def test_memory_of_the_ring_buffer_is_bounded() -> None:
    ring = RingBuffer()
    for n in range(MAX_BUFFERED_SAMPLES + 10):
        ring.add_samples([sample(1.0)], 1.0)
        ring.add_event({"n": n})
        ring.add_view(view(fault={"code": n}), 1.0)
    found = ring.as_json(1.0)
    assert (len(found["signals"]["output_current"]["t"]), len(found["events"]), len(found["states"])) == (
        20_000,
        50,
        1_000,
    )
    ring.add_samples([sample(1.0)], 62.0)
    assert len(ring._samples) == 1


def test_samples_older_than_a_minute_are_not_in_an_incident() -> None:
    ring = RingBuffer()
    ring.add_samples([sample(1.0)], 39.0)
    assert ring.as_json(100.0)["signals"] == {}


def test_faults_interlocks_and_unconfirmed_stops_are_trips() -> None:
    assert {"fault", "interlock_trip", "stop_unconfirmed"} == TRIP_ALARM_KINDS


def test_an_incident_is_json_throughout(tmp_path: Path) -> None:
    async def go() -> str:
        return str(await save_incident(IncidentRecorder(IncidentStore(tmp_path))))

    assert json.loads(json.dumps(IncidentStore(tmp_path).get(run(go()))))["view"]["title"]["zh"] == "风机"


def test_an_incident_is_shown_without_its_capture_file_and_with_the_damage_in_one(tmp_path: Path) -> None:
    store = IncidentStore(tmp_path)
    id = str(run(save_incident(IncidentRecorder(store))))
    path = tmp_path / id / "frames.dbcap"
    path.write_bytes(path.read_bytes() + b"\xff\n")
    incident = store.get(id)
    assert incident["capture"]["text"].endswith("\\xff\n") and len(incident["frames"]) == 2
    path.unlink()
    incident = store.get(id)
    assert incident["capture"] is None and len(incident["frames"]) == 2


def test_an_unexpected_error_while_an_incident_is_recorded_is_kept_for_its_alarm(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = IncidentStore(tmp_path)
    recorder = IncidentRecorder(store)

    def fail(*_: Any) -> str:
        raise ValueError("surrogate")

    monkeypatch.setattr(store, "write", fail)
    assert run(save_incident(recorder)) is None
    assert isinstance(recorder.error, ValueError) and "surrogate" in caplog.text
