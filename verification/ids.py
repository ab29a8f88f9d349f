"""Ids of traps (T01 …) and invariants (I1 …): their definitions, their uses, and codes that no page defines."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

SEARCHED = ("src", "tests", "verification", "benchmarks", "docs")
SUFFIXES = {".py", ".md", ".json", ".js", ".css", ".html", ".c"}
TRAP = re.compile(r"\bT\d\d\b")
INVARIANT = re.compile(r"\bI(?:[1-9]|1\d)\b(?![.²·])")
UNDEFINED = re.compile(
    r"\b[GS]\d\d\b(?!\.)"
    r"|\bF\d\d\b(?![.\d])"  # F06.06 is a parameter of a drive
    r"|\b[Rr]ulings? \d+"
    r"|\bRELIABILITY\b"
    r"|(?<![\w\])}])\([5-9]\.[1-9](?:[,;] ?\d\.\d)*\)"
)
"""Codes of documents that are not part of this repository."""
PARAMETER_GROUP = re.compile(r"F(?:0\d|1[0-2])")
"""Parameter groups of the VC660, defined on its page: its ids in files on it, on profiles and on group sizes."""
_DEFINED_TRAP = re.compile(r'^\| (?:<a id="t\d+"></a>)?\*\*(T\d\d)\*\* \|', re.MULTILINE)
_DEFINED_INVARIANT = re.compile(r'^\| <a id="i\d+"></a>(I\d+) \|', re.MULTILINE)


def defined_ids(root: Path) -> frozenset[str]:
    """Return the traps of the protocol pages and the invariants of the verification page."""
    pages = [*(root / "docs" / "protocols").glob("*.md"), root / "docs" / "explanation" / "verification.md"]
    texts = [_text(page) for page in pages if page.exists()]
    return frozenset(one for text in texts for one in (*_DEFINED_TRAP.findall(text), *_DEFINED_INVARIANT.findall(text)))


def undefined_codes(root: Path) -> dict[str, list[str]]:
    """Return file → codes in it that no page of the repository defines."""
    defined = defined_ids(root)
    found: dict[str, list[str]] = {}
    for path in searched_files(root):
        text = _text(path)
        used = {*TRAP.findall(text), *INVARIANT.findall(text)} - defined
        if codes := sorted(used.union(_undefined(path, text))):
            found[path.relative_to(root).as_posix()] = codes
    return found


def count_undefined(root: Path) -> int:
    """Return the number of places where such a code stands."""
    defined = defined_ids(root)
    texts = {path: _text(path) for path in searched_files(root)}
    ids = [one for text in texts.values() for one in (*TRAP.findall(text), *INVARIANT.findall(text))]
    return sum(one not in defined for one in ids) + sum(len(_undefined(path, text)) for path, text in texts.items())


def _undefined(path: Path, text: str) -> list[str]:
    found = UNDEFINED.findall(text)
    has_groups = "vc660" in path.name or "profiles" in path.as_posix() or "group_sizes" in text
    return [code for code in found if not (has_groups and PARAMETER_GROUP.fullmatch(code))]


def searched_files(root: Path) -> Iterator[Path]:
    """Return the texts of code, tests and documentation, sorted."""
    for folder in SEARCHED:
        for path in sorted((root / folder).rglob("*")):
            data = folder == "tests" and path.suffix == ".json"  # refused profiles have ids that must not exist
            if path.suffix in SUFFIXES and path.is_file() and "__pycache__" not in path.parts and not data:
                yield path


def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8")
