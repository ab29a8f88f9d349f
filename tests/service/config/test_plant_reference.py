"""The reference of plant.toml is complete, and its examples load."""

from __future__ import annotations

import dataclasses
import re
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from drivebus import i18n
from drivebus.service import config

ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="module")
def reference() -> ModuleType:
    sys.path.insert(0, str(ROOT / "docs"))
    try:
        from generator import plant_reference
    finally:
        sys.path.remove(str(ROOT / "docs"))
    return plant_reference


@pytest.mark.parametrize("language", i18n.LANGUAGES)
def test_every_key_has_a_paragraph_and_every_paragraph_a_key(reference: ModuleType, language: str) -> None:
    paths = {f"plant_config.key.{'.'.join(path)}" for path in reference.paths()}
    known = {key for key in i18n.catalogue(language) if key.startswith("plant_config.key.")}
    assert len(paths) > 50 and paths == known


@pytest.mark.parametrize("language", i18n.LANGUAGES)
def test_every_key_stands_on_the_page_with_what_it_means(reference: ModuleType, language: str) -> None:
    suffix = "" if language == "en" else f".{language}"
    page = (ROOT / "docs" / "reference" / f"plant-toml{suffix}.md").read_text(encoding="utf-8")
    for path in reference.paths():
        assert reference.paragraph(path, language) in page, path
        assert f"`{path[-1]}`" in page or f"[{path[0]}.ID" in page or f"`[{path[0]}]`" in page


@pytest.mark.parametrize(("language", "kind"), [("en", "text, or"), ("zh", "文本，或")])
def test_a_title_may_be_a_plain_text(reference: ModuleType, language: str, kind: str) -> None:
    """The schema of a title is that of a table, and the page named no other form."""
    rows = [line for line in reference.page(language)["keys"].splitlines() if line.startswith("| `title` ")]
    assert len(rows) == 6 and all(line.startswith(f"| `title` | {kind} ") for line in rows)


def without_source(value: Any) -> Any:
    """Return a configuration without the path of its file."""
    return dataclasses.replace(value, source="")


def test_both_samples_are_the_same_plant_and_name_every_table_and_key(reference: ModuleType) -> None:
    folder = Path(config.__file__).parent
    english, chinese = (folder / f"sample.{language}.toml" for language in i18n.LANGUAGES)
    assert without_source(config.load(english)) == without_source(config.load(chinese))
    for path in (english, chinese):
        text = path.read_text(encoding="utf-8")
        missing = [path for path in reference.paths() if not re.search(rf"\b{path[-1]}\b", text)]
        assert missing == [("drive", "limits", "forward"), ("gateway", "web", "enabled")]


@pytest.mark.parametrize(
    "page", sorted((ROOT / "docs" / "reference").glob("plant-toml*.md")), ids=lambda page: page.name
)
def test_the_example_on_the_page_loads(page: Path) -> None:
    examples = re.findall(r"^```toml\n(.*?)^```", page.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)
    assert len(examples) == 1
    assert config.loads(examples[0]).id == "boiler-house"


def test_states_and_intervals_on_the_page_are_those_of_the_code() -> None:
    from drivebus.service.config.bus_load import CANDIDATE_INTERVALS_S
    from drivebus.service.config.diff import REPOLL_FIELDS, UPDATE_FIELDS

    for suffix in ("", ".zh"):
        page = (ROOT / "docs" / "reference" / f"plant-toml{suffix}.md").read_text(encoding="utf-8")
        *first, last = [f"{pace:g}" for pace in CANDIDATE_INTERVALS_S]
        assert f"{', '.join(first)} or {last} s" in page or "、".join([*first, f"{last} s"]) in page
        row = next(line for line in page.splitlines() if "`on_client_lost`, " in line or "`on_client_lost`、" in line)
        assert all(f"`{name}`" in row for name in UPDATE_FIELDS)
        assert (
            re.search(r"^\| `signals`[,、] ?`min_poll_interval_s` \|", page, re.MULTILINE)
            and {"signals", "min_poll_interval_s"} == REPOLL_FIELDS
        )
