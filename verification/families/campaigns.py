"""Registry of the campaigns' codecs, frames and stations, by family."""

from __future__ import annotations

from functools import cache
from importlib import import_module

from verification.families.family_campaign import FamilyCampaign, WrittenParameter
from verification.families.registry import FAMILY_NAMES, facts_by_model, family_facts


@cache
def family_campaigns() -> dict[str, FamilyCampaign]:
    """Return what the campaigns need of each family, by its name."""
    return {name: import_module(f"verification.families.{name}.campaign").CAMPAIGN for name in FAMILY_NAMES}


@cache
def campaign_of(model: str) -> FamilyCampaign:
    """Return what the campaigns need of a model's family. Raises KeyError."""
    facts = facts_by_model()[model]
    return next(family_campaigns()[name] for name, candidate in family_facts().items() if candidate is facts)


def written_parameter(model: str) -> WrittenParameter:
    """Return the parameter of a model that campaigns write. Raises KeyError where they write none."""
    return campaign_of(model).written_parameters[model]


FUZZED_CODECS = {codec.name: codec for campaign in family_campaigns().values() for codec in campaign.fuzzed_codecs}
"""Every codec that ``fuzz`` and ``flips`` cover, by its name."""
