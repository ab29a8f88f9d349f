"""The campaign ``failures`` finds no violation, is reproducible, and finds planted errors in the handling of failing
calls."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from drivebus import i18n
from drivebus.bus import Bus
from drivebus.bus import timer as timers
from drivebus.bus.core import BusCore
from drivebus.capture.dbcap import CaptureWriter
from drivebus.drives import store as stores
from drivebus.drives.eeprom_budget import EepromBudget
from verification.campaign import CampaignRun, run_campaign
from verification.campaigns import failures
from verification.drive_variants import DriveVariant
from verification.families.registry import VARIANTS_BY_NAME
from verification.fault_injection import faulty_disk as files
from verification.fault_injection.clocks import fail_kernel_timers, stall_clock
from verification.fault_injection.faulty_disk import FaultyDisk, ProgramKilled, installed_disk
from verification.fault_injection.faulty_port import PORT_ERRORS, PortFailureScenario

VC660 = VARIANTS_BY_NAME["vc660"]


TRACE_LINES: list[str] = []


def campaign_run(budget: int = 4) -> CampaignRun:
    return CampaignRun(campaign="failures", seed=1, budget=budget, listener=TRACE_LINES.append)


def reported(what: str) -> bool:
    return any(line.startswith("VIOLATION") and what in line for line in TRACE_LINES)


def test_every_target_handles_its_failures() -> None:
    found = run_campaign(failures.CAMPAIGN, campaign_run(2))
    assert found.violations == []
    assert found.trials == 2 * len(found.figures) == 26


# --- the port --------------------------------------------------------------------------------------------------------


def port(variant: DriveVariant, calls: str, error: str, every: int = 1, most: int = 12) -> CampaignRun:
    """Let the calls of this name fail, one in each run."""
    found = campaign_run()
    row = PortFailureScenario(found, variant, "clean").run_with_failure()
    places = [nth for nth, call in enumerate(row, 1) if call == calls]
    for nth in places[::every][:most]:
        PortFailureScenario(found, variant, f"{nth}").run_with_failure(nth, error)
    return found


@pytest.mark.parametrize("error", PORT_ERRORS)
def test_a_port_that_cannot_be_opened_or_closed_is_handled(error: str) -> None:
    for calls in ("open", "close"):
        assert port(VC660, calls, error).violations == []


def test_an_escaping_port_error_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    async def plainly(bus: Bus) -> None:
        await bus.port.close()

    monkeypatch.setattr(Bus, "_close_port", plainly)
    port(VC660, "close", "EIO")
    assert reported("close raised OSError")


def test_a_bus_that_does_not_reopen_its_port_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    async def never(bus: Bus) -> None:
        return

    monkeypatch.setattr(Bus, "_reopen", never)
    port(VC660, "write", "PortLost", every=30, most=4)
    assert reported("the bus does not work again") or reported("the motor stays on")


def test_i6_a_frame_sent_too_soon_after_a_failed_write_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    plain = BusCore.on_port_open

    def hasty(core: BusCore, now: float) -> Any:
        core._silent_since = now
        return plain(core, now)

    monkeypatch.setattr(BusCore, "on_port_open", hasty)
    found = campaign_run()
    row = PortFailureScenario(
        found, VC660, "clean"
    ).run_with_failure()  # a stop is the only frame that goes at once after an opening
    frames = [line for line in TRACE_LINES if " > " in line]
    stop = max(place for place, line in enumerate(frames) if " stop " in line)
    for nth in [nth for nth, call in enumerate(row, 1) if call == "write"][stop - 3 : stop + 12]:
        PortFailureScenario(found, VC660, "sent").run_with_failure(nth, "EIO", sends_anyway=True)
    assert reported("I6")


# --- files -----------------------------------------------------------------------------------------------------------


def failing(play: Callable[[CampaignRun, FaultyDisk], None], folder: Path, errors: Any, every: int = 1) -> CampaignRun:
    """Let each file call fail in each of these modes."""
    found = campaign_run()
    clean = FaultyDisk(folder / "clean")
    clean.folder.mkdir()
    play(found, clean)
    for nth in range(1, clean.calls + 1, every):
        for number, how in enumerate(errors):
            place = folder / f"{nth}-{number}"
            place.mkdir()
            play(found, FaultyDisk(place, nth, **how))
    return found


def test_a_store_written_in_place_is_found(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def in_place(path: Path, text: str) -> None:
        with path.open("w", encoding="utf-8") as file:
            file.write(text)

    monkeypatch.setattr(stores, "_replace", in_place)
    failing(files.fail_store, tmp_path, (failures.KILL_MODE,), 2)
    assert reported("torn")


def test_a_store_without_sync_is_found_after_a_power_cut(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def unsynced(path: Path, text: str) -> None:
        part = path.with_name("part")
        with part.open("w", encoding="utf-8") as file:
            file.write(text)
        part.replace(path)

    monkeypatch.setattr(stores, "_replace", unsynced)
    failing(partial(files.fail_store, power=True), tmp_path, (failures.KILL_MODE,))
    assert reported("torn")


def test_saves_counted_too_late_are_found(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    plain = EepromBudget.mark_saved

    def charge(budget: EepromBudget, notation: str, day: str) -> Any:
        return
        yield

    def saved(budget: EepromBudget, notation: str) -> Any:
        yield from budget._change(notation, lambda old: type(old)("2026-01-01", old.today + 1, old.total + 1))
        yield from plain(budget, notation)

    monkeypatch.setattr(EepromBudget, "consume", charge)
    monkeypatch.setattr(EepromBudget, "mark_saved", saved)
    failing(files.fail_store, tmp_path, (failures.KILL_MODE,), 2)
    assert reported("are counted")


def recording(found: CampaignRun, disk: FaultyDisk) -> None:
    records = RECORDED_FILES.setdefault("records", [])
    files.fail_capture(found, disk, RECORDED_FILES.setdefault("lines", []), records)


RECORDED_FILES: dict[str, Any] = {}


@pytest.fixture(autouse=True)
def _forget_failure() -> None:
    RECORDED_FILES.clear()
    TRACE_LINES.clear()


def test_a_recording_that_ends_silently_is_found(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def silently(writer: CaptureWriter, line: str) -> None:
        if not hasattr(writer, "_over"):
            try:
                os.write(writer._fd, line.encode())
            except OSError:
                writer._over = True  # type: ignore[attr-defined]

    monkeypatch.setattr(CaptureWriter, "_write_line", silently, raising=True)
    monkeypatch.setattr(CaptureWriter, "__slots__", (), raising=False)
    failing(recording, tmp_path, failures.CAPTURE_FAILURES[:1], 40)
    assert reported("without a report")


def test_a_recording_whose_failure_reaches_the_bus_is_found(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def put(writer: CaptureWriter, line: str) -> None:
        os.write(writer._fd, line.encode())

    monkeypatch.setattr(CaptureWriter, "_write_line", put)
    try:
        failing(recording, tmp_path, failures.CAPTURE_FAILURES[:1], 40)
    except OSError:
        return
    assert reported("changed the behaviour of the bus")


def test_messages_that_fail_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(i18n, "_sentence", lambda key, language: i18n.catalogue(language).get(key))
    found = campaign_run()
    files.fail_catalogue(found, FaultyDisk(files.SENTENCES, 5, OSError(24, "Too many open files")))
    assert reported("raised OSError")


def test_profiles_that_stay_lost_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    def inside(folder: Path) -> list[Path]:
        try:
            return list(folder.iterdir())
        except OSError:
            return []

    monkeypatch.setattr(files.PROFILE_LOADER, "_list_directory", inside)
    found = campaign_run()
    files.fail_profile(found, FaultyDisk(files.PROFILES, 1, PermissionError(13, "Permission denied")))
    files.PROFILE_LOADER._builtin_files.cache_clear()
    assert reported("cannot be loaded again")


# --- time ------------------------------------------------------------------------------------------------------------


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux has timerfd")
def test_a_timer_that_stays_open_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(timers._KernelTimer, "close", lambda timer: None)
    found = campaign_run()
    for nth in range(1, fail_kernel_timers(found, 0) + 1):
        fail_kernel_timers(found, nth)
    assert reported("stayed open")


def test_a_busy_loop_on_a_stalled_clock_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("verification.fault_injection.clocks.MAX_CLOCK_READS", 1000)
    monkeypatch.setattr(timers, "SLOW_CLOCK_RETRY_S", 1e-6)
    found = campaign_run()
    assert stall_clock(found, 40) > 40
    assert reported("busy loop")


# --- the disk itself -------------------------------------------------------------------------------------------------


def test_a_killed_program_leaves_half_a_write_and_changes_nothing_afterwards(tmp_path: Path) -> None:
    disk = FaultyDisk(tmp_path, 2)
    with installed_disk(disk):
        with pytest.raises(ProgramKilled), (tmp_path / "a").open("w") as file:
            file.write("12345678")
            file.flush()
        with pytest.raises(ProgramKilled):
            (tmp_path / "a").unlink()
    assert (tmp_path / "a").read_text() == "1234" and disk.failed == "write"


def test_files_outside_the_folder_do_not_fail(tmp_path: Path) -> None:
    disk = FaultyDisk(tmp_path / "inside", 1, OSError(5, "Input/output error"))
    with installed_disk(disk):
        (tmp_path / "outside").write_text(json.dumps(1))
    assert disk.calls == 0 and (tmp_path / "outside").read_text() == "1"
