"""A damaged file of waivers and limits: the service starts, and only what needs them is refused."""

from __future__ import annotations

import errno
import json
import os
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from drivebus import atomic_write
from drivebus.drives import Drive, FileStore, MemoryStore, store
from drivebus.drives.context import DriveLimits
from drivebus.errors import ConfigurationError, EepromBudgetExceeded, ServiceError
from drivebus.service.app import Service, build_service
from drivebus.service.config.model import HistoryConfig
from drivebus.service.historian import Historian
from drivebus.service.runtime.supervision import STORAGE_CHECK_CYCLES
from drivebus.service.storage.settings import StoredSettings, recover_settings
from drivebus.service.storage.storage import Storage
from drivebus.simulator.port import clear_simulated_buses
from drivebus.types import Json
from fixtures.drives import SimulatedDrives
from fixtures.service import LOCAL, WIDEST_LIMITS, plant_config

DAMAGED = {
    "random bytes": b"\x80\x9f\x00\xff\xfe",
    "empty": b"",
    "a list": b"[]",
    "nested too deep": b"[" * 100_000,
    "wrong types": b'{"format": 1, "values": {"limits/fan-1": 5}}',
}


@asynccontextmanager
async def service_in(folder: Path) -> AsyncIterator[Service]:
    config = plant_config(directory=folder)
    try:
        async with build_service(config, replace(Storage.of(config), drives=MemoryStore())) as service, service:
            yield service
    finally:
        clear_simulated_buses()


async def blockers(service: Service, drive: str) -> list[str]:
    found: Json = await service.call("drives.get", {"drive": drive}, LOCAL)
    return [blocker["key"] for blocker in found["start_blockers"]]


def lost_alarms(service: Service) -> list[Any]:
    return [
        alarm for alarm in service.plant.alarms.active() if alarm.kind == "settings_lost" and alarm.cleared_ms is None
    ]


@pytest.mark.parametrize("content", DAMAGED.values(), ids=DAMAGED)
def test_a_damaged_file_is_put_aside_and_its_limits_count_as_lost(tmp_path: Path, content: bytes) -> None:
    store = FileStore(tmp_path / "plant.json")
    store.path.write_bytes(content)
    assert StoredSettings.of(store, "fan-1") == StoredSettings(None, None, True)
    recover_settings(store, ["fan-1"], 17)
    recover_settings(store, ["fan-1"], 18)
    assert (tmp_path / "plant.json.damaged-17").read_bytes() == content
    assert not (tmp_path / "plant.json.damaged-18").exists()
    assert StoredSettings.of(store, "fan-1") == StoredSettings(None, None, True)
    assert StoredSettings.of(store, "new") == StoredSettings(None, None, False)


async def test_the_service_starts_and_stops_with_damaged_settings_and_refuses_only_motion(tmp_path: Path) -> None:
    (tmp_path / "plant.json").write_bytes(DAMAGED["random bytes"])
    async with service_in(tmp_path) as service:
        assert "fan-1, fan-2, pump-1, pump-2" in lost_alarms(service)[0].text.en
        assert "plant.limits_lost" in await blockers(service, "fan-1")
        with pytest.raises(ServiceError, match="limits of fan-1 are lost"):
            await service.call("drive.set_frequency", {"drive": "fan-1", "frequency_hz": 5.0}, LOCAL)
        assert (await service.call("plant.stop", {}, LOCAL))["outcomes"].keys() == service.plant.drives.keys()
        await service.call("drive.limits", {"drive": "fan-1", **WIDEST_LIMITS, "maximum_hz": 30.0}, LOCAL)
        assert "plant.limits_lost" not in await blockers(service, "fan-1")
    async with service_in(tmp_path) as service:
        assert service.plant.drives["fan-1"].drive.range_hz[1] == 30.0
        assert "plant.limits_lost" not in await blockers(service, "fan-1")
        assert "plant.limits_lost" in await blockers(service, "fan-2")
        for drive in ("fan-2", "pump-1", "pump-2"):
            assert lost_alarms(service)
            await service.call("drive.limits", {"drive": drive, **WIDEST_LIMITS}, LOCAL)
        assert not lost_alarms(service)


