"""Which pages have generated parts, and what belongs between their marks."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path

from drivebus import profiles
from drivebus.i18n import LANGUAGES
from generator import (
    bus_load,
    cli_reference,
    drives,
    error_reference,
    fault_matrix,
    frames,
    metrics_reference,
    plant_reference,
    profile_tables,
    python_reference,
    rest_reference,
    verification,
)

FAMILIES = ("c320", "dzb100", "vc660", "df800")
PARTS: dict[str, Callable[[profiles.DriveProfile, str], str]] = {
    "line": profile_tables.line,
    "keypad": profile_tables.keypad,
    "signals": profile_tables.signals,
    "parameters": profile_tables.parameters,
    "faults": profile_tables.faults,
    "caveats": profile_tables.caveats,
    "open": profile_tables.open_questions,
    "commands": profile_tables.commands,
    "sisters": drives.sisters,
}


def wanted(root: Path) -> Iterator[tuple[Path, str]]:
    """Every page with its text as it should be."""
    for language in LANGUAGES:
        suffix = "" if language == "en" else f".{language}"
        readme = root / f"README{suffix}.md"
        yield readme, _filled(readme, {"drives": drives.table(language)})
        proof = root / "docs" / "explanation" / f"verification{suffix}.md"
        yield proof, _filled(proof, {"campaigns": verification.campaign_table(root / "docs" / "reports", language)})
        page = root / "docs" / "explanation" / f"fault-matrix{suffix}.md"
        yield page, _filled(page, fault_matrix.page_parts(root, language))
        page = root / "docs" / "explanation" / f"timing{suffix}.md"
        yield page, _filled(page, {"arithmetic": bus_load.bus_load_page(language)})
        page = root / "docs" / "how-to" / f"keypad-settings{suffix}.md"
        yield page, _filled(page, {name: profile_tables.keypad(profiles.load(name), language) for name in FAMILIES})
        reference = root / "docs" / "reference"
        page = reference / f"command-line{suffix}.md"
        yield page, _filled(page, {"verbs": cli_reference.page(language)})
        page = reference / f"errors{suffix}.md"
        yield page, _filled(page, {"errors": error_reference.page(language)})
        page = reference / f"plant-toml{suffix}.md"
        yield page, _filled(page, plant_reference.page(language))
        page = reference / f"rest-api{suffix}.md"
        yield page, _filled(page, rest_reference.parts(language))
        page = reference / f"python{suffix}.md"
        yield page, _filled(page, {"names": python_reference.page(language)})
        page = reference / f"metrics{suffix}.md"
        yield page, _filled(page, metrics_reference.parts(language))
        for model in FAMILIES:
            page = root / "docs" / "protocols" / f"{model}{suffix}.md"
            yield page, _filled(page, _parts(root, model, language))


def _parts(root: Path, model: str, language: str) -> dict[str, str]:
    profile = profiles.load(model)
    vectors = frames.load_vectors(root / "vectors" / f"{model}.jsonl")
    parts = {name: make(profile, language) for name, make in PARTS.items()}
    return parts | {"frames": frames.frame_tables(vectors, language), "errata": frames.errata_table(vectors, language)}


def _filled(page: Path, parts: dict[str, str]) -> str:
    """The page with its marked parts filled. Raises KeyError for a mark that nobody can fill."""
    text = page.read_text(encoding="utf-8")
    pattern = re.compile(r"(<!-- ([a-z0-9]+):begin -->\n).*?(<!-- \2:end -->)", re.DOTALL)
    return pattern.sub(lambda match: f"{match[1]}{parts[match[2]].rstrip()}\n{match[3]}", text)
