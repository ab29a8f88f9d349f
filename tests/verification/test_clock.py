"""The campaign ``clock`` runs clean, repeats itself, and finds planted ways to live by the wall clock."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from drivebus import clock as seams
from drivebus.bus import Bus
from drivebus.drives import permissives, runner
from drivebus.drives.context import EepromBudget, SaveCount
from drivebus.drives.operations.context import OperationContext
from drivebus.drives.operations.steps import get_bus_conditions
from verification.campaign import CampaignRun, run_campaign
from verification.campaigns import clock
from verification.drive_variants import DRIVE_VARIANTS, VARIANTS_BY_NAME
from verification.fault_injection.host_sleep import HostSleepScenario
from verification.fault_injection.wall_clock import (
    CLOCK_JUMPS_S,
    JumpingWallClock,
    before_midnight,
    clock_readers,
    installed_clock,
)
from verification.report import PACKAGE_FOLDER

NAMES = list(CLOCK_JUMPS_S)


def campaign(jumps: int = 20, seed: int = 3) -> CampaignRun:
    return run_campaign(clock.CAMPAIGN, CampaignRun("clock", seed, jumps))


def reported(session: CampaignRun, what: str) -> bool:
    return any(what in text for text in session.violations)


def test_no_jump_changes_anything_and_the_same_seed_is_the_same_run() -> None:
    first, second = campaign(), campaign()
    assert first.violations == [] and first.trials == 20
    assert first.digest == second.digest != campaign(20, 4).digest
    assert first.counts["samples"] > 100 and first.counts["frames"] > 100


def test_one_door_leads_to_the_wall_clock() -> None:
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
def test_another_door_would_be_seen(tmp_path: Path, line: str) -> None:
    (tmp_path / "bus").mkdir()
    (tmp_path / "bus" / "x.py").write_text(line)
    assert {file for file, _ in clock_readers(tmp_path)} == {"bus/x.py"}


def test_the_clock_jumps_and_afterwards_all_is_as_before() -> None:
    plain, wall = time.time, seams.wall_clock
    passed = 0.0
    with installed_clock(JumpingWallClock(before_midnight(2.0), lambda: passed)) as fake:
        begun, hour = time.time(), time.localtime().tm_hour
        passed = 5.0
        fake.jump("-1 h")
        assert time.time() == begun + 5.0 - 3600.0 and seams.wall_clock().timestamp() == time.time()
        fake.jump("summer time begins")
        fake.jump("+10 y")
        assert seams.wall_clock().year == 2036
        assert hour == time.localtime().tm_hour - 1 or hour == 23  # the real hour, one zone further
    assert (time.time, seams.wall_clock) == (plain, wall) and abs(time.time() - begun) > 86400


def test_a_bus_that_keeps_time_by_the_wall_clock_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """The age of commands, for one, is judged by it."""
    plain, midnight = Bus.now, before_midnight(0.0)
    monkeypatch.setattr(Bus, "now", lambda bus: plain(bus) + (seams.wall_clock() - midnight).total_seconds())
    lines: list[str] = []
    session = CampaignRun("clock", 1, 1, listener=lines.append)
    clock.compare_clocks(session, VARIANTS_BY_NAME["vc660"], 0, ["+1 h", "-1 h"] * 30, Path())
    assert any(line.startswith("VIOLATION G15") for line in lines)


def test_a_label_that_reaches_the_records_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    plain = clock.RecordingPort._record_event

    def labelled(port: Any, name: str, **details: object) -> None:
        plain(port, name, at=seams.wall_clock().isoformat(), **details)

    monkeypatch.setattr(clock.RecordingPort, "_record_event", labelled)
    assert reported(campaign(10), "the captures differ")


def test_samples_that_go_back_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """A reading timed by a wall clock that was set back."""
    plain = clock.ClockStory._on_sample

    def timed(life: Any, address: int, name: str, reading: Any) -> None:
        moved = life.clock._offset.total_seconds()
        plain(life, address, name, replace(reading, source_time=reading.source_time + moved))

    monkeypatch.setattr(clock.ClockStory, "_on_sample", timed)
    session = CampaignRun("clock", 1, 10)
    clock.compare_clocks(session, VARIANTS_BY_NAME["vc660"], 0, ["-1 s", "+1 s"] * 5, Path())
    assert reported(session, "G15 output_frequency") or reported(session, "came after one at")


@pytest.fixture(autouse=True)
def _somewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_the_budget_holds_under_every_jump_and_is_given_again_on_a_later_day() -> None:
    session = budget()
    assert session.violations == []
    assert session.counts["write: confirmed"] > clock.EEPROM_WRITES_PER_DAY
    assert session.counts["write: EepromBudgetExceeded"] > 0


def test_a_budget_that_a_clock_set_back_renews_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    def forgetful(wear: EepromBudget, notation: str, day: str) -> Any:
        def one_more(old: SaveCount) -> SaveCount:
            today = old.today if day == old.day else 0
            if today >= wear.budget:
                raise clock_error()
            return SaveCount(day, today + 1, old.total + 1)

        yield from wear._change(notation, one_more)

    monkeypatch.setattr(EepromBudget, "consume", forgetful)
    assert reported(budget(), "G16")


def clock_error() -> Exception:
    from drivebus.errors import EepromBudgetExceeded

    return EepromBudgetExceeded("drives.eeprom_budget", notation="", count=0, budget=0)


def test_a_budget_that_is_never_given_again_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    real = runner.bus_conditions
    monkeypatch.setattr(runner, "bus_conditions", lambda *given: replace(real(*given), day="2026-01-01"))
    assert reported(budget(), "G16")


def budget() -> CampaignRun:
    session = CampaignRun("clock", 1, 1)
    clock.EepromBudgetTrial(session, DRIVE_VARIANTS[0], "budget", session.rng("budget")).use_budget(NAMES)
    return session


def sleep_scenarios(count: int = 6) -> CampaignRun:
    session = CampaignRun("clock", 1, count)
    for number in range(count):
        HostSleepScenario(session, VARIANTS_BY_NAME["vc660"], f"night {number}", session.rng("night", number)).play()
    return session


def test_6_6_what_is_queued_over_a_sleep_expires_and_stops_go() -> None:
    session = sleep_scenarios()
    assert session.violations == []
    assert sum(amount for name, amount in session.counts.items() if name.endswith(": Expired")) > 3
    assert session.counts["stop: confirmed"] > 1 and session.counts["leases lost over the sleep"] > 1


def test_6_6_a_command_that_does_not_age_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    def whenever(talk: OperationContext) -> Any:
        around = yield from get_bus_conditions()
        return around

    monkeypatch.setattr(OperationContext, "check_deadline", whenever)
    assert reported(sleep_scenarios(), "was sent after the sleep")


def test_6_6_a_queue_that_does_not_age_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    ages = dict.fromkeys(permissives.COMMAND_TTL_S, 1e6)
    monkeypatch.setattr(permissives, "COMMAND_TTL_S", ages)
    monkeypatch.setattr("drivebus.drives.operations.context.CHECKS_TIMEOUT_S", 1e6)
    assert reported(sleep_scenarios(), "was sent after the sleep")


def test_t13_a_lease_without_an_end_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    from drivebus.drives.jog_session import JogSession

    monkeypatch.setattr(JogSession, "_arm", lambda lease, left_s: setattr(lease, "_timer", lease))
    monkeypatch.setattr(JogSession, "renew", lambda lease: None)
    assert reported(sleep_scenarios(), "T13")