async def test_limits_of_a_deleted_file_are_lost_and_not_forgotten(tmp_path: Path) -> None:
    """A plant without the file was a new one: its drives started without the limits that an engineer had set."""
    limits = {"drive": "fan-1", **WIDEST_LIMITS, "maximum_hz": 30.0}
    async with service_in(tmp_path) as service:
        assert not lost_alarms(service), "a new plant"
    async with service_in(tmp_path) as service:
        assert not lost_alarms(service), "a plant in which nothing was ever set"
        await service.call("drive.limits", limits, LOCAL)
        (tmp_path / "plant.json").unlink()
        with pytest.raises(ConfigurationError, match="json is missing") as refused:
            await service.call("drive.limits", limits | {"drive": "fan-2"}, LOCAL)
        assert refused.value.key == "drives.store_missing"
        assert service.plant.drives["fan-1"].drive.range_hz[1] == 30.0, "until the end"
    async with service_in(tmp_path) as service:
        assert "fan-1, fan-2, pump-1, pump-2" in lost_alarms(service)[0].text.en
        assert "plant.limits_lost" in await blockers(service, "fan-1")
        await service.call("drive.limits", limits, LOCAL)
    async with service_in(tmp_path) as service:
        assert service.plant.drives["fan-1"].drive.range_hz[1] == 30.0
        assert "fan-2, pump-1, pump-2" in lost_alarms(service)[0].text.en


