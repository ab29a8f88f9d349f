"""The campaign ``late`` runs clean, repeats itself, and finds each planted way to believe a late reply (G04, I5)."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import Any

import pytest

from drivebus.bus import aftermath
from drivebus.bus.stations import Station
from drivebus.drives.modbus import ModbusDialect
from drivebus.lab.campaign import Session, perform
from drivebus.lab.campaigns import late
from drivebus.lab.kinds import BY_NAME, KINDS, Kind

ALL = [pytest.param(kind, id=kind.name) for kind in KINDS]


def hard(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every fifth reply is late, by up to 5 s."""
    monkeypatch.setattr(late, "SHARES", (0.2,))
    monkeypatch.setattr(late, "LATENESS_S", (5.0,))


def line(kind: Kind, frames: int, seed: int = 1) -> tuple[Session, late.Line]:
    session = Session("late", seed, frames)
    found = late.Line(session, kind, kind.name, session.rng(kind.name))
    found.do(frames)
    return session, found


def test_no_late_reply_is_believed_and_the_same_seed_is_the_same_run() -> None:
    first, second = (perform(late.CAMPAIGN, Session("late", 1, 200)) for _ in range(2))
    assert first.violations == [] and first.trials == 200
    assert first.digest == second.digest
    assert first.digest != perform(late.CAMPAIGN, Session("late", 2, 200)).digest


def test_the_run_does_not_hang_on_the_order_of_hashes() -> None:
    code = (
        "from drivebus.lab.campaign import Session, perform\n"
        "from drivebus.lab.campaigns.late import CAMPAIGN\n"
        "print(perform(CAMPAIGN, Session('late', 5, 100)).digest)"
    )
    digests = {
        subprocess.run(
            [sys.executable, "-c", code], env={**os.environ, "PYTHONHASHSEED": seed}, capture_output=True, check=True
        ).stdout
        for seed in ("1", "2")
    }
    assert len(digests) == 1


@pytest.mark.parametrize("kind", ALL)
def test_late_replies_meet_other_questions_and_none_is_believed(kind: Kind, monkeypatch: pytest.MonkeyPatch) -> None:
    """G04: what came later than the family's longest lateness was believed by nobody, though it met questions."""
    hard(monkeypatch)
    session, found = line(kind, 500)
    assert session.violations == []
    assert found.counts["later than the longest lateness"] > 20
    assert found.counts["later than the longest lateness, believed"] == 0
    assert found.counts["later than the longest lateness, met a newer question to another station"] > 0
    assert found.counts["in time, believed"] > 100 and found.counts["from nowhere, believed"] == 0


@pytest.mark.parametrize("kind", ALL)
def test_a_naive_host_misattributes_on_the_same_line(kind: Kind, monkeypatch: pytest.MonkeyPatch) -> None:
    """F01: the campaign can fail."""
    hard(monkeypatch)
    session = Session("late", 1, 1)
    counts = late.Line(session, kind, kind.name, session.rng(kind.name)).do_naively(1500)
    assert counts["misattributed"] > 0
    assert counts["believed"] > counts["misattributed"]


def trust(self: Station, now: float) -> None:
    """A planted fault: a reply that did not come leaves no doubt."""


@pytest.mark.parametrize("kind", [pytest.param(k, id=k.name) for k in KINDS if k.model in ("vc660", "df800")])
def test_a_bus_without_quarantine_and_fence_is_found(kind: Kind, monkeypatch: pytest.MonkeyPatch) -> None:
    hard(monkeypatch)
    monkeypatch.setattr(Station, "doubt", trust)
    session, _ = line(kind, 1500)
    assert any("I5" in text for text in session.violations)
    assert any("G04" in text for text in session.violations)


@pytest.mark.parametrize("name", ["c320-ascii", "c320-hex", "dzb100"])
def test_the_same_item_is_no_excuse(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ruling 3: where the reply repeats the item, an older sample of the same item is still another answer."""
    hard(monkeypatch)
    monkeypatch.setattr(Station, "doubt", trust)
    kind = BY_NAME[name]
    monkeypatch.setattr(late, "questions", lambda kind, address: one_question(kind, address))
    session, _ = line(kind, 2000)
    assert any("G04" in text for text in session.violations)


ASKED = late.questions


def one_question(kind: Kind, address: int) -> Any:
    return ASKED(kind, address)[1:2]


def test_a_fence_that_looks_like_a_question_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ruling 2: the late answer passes for the fence's. Many come just after the quarantine of 0.2 s."""
    hard(monkeypatch)
    monkeypatch.setattr(aftermath, "_fits_older", lambda flight: False)
    monkeypatch.setattr(late, "LATENESS_S", (0.4,))
    kind = BY_NAME["vc660"]
    monkeypatch.setattr(ModbusDialect, "_bus_fence", lambda self, n: late.questions(kind, self.address)[n % 3])
    session, _ = line(kind, 2000)
    assert any("G04" in text for text in session.violations)


def test_a_fence_that_believes_an_older_answer_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """DF800's fences differ in nothing but their number of registers: only the 5 s between them help (ruling 2)."""
    hard(monkeypatch)
    monkeypatch.setattr(aftermath, "_fits_older", lambda flight: False)
    session, _ = line(BY_NAME["df800-rtu"], 2000)
    assert any("G04" in text for text in session.violations)


@pytest.mark.parametrize(("name", "number"), [("df800-rtu", 10), ("df800-ascii", 13), ("dzb100", 18)])
def test_lines_that_once_believed_a_late_answer_do_so_no_more(name: str, number: int) -> None:
    """From the full campaign's seed 1. DF800: the late answer to a user's read passed for a fence's. DZB100: two
    stations at once make a digit that no check value tells; it is counted apart, and only there."""
    session = Session("late", 1, 10**6)
    kind = BY_NAME[name]
    found = late.Line(session, kind, f"{name}/{number}", session.rng(name, number))
    found.do(late.CHUNK)
    assert session.violations == []
    spoilt = found.counts["the right answer, spoilt by another station's late one, believed"]
    assert spoilt == (1 if name == "dzb100" else 0)
