"""Table of registers (CSV) of a manual: each line a signal or a parameter of a new profile."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

from drivebus.commissioning.new_profile.questions import parse_register
from drivebus.errors import ProfileError, SystemReason
from drivebus.profiles.diagnostics import Diagnostic, issue, profile_error, to_diagnostic
from drivebus.profiles.schema import Unit
from drivebus.profiles.toml_file import toml_string

CATALOGUE = "register_table"
COLUMNS = {
    "name": ("name", "名称", "参数"),
    "address": ("address", "register", "地址"),
    "unit": ("unit", "单位"),
    "scale": ("scale", "factor", "倍率", "比例"),
    "access": ("access", "读写", "属性"),
    "text": ("text", "description", "说明", "描述"),
}
"""Each column with the headings that name it, in any order of the table."""
REQUIRED = ("name", "address")
ACCESS = {"": False, "r": False, "ro": False, "只读": False, "rw": True, "r/w": True, "w": True, "读写": True}
"""Text of the access column to whether the register can be written."""
UNITS = tuple(unit for unit in get_args(Unit) if unit)
MAX_TABLE_BYTES = 1_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class TableRow:
    """Register of a table."""

    name: str
    register: int
    unit: str
    factor: float
    is_writable: bool
    text: str

    def toml_lines(self) -> Iterator[str]:
        """Yield the table of a signal, or of a parameter, without its evidence."""
        if self.is_writable:
            yield from (f"[parameters.{toml_string(self.name)}]", f"register = 0x{self.register:04X}")
        else:
            key = self.name if re.fullmatch(r"[a-z][a-z0-9_]*", self.name) else f"register_{self.register:04x}"
            yield from (f"[signals.{key}]", f'notation = "{self.register:04X}H"')
        yield f"text = {toml_string(self.text or self.name)}"
        if self.unit:
            yield f"unit = {toml_string(self.unit)}"
        yield from (f"factor = {self.factor}", f"decimals = {_decimals(self.factor)}")


def _decimals(factor: float) -> int:
    """Return the decimals that show one step, 4 at most."""
    text = f"{factor:.4f}".rstrip("0")
    return len(text.partition(".")[2])


def read_table(path: str | Path, numbering: str) -> list[TableRow]:
    """Return the registers of a CSV file: comma, semicolon or tab, UTF-8 or GBK, header in English or Chinese.

    ``numbering`` is one of ``questions.NUMBERING``. Raises ProfileError, which names every faulty line.
    """
    text = _read_text(Path(path))
    separator = _separator(text)
    lines = list(csv.reader(io.StringIO(text), delimiter=separator))
    if not lines:
        raise profile_error([to_diagnostic(issue("empty", (), ""), str(path), 1, CATALOGUE)])
    places = _columns(lines[0])
    missing = [name for name in REQUIRED if name not in places]
    if missing:
        problem = issue("header", (missing[0],), separator.join(lines[0]))
        raise profile_error([to_diagnostic(problem, str(path), 1, CATALOGUE)])
    rows: list[TableRow] = []
    faults: list[Diagnostic] = []
    for number, line in enumerate(lines[1:], 2):
        if any(cell.strip() for cell in line):
            cells = {name: line[at].strip() if at < len(line) else "" for name, at in places.items()}
            row = _row(cells, numbering, {row.register for row in rows}, {row.name for row in rows})
            if isinstance(row, TableRow):
                rows.append(row)
            else:
                fault = issue(row[0], (row[1],), cells.get(row[1], ""), units=UNITS)
                faults.append(to_diagnostic(fault, str(path), number, CATALOGUE))
    if faults:
        raise profile_error(faults)
    return rows


def _read_text(path: Path) -> str:
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise ProfileError("register_table.unreadable", file=str(path), reason=SystemReason(error)) from error
    if len(raw) > MAX_TABLE_BYTES:
        raise profile_error([to_diagnostic(issue("too_large", (), len(raw)), str(path), 1, CATALOGUE)])
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        return raw.decode("gb18030", errors="replace")


def _separator(text: str) -> str:
    """Return the separator that the header has most of."""
    header = text.partition("\n")[0]
    return max(",;\t", key=header.count)


def _columns(header: list[str]) -> dict[str, int]:
    """Return the place of each known column."""
    titles = [cell.strip().casefold() for cell in header]
    return {name: titles.index(title) for name, known in COLUMNS.items() for title in known if title in titles}


def _row(cells: Mapping[str, str], numbering: str, registers: set[int], names: set[str]) -> TableRow | tuple[str, str]:
    """Return the register of a line, else the kind of its fault and the column."""
    if not cells["name"]:
        return "no_name", "name"
    if cells["name"] in names:
        return "name_again", "name"
    try:
        register = parse_register(cells["address"], numbering)
    except ValueError:
        return "address", "address"
    if register in registers:
        return "address_again", "address"
    try:
        factor = float(cells.get("scale") or 1)
    except ValueError:
        factor = 0.0
    if not 0 < factor <= 1e6:
        return "scale", "scale"
    unit = cells.get("unit", "")
    if unit not in get_args(Unit):
        return "unit", "unit"
    access = ACCESS.get(cells.get("access", "").casefold())
    if access is None:
        return "access", "access"
    return TableRow(
        name=cells["name"], register=register, unit=unit, factor=factor, is_writable=access, text=cells.get("text", "")
    )
