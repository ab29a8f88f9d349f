"""No name, first sentence of a docstring or English message has one of the words that no reader could look up."""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
UNNAMED_SUBJECTS = ("told", "said", "heard", "wish", "wished", "whoever", "nobody", "somebody", "anew")
METAPHORS = ("desk", "door", "ear", "voice", "witness", "witnesses")
WORDS = frozenset((*UNNAMED_SUBJECTS, *METAPHORS))
OPENINGS = re.compile(r"(?:One|What|Who|Whoever|Somebody|So many|How|Why|When|Where)\b(?!-)")
"""Openings that hide the subject of a docstring: it begins with a noun phrase or an imperative."""
FOLDERS = ("src", "tests", "verification", "benchmarks", "docs/generator", "examples")
SUFFIXES = (".py", ".js", ".mjs", ".css", ".json", ".toml")

PART = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+")
FIRST_SENTENCE = re.compile(r"(?<=[.:?!])\s")
JS_SKIPPED = re.compile(r"""//[^\n]*|/\*.*?\*/|'(?:\\.|[^'\\\n])*'|"(?:\\.|[^"\\\n])*\"""", re.DOTALL)
JS_NAME = re.compile(r"[A-Za-z_$][\w$]*")
CSS_COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)
CSS_NAME = re.compile(r"[.#][A-Za-z_-][\w-]*|--[\w-]+|@keyframes\s+[\w-]+")
CLASS_ATTRIBUTE = re.compile(r"""\bclass=(?:"([^"]*)"|'([^']*)')""")
CLI_OPTION = re.compile(r"--[a-z][\w-]*")
TOML_KEY = re.compile(r"^\s*\[{0,2}([\w.-]+)(?:\s*=|\]{1,2}\s*$)", re.MULTILINE)


@cache
def has_word(name: str) -> bool:
    """Return whether one of the words is a whole part of a snake_case, kebab-case or CamelCase name."""
    return any(part.lower() in WORDS for part in PART.findall(name))


def assigned_names(nodes: Iterable[ast.AST]) -> Iterator[str]:
    for node in nodes:
        match node:
            case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name) | ast.ClassDef(name=name):
                yield name
            case ast.arg(arg=name) | ast.Name(id=name, ctx=ast.Store()) | ast.Attribute(attr=name, ctx=ast.Store()):
                yield name
            case ast.alias(asname=str(name)) | ast.keyword(arg=str(name)) | ast.MatchAs(name=str(name)):
                yield name
            case ast.ExceptHandler(name=str(name)) | ast.MatchStar(name=str(name)):
                yield name
            case ast.Global(names=names) | ast.Nonlocal(names=names):
                yield from names


def cli_options(nodes: Iterable[ast.AST]) -> Iterator[str]:
    for node in nodes:
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and CLI_OPTION.fullmatch(node.value):
            yield node.value


def first_sentences(nodes: Iterable[ast.AST]) -> Iterator[str]:
    for node in nodes:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef | ast.Module):
            docstring = ast.get_docstring(node)
            if docstring:
                yield FIRST_SENTENCE.split(docstring)[0]


def python_findings(source: str) -> set[str]:
    nodes = [*ast.walk(ast.parse(source))]
    found = {name for name in [*assigned_names(nodes), *cli_options(nodes)] if has_word(name)}
    sentences = list(first_sentences(nodes))
    found |= {text for text in sentences if OPENINGS.match(text)}
    return found | {text for text in sentences if set(re.findall(r"[a-z]+", text.lower())) & WORDS}


def js_findings(source: str) -> set[str]:
    """Return names outside comments and quoted strings, and the classes of the templates."""
    classes = " ".join(double or single for double, single in CLASS_ATTRIBUTE.findall(source))
    names = JS_NAME.findall(JS_SKIPPED.sub('""', re.sub(r">[^<>`${}]*<", "><", source)))
    return {name for name in [*names, *classes.split()] if has_word(name)}


