"""Every id of a trap or invariant in use is defined on a page, and no other codes are used."""

from __future__ import annotations

from pathlib import Path

from verification.ids import defined_ids, undefined_codes

ROOT = Path(__file__).resolve().parents[1]


def test_the_pages_define_the_invariants_and_traps() -> None:
    assert {f"I{number}" for number in range(1, 13)} <= defined_ids(ROOT)
    assert {f"T{number:02d}" for number in range(1, 22)} <= defined_ids(ROOT)


def test_every_id_in_use_is_defined_on_a_page() -> None:
    assert undefined_codes(ROOT) == {}
