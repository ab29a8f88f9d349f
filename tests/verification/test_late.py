"""The campaign ``late`` runs clean, repeats itself, and finds each planted way to believe a late reply (I5)."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import Any

import pytest

from drivebus.bus import core as bus_core
from drivebus.bus.core import BusCore
from drivebus.bus.station import Station
from drivebus.drives.dialects.modbus import ModbusDialect
from verification.campaign import CampaignRun, run_campaign
from verification.campaigns import late
from verification.drive_variants import DRIVE_VARIANTS, VARIANTS_BY_NAME, DriveVariant

ALL = [pytest.param(kind, id=kind.name) for kind in DRIVE_VARIANTS]


def many_late_replies(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every fifth reply is late, by up to 5 s."""
    monkeypatch.setattr(late, "LATE_SHARES", (0.2,))
    monkeypatch.setattr(late, "LATENESS_STEPS_S", (5.0,))


def run_bus(kind: DriveVariant, frames: int, seed: int = 1) -> tuple[CampaignRun, late.LateReplyBus]:
    session = CampaignRun("late", seed, frames)
    found = late.LateReplyBus(session, kind, kind.name, session.rng(kind.name))
    found.run_transactions(frames)
    return session, found


def test_no_late_reply_is_believed_and_the_same_seed_is_the_same_run() -> None:
    first, second = (run_campaign(late.CAMPAIGN, CampaignRun("late", 1, 200)) for _ in range(2))
    assert first.violations == [] and first.trials == 200
    assert first.digest == second.digest
    assert first.digest != run_campaign(late.CAMPAIGN, CampaignRun("late", 2, 200)).digest


def test_the_run_does_not_hang_on_the_order_of_hashes() -> None:
    code = (
        "from verification.campaign import CampaignRun, run_campaign\n"
        "from verification.campaigns.late import CAMPAIGN\n"
        "print(run_campaign(CAMPAIGN, CampaignRun('late', 5, 100)).digest)"
    )
    digests = {
        subprocess.run(
            [sys.executable, "-c", code], env={**os.environ, "PYTHONHASHSEED": seed}, capture_output=True, check=True
        ).stdout
        for seed in ("1", "2")
    }
    assert len(digests) == 1


@pytest.mark.parametrize("kind", ALL)
def test_late_replies_meet_other_questions_and_none_is_believed(
    kind: DriveVariant, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What came later than the family's longest lateness was believed by nobody, though it met questions."""
    many_late_replies(monkeypatch)
    session, found = run_bus(kind, 500)
    assert session.violations == []
    assert found.counts["later than the longest lateness"] > 20
    assert found.counts["later than the longest lateness, believed"] == 0
    assert found.counts["later than the longest lateness, met a newer question to another station"] > 0
    assert found.counts["in time, believed"] > 100 and found.counts["from nowhere, believed"] == 0


@pytest.mark.parametrize("kind", ALL)
def test_a_naive_host_misattributes_on_the_same_line(kind: DriveVariant, monkeypatch: pytest.MonkeyPatch) -> None:
    """The campaign can fail."""
    many_late_replies(monkeypatch)
    session = CampaignRun("late", 1, 1)
    counts = late.LateReplyBus(session, kind, kind.name, session.rng(kind.name)).run_baseline(1500)
    assert counts["misattributed"] > 0
    assert counts["believed"] > counts["misattributed"]


def never_suspect(self: BusCore, station: Station, now: float) -> None:
    """A planted fault: a reply that did not come leaves no doubt."""


@pytest.mark.parametrize("kind", [pytest.param(k, id=k.name) for k in DRIVE_VARIANTS if k.model in ("vc660", "df800")])
def test_a_bus_without_quarantine_and_fence_is_found(kind: DriveVariant, monkeypatch: pytest.MonkeyPatch) -> None:
    many_late_replies(monkeypatch)
    monkeypatch.setattr(BusCore, "_mark_suspect", never_suspect)
    session, _ = run_bus(kind, 1500)
    assert any("I5" in text for text in session.violations)
    assert any("G04" in text for text in session.violations)


@pytest.mark.parametrize("name", ["c320-ascii", "c320-hex", "dzb100"])
def test_the_same_item_is_no_excuse(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the reply repeats the item, an older sample of the same item is still another answer."""
    many_late_replies(monkeypatch)
    monkeypatch.setattr(BusCore, "_mark_suspect", never_suspect)
    kind = VARIANTS_BY_NAME[name]
    monkeypatch.setattr(late, "similar_reads", lambda kind, address: one_question(kind, address))
    session, _ = run_bus(kind, 6000)
    assert any("G04" in text for text in session.violations)


ORIGINAL_READS = late.similar_reads


def one_question(kind: DriveVariant, address: int) -> Any:
    return ORIGINAL_READS(kind, address)[1:2]


def test_a_fence_that_looks_like_a_question_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """The late answer passes for the fence's. Many come just after the quarantine of 0.2 s."""
    many_late_replies(monkeypatch)
    monkeypatch.setattr(bus_core, "_matches_older_request", lambda flight: False)
    monkeypatch.setattr(late, "LATENESS_STEPS_S", (0.4,))
    kind = VARIANTS_BY_NAME["vc660"]
    monkeypatch.setattr(
        ModbusDialect, "_bus_sync_request", lambda self, n: late.similar_reads(kind, self.address)[n % 3]
    )
    session, _ = run_bus(kind, 2000)
    assert any("G04" in text for text in session.violations)


def test_a_fence_that_believes_an_older_answer_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """DF800's fences differ in nothing but their number of registers: only the 5 s between them help."""
    many_late_replies(monkeypatch)
    monkeypatch.setattr(bus_core, "_matches_older_request", lambda flight: False)
    session, _ = run_bus(VARIANTS_BY_NAME["df800-rtu"], 2000)
    assert any("G04" in text for text in session.violations)


@pytest.mark.parametrize(("name", "number"), [("df800-rtu", 10), ("df800-ascii", 13), ("dzb100", 18)])
def test_lines_that_once_believed_a_late_answer_do_so_no_more(name: str, number: int) -> None:
    """From the full campaign's seed 1. DF800: the late answer to a user's read passed for a fence's. DZB100: two
    stations at once make a digit that no check value tells; it is counted apart, and only there."""
    session = CampaignRun("late", 1, 10**6)
    kind = VARIANTS_BY_NAME[name]
    found = late.LateReplyBus(session, kind, f"{name}/{number}", session.rng(name, number))
    found.run_transactions(late.TRANSACTIONS_PER_CHUNK)
    assert session.violations == []
    spoilt = found.counts["the right answer, spoilt by another station's late one, believed"]
    assert spoilt == (1 if name == "dzb100" else 0)
