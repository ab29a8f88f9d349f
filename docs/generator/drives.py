"""Tables of drives: by maker for the README, all models for their index, the related models for a protocol page."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cache

from drivebus import i18n, profiles
from drivebus.profiles import DriveProfile
from generator import terms
from generator.terms import CAPABILITIES, GRADES, localized, term

MODELS_WITH_PAGE = ("c320", "dzb100", "vc660", "df800")


@cache
def shipped() -> tuple[DriveProfile, ...]:
    """Return the built-in profiles, without those of the user, by maker.

    The makers of the models with a protocol page come first, and these models first among those of their maker.
    """
    package = profiles.load("c320").source.rsplit("/", 4)[0]
    found = [profile for profile in map(profiles.load, profiles.models()) if profile.source.startswith(package)]
    makers = [profiles.load(name).maker.en for name in MODELS_WITH_PAGE]

    def place(profile: DriveProfile) -> tuple[int, str, bool, str]:
        maker = profile.maker.en
        rank = makers.index(maker) if maker in makers else len(makers)
        return rank, maker, profile.model not in MODELS_WITH_PAGE, profile.model

    return tuple(sorted(found, key=place))


def makers_table(language: str) -> str:
    """Return the table of the makers, with their models by grade."""
    grades = [grade for grade in reversed(GRADES) if any(profile.grade == grade for profile in shipped())]
    by_maker: dict[str, dict[str, list[str]]] = {}
    for profile in shipped():
        models = by_maker.setdefault(localized(profile.maker, language), {grade: [] for grade in grades})
        models[profile.grade].append(model_link(profile, language, "docs/reference/models/"))
    heads = [term("maker", language), *(localized(GRADES[grade], language) for grade in grades)]
    rows = (
        [maker, *(i18n.join(models[grade], "items", language) for grade in grades)]
        for maker, models in by_maker.items()
    )
    return terms.table(heads, rows)


def models_table(found: Iterable[DriveProfile], language: str, link: Callable[[DriveProfile], str]) -> str:
    """Return the table of models with what distinguishes them; ``link`` makes the first cell of a row."""
    heads = ("model", "maker", "encodings", "line", "addresses", "lacks", "grade")
    return terms.table(
        [term(head, language) for head in heads], (_row(profile, language, link(profile)) for profile in found)
    )


def model_link(profile: DriveProfile, language: str, folder: str) -> str:
    """Return the name of a model with a link to its page in ``folder``."""
    suffix = "" if language == "en" else f".{language}"
    return f"[`{profile.model}`]({folder}{profile.model}{suffix}.md)"


def related_models(profile: DriveProfile, language: str) -> str:
    """Return the table of a profile and of the models that share its maker's protocol; Modbus is no such protocol."""
    is_shared = profile.family != "modbus"
    same = (other for other in shipped() if other is profile or (is_shared and other.family == profile.family))
    return models_table(same, language, lambda other: f"`{other.model}`")


def _row(profile: DriveProfile, language: str, model: str) -> list[str]:
    lacking = [localized(text, language) for what, text in CAPABILITIES.items() if what not in profile.capabilities]
    low, high = profile.addresses
    return [
        model,
        localized(profile.maker, language),
        i18n.join(profile.encodings, "items", language),
        f"{profile.serial.baud} {profile.serial.format}",
        f"{low}–{high}",
        i18n.join(lacking, "items", language) or "–",
        localized(GRADES[profile.grade], language),
    ]
