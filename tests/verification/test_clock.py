"""The campaign ``clock`` finds no violation, follows its seed, and finds planted uses of the wall clock."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from drivebus import clock as product_clock
from drivebus.bus import Bus
from drivebus.drives import permissives, runner
from drivebus.drives.eeprom_budget import EepromBudget, SaveCount
from drivebus.drives.operations.context import OperationContext
from drivebus.drives.operations.steps import get_bus_conditions
from fixtures.campaigns import finds
from verification.campaign import CampaignRun, run_campaign
from verification.campaigns import clock
from verification.families.registry import DRIVE_VARIANTS, VARIANTS_BY_NAME
from verification.fault_injection.clocks import (
    CLOCK_JUMPS_S,
    HostSleepScenario,
    JumpingWallClock,
    before_midnight,
    clock_readers,
    installed_clock,
)
from verification.report import PACKAGE_FOLDER

NAMES = list(CLOCK_JUMPS_S)


def campaign(jumps: int = 20, seed: int = 3) -> CampaignRun:
    return run_campaign(clock.CAMPAIGN, CampaignRun(campaign="clock", seed=seed, budget=jumps))


def reported(campaign_run: CampaignRun, what: str) -> bool:
    return any(what in text for text in campaign_run.violations)


def test_jumps_change_nothing_and_another_seed_jumps_otherwise() -> None:
    first = campaign()
    assert first.violations == [] and first.trials == 20
    assert first.digest != campaign(20, 4).digest
    assert first.counts["samples"] > 100 and first.counts["frames"] > 100


def test_one_function_reads_the_wall_clock() -> None:
    assert clock_readers(PACKAGE_FOLDER) == clock.CLOCK_READER


@pytest.mark.parametrize(
    "line",
    [
        "import time\nt = time.time()",
        "import datetime\nt = datetime.datetime.now()",
        "from time import time_ns as t",
        "from datetime import date\nt = date.today",
        "import time\nt = time.clock_gettime(time.CLOCK_REALTIME)",
    ],
)
def test_another_read_of_the_wall_clock_is_found(tmp_path: Path, line: str) -> None:
    (tmp_path / "bus").mkdir()
    (tmp_path / "bus" / "x.py").write_text(line)
    assert {file for file, _ in clock_readers(tmp_path)} == {"bus/x.py"}


def test_a_jumping_clock_is_uninstalled_completely() -> None:
    plain, wall = time.time, product_clock.wall_clock
    elapsed = 0.0
    with installed_clock(JumpingWallClock(before_midnight(2.0), lambda: elapsed)) as fake:
        began, hour = time.time(), time.localtime().tm_hour
        elapsed = 5.0
        fake.jump("-1 h")
        assert time.time() == began + 5.0 - 3600.0 and product_clock.wall_clock().timestamp() == time.time()
        fake.jump("summer time begins")
        fake.jump("+10 y")
        assert product_clock.wall_clock().year == 2036
        assert hour == time.localtime().tm_hour - 1 or hour == 23  # the real hour, one zone further
    assert (time.time, product_clock.wall_clock) == (plain, wall) and abs(time.time() - began) > 86400


def test_a_bus_timed_by_the_wall_clock_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """The age of commands depends on it."""
    plain, midnight = Bus.now, before_midnight(0.0)
    monkeypatch.setattr(Bus, "now", lambda bus: plain(bus) + (product_clock.wall_clock() - midnight).total_seconds())
    lines: list[str] = []
    campaign_run = CampaignRun(campaign="clock", seed=1, budget=1, listener=lines.append)
    clock.compare_clocks(campaign_run, VARIANTS_BY_NAME["vc660"], 0, ["+1 h", "-1 h"] * 30, Path())
    assert any(line.startswith("VIOLATION wall clock") for line in lines)


def test_a_wall_clock_time_in_the_records_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    plain = clock.RecordingPort._record_event

    def labelled(port: Any, name: str, **details: object) -> None:
        plain(port, name, at=product_clock.wall_clock().isoformat(), **details)

    monkeypatch.setattr(clock.RecordingPort, "_record_event", labelled)
    assert finds("clock", "the captures differ", 10, seed=3)


def test_samples_with_decreasing_times_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """The time of a reading comes from a wall clock that was set back."""
    plain = clock.ClockTrial._on_sample

    def with_wall_time(trial: Any, address: int, name: str, reading: Any) -> None:
        moved = trial.clock._offset.total_seconds()
        plain(trial, address, name, replace(reading, source_time=reading.source_time + moved))

    monkeypatch.setattr(clock.ClockTrial, "_on_sample", with_wall_time)
    campaign_run = CampaignRun(campaign="clock", seed=1, budget=10)
    clock.compare_clocks(campaign_run, VARIANTS_BY_NAME["vc660"], 0, ["-1 s", "+1 s"] * 5, Path())
    assert reported(campaign_run, "order of samples: output_frequency") or reported(campaign_run, "came after one at")


@pytest.fixture(autouse=True)
def _somewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_the_eeprom_budget_holds_under_every_jump_and_renews_on_a_later_day() -> None:
    campaign_run = budget()
    assert campaign_run.violations == []
    assert campaign_run.counts["write: confirmed"] > clock.EEPROM_WRITES_PER_DAY
    assert campaign_run.counts["write: EepromBudgetExceeded"] > 0


def test_a_budget_renewed_by_a_clock_set_back_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    def forgetful(budget_of_drive: EepromBudget, notation: str, day: str) -> Any:
        def one_more(old: SaveCount) -> SaveCount:
            today = old.today if day == old.day else 0
            if today >= budget_of_drive.budget:
                raise clock_error()
            return SaveCount(day, today + 1, old.total + 1)

        yield from budget_of_drive._change(notation, one_more)

    monkeypatch.setattr(EepromBudget, "consume", forgetful)
    assert reported(budget(), "EEPROM budget")


def clock_error() -> Exception:
    from drivebus.errors import EepromBudgetExceeded

    return EepromBudgetExceeded("drives.eeprom_budget", notation="", count=0, budget=0)


def test_a_budget_that_never_renews_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    real = runner.bus_conditions
    monkeypatch.setattr(runner, "bus_conditions", lambda *given: replace(real(*given), day="2026-01-01"))
    assert reported(budget(), "EEPROM budget")


def budget() -> CampaignRun:
    campaign_run = CampaignRun(campaign="clock", seed=1, budget=1)
    clock.EepromBudgetTrial(campaign_run, DRIVE_VARIANTS[0], "budget", campaign_run.rng("budget")).use_budget(NAMES)
    return campaign_run


def sleep_scenarios(count: int = 6) -> CampaignRun:
    campaign_run = CampaignRun(campaign="clock", seed=1, budget=count)
    for number in range(count):
        HostSleepScenario(
            campaign_run, VARIANTS_BY_NAME["vc660"], f"night {number}", campaign_run.rng("night", number)
        ).play()
    return campaign_run


def test_commands_queued_during_a_sleep_expire_and_stops_are_sent() -> None:
    campaign_run = sleep_scenarios()
    assert campaign_run.violations == []
    assert sum(amount for name, amount in campaign_run.counts.items() if name.endswith(": Expired")) > 3
    assert campaign_run.counts["stop: confirmed"] > 1 and campaign_run.counts["leases lost over the sleep"] > 1


def test_a_command_that_never_expires_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    def without_check(op: OperationContext) -> Any:
        around = yield from get_bus_conditions()
        return around

    monkeypatch.setattr(OperationContext, "check_deadline", without_check)
    assert reported(sleep_scenarios(), "was sent after the sleep")


def test_a_queued_frame_that_never_expires_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    ages = dict.fromkeys(permissives.COMMAND_TTL_S, 1e6)
    monkeypatch.setattr(permissives, "COMMAND_TTL_S", ages)
    monkeypatch.setattr("drivebus.drives.operations.command_age.CHECKS_TIMEOUT_S", 1e6)
    assert reported(sleep_scenarios(), "was sent after the sleep")


def test_t13_a_lease_that_never_ends_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    from drivebus.drives.jog_session import JogSession

    monkeypatch.setattr(JogSession, "_arm", lambda lease, left_s: setattr(lease, "_timer", lease))
    monkeypatch.setattr(JogSession, "renew", lambda lease: None)
    assert reported(sleep_scenarios(), "T13")
