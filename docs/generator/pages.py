"""Pages with generated parts, the text between their marks, and pages that are generated as a whole."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path

from drivebus import profiles
from drivebus.i18n import LANGUAGES
from generator import (
    bus_load,
    cli_reference,
    command_collisions,
    components,
    drives,
    error_reference,
    fault_matrix,
    frames,
    metrics_reference,
    model_pages,
    plant_reference,
    profile_tables,
    python_reference,
    rest_reference,
    security,
    sentences,
    system_alarms,
    verification,
)
from verification import ids

PROFILE_PARTS: dict[str, Callable[[profiles.DriveProfile, str], str]] = {
    "serial": profile_tables.serial_settings,
    "keypad": profile_tables.keypad,
    "signals": profile_tables.signals,
    "parameters": profile_tables.parameters,
    "faults": profile_tables.faults,
    "caveats": profile_tables.caveats,
    "open": profile_tables.open_questions,
    "commands": profile_tables.commands,
    "models": drives.related_models,
}


def generated_pages(root: Path) -> Iterator[tuple[Path, str]]:
    """Yield every page with generated parts and its up-to-date text, in which each id links to its definition.

    The list of components is the last.
    """
    for language in LANGUAGES:
        definitions = ids.definitions(root, language)
        for page, text in _filled_pages(root, language):
            yield page, ids.link_ids(text, page, definitions)
    yield root / components.FILE, components.page(root)


def _filled_pages(root: Path, language: str) -> Iterator[tuple[Path, str]]:
    suffix = "" if language == "en" else f".{language}"
    readme = root / f"README{suffix}.md"
    yield readme, _fill_marks(readme, {"drives": drives.makers_table(language)})
    for name, parts in _parts_of_pages(root, language):
        page = root / "docs" / f"{name}{suffix}.md"
        yield page, _fill_marks(page, parts)
    shipped = drives.shipped()
    for profile in shipped:
        yield root / model_pages.FOLDER / f"{profile.model}{suffix}.md", model_pages.page(profile, language)
    yield root / model_pages.FOLDER / f"README{suffix}.md", model_pages.index(shipped, language)


def _parts_of_pages(root: Path, language: str) -> Iterator[tuple[str, dict[str, str]]]:
    """Yield the path of each page below ``docs``, without its ending, and its generated parts by mark."""
    yield "explanation/alarms", {"system": system_alarms.system_alarms(language)}
    yield "explanation/verification", {"campaigns": verification.campaign_table(root / "docs" / "reports", language)}
    yield "explanation/bus-stop", {"collisions": command_collisions.collision_table(language)}
    yield "explanation/fault-matrix", fault_matrix.page_parts(root, language)
    yield (
        "explanation/security",
        {name: security.requirements(name, language) for name in ("asvs", "iec62443")}
        | {"attacks": security.attacks(language)},
    )
    yield "explanation/timing", {"load": bus_load.bus_load_table(language)}
    yield (
        "how-to/keypad-settings",
        {name: profile_tables.keypad(profiles.load(name), language) for name in drives.MODELS_WITH_PAGE},
    )
    yield "reference/command-line", {"commands": cli_reference.page(language)}
    yield "reference/errors", {"errors": error_reference.page(language)}
    yield "reference/sentences", sentences.parts(root, language)
    yield "reference/plant-toml", plant_reference.page(language)
    yield "reference/rest-api", rest_reference.parts(language)
    yield "reference/python", {"names": python_reference.page(language)}
    yield "reference/metrics", metrics_reference.parts(language)
    for model in drives.MODELS_WITH_PAGE:
        yield f"protocols/{model}", _protocol_page_parts(root, model, language)


def _protocol_page_parts(root: Path, model: str, language: str) -> dict[str, str]:
    profile = profiles.load(model)
    vectors = frames.load_vectors(root / "vectors" / f"{model}.jsonl")
    parts = {name: make(profile, language) for name, make in PROFILE_PARTS.items()}
    return parts | {"frames": frames.frame_tables(vectors, language), "errata": frames.errata_table(vectors, language)}


def _fill_marks(page: Path, parts: dict[str, str]) -> str:
    """Return the page with its marked parts replaced. Raises KeyError for a mark without a part."""
    text = page.read_text(encoding="utf-8")
    pattern = re.compile(r"(<!-- ([a-z0-9]+):begin -->\n).*?(<!-- \2:end -->)", re.DOTALL)
    return pattern.sub(lambda match: f"{match[1]}{parts[match[2]].rstrip()}\n{match[3]}", text)
