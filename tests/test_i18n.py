"""The catalogues: the same keys and places in every language, one owner a key, and every key that the code names."""

from __future__ import annotations

import ast
import io
import json
import re
import string
from collections.abc import Iterator
from itertools import combinations
from pathlib import Path
from typing import Any

import pytest

from drivebus import errors, i18n
from drivebus.service.api.operations import OPERATIONS

SOURCE = Path(i18n.__file__).parents[1]
CATALOGUES = Path(i18n.__file__).parent
ROOMS = sorted({path.name.split(".")[0] for path in CATALOGUES.glob("*.json")})
FILES = {"db", "json", "jsonl", "lock", "sock", "toml"}
KEY = re.compile(r"[a-z][a-z0-9_]*(?:\.[a-z0-9][a-z0-9_]*)+")


def sentences(room: str, language: str) -> dict[str, str]:
    """A catalogue. A key that stands twice in one file would hide a sentence: refused."""
    pairs: list[tuple[str, str]] = json.loads(
        (CATALOGUES / f"{room}.{language}.json").read_text(encoding="utf-8"), object_pairs_hook=list
    )
    keys = [key for key, _ in pairs]
    assert len(keys) == len(set(keys)), {key for key in keys if keys.count(key) > 1}
    return dict(pairs)


def places(sentence: str) -> set[str]:
    return {name for _, name, _, _ in string.Formatter().parse(sentence) if name is not None}


def has_chinese(sentence: str) -> bool:
    return any("一" <= character <= "鿿" for character in sentence)


def test_there_is_no_catalogue_in_a_language_that_nobody_offers() -> None:
    assert {path.name.split(".")[1] for path in CATALOGUES.glob("*.json")} == set(i18n.LANGUAGES)


@pytest.mark.parametrize("room", ROOMS)
def test_a_room_has_the_same_keys_in_every_language(room: str) -> None:
    assert sentences(room, "en").keys() == sentences(room, "zh").keys()


@pytest.mark.parametrize("room", ROOMS)
def test_a_sentence_has_the_same_places_in_every_language(room: str) -> None:
    english, chinese = sentences(room, "en"), sentences(room, "zh")
    different = {key for key in english if places(english[key]) != places(chinese.get(key, ""))}
    assert not different


@pytest.mark.parametrize("room", ROOMS)
def test_no_sentence_is_empty_and_english_has_no_chinese(room: str) -> None:
    english, chinese = sentences(room, "en"), sentences(room, "zh")
    assert not [key for key, sentence in [*english.items(), *chinese.items()] if not sentence.strip()]
    assert not [key for key, sentence in english.items() if has_chinese(sentence)]


@pytest.mark.parametrize("room", ROOMS)
def test_what_is_longer_than_a_name_is_translated(room: str) -> None:
    english, chinese = sentences(room, "en"), sentences(room, "zh")
    same = {
        key for key in english if english[key] == chinese.get(key) and re.search(r"[a-z]{2,} [a-z]{2,}", english[key])
    }
    assert not same


def test_no_two_rooms_own_the_same_key() -> None:
    for one, other in combinations(ROOMS, 2):
        assert not sentences(one, "en").keys() & sentences(other, "en").keys(), (one, other)


def test_the_look_up_knows_every_sentence() -> None:
    for language in i18n.LANGUAGES:
        assert len(i18n.catalogue(language)) == sum(len(sentences(room, language)) for room in ROOMS)


