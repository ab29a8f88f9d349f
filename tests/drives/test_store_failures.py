"""Failing store of write counts: no save is sent without its count, and every error is a DrivebusError."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from drivebus.bus import Bus
from drivebus.drives import Drive, FileStore, MemoryStore
from drivebus.drives.operations.context import OperationContext
from drivebus.drives.operations.parameters import write_values
from drivebus.drives.outcome import OutcomeStatus
from drivebus.drives.store import drive_key
from drivebus.errors import ConfigurationError, TargetNotReached
from drivebus.ports import open_port
from drivebus.protocols import sunfar
from fixtures.drives import FakeC320, PureBus, SimulatedDrives, context_for, dialect_for, run_virtual


class Failing(MemoryStore):
    """Store whose ``fails``-th use fails."""

    def __init__(self, fails: int) -> None:
        super().__init__()
        self.uses, self.fails = 0, fails

    def _use(self) -> None:
        self.uses += 1
        if self.uses == self.fails:
            raise ConfigurationError("drives.store_unwritable", file="s.json", problem="No space left on device")

    def get(self, key: str) -> str | None:
        self._use()
        return super().get(key)

    def update(self, key: str, change: Callable[[str | None], str]) -> None:
        self._use()
        super().update(key, change)


def saved(store: Failing, values: dict[str, float]) -> tuple[PureBus, Any]:
    bus = PureBus(dialect=dialect_for("c320"), station=FakeC320(), store=store)
    try:
        return bus, bus.run(write_values(OperationContext(context_for(bus.dialect, store=store)), values, save=True))
    except ConfigurationError as error:
        return bus, error


@pytest.mark.parametrize("fails", range(1, 6))
def test_a_store_that_fails_is_raised_only_where_nothing_was_sent(fails: int) -> None:
    """Each frame that was sent was counted."""
    store = Failing(fails)
    bus, end = saved(store, {"F0.2": 30.0})
    sent = len(bus.sent(sunfar.SunfarWriteParameter))
    assert sent == (0 if isinstance(end, ConfigurationError) else 1)
    assert sent == 0 or end.status is OutcomeStatus.CONFIRMED
    store.fails = 0
    assert context_for(bus.dialect, store=store).eeprom_budget.count("F0.2").total >= sent


def test_where_the_first_of_a_list_was_sent_the_failing_store_is_an_outcome() -> None:
    uses = Failing(0)
    saved(uses, {"F0.2": 30.0})
    bus, end = saved(Failing(uses.uses + 1), {"F0.2": 30.0, "F1.10": 2.0})
    assert (end.status, end.key) == (OutcomeStatus.FAILED, "drives.not_written")
    assert isinstance(end.params["why"], ConfigurationError) and len(bus.sent(sunfar.SunfarWriteParameter)) == 1


def test_a_drive_on_a_bus_reports_the_same() -> None:
    """The operation handles the error of a step, also when the runner performs it."""

    class Full(MemoryStore):
        def update(self, key: str, change: Callable[[str | None], str]) -> None:
            if key.endswith("F1.10"):
                raise ConfigurationError("drives.store_unwritable", file="s.json", problem="full")
            super().update(key, change)

    async def scenario() -> None:
        async with SimulatedDrives("c320", query="echo=off") as bench:
            with pytest.raises(TargetNotReached) as caught:
                await bench.drive(store=Full()).write({"F0.2": 30.0, "F1.10": 2.0}, save=True)
            assert caught.value.key == "drives.not_written"
            assert bench.station().memory.eeprom_writes.total() == 1

    run_virtual(scenario())


@pytest.mark.parametrize("is_open_before", [True, False])
@pytest.mark.parametrize("model", ["c320", "ms300"])
def test_a_store_that_cannot_be_read_prevents_no_stop(model: str, is_open_before: bool, tmp_path: Path) -> None:
    """The first stop to a model whose stop may start another one raised the error of the file, and sent nothing."""
    file = tmp_path / "store.json"
    file.write_text("{")

    async def scenario() -> None:
        bus = Bus(open_port(f"sim://{model}@3"))
        drive = None if is_open_before else Drive(bus, model, 3, store=FileStore(file))
        async with bus:
            drive = drive or Drive(bus, model, 3, store=FileStore(file))
            assert (await drive.stop()).status is OutcomeStatus.CONFIRMED

    run_virtual(scenario())


@pytest.mark.parametrize("record", ["null", "[]", '"x"', "0.01", "NaN"])
def test_a_stored_value_that_its_option_cannot_have_determines_nothing(record: str) -> None:
    """Some lifted the cap of a C320 whose setpoint step is not known, others ended each start with a TypeError."""

    async def scenario() -> None:
        bus, store = Bus(open_port("sim://c320@3")), MemoryStore()
        store.put(f"calibration/{drive_key(bus.port.identity, 3)}/c320/setpoint_step", record)
        async with bus:
            drive = Drive(bus, "c320", 3, store=store)
            assert drive.dialect.options["setpoint_step"] == "0.01", "as the simulated drive states"
            assert (await drive.run(2.0)).succeeded

    run_virtual(scenario())


@pytest.mark.parametrize("call", ["os.mkdir", "io.open", "os.fsync", "os.replace", "fcntl.flock"])
def test_whatever_the_system_refuses_is_our_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: str) -> None:
    def refused(*_: Any, **__: Any) -> Any:
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr(call, refused)
    with pytest.raises(ConfigurationError) as caught:
        FileStore(tmp_path / "new" / "s.json").put("a", "1")
    assert "Read-only file system" in caught.value.text("en")
    assert "文件系统为只读" in caught.value.text("zh") and "s.json" in caught.value.text("zh")


@pytest.mark.parametrize("name", ["plant.json", "store.json"])
def test_the_sentence_about_a_file_fits_limits_and_waivers_as_well_as_write_counts(name: str, tmp_path: Path) -> None:
    """A limit that could not be stored was answered with a save that is not sent."""
    path = tmp_path / name
    path.mkdir()
    with pytest.raises(ConfigurationError) as unreadable:
        FileStore(path).get("limits/fan-1")
    unwritable = ConfigurationError("drives.store_unwritable", file=str(path), problem="disk full")
    for error in (unreadable.value, unwritable):
        before, file, after = error.text("en").partition(str(path))
        assert file and not any(word in before + after for word in ("calibration", "save", "sent"))


def test_no_other_user_can_write_calibrations_waivers_and_limits_whatever_the_umask(tmp_path: Path) -> None:
    """Under the umask 000 their file was writable by every user."""
    store = FileStore(tmp_path / "new" / "s.json")
    umask = os.umask(0)
    try:
        store.put("a", "1")
    finally:
        os.umask(umask)
    modes = {path.name: path.stat().st_mode & 0o777 for path in (store.path.parent, *store.path.parent.iterdir())}
    assert modes == {"new": 0o700, "s.json": 0o600, "s.lock": 0o600}


def test_what_killed_writers_left_behind_does_not_pile_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Killed between writing and renaming, by one program after the other."""
    store = FileStore(tmp_path / "s.json")
    with monkeypatch.context() as killed:
        killed.setattr(Path, "replace", lambda *_: (_ for _ in ()).throw(OSError("killed")))
        killed.setattr(Path, "unlink", lambda *_, **__: None)
        for pid in (11, 12, 13):
            killed.setattr("os.getpid", lambda pid=pid: pid)
            with pytest.raises(ConfigurationError):
                store.put("a", "0")
    store.put("a", "1")
    assert store.get("a") == "1"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["s.json", "s.lock"]
