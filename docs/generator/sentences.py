"""Reference of the sentences about a drive or a bus: when each is used, and the tests that show it.

A test names a sentence if it has its key, or words that only this sentence has.
"""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from drivebus import i18n
from drivebus.values import Text
from generator.terms import colon, localized, named_placeholders, table

CONDITIONS: dict[str, dict[str, str]] = json.loads(
    (Path(__file__).parent / "sentences.json").read_text(encoding="utf-8")
)
"""Key → condition in each language; a key that ends with ``*`` is for every key that begins so."""
OTHER_TEXTS: dict[str, Text] = {
    "about_no_drive": Text(
        "about files, users and programs, not about a drive or a bus", "关于文件、用户和程序，不涉及变频器或总线"
    ),
    "advice": Text("a question, an instruction or advice, which states nothing", "提问、指示或建议，不作陈述"),
    "frame_bytes": Text(
        "about the bytes of one frame, by comparison with its format", "通过与格式比较，说明一帧的字节"
    ),
    "names": Text("names of columns, values and settings", "栏目、数值和设置的名称"),
}
"""Group of texts that are not in the table → why."""
GROUPS: dict[str, str] = json.loads((Path(__file__).parent / "other_texts.json").read_text(encoding="utf-8"))
"""Key, or its beginning with ``*`` → name of its group in ``OTHER_TEXTS``."""
HEADS = {
    "sentence": Text("sentence", "语句"),
    "condition": Text("used when", "何时使用"),
    "proof": Text("test", "测试"),
}
CAMPAIGN = Text("campaign `statements`", "试验 `statements`")
SHORTEST_WORDING = 10
"""Characters of a text in a test, from which it may identify a sentence."""
CHINESE_WORDING = re.compile("[一-鿿，：]{6,}")
PLACEHOLDER = re.compile(r"\{[^}]*\}")
SEPARATOR = "\0"
"""Character that no text has."""
TEST_OF_TABLE = "tests/test_sentences.py"
PAGE_TESTS = "tests/web/page/"
MOST_LINKS = 2


@dataclass(frozen=True, slots=True)
class Proof:
    """Test that names a sentence; ``name`` is empty for a table of the file."""

    file: str
    name: str


@cache
def sentence_keys() -> list[str]:
    """Return the keys of all sentences about a drive or a bus, in the order of the conditions."""
    places = {pattern: place for place, pattern in enumerate(CONDITIONS)}
    governing = {key: _governing(key, CONDITIONS) for key in _catalogue("en")}
    return sorted((key for key, by in governing.items() if by), key=lambda key: (places[governing[key] or ""], key))


def unassigned_keys() -> list[str]:
    """Return the keys that are neither in the table nor in a group of other texts."""
    return [key for key in sorted(_catalogue("en")) if _governing(key, {**CONDITIONS, **GROUPS}) is None]


def parts(root: Path, language: str) -> dict[str, str]:
    """Return the generated parts of the page: the table, and the groups of other texts."""
    rows = [
        (
            f"{named_placeholders(_catalogue(language)[key])}<br>`{key}`",
            CONDITIONS[_governing(key, CONDITIONS) or key][language],
            _proof_cell(key, root, language),
        )
        for key in sentence_keys()
    ]
    groups = [
        f"- {localized(why, language)}{colon(language)}{_group_keys(name, language)}"
        for name, why in OTHER_TEXTS.items()
    ]
    return {
        "sentences": table([localized(head, language) for head in HEADS.values()], rows),
        "others": "\n".join(groups) + "\n",
    }


def _group_keys(name: str, language: str) -> str:
    return i18n.join((f"`{pattern}`" for pattern, group in GROUPS.items() if group == name), "items", language)


def _governing(key: str, patterns: Mapping[str, object]) -> str | None:
    """Return the pattern of a key: itself, else the longest beginning."""
    if key in patterns:
        return key
    fitting = [pattern for pattern in patterns if pattern.endswith("*") and key.startswith(pattern[:-1])]
    return max(fitting, key=len, default=None)


@cache
def _catalogue(language: str) -> dict[str, str]:
    """Return the texts of drivebus and its built-in families; tests may have added those of other packages."""
    files = sorted(Path(i18n.__file__).parents[1].rglob(f"*.{language}.json"))
    return {key: text for file in files for key, text in json.loads(file.read_text(encoding="utf-8")).items()}


def _proof_cell(key: str, root: Path, language: str) -> str:
    campaign = localized(CAMPAIGN, language)
    links = [campaign if proof.file.startswith("verification/") else _link(proof) for proof in proofs(root)[key]]
    return i18n.join(list(dict.fromkeys(links))[:MOST_LINKS], "items", language)


def _link(proof: Proof) -> str:
    label = proof.name or Path(proof.file).name
    return f"[`{label}`](../../{proof.file})"


@cache
def proofs(root: Path) -> dict[str, list[Proof]]:
    """Return key → tests that name it: those with the key itself, then those with words that only its sentence has."""
    literals = _literals(root)
    texts = {key: [_catalogue(language)[key] for language in i18n.LANGUAGES] for key in _catalogue("en")}
    all_texts = SEPARATOR.join(text for versions in texts.values() for text in versions)
    found = {key: literals.get(key, []) + _page_tests(key, literals) for key in sentence_keys()}
    keys_of_text = [key for key in texts for _ in i18n.LANGUAGES]
    for literal, places in literals.items():
        words = literal.strip()
        if is_wording(words) and (at := all_texts.find(words)) >= 0 and all_texts.find(words, at + 1) < 0:
            found.get(keys_of_text[all_texts.count(SEPARATOR, 0, at)], []).extend(places)
    all_literals, all_places = SEPARATOR.join(literals), list(literals.values())
    for key in found:
        for words in (part.strip() for text in texts[key] for part in PLACEHOLDER.split(text)):
            if is_wording(words) and all_texts.count(words) == 1:
                found[key] += [
                    place
                    for match in re.finditer(re.escape(words), all_literals)
                    for place in all_places[all_literals.count(SEPARATOR, 0, match.start())]
                ]
    return {key: list(dict.fromkeys(places)) for key, places in found.items()}


def _page_tests(key: str, literals: Mapping[str, list[Proof]]) -> list[Proof]:
    """Return the tests of the page that name one of its sentences: they leave out the first part of the key."""
    catalogue, _, name = key.partition(".")
    return [
        literal for literal in literals.get(name, []) if catalogue == "page" and literal.file.startswith(PAGE_TESTS)
    ]


def is_wording(words: str) -> bool:
    """Return whether words are long enough to name one sentence."""
    return (len(words) >= SHORTEST_WORDING and " " in words) or bool(CHINESE_WORDING.search(words))


def _literals(root: Path) -> dict[str, list[Proof]]:
    """Return each string constant of the tests and of the campaign, with its places.

    The test of the table itself is left out: it names the keys that nothing shows.
    """
    found: dict[str, list[Proof]] = {}
    tests = [file for file in sorted((root / "tests").rglob("test_*.py")) if file != root / TEST_OF_TABLE]
    files = [*tests, *sorted((root / "verification" / "statements").glob("*.py"))]
    for file in files:
        for node in ast.parse(file.read_text(encoding="utf-8")).body:
            is_test = isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and node.name.startswith("test_")
            place = Proof(file.relative_to(root).as_posix(), node.name if is_test else "")  # type: ignore[attr-defined]
            for constant in ast.walk(node):
                if isinstance(constant, ast.Constant) and isinstance(constant.value, str):
                    found.setdefault(constant.value, []).append(place)
    return found
