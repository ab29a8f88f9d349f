"""Every id of a trap or invariant in use is defined on a page and linked or explained, and no other codes are used."""

from __future__ import annotations

from pathlib import Path

from verification.ids import (
    SUFFIXES,
    definitions,
    link_ids,
    searched_files,
    undefined_codes,
    unexplained_uses,
    unlinked_pages,
)

ROOT = Path(__file__).resolve().parents[1]


def test_the_pages_of_both_languages_define_the_invariants_and_traps() -> None:
    ids = {f"I{number}" for number in range(1, 13)} | {f"T{number:02d}" for number in range(1, 22)}
    assert definitions(ROOT).keys() == definitions(ROOT, "zh").keys() == ids


def test_every_id_in_use_is_defined_on_a_page() -> None:
    assert undefined_codes(ROOT) == {}


def test_every_kind_of_text_is_searched() -> None:
    searched = {path.relative_to(ROOT).as_posix() for path in searched_files(ROOT)}
    expected = {
        "README.md",
        "pyproject.toml",
        "Makefile",
        "examples/one_pump.py",
        "vectors/c320.jsonl",
        "tests/test_ids.py",
    }
    assert expected <= searched
    assert any(name.startswith("src/") and name.endswith(".toml") for name in searched)
    assert ".mjs" in SUFFIXES


def test_every_id_on_a_page_links_to_its_definition() -> None:
    assert unlinked_pages(ROOT) == []


def test_every_id_in_a_comment_stands_beside_its_reason() -> None:
    assert unexplained_uses(ROOT) == []


def test_an_id_is_linked_once_and_not_in_code_or_in_its_definition() -> None:
    page, pages = ROOT / "docs" / "how-to" / "a.md", {"T11": ROOT / "docs" / "protocols" / "dzb100.md"}
    text = 'a stop (T11), `T11`, <a id="t11"></a>**T11**\n```\nT11\n```\nT12'
    linked = link_ids(text, page, pages)
    assert linked == text.replace("(T11)", "([T11](../protocols/dzb100.md#t11))")
    assert link_ids(linked, page, pages) == linked
    assert link_ids("T11", pages["T11"], pages) == "[T11](#t11)"


def test_a_comment_with_a_bare_id_is_found(tmp_path: Path) -> None:
    (tmp_path / "src").mkdir()
    (tmp_path / "src" / "a.py").write_text("a = 1  # T11\nb = 2  # a stop carries 0000 (T11)\n", encoding="utf-8")
    assert unexplained_uses(tmp_path) == ["src/a.py:1"]
