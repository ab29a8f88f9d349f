"""Which cells there are. A case is a function of a row of the table, run with each kind of drive that it is for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from random import Random
from typing import Any

from verification.campaign import CampaignRun
from verification.drive_variants import DRIVE_VARIANTS, DriveVariant
from verification.fault_matrix.matrix_bus import MatrixBus
from verification.fault_matrix.table import TABLE

CELL_MODULES = (
    "no_reply_cells",
    "late_reply_cells",
    "damaged_frame_cells",
    "swapped_digit_cells",
    "echo_cells",
    "error_reply_cells",
    "foreign_station_cells",
    "broadcast_cells",
    "adapter_cells",
    "host_loss_cells",
    "drive_rule_cells",
)


class CellRun:
    """One run of a cell: a kind of drive, chance of its own, and the lines that the case builds."""

    def __init__(self, session: CampaignRun, cell: MatrixCell, number: int) -> None:
        self.session, self.kind = session, cell.kind
        self.name = f"{cell.name}/{number}"
        self.rng: Random = session.rng(cell.name, number)
        self.buses: list[MatrixBus] = []

    def bus(self, *addresses: int, **options: Any) -> MatrixBus:
        """A line of drives that have been spoken to. ``options`` as those of ``sim://`` links."""
        line = MatrixBus(self.session, self.kind, self.name, addresses or (1, 2), self.rng.randrange(2**31), options)
        self.buses.append(line)
        return line

    def random_hz(self, low: float = 5.0, high: float = 20.0) -> float:
        """A frequency of 0.1 Hz steps, which every family can say."""
        return self.rng.randrange(round(low * 10), round(high * 10)) / 10.0

    def close(self) -> None:
        for line in self.buses:
            line.close()


CellCheck = Callable[[CellRun], None]


@dataclass(frozen=True, slots=True)
class MatrixCell:
    """``row`` is a row of the table; its column is the kind's model."""

    row: str
    kind: DriveVariant
    check: CellCheck

    @property
    def name(self) -> str:
        return f"{self.row}/{self.kind.name}"


_CELL_CHECKS: dict[tuple[str, str], CellCheck] = {}


def cell(row: str, *kinds: DriveVariant) -> Callable[[CellCheck], CellCheck]:
    """This function is the case of a row, for these kinds (none named: for all)."""

    def register(check: CellCheck) -> CellCheck:
        for kind in kinds or DRIVE_VARIANTS:
            _CELL_CHECKS[row, kind.name] = check
        return check

    return register


def all_cells() -> tuple[MatrixCell, ...]:
    """All cells, in the order of the table. Raises KeyError for one without a case."""
    for module in CELL_MODULES:
        import_module(f"verification.fault_matrix.{module}")
    return tuple(
        MatrixCell(row, kind, _CELL_CHECKS[row, kind.name])
        for row, message in TABLE.items()
        for kind in DRIVE_VARIANTS
        if kind.model in message["cells"]
    )
