"""Every protocol family of the product is registered with the campaigns, and both read its requests alike."""

from __future__ import annotations

from collections.abc import Callable
from random import Random

import pytest

from drivebus.families.huanyang.codec import frame_effect as huanyang_effect
from drivebus.families.mitsubishi.codec import frame_effect as mitsubishi_effect
from drivebus.protocols.codec import Effect
from drivebus.protocols.family import protocol_families
from verification.campaign import CAMPAIGN_NAMES, CampaignRun
from verification.campaigns import fuzz, late
from verification.drive_variants import NOT_YET_COVERED_BY
from verification.families.campaigns import FUZZED_CODECS, campaign_of, family_campaigns
from verification.families.registry import DRIVE_VARIANTS, FAMILY_NAMES, family_facts
from verification.reference.effects import RequestEffect
from verification.reference.request_effects import worst_effect

EFFECTS = {
    Effect.NONE: RequestEffect.READ,
    Effect.SETTING: RequestEffect.SETTING,
    Effect.MOTION: RequestEffect.MOTION,
    Effect.STOP: RequestEffect.STOP,
}


@pytest.mark.parametrize("family", protocol_families(), ids=lambda family: family.name)
def test_each_family_of_the_product_is_registered(family: object) -> None:
    assert getattr(family, "name", "") in FAMILY_NAMES, "add verification/families/<name> and its name to the registry"


def test_the_registry_has_no_other_family() -> None:
    assert {*FAMILY_NAMES} == {family.name for family in protocol_families()}


@pytest.mark.parametrize("name", FAMILY_NAMES)
def test_a_family_has_codecs_of_each_of_its_encodings_and_a_station_of_each_model(name: str) -> None:
    (product,) = (family for family in protocol_families() if family.name == name)
    facts, campaign = family_facts()[name], family_campaigns()[name]
    assert {codec.codec.encoding for codec in campaign.fuzzed_codecs} == set(product.encodings)
    assert {codec.codec.family for codec in campaign.fuzzed_codecs} == {name}
    assert {variant.model for variant in facts.variants} == set(campaign.stations)
    assert campaign.worked_frames or campaign.codecs_of_vectors
    assert {row.codec for row in campaign.strength_cases} <= set(FUZZED_CODECS)


def test_a_variant_leaves_out_only_campaigns_that_exist_and_none_of_the_five() -> None:
    assert set(CAMPAIGN_NAMES) >= NOT_YET_COVERED_BY
    for variant in DRIVE_VARIANTS:
        assert variant.not_covered_by <= NOT_YET_COVERED_BY
        assert not variant.not_covered_by & {"flips", "fuzz", "late", "matrix", "statements"}


def test_a_run_may_be_limited_to_one_family() -> None:
    fuzzed = CampaignRun(campaign="fuzz", seed=1, budget=1000, only=frozenset({"huanyang-rtu"}))
    fuzz.run(fuzzed)
    assert set(fuzzed.figures) == {"huanyang-rtu"} and fuzzed.trials >= 1000
    late_run = CampaignRun(campaign="late", seed=1, budget=20, only=frozenset({"fr-e500"}))
    late.run(late_run)
    assert set(late_run.figures) == {"order", "fr-e500"} and late_run.violations == []


@pytest.mark.parametrize(
    ("model", "codec", "effect_of"),
    [("huanyang_hy", "huanyang-rtu", huanyang_effect), ("fr_e500", "mitsubishi-ascii", mitsubishi_effect)],
)
def test_product_and_reference_agree_on_the_effect_of_a_request(
    model: str, codec: str, effect_of: Callable[[bytes], Effect]
) -> None:
    """Requests as they are sent, and with one byte replaced and the check corrected."""
    rng, entry = Random(model), FUZZED_CODECS[codec]
    assert entry in campaign_of(model).fuzzed_codecs
    seen = set()
    for _ in range(4000):
        frame = bytearray(entry.make_exchange(rng, entry.codec).sent)
        if rng.random() < 0.5:
            frame[rng.randrange(len(frame))] = rng.choice(entry.alphabet)
        data = entry.reference.reseal(bytes(frame))
        assert EFFECTS[effect_of(data)] is worst_effect(model, data), data.hex(" ")
        seen.add(effect_of(data))
    assert seen == set(EFFECTS)
