"""The campaign ``clock`` runs clean, repeats itself, and finds planted ways to live by the wall clock (G15, F21)."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from drivebus import seams
from drivebus.bus import Bus
from drivebus.drives import gate, shell
from drivebus.drives.operation import Talk
from drivebus.drives.talk import look
from drivebus.drives.wear import Count, Wear
from drivebus.lab.breaking.asleep import Night
from drivebus.lab.breaking.wallclock import JUMPS_S, WallClock, before_midnight, installed, readers
from drivebus.lab.campaign import Session, perform
from drivebus.lab.campaigns import clock
from drivebus.lab.kinds import BY_NAME, KINDS
from drivebus.lab.report import PACKAGE

NAMES = list(JUMPS_S)


def campaign(jumps: int = 20, seed: int = 3) -> Session:
    return perform(clock.CAMPAIGN, Session("clock", seed, jumps))


def told(session: Session, what: str) -> bool:
    return any(what in text for text in session.violations)


def test_no_jump_changes_anything_and_the_same_seed_is_the_same_run() -> None:
    first, second = campaign(), campaign()
    assert first.violations == [] and first.trials == 20
    assert first.digest == second.digest != campaign(20, 4).digest
    assert first.counts["samples"] > 100 and first.counts["frames"] > 100


def test_f21_one_door_leads_to_the_wall_clock() -> None:
    assert readers(PACKAGE) == clock.DOOR


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
def test_f21_another_door_would_be_seen(tmp_path: Path, line: str) -> None:
    (tmp_path / "bus").mkdir()
    (tmp_path / "bus" / "x.py").write_text(line)
    assert {file for file, _ in readers(tmp_path)} == {"bus/x.py"}


def test_the_clock_jumps_and_afterwards_all_is_as_before() -> None:
    plain, wall = time.time, seams.wall_clock
    passed = 0.0
    with installed(WallClock(before_midnight(2.0), lambda: passed)) as fake:
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
    session = Session("clock", 1, 1, listener=lines.append)
    clock.twice(session, BY_NAME["vc660"], 0, ["+1 h", "-1 h"] * 30, Path())
    assert any(line.startswith("VIOLATION G15") for line in lines)


def test_a_label_that_reaches_the_records_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    plain = clock.CapturingPort._event

    def labelled(port: Any, name: str, **details: object) -> None:
        plain(port, name, at=seams.wall_clock().isoformat(), **details)

    monkeypatch.setattr(clock.CapturingPort, "_event", labelled)
    assert told(campaign(10), "the captures differ")


def test_samples_that_go_back_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """A reading timed by a wall clock that was set back."""
    plain = clock.Life._sample

    def timed(life: Any, address: int, name: str, reading: Any) -> None:
        moved = life.clock._moved.total_seconds()
        plain(life, address, name, replace(reading, source_time=reading.source_time + moved))

    monkeypatch.setattr(clock.Life, "_sample", timed)
    session = Session("clock", 1, 10)
    clock.twice(session, BY_NAME["vc660"], 0, ["-1 s", "+1 s"] * 5, Path())
    assert told(session, "G15 output_frequency") or told(session, "came after one at")


@pytest.fixture(autouse=True)
def _somewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_g16_the_budget_holds_under_every_jump_and_is_given_again_on_a_later_day() -> None:
    session = budget()
    assert session.violations == []
    assert session.counts["write: confirmed"] > clock.SAVES_A_DAY and session.counts["write: WearBudget"] > 0


def test_g16_a_budget_that_a_clock_set_back_renews_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    def forgetful(wear: Wear, notation: str, day: str) -> Any:
        def one_more(old: Count) -> Count:
            today = old.today if day == old.day else 0
            if today >= wear.budget:
                raise clock_error()
            return Count(day, today + 1, old.total + 1)

        yield from wear._change(notation, one_more)

    monkeypatch.setattr(Wear, "charge", forgetful)
    assert told(budget(), "G16")


def clock_error() -> Exception:
    from drivebus.errors import WearBudget

    return WearBudget("drives.wear_budget", notation="", count=0, budget=0)


def test_g16_a_budget_that_is_never_given_again_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shell, "_today", lambda: "2026-01-01")
    assert told(budget(), "G16")


def budget() -> Session:
    session = Session("clock", 1, 1)
    clock.Budget(session, KINDS[0], "budget", session.rng("budget")).draw(NAMES)
    return session


def nights(count: int = 6) -> Session:
    session = Session("clock", 1, count)
    for number in range(count):
        Night(session, BY_NAME["vc660"], f"night {number}", session.rng("night", number)).play()
    return session


def test_6_6_what_is_queued_over_a_sleep_expires_and_stops_go() -> None:
    session = nights()
    assert session.violations == []
    assert sum(amount for name, amount in session.counts.items() if name.endswith(": Expired")) > 3
    assert session.counts["stop: confirmed"] > 1 and session.counts["leases lost over the sleep"] > 1


def test_6_6_a_command_that_does_not_age_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    def whenever(talk: Talk) -> Any:
        around = yield from look()
        return around

    monkeypatch.setattr(Talk, "in_time", whenever)
    assert told(nights(), "was sent after the sleep")


def test_6_6_a_queue_that_does_not_age_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    ages = dict.fromkeys(gate.EXPIRY_S, 1e6)
    monkeypatch.setattr(gate, "EXPIRY_S", ages)
    monkeypatch.setattr("drivebus.drives.operation.PREPARE_S", 1e6)
    assert told(nights(), "was sent after the sleep")


def test_t13_a_lease_without_an_end_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    from drivebus.drives.lease import JogLease

    monkeypatch.setattr(JogLease, "_arm", lambda lease, left_s: setattr(lease, "_timer", lease))
    monkeypatch.setattr(JogLease, "renew", lambda lease: None)
    assert told(nights(), "T13")
