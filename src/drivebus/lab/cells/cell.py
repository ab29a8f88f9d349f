"""Which cells there are. A case is a function of a row of the table, run with each kind of drive that it is for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from random import Random
from typing import Any

from drivebus.lab.campaign import Session
from drivebus.lab.cells.line import Line
from drivebus.lab.cells.table import TABLE
from drivebus.lab.kinds import KINDS, Kind

MODULES = (
    "silence",
    "believing",
    "damage",
    "digits",
    "echo",
    "answers",
    "others",
    "broadcasts",
    "adapter",
    "host",
    "rules",
)


class Case:
    """One run of a cell: a kind of drive, chance of its own, and the lines that the case builds."""

    def __init__(self, session: Session, cell: Cell, number: int) -> None:
        self.session, self.kind = session, cell.kind
        self.name = f"{cell.name}/{number}"
        self.rng: Random = session.rng(cell.name, number)
        self.lines: list[Line] = []

    def line(self, *addresses: int, **options: Any) -> Line:
        """A line of drives that have been spoken to. ``options`` as those of ``sim://`` links."""
        line = Line(self.session, self.kind, self.name, addresses or (1, 2), self.rng.randrange(2**31), options)
        self.lines.append(line)
        return line

    def hz(self, low: float = 5.0, high: float = 20.0) -> float:
        """A frequency of 0.1 Hz steps, which every family can say."""
        return self.rng.randrange(round(low * 10), round(high * 10)) / 10.0

    def close(self) -> None:
        for line in self.lines:
            line.close()


Check = Callable[[Case], None]


@dataclass(frozen=True, slots=True)
class Cell:
    """``row`` is a row of the table; its column is the kind's model."""

    row: str
    kind: Kind
    check: Check

    @property
    def name(self) -> str:
        return f"{self.row}/{self.kind.name}"


_CHECKS: dict[tuple[str, str], Check] = {}


def case(row: str, *kinds: Kind) -> Callable[[Check], Check]:
    """This function is the case of a row, for these kinds (none named: for all)."""

    def register(check: Check) -> Check:
        for kind in kinds or KINDS:
            _CHECKS[row, kind.name] = check
        return check

    return register


def cells() -> tuple[Cell, ...]:
    """All cells, in the order of the table. Raises KeyError for one without a case."""
    for module in MODULES:
        import_module(f"drivebus.lab.cells.{module}")
    return tuple(
        Cell(row, kind, _CHECKS[row, kind.name])
        for row, told in TABLE.items()
        for kind in KINDS
        if kind.model in told["cells"]
    )