def constants() -> Iterator[tuple[str, ast.AST]]:
    """Every node of the code, with the name of its file."""
    for path in sorted(SOURCE.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            yield path.relative_to(SOURCE).as_posix(), node


def named_keys() -> set[tuple[str, str]]:
    """Every string constant of the code that looks like a key of some room, with its file."""
    rooms = {key.split(".")[0] for key in i18n.catalogue("en")}
    strings = ((file, node.value) for file, node in constants() if isinstance(node, ast.Constant))
    return {
        (file, value)
        for file, value in strings
        if isinstance(value, str) and KEY.fullmatch(value) and value.split(".")[0] in rooms
    }


def raised_keys() -> set[tuple[str, str]]:
    """The keys of the errors of ``drivebus.errors`` that are raised with a constant key."""
    calls = ((file, node.exc) for file, node in constants() if isinstance(node, ast.Raise))
    return {
        (file, call.args[0].value)
        for file, call in calls
        if isinstance(call, ast.Call) and call.args and isinstance(call.args[0], ast.Constant)
        if isinstance(getattr(errors, getattr(call.func, "id", ""), None), type)
    }


def test_every_key_of_an_error_has_its_sentence() -> None:
    known = i18n.catalogue("en").keys()
    raised = raised_keys()
    assert len(raised) > 3
    assert not {(file, key) for file, key in raised if key not in known}


def test_every_key_that_the_code_names_has_its_sentence() -> None:
    """Beginnings of keys (f-strings put the rest), names of modules, files and operations are no keys."""
    known = i18n.catalogue("en").keys()
    starts = {".".join(key.split(".")[:n]) for key in known for n in range(1, key.count(".") + 1)}
    starts |= OPERATIONS.keys()
    missing = {(file, key) for file, key in named_keys() if key not in known and key not in starts}
    missing = {(file, key) for file, key in missing if key.rpartition(".")[2] not in FILES}
    missing = {(file, key) for file, key in missing if not (key[-1] == "_" and any(k.startswith(key) for k in known))}
    assert not {(file, key) for file, key in missing if not (SOURCE / (key.replace(".", "/") + ".py")).exists()}


def test_a_sentence_within_a_sentence_is_in_the_same_language() -> None:
    """A start that never left says why in the reader's language, not in English within Chinese."""
    why = errors.StartInhibited("drives.limits_unchecked")
    inner = i18n.text("drives.limits_unchecked", "zh")
    assert inner in i18n.text("drives.not_started", "zh", why=why)
    assert inner != i18n.text("drives.limits_unchecked", "en")


BEGINNING = re.compile(r"""["'`]([a-z][a-z0-9_]*\.[a-z0-9_.]*)(?:\$?\{|["'`])""")
OF_TWO_WORDS = {
    "drives.kind_",
    "page.by_",
    "page.size_",
    "page.sort_",
    "plant_config.key.",
    "page.counter_",
    "page.error_",
}
"""Beginnings that are put together themselves: ``state.Named``, ``parts.figures``, ``pages.fleet``, the reference."""


def test_every_sentence_is_said_somewhere() -> None:
    """What nobody says is translated and kept in vain. A key may be put together: then its beginning stands in code."""
    files = [path for kind in ("py", "js", "toml") for path in SOURCE.rglob(f"*.{kind}") if "vendor" not in path.parts]
    text = "\n".join(path.read_text(encoding="utf-8") for path in files)
    words = set(re.findall(r"[\w.-]+", text))
    beginnings = {found for found in BEGINNING.findall(text) if re.fullmatch(r"\w+\..+[._]", found)} | OF_TWO_WORDS
    silent = {key for key in i18n.catalogue("en") if key not in words and not key.startswith(tuple(beginnings))}
    assert {key for key in silent if not {key.partition(".")[2], key.rpartition(".")[2]} & words} == set()


RETIRED = {
    "起动": "启动",
    "从机地址": "站号",
    "站地址": "站号",
    "仿真": "模拟",
    "说明书": "手册",
    "给定频率": "设定频率",
    "回声": "回波",
}
"""One thing, one Chinese word, wherever a user reads it. Names of parameters stay as the drive's keypad has them."""


def test_one_thing_has_one_chinese_word() -> None:
    root = SOURCE.parents[1]
    pages = [*root.glob("*.zh.md"), *root.glob("docs/**/*.zh.md"), *root.glob("docs/generator/*")]
    data = [*SOURCE.glob("i18n/*.zh.json"), *SOURCE.glob("profiles/data/**/*.toml")]
    read = {path: path.read_text(encoding="utf-8") for path in [*pages, *data] if path.is_file()}
    assert len(read) > 40
    assert [(path.name, old, new) for path, text in read.items() for old, new in RETIRED.items() if old in text] == []


@pytest.mark.parametrize("text", [None, "{"])
def test_a_catalogue_that_can_not_be_read_hides_no_error(monkeypatch: pytest.MonkeyPatch, text: str | None) -> None:
    """Whoever tells of an error must not fail at it; the next one has its sentence again."""

    def refused(*_: Any, **__: Any) -> Any:
        if text is None:
            raise OSError(24, "Too many open files")
        return io.StringIO(text)

    i18n.catalogue.cache_clear()
    with monkeypatch.context() as context:
        context.setattr("builtins.open", refused)
        message = i18n.text("bus.no_reply", "zh", station=3)
        assert "bus.no_reply" in message and "3" in message and not i18n.known("bus.no_reply")
    assert "bus.no_reply" not in i18n.text("bus.no_reply", "zh", station=3) and i18n.known("bus.no_reply")
