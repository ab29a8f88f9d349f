"""Reference of the sentences: every text has its place there, and every test that it names exists."""

from __future__ import annotations

from pathlib import Path

from generator import sentences

ROOT = Path(__file__).resolve().parents[1]


def test_every_text_is_in_the_table_or_in_a_group_of_other_texts() -> None:
    assert sentences.unassigned_keys() == [], (
        "add each of these texts to docs/generator/sentences.json with the condition under which it is used, "
        "or to docs/generator/other_texts.json where it states nothing about a drive or a bus"
    )


def test_every_pattern_of_the_table_has_a_text() -> None:
    patterns = {**sentences.CONDITIONS, **sentences.GROUPS}
    keys = sentences.sentence_keys()
    assert len(keys) > 400
    unused = [
        pattern
        for pattern in sentences.CONDITIONS
        if not any(key == pattern or (pattern[-1] == "*" and key.startswith(pattern[:-1])) for key in keys)
    ]
    assert unused == []
    assert {patterns[pattern] for pattern in sentences.GROUPS} == sentences.OTHER_TEXTS.keys()


def test_every_sentence_is_named_by_a_test() -> None:
    """A test that merely uses a sentence does not notice where it is used without its condition."""
    without = [key for key, found in sentences.proofs(ROOT).items() if not found]
    assert without == [], "write a test that plays the case of the sentence and the one beside it, and names its key"


def test_a_text_names_a_sentence_only_if_no_other_sentence_has_it() -> None:
    """A short word, or one of several sentences, proves nothing."""
    assert not sentences.is_wording("stopped")
    assert sentences.is_wording("no reply within")
    assert sentences.is_wording("停机未确认：请现场检查")
