"""List of the models, as the command line, the API and the page show them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from drivebus.errors import ProfileError
from drivebus.profiles.load import load, models
from drivebus.profiles.model import DriveProfile


def list_models() -> Iterator[dict[str, Any] | ProfileError]:
    """Yield each model that ``load`` accepts by name, or the error of a rejected file of the user.

    Each step loads one file: about 5 ms.
    """
    for name in dict.fromkeys(models()):
        try:
            yield model_summary(name, load(name))
        except ProfileError as error:
            yield error


def models_of_maker(maker: str) -> list[str]:
    """Return the models of a maker, whose name in any language has this word."""
    word = maker.strip().casefold()
    summaries = [summary for summary in list_models() if not isinstance(summary, ProfileError)]
    return [
        summary["model"]
        for summary in summaries
        if word in (part.casefold() for text in summary["maker"].by_language().values() for part in text.split())
    ]


def model_summary(name: str, profile: DriveProfile) -> dict[str, Any]:
    """Return a model; ``name`` is the value of ``--model``, the user's own file may contain the name of its base."""
    return {
        "model": name,
        "title": profile.title,
        "maker": profile.maker,
        "family": profile.family,
        "encodings": list(profile.encodings),
        "serial": {"baud": profile.serial.baud, "format": profile.serial.format},
        "addresses": list(profile.addresses),
        "broadcast": profile.broadcast,
        "grade": profile.grade,
        "capabilities": sorted(profile.capabilities),
    }


def matches_search(summary: dict[str, Any], search: str) -> bool:
    """Return whether model, maker and title, in any language, contain every word of a search."""
    texts = [summary["model"], *(text for name in ("maker", "title") for text in summary[name].by_language().values())]
    joined = " ".join(texts).casefold()
    return all(word in joined for word in search.casefold().split())
