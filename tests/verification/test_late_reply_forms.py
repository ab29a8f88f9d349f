"""Late replies of drives whose replies deviate from the standard: none is accepted, by the oracle of ``late``."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from drivebus.drives.dialects.modbus import ModbusDialect
from drivebus.protocols.modbus import ReadRegisters
from verification.campaign import CampaignRun
from verification.campaigns import late
from verification.drive_variants import DriveVariant
from verification.families.modbus.facts import DF800
from verification.families.registry import facts_by_model, family_facts

OTHERS = replace(DF800, drive_options={}, min_timeout_s=0.04, min_timeout_characters=0)
"""Like a DF800 the others read no state here, and their sync probes are alike."""
REGISTERS = {"vf_s11": (0xFD00, 0xFD01, 0xFE03), "huanyang_h2a": (0x3000, 0x700C, 0x700D, 0xB005)}


@pytest.fixture(params=["vf_s11", "huanyang_h2a"], name="variant")
def late_variant(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> DriveVariant:
    """Return a variant of the campaign, every fifth reply of which is late by up to 5 s."""
    model: str = request.param
    monkeypatch.setitem(facts_by_model(), model, family_facts()["modbus"])  # type: ignore[arg-type]
    monkeypatch.setattr(late, "similar_reads", reads)
    monkeypatch.setattr(late, "LATE_SHARES", (0.2,))
    monkeypatch.setattr(late, "LATENESS_STEPS_S", (5.0,))
    return replace(OTHERS, name=model, model=model, baud=9600 if model == "vf_s11" else 19200)


def reads(variant: DriveVariant, address: int) -> tuple[Any, ...]:
    return tuple(ReadRegisters(address, register, 1) for register in REGISTERS[variant.model])


def played(variant: DriveVariant, frames: int) -> tuple[CampaignRun, late.LateReplyBus]:
    campaign_run = CampaignRun(campaign="late", seed=1, budget=frames)
    found = late.LateReplyBus(campaign_run, variant, variant.name, campaign_run.rng(variant.name))
    found.run_transactions(frames)
    return campaign_run, found


def test_no_late_reply_is_accepted_for_a_newer_request(variant: DriveVariant) -> None:
    campaign_run, found = played(variant, 1500)
    assert campaign_run.violations == []
    assert found.counts["in time, accepted"] > 500 and found.counts["later than the longest lateness"] > 20
    assert found.counts["later than the longest lateness, arrived during a newer request to another station"] > 0
    assert found.counts["later than the longest lateness, accepted"] == found.counts["from nowhere, accepted"] == 0


def test_a_sync_probe_that_equals_a_read_is_found(variant: DriveVariant, monkeypatch: pytest.MonkeyPatch) -> None:
    """The oracle is no weaker here than with the drives of the campaign."""
    monkeypatch.setattr("drivebus.bus.core._matches_older_request", lambda transaction: False)
    monkeypatch.setattr(ModbusDialect, "_bus_sync_request", lambda self, n: reads(variant, self.address)[n % 3])
    campaign_run, _ = played(variant, 3000)
    assert any("wrong reply" in text for text in campaign_run.violations)
