"""The campaign ``late`` finds no violation, follows its seed, and finds planted acceptances of late replies (I5)."""

from __future__ import annotations

from typing import Any

import pytest

from drivebus.bus import core as bus_core
from drivebus.bus.scheduler import Scheduler
from drivebus.bus.station import Station
from drivebus.drives.dialects.modbus import ModbusDialect
from verification.campaign import CampaignRun, run_campaign
from verification.campaigns import late
from verification.drive_variants import DriveVariant
from verification.families.registry import DRIVE_VARIANTS, VARIANTS_BY_NAME

ALL = [pytest.param(variant, id=variant.name) for variant in DRIVE_VARIANTS]


def many_late_replies(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make every fifth reply late, by up to 5 s."""
    monkeypatch.setattr(late, "LATE_SHARES", (0.2,))
    monkeypatch.setattr(late, "LATENESS_STEPS_S", (5.0,))


def run_bus(variant: DriveVariant, frames: int, seed: int = 1) -> tuple[CampaignRun, late.LateReplyBus]:
    campaign_run = CampaignRun(campaign="late", seed=seed, budget=frames)
    found = late.LateReplyBus(campaign_run, variant, variant.name, campaign_run.rng(variant.name))
    found.run_transactions(frames)
    return campaign_run, found


def test_no_late_reply_is_accepted_and_another_seed_gives_other_delays() -> None:
    first, second = (
        run_campaign(late.CAMPAIGN, CampaignRun(campaign="late", seed=seed, budget=200)) for seed in (1, 2)
    )
    assert first.violations == second.violations == [] and first.trials == second.trials == 200
    assert first.digest != second.digest


@pytest.mark.parametrize("variant", ALL)
def test_late_replies_during_newer_requests_are_never_accepted(
    variant: DriveVariant, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Replies later than the model's longest lateness arrive during newer requests and are never accepted."""
    many_late_replies(monkeypatch)
    campaign_run, found = run_bus(variant, 500)
    assert campaign_run.violations == []
    assert found.counts["later than the longest lateness"] > 20
    assert found.counts["later than the longest lateness, accepted"] == 0
    assert found.counts["later than the longest lateness, arrived during a newer request to another station"] > 0
    assert found.counts["in time, accepted"] > 100 and found.counts["from nowhere, accepted"] == 0


@pytest.mark.parametrize("variant", ALL)
def test_a_baseline_host_accepts_wrong_replies(variant: DriveVariant, monkeypatch: pytest.MonkeyPatch) -> None:
    """A host without the product's checks makes mistakes here."""
    many_late_replies(monkeypatch)
    campaign_run = CampaignRun(campaign="late", seed=1, budget=1)
    counts = late.LateReplyBus(campaign_run, variant, variant.name, campaign_run.rng(variant.name)).run_baseline(1500)
    assert counts["misattributed"] > 0
    assert counts["accepted"] > counts["misattributed"]


def never_suspect(self: Scheduler, station: Station, now: float) -> None:
    """Planted fault: a missing reply does not make the station suspect."""


@pytest.mark.parametrize(
    "variant", [pytest.param(k, id=k.name) for k in DRIVE_VARIANTS if k.model in ("vc660", "df800")]
)
def test_a_bus_without_quarantine_and_sync_probe_is_found(
    variant: DriveVariant, monkeypatch: pytest.MonkeyPatch
) -> None:
    many_late_replies(monkeypatch)
    monkeypatch.setattr(Scheduler, "mark_suspect", never_suspect)
    campaign_run, _ = run_bus(variant, 1500)
    assert any("I5" in text for text in campaign_run.violations)
    assert any("wrong reply" in text for text in campaign_run.violations)


@pytest.mark.parametrize("name", ["c320-ascii", "c320-hex", "dzb100"])
def test_a_late_reply_with_the_same_item_is_found(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """An older reply with the same item is a wrong one, also where the reply repeats the item."""
    many_late_replies(monkeypatch)
    monkeypatch.setattr(Scheduler, "mark_suspect", never_suspect)
    variant = VARIANTS_BY_NAME[name]
    monkeypatch.setattr(late, "similar_reads", lambda variant, address: one_question(variant, address))
    campaign_run, _ = run_bus(variant, 6000)
    assert any("wrong reply" in text for text in campaign_run.violations)


ORIGINAL_READS = late.similar_reads


def one_question(variant: DriveVariant, address: int) -> Any:
    return ORIGINAL_READS(variant, address)[1:2]


def test_a_sync_probe_that_equals_a_read_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """The late reply is taken for the sync probe's; many arrive just after the quarantine of 0.2 s."""
    many_late_replies(monkeypatch)
    monkeypatch.setattr(bus_core, "_matches_older_request", lambda transaction: False)
    monkeypatch.setattr(late, "LATENESS_STEPS_S", (0.4,))
    variant = VARIANTS_BY_NAME["vc660"]
    monkeypatch.setattr(
        ModbusDialect, "_bus_sync_request", lambda self, n: late.similar_reads(variant, self.address)[n % 3]
    )
    campaign_run, _ = run_bus(variant, 2000)
    assert any("wrong reply" in text for text in campaign_run.violations)


def test_a_sync_probe_that_accepts_an_older_reply_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """The sync probes of the DF800 differ only in their number of registers, so that only the 5 s between them help."""
    many_late_replies(monkeypatch)
    monkeypatch.setattr(bus_core, "_matches_older_request", lambda transaction: False)
    campaign_run, _ = run_bus(VARIANTS_BY_NAME["df800-rtu"], 2000)
    assert any("wrong reply" in text for text in campaign_run.violations)


@pytest.mark.parametrize(("name", "number"), [("df800-rtu", 10), ("df800-ascii", 13), ("dzb100", 18)])
def test_earlier_acceptances_of_late_replies_are_fixed(name: str, number: int) -> None:
    """Cases of the full campaign's seed 1. DF800: the late reply to a user's read was taken for a sync probe's. DZB100:
    two colliding stations made a digit that no checksum reveals; it is counted separately."""
    campaign_run = CampaignRun(campaign="late", seed=1, budget=10**6)
    variant = VARIANTS_BY_NAME[name]
    found = late.LateReplyBus(campaign_run, variant, f"{name}/{number}", campaign_run.rng(name, number))
    found.run_transactions(late.TRANSACTIONS_PER_CHUNK)
    assert campaign_run.violations == []
    spoilt = found.counts["right reply, damaged by another station's late reply, accepted"]
    assert spoilt == (1 if name == "dzb100" else 0)
