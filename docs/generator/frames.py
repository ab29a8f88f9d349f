"""Byte tables of the worked frames, and the list of misprints of the manuals, from ``vectors/``."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from drivebus import i18n
from generator.frame_layouts import layout
from generator.terms import colon, evidence_kind, localized, phrase, table, term

SOURCE_WORDS = (
    ("sister manual", evidence_kind("sister", "zh")),
    ("manual", evidence_kind("manual", "zh")),
    ("CRC computed", "CRC 为计算值"),
    ("LRC computed", "LRC 为计算值"),
    ("computed", evidence_kind("computed", "zh")),
    ("as printed", "照印"),
    ("printed at", "印为"),
    ("printed", "印为"),
    ("corrected", "更正"),
    ("registers", "寄存器"),
    ("drive's answer", "变频器应答"),
    ("examples", "示例"),
    ("frame table", "帧表"),
    ("error form", "错误应答格式"),
    ("read form", "读应答格式"),
    ("its frequency unit is", "频率单位为"),
)

Vector = dict[str, Any]


def load_vectors(path: Path) -> list[Vector]:
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines() if line.strip()]


def frame_tables(vectors: list[Vector], language: str) -> str:
    """Return one byte table per vector, requests followed by their replies."""
    return "\n".join(_frame_table(vector, language) for vector in vectors)


def _frame_table(vector: Vector, language: str) -> str:
    raw = bytes.fromhex(vector["hex"])
    direction = term(vector["direction"], language)
    lines = [
        f"#### `{vector['id']}`",
        "",
        f"{vector['encoding']} · {direction} · {_source(vector['source'], language)}",
    ]
    if "reply_to" in vector:
        lines[-1] += f" · {term('answers', language)} `{vector['reply_to']}`"
    lines += ["", "```", vector["hex"], "```", "", table(_heads(language), _rows(vector, raw, language))]
    lines += [f"{term('fields', language)}{colon(language)}{_fields(vector['fields'])}", ""]
    for mark in ("hazard", "erratum"):
        if mark in vector:
            lines += [f"> **{term(mark, language)}**{colon(language)}{phrase(vector[mark], language)}", ""]
    if vector.get("ambiguous"):
        lines += [f"> **{term('ambiguous', language)}**{colon(language)}{_fields(vector['meant'])}", ""]
    return "\n".join(lines)


def _heads(language: str) -> list[str]:
    return [term(head, language) for head in ("bytes", "field", "hex", "value")]


def _rows(vector: Vector, raw: bytes, language: str) -> list[tuple[str, str, str, str]]:
    rows, at = [], 0
    digits = vector["encoding"] == "ascii"
    for name, size in layout(vector):
        part = raw[at : at + size]
        where = str(at) if size == 1 else f"{at}–{at + size - 1}"
        rows.append((where, localized(name, language), f"`{part.hex(' ').upper()}`", _value(part, digits=digits)))
        at += size
    return rows


def _value(part: bytes, *, digits: bool) -> str:
    """Return characters of an ASCII frame, else the number."""
    if digits and all(0x20 < byte < 0x7F for byte in part):
        return f'"{part.decode("ascii")}"'
    return f"{part.hex().upper()}H"


def _fields(fields: dict[str, Any]) -> str:
    return " · ".join(f"`{name}` {json.dumps(value)}" for name, value in fields.items())


def _source(source: str, language: str) -> str:
    if language == "zh":
        for english, chinese in SOURCE_WORDS:
            source = source.replace(english, chinese)
        source = re.sub(r" ?\(([^()]*\D[^()]*)\)", r"（\1）", source)  # not the number of a paragraph, as §2.2 (5)
        for half, full in ((", ", "，"), ("; ", "；"), (": ", "：")):
            source = source.replace(half, full)
    return source


def errata_table(vectors: list[Vector], language: str) -> str:
    """Return the table of misprints and hazards, with the frame of a correct sender."""
    heads = [term(head, language) for head in ("frame", "printed", "wrong", "correct")]
    rows = [
        (
            f"`{v['id']}`",
            f"`{v['hex']}`",
            _wrong(v, language),
            f"`{v['canonical_hex']}`" if "canonical_hex" in v else "–",
        )
        for v in vectors
        if "erratum" in v or "hazard" in v
    ]
    return table(heads, rows) if rows else term("none", language) + "\n"


def _wrong(vector: Vector, language: str) -> str:
    phrases = (phrase(vector[mark], language) for mark in ("hazard", "erratum") if mark in vector)
    return i18n.join(phrases, "clauses", language)