async def test_a_first_setting_that_could_not_be_stored_is_no_loss(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    async with service_in(tmp_path) as service:
        with monkeypatch.context() as full_disk, pytest.raises(ConfigurationError, match="No space left"):
            full_disk.setattr(store, "_replace", fail)
            await service.call("drive.limits", {"drive": "fan-1", **WIDEST_LIMITS}, LOCAL)
    async with service_in(tmp_path) as service:
        assert not lost_alarms(service)


@pytest.mark.parametrize("failing", ["link", "replace"])
async def test_a_damaged_file_that_cannot_be_replaced_stays_and_its_limits_count_as_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, failing: str
) -> None:
    file = tmp_path / "plant.json"
    file.write_bytes(DAMAGED["random bytes"])

    def fail(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as full_disk:
        full_disk.setattr(*((atomic_write, "link_or_copy") if failing == "link" else (store, "_replace")), fail)
        for _ in range(2):
            async with service_in(tmp_path) as service:
                assert "fan-1, fan-2, pump-1, pump-2" in lost_alarms(service)[0].text.en
                assert "plant.limits_lost" in await blockers(service, "fan-1")
                with pytest.raises(ServiceError, match="limits of fan-1 are lost"):
                    await service.call("drive.set_frequency", {"drive": "fan-1", "frequency_hz": 45.0}, LOCAL)
            assert file.read_bytes() == DAMAGED["random bytes"]
    recover_settings(FileStore(file), ["fan-1"], 17)
    assert (tmp_path / "plant.json.damaged-17").read_bytes() == DAMAGED["random bytes"]
    assert StoredSettings.of(FileStore(file), "fan-1").limits_lost


def test_a_damaged_file_is_copied_where_no_hard_link_is_possible(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise OSError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr("os.link", fail)
    (tmp_path / "plant.json").write_bytes(b"[")
    recover_settings(FileStore(tmp_path / "plant.json"), ["fan-1"], 17)
    assert (tmp_path / "plant.json.damaged-17").read_bytes() == b"["
    assert StoredSettings.of(FileStore(tmp_path / "plant.json"), "fan-1").limits_lost


def test_a_damaged_file_exists_at_every_moment_until_it_is_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found, replace_file = FileStore(tmp_path / "plant.json"), store._replace
    found.path.write_bytes(b"[")

    def power_cut(path: Path, text: str) -> None:
        assert StoredSettings.of(found, "fan-1").limits_lost
        replace_file(path, text)

    monkeypatch.setattr(store, "_replace", power_cut)
    recover_settings(found, ["fan-1"], 17)
    assert StoredSettings.of(found, "fan-1").limits_lost


COMPLETE_LIMITS = '"minimum_hz": 0.0, "maximum_hz": null, "forward": true, "reverse": true'


@pytest.mark.parametrize(
    "wrong",
    [
        '"maximum_hz": "abc"',
        '"maximum_hz": NaN',
        '"maximum_hz": 1e999',
        '"maximum_hz": true',
        f'"maximum_hz": 1{"0" * 400}',
        '"minimum_hz": null',
        '"minimum_hz": [5]',
        '"forward": "no"',
        '"reverse": 0',
        '"eeprom_writes_per_day": "1"',
    ],
)
def test_limits_of_a_wrong_type_count_as_lost(wrong: str) -> None:
    found = MemoryStore()
    found.put("limits/fan-1", f"{{{COMPLETE_LIMITS}}}")
    assert StoredSettings.of(found, "fan-1") == StoredSettings(None, DriveLimits(), False)
    found.put("limits/fan-1", f"{{{COMPLETE_LIMITS}, {wrong}}}")
    assert StoredSettings.of(found, "fan-1") == StoredSettings(None, None, True)


@pytest.mark.parametrize("identity", ["5", '"fan"', "{}", '{"model": 1, "port": "p", "address": 1}'])
def test_limits_hold_where_the_drive_that_they_were_set_for_cannot_be_read(identity: str) -> None:
    """They counted as lost, and the drive could not be started, though each limit was there."""
    found = MemoryStore()
    found.put("limits/fan-1", f'{{{COMPLETE_LIMITS}, "set_for": {identity}}}')
    assert StoredSettings.of(found, "fan-1") == StoredSettings(None, DriveLimits(), False)


@pytest.mark.parametrize("stored", ["[15.0]", "null", "15.0", "", '{"minimum_hz": 0.0, "maximum_hz": 30.0}'])
def test_limits_that_are_not_complete_count_as_lost(stored: str) -> None:
    """Without its directions a record would permit reverse, which the engineer may have forbidden."""
    found = MemoryStore()
    found.put("limits/fan-1", stored)
    assert StoredSettings.of(found, "fan-1") == StoredSettings(None, None, True)


@pytest.mark.parametrize("names", ["5", '"fan"', '{"pump-1": 1}', "["])
def test_a_list_of_lost_limits_of_a_wrong_type_names_every_drive(names: str) -> None:
    found = MemoryStore()
    found.put("lost-limits", names)
    assert StoredSettings.of(found, "fan-1").limits_lost


@pytest.mark.parametrize("waiver", ['{"text": 5}', '{"text": "on site (Li)", "model": [1]}', "5", "[]"])
async def test_a_service_starts_with_settings_of_a_wrong_type(tmp_path: Path, waiver: str) -> None:
    found = FileStore(tmp_path / "plant.json")
    found.put("limits/fan-1", '{"maximum_hz": "abc"}')
    found.put("waiver/fan-2", waiver)
    async with service_in(tmp_path) as service:
        assert "plant.limits_lost" in await blockers(service, "fan-1")
        assert any(blocker.startswith("plant.waiver") for blocker in await blockers(service, "fan-2"))
        assert "fan-1" in lost_alarms(service)[0].text.en


async def test_one_damaged_record_concerns_one_drive(tmp_path: Path) -> None:
    store = FileStore(tmp_path / "plant.json")
    store.put("limits/fan-1", '{"highest": 3}')
    store.put("waiver/fan-2", '{"x": 1}')
    async with service_in(tmp_path) as service:
        assert "plant.limits_lost" in await blockers(service, "fan-1")
        assert "plant.limits_lost" not in await blockers(service, "fan-2")
        assert "plant.waiver_needed" in await blockers(service, "fan-2")


async def test_a_damaged_store_of_eeprom_counts_prevents_no_stop(tmp_path: Path) -> None:
    file = tmp_path / "store.json"
    file.write_bytes(b"\x80")
    async with SimulatedDrives("c320") as bench:
        drive = Drive(bench.bus, "c320", 1, store=FileStore(file))
        assert (await drive.stop()).status == "confirmed"
        with pytest.raises(ConfigurationError, match=r"store\.json"):
            await drive.write({"F1.10": 16}, save=True)
    assert file.read_bytes() == b"\x80"


@pytest.mark.parametrize("count", ['{"day": 5}', '{"today": "many"}', '{"total": null}', "[" * 100_000, "[1, 2]"])
async def test_a_damaged_count_of_eeprom_writes_is_a_used_up_budget(tmp_path: Path, count: str) -> None:
    """A count of another type ended the write with an internal error."""
    store = FileStore(tmp_path / "store.json")
    async with SimulatedDrives("c320") as bench:
        drive = Drive(bench.bus, "c320", 1, store=store)
        await drive.write({"F1.10": 16}, save=True)
        (key,) = [key for key in json.loads(store.path.read_text())["values"] if key.startswith("eeprom/")]
        store.put(key, count)
        with pytest.raises(EepromBudgetExceeded):
            await drive.write({"F1.10": 17}, save=True)


async def test_damaged_run_statistics_are_an_alarm_until_the_next_start(tmp_path: Path) -> None:
    """Nothing was counted any more, of any drive, without an alarm."""
    historian = Historian(HistoryConfig(), tmp_path)
    await historian.open()
    historian.put_document("statistics", "fan-1", {"running_s": "long"})
    await historian.close()
    for expected in (["statistics"], []):
        async with service_in(tmp_path) as service:
            for _ in range(STORAGE_CHECK_CYCLES):
                service.supervision.run_once()
            damaged = [alarm for alarm in service.plant.alarms.active() if alarm.kind == "file_damaged"]
            assert [alarm.subject for alarm in damaged if alarm.cleared_ms is None] == expected
            assert "put aside as statistics.damaged-" in damaged[0].text.en


async def test_a_damaged_log_of_alarms_is_an_alarm_until_the_next_start(tmp_path: Path) -> None:
    """It was read around without a word."""
    (tmp_path / "alarms.jsonl").write_bytes(b"\x80\xff\n")
    for expected in (["alarms.jsonl"], []):
        async with service_in(tmp_path) as service:
            damaged = [alarm for alarm in service.plant.alarms.active() if alarm.kind == "file_damaged"]
            assert [alarm.subject for alarm in damaged if alarm.cleared_ms is None] == expected
            assert "put aside as alarms.jsonl.damaged-" in damaged[0].text.en


FILES = ("audit.jsonl", "checkpoints.jsonl", "../state.audit.key", "../state.audit.head", "history.db", "incidents")


KINDS = {
    **{name: partial(Path.write_bytes, data=content) for name, content in DAMAGED.items()},
    "a directory": Path.mkdir,
}


@pytest.mark.parametrize("make", [*KINDS.values(), os.mkfifo], ids=[*KINDS, "a FIFO, which blocks its reader"])
async def test_a_service_starts_and_stops_its_drives_whatever_its_files_contain(
    tmp_path: Path, make: Callable[[Path], object]
) -> None:
    state = tmp_path / "state"
    state.mkdir(mode=0o700)
    for name in (*FILES, "plant.json", "alarms.jsonl"):
        make(state / name)
    async with service_in(state) as service:
        assert (await service.call("plant.stop", {}, LOCAL))["outcomes"].keys() == service.plant.drives.keys()
        kinds = {alarm.kind for alarm in service.plant.alarms.active()}
        assert "settings_lost" in kinds
        assert make is KINDS["empty"] or kinds & {"file_damaged", "storage_failure"}
