"""Registry of the families that the campaigns cover. ``tests/verification`` compares it with the product's."""

from __future__ import annotations

from functools import cache
from importlib import import_module

from verification.drive_variants import DriveVariant
from verification.families.family_facts import FamilyFacts, models_of

FAMILY_NAMES = ("sunfar", "dzb100", "modbus", "huanyang", "mitsubishi")


@cache
def family_facts() -> dict[str, FamilyFacts]:
    """Return the facts of each family by its name."""
    return {name: import_module(f"verification.families.{name}.facts").FACTS for name in FAMILY_NAMES}


@cache
def facts_by_model() -> dict[str, FamilyFacts]:
    """Return the facts of each model's family."""
    return {model: facts for family in family_facts().values() for model, facts in models_of(family).items()}


DRIVE_VARIANTS: tuple[DriveVariant, ...] = tuple(
    variant for facts in family_facts().values() for variant in facts.variants
)
VARIANTS_BY_NAME = {variant.name: variant for variant in DRIVE_VARIANTS}


def variants_for(campaign: str) -> tuple[DriveVariant, ...]:
    """Return the variants that a campaign covers."""
    return tuple(variant for variant in DRIVE_VARIANTS if campaign not in variant.not_covered_by)
