"""Evidence of a fact: its kind and source, with the page numbers of an English source in the other languages."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, cast

from drivebus import i18n
from drivebus.profiles.model import Evidence
from drivebus.profiles.schema import evidence_kind
from drivebus.values import Text

_PAGE = r"(?:[A-Z]-|App)?\d+(?:[.-]\d+)*(?!\w)"
_LIST = rf"{_PAGE}(?:(?:, | and | to ){_PAGE})*"
_PAGES = re.compile(rf"(?P<manual>\bmanual )?\b(?:page (?P<page>{_PAGE})|pages (?P<pages>{_LIST}))(?P<colon>: )?")


def parse_evidence(lines: Mapping[str, str]) -> Evidence:
    """Return kind and source of lines such as ``manual §4.2``, one for each language."""
    kind = evidence_kind(next(iter(lines.values())))
    sources = {language: line.partition(" ")[2] for language, line in lines.items()}
    if "en" in sources:
        sources = {language: translate_pages(sources["en"], language) for language in i18n.LANGUAGES} | sources
    return Evidence(cast("Any", kind), Text.from_mapping(sources))


def translate_pages(source: str, language: str) -> str:
    """Return an English source with its mentions of pages, such as "manual pages 3 and 4", in ``language``."""
    return source if language == "en" else _PAGES.sub(lambda match: _pages(match, language), source)


def _pages(match: re.Match[str], language: str) -> str:
    listed = (match["page"] or match["pages"]).replace(" to ", i18n.text("profiles.pages_to", language))
    numbers = i18n.join(re.split(", | and ", listed), "items", language)
    key = "profiles.manual_pages" if match["manual"] else "profiles.pages"
    return i18n.text(key, language, pages=numbers) + (
        i18n.text("profiles.pages_colon", language) if match["colon"] else ""
    )