def css_findings(source: str) -> set[str]:
    return {name for name in CSS_NAME.findall(CSS_COMMENT.sub("", source)) if has_word(name)}


def json_findings(source: str) -> set[str]:
    """Return the keys of a message catalogue that have one of the words in their name or text."""
    texts: dict[str, str] = json.loads(source)
    return {key for key, text in texts.items() if has_word(key) or set(re.findall(r"[a-z]+", text.lower())) & WORDS}


def toml_findings(source: str) -> set[str]:
    return {key for key in TOML_KEY.findall(source) if has_word(key)}


CHECKS = {
    ".py": python_findings,
    ".js": js_findings,
    ".mjs": js_findings,
    ".css": css_findings,
    ".toml": toml_findings,
}


def findings(path: Path) -> set[str]:
    name = {path.name} if has_word(path.stem) else set()
    if path.suffix == ".json":
        return name | (json_findings(path.read_text(encoding="utf-8")) if path.parent.name == "i18n" else set())
    return name | CHECKS[path.suffix](path.read_text(encoding="utf-8", errors="replace"))


def test_no_name_and_no_first_sentence_has_one_of_the_words() -> None:
    files = [path for folder in FOLDERS for path in (ROOT / folder).rglob("*") if path.suffix in SUFFIXES]
    files = [path for path in files if "vendor" not in path.parts and "node_modules" not in path.parts]
    assert len(files) > 400
    found = {path.relative_to(ROOT).as_posix(): findings(path) for path in files}
    assert {file: names for file, names in found.items() if names} == {}, (
        f"write the term of the field instead of {', '.join(sorted(WORDS))}; "
        "a docstring begins with a noun phrase or an imperative"
    )


def test_a_docstring_whose_opening_hides_its_subject_is_found() -> None:
    assert python_findings('class Bus:\n    """One bus. More."""') == {"One bus."}
    assert python_findings('class Status:\n    """How a command ended."""') == {"How a command ended."}
    assert python_findings('class Secret:\n    """One-time secret."""') == set()


@pytest.mark.parametrize("word", sorted(WORDS))
def test_the_check_finds_each_word(word: str) -> None:
    camel = word.capitalize()
    assert python_findings(f"def last_{word}_at(): ...") == {f"last_{word}_at"}
    assert python_findings(f"class Last{camel}At: ...") == {f"Last{camel}At"}
    assert python_findings(f'option("--{word}-at")') == {f"--{word}-at"}
    assert python_findings(f'"""The {word} value. More."""') == {f"The {word} value."}
    assert js_findings(f"const last{camel} = 1;") == {f"last{camel}"}
    assert js_findings(f'html`<p class="{word}-at">`') == {f"{word}-at"}
    assert css_findings(f".last-{word} {{ color: red }}") == {f".last-{word}"}
    assert json_findings(f'{{"drives.{word}_at": "", "drives.a": "{camel} controls it"}}') == {
        f"drives.{word}_at",
        "drives.a",
    }
    assert toml_findings(f"{word}_at = 1") == {f"{word}_at"}


@pytest.mark.parametrize(
    "source",
    [
        "def f(x, told): ...",
        "self.told = 1",
        "for told in x: ...",
        "with x as told: ...",
        "import x as told",
        "f(told=1)",
        "try: ...\nexcept E as told: ...",
        "match x:\n  case told: ...",
        "told: int = 1",
        "(told := 1)",
        "lambda told: 1",
    ],
)
def test_the_check_finds_every_kind_of_python_name(source: str) -> None:
    assert python_findings(source) == {"told"}


def test_the_check_ignores_longer_words_text_and_later_sentences() -> None:
    assert python_findings('def wishbone(newtold):\n    """A value. Told later."""\n    return "said"') == set()
    assert js_findings("// told\nconst text = 'said';") == set()
    assert js_findings("html`<p>as was said</p>`") == set()
    assert css_findings("/* .told */ .untold { color: red }") == set()
