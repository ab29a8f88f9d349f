"""Ids of traps (T01 …) and invariants (I1 …): definitions, uses, links, and codes that no page defines."""

from __future__ import annotations

import io
import os
import re
import tokenize
from collections.abc import Iterator, Mapping
from pathlib import Path

SEARCHED = (".", "src", "tests", "verification", "benchmarks", "docs", "examples", "vectors", "requirements")
"""Folders whose files are searched; of the first, the repository itself, only its own files."""
SUFFIXES = {".py", ".md", ".json", ".jsonl", ".js", ".mjs", ".css", ".html", ".c", ".toml", ".sh"}
TRAP = re.compile(r"\bT\d\d\b")
INVARIANT = re.compile(r"\bI(?:[1-9]|1\d)\b(?![.²·])")
UNDEFINED = re.compile(
    r"(?<!Mollom )(?<!VF-)\b[GS]\d\d\b(?!\.)"  # Mollom G70 and Toshiba VF-S15 are inverters
    r"|\bF\d\d\b(?![.\d])"  # F06.06 is a parameter of a drive
    r"|\b[Rr]ulings? \d+"
    r"|\bRELIABILITY\b"
    r"|(?<![\w\])}])\([5-9]\.[1-9](?:[,;] ?\d\.\d)*\)"
)
"""Codes of documents that are not part of this repository."""
PARAMETER_GROUP = re.compile(r"F(?:0\d|1[0-2])")
"""Parameter groups of the VC660, defined on its page: its ids in files on it, on profiles and on group sizes."""
_DEFINED_TRAP = re.compile(r'^\| <a id="t\d+"></a>\*\*(T\d\d)\*\* \|', re.MULTILINE)
_DEFINED_INVARIANT = re.compile(r'^\| <a id="i\d+"></a>(I\d+) \|', re.MULTILINE)
_LINKABLE = re.compile(
    r"(?P<kept>```.*?```|`[^`\n]*`|<a id=\"\w+\"></a>(?:\*\*)?\w+|\[[^\]\n]*\]\([^)\n]*\))"
    rf"|(?P<id>{TRAP.pattern}|{INVARIANT.pattern})",
    re.DOTALL,
)
"""Id in Markdown outside code, links and definitions."""
_WORD = re.compile(r"[^\W\d_]{2,}")
MIN_WORDS = 2
"""Fewest words beside an id in a comment or docstring, which can hold no link."""


def definitions(root: Path, language: str = "en") -> dict[str, Path]:
    """Return id → page that defines it: a trap on a protocol's page, an invariant on the verification page."""
    suffix = "" if language == "en" else f".{language}"
    protocols = (page for page in sorted((root / "docs" / "protocols").glob("*.md")) if _language(page) == language)
    found: dict[str, Path] = {}
    for page in (*protocols, root / "docs" / "explanation" / f"verification{suffix}.md"):
        if page.exists():
            text = _text(page)
            found |= dict.fromkeys((*_DEFINED_TRAP.findall(text), *_DEFINED_INVARIANT.findall(text)), page)
    return found


def link_ids(text: str, page: Path, pages: Mapping[str, Path]) -> str:
    """Return the Markdown text of ``page`` with a link from each id to its definition in ``pages``."""

    def link(match: re.Match[str]) -> str:
        id = match["id"]
        if id is None or id not in pages:
            return match[0]
        target = "" if pages[id] == page else Path(os.path.relpath(pages[id], page.parent)).as_posix()
        return f"[{id}]({target}#{id.lower()})"

    return _LINKABLE.sub(link, text)


def unlinked_pages(root: Path) -> list[str]:
    """Return the pages that use an id without a link to its definition in the page's language."""
    pages = {language: definitions(root, language) for language in ("en", "zh")}
    texts = ((path, _text(path)) for path in searched_files(root) if path.suffix == ".md")
    found = (path for path, text in texts if link_ids(text, path, pages[_language(path)]) != text)
    return [path.relative_to(root).as_posix() for path in found]


def unexplained_uses(root: Path) -> list[str]:
    """Return the comments and docstrings with an id and without the reason in words beside it."""
    found = []
    for path in searched_files(root):
        source = _text(path)
        if path.suffix == ".py" and _has_id(source):
            lines = [line for line, text in _comments(source) if _has_id(text) and len(_WORD.findall(text)) < MIN_WORDS]
            found += [f"{path.relative_to(root).as_posix()}:{line}" for line in lines]
    return found


def _comments(source: str) -> Iterator[tuple[int, str]]:
    """Yield line and text of each comment and docstring."""
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT or token.string.startswith('"""'):
            yield token.start[0], token.string


def _has_id(text: str) -> bool:
    return bool(TRAP.search(text) or INVARIANT.search(text))


def undefined_codes(root: Path) -> dict[str, list[str]]:
    """Return file → codes in it that no page of the repository defines."""
    defined = definitions(root)
    found: dict[str, list[str]] = {}
    for path in searched_files(root):
        text = _text(path)
        used = {*TRAP.findall(text), *INVARIANT.findall(text)} - defined.keys()
        if codes := sorted(used.union(_undefined(path, text))):
            found[path.relative_to(root).as_posix()] = codes
    return found


def count_undefined(root: Path) -> int:
    """Return the number of places where such a code stands."""
    defined = definitions(root)
    texts = {path: _text(path) for path in searched_files(root)}
    ids = [code for text in texts.values() for code in (*TRAP.findall(text), *INVARIANT.findall(text))]
    return sum(code not in defined for code in ids) + sum(len(_undefined(path, text)) for path, text in texts.items())


def _undefined(path: Path, text: str) -> list[str]:
    found = UNDEFINED.findall(text)
    has_groups = "vc660" in path.name or "profiles" in path.as_posix() or "group_sizes" in text
    return [code for code in found if not (has_groups and PARAMETER_GROUP.fullmatch(code))]


def searched_files(root: Path) -> Iterator[Path]:
    """Return the texts of code, tests and documentation, sorted."""
    for folder in SEARCHED:
        for path in sorted((root / folder).glob("*") if folder == "." else (root / folder).rglob("*")):
            # Ids that must not exist; "refused" is the name of the folder in the checkout before the rework.
            data = folder == "tests" and (path.suffix == ".json" or not {"rejected", "refused"}.isdisjoint(path.parts))
            if (
                (path.suffix in SUFFIXES or path.name == "Makefile")
                and path.is_file()
                and "__pycache__" not in path.parts
                and not data
            ):
                yield path


def _language(page: Path) -> str:
    return "zh" if page.name.endswith(".zh.md") else "en"


def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8")
