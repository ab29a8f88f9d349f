"""Tables of the full-screen view: columns, cells and colours."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

from rich.text import Text
from textual.coordinate import Coordinate
from textual.widgets import DataTable

from drivebus.cli import output
from drivebus.cli.output import width
from drivebus.cli.tui.rows import COLUMN_SIGNALS, BusRow, DriveRow

STALE_AGE_S = 3.0  # older values are dimmed

DRIVE_COLUMNS = {"name": 13, "state": 13, "direction": 5} | dict(zip(COLUMN_SIGNALS, (8, 8, 7, 6, 6), strict=True))
AGE_CELLS = 6
MIN_FAULT_CELLS = 7
FAULT_TEXT_MIN_CELLS = 24  # a narrower fault column shows the code without its text
LOAD_CELLS = 7  # of the load without its bar
MIN_ERROR_CELLS = 12
BUS_COLUMNS = {"bus": 13, "settings": 11, "link": 9, "load": 18, "rate": 8}
_RIGHT_ALIGNED = frozenset({*COLUMN_SIGNALS, "age", "rate"})
_BAR_CELLS = 10

_STATE_STYLE = {
    "running": "bold green",
    "accelerating": "green",
    "decelerating": "green",
    "jogging": "green",
    "braking": "green",
    "fault": "bold red",
    "emergency_stopped": "bold red",
    "not_ready": "yellow",
    "unknown": "yellow",
}


def drive_columns(cells: int) -> dict[str, int]:
    """Return the column widths of the drive table on a terminal of ``cells``; the fault takes the rest.

    A narrow terminal hides voltage, then DC bus voltage, current, set frequency, direction, and last the fault: it is
    a state too.
    """
    columns, free = dict(DRIVE_COLUMNS), cells - AGE_CELLS
    for name in ("output_voltage", "dc_bus_voltage", "output_current", "set_frequency", "direction"):
        if sum(columns.values()) + MIN_FAULT_CELLS > free:
            del columns[name]
    rest = free - sum(columns.values())
    return columns | ({"fault": max(MIN_FAULT_CELLS, rest - 1)} if rest >= MIN_FAULT_CELLS else {}) | {"age": AGE_CELLS}


def bus_columns(cells: int) -> dict[str, int]:
    """Return the column widths of the bus table; the error counters take the rest.

    A narrow terminal shows the load without its bar, then hides rate, settings and load.
    """
    columns = dict(BUS_COLUMNS)
    if sum(columns.values()) + MIN_ERROR_CELLS >= cells:
        columns["load"] = LOAD_CELLS
    for name in ("rate", "settings", "load"):
        if sum(columns.values()) + MIN_ERROR_CELLS > cells:
            del columns[name]
    return columns | {"errors": max(MIN_ERROR_CELLS, cells - sum(columns.values()) - 1)}


def drive_cells(row: DriveRow, now: float, columns: Mapping[str, int]) -> list[Text]:
    """Return the cells of one drive in these columns."""
    age = row.age_s(now)
    fresh = row.presence == "online" and age is not None and age <= STALE_AGE_S
    style = "" if fresh else "dim"
    fits_text = columns.get("fault", 0) >= FAULT_TEXT_MIN_CELLS or not row.fault_label
    fault = row.fault_cell() if fits_text else row.fault_label
    shown = {
        "name": (row.name_text(), "bold"),
        "state": (row.state_text(), _STATE_STYLE.get(row.state, "") if row.presence == "online" else "yellow"),
        "direction": (row.direction_text(), style),
        "fault": (f" {fault}", "bold red"),
        "age": (row.age_text(now), style if fresh else "yellow"),
    } | {signal: (row.cell(signal), style) for signal in COLUMN_SIGNALS}
    return [_cell(shown[name][0], name, shown[name][1]) for name in columns]


def bus_cells(row: BusRow, columns: Mapping[str, int]) -> list[Text]:
    """Return the cells of one bus in these columns."""
    errors = row.errors_text(columns["errors"] - 1)
    rate = "–" if row.transactions_per_s is None else f"{row.transactions_per_s:.1f} "
    shown = {
        "bus": (_keep_end(row.name, columns["bus"] - 1), "bold"),
        "settings": (row.settings, ""),
        "link": (output.text("live.link.up" if row.up else "live.link.lost"), "" if row.up else "bold red"),
        "load": (load_bar(row.load, bar=columns.get("load", 0) > LOAD_CELLS), ""),
        "rate": (rate, ""),
        "errors": (f" {errors}", "yellow" if any(row.errors.values()) else "dim"),
    }
    return [_cell(shown[name][0], name, shown[name][1]) for name in columns]


def _keep_end(text: str, cells: int) -> str:
    """Shorten a long name at its beginning: ports differ at the end."""
    return text if width(text) <= cells else "…" + text[1 - cells :]


def load_bar(load: float | None, *, bar: bool) -> str:
    """Format the load as a percentage, with ``bar`` after a bar."""
    if load is None:
        return "–"
    full = min(_BAR_CELLS, round(load * _BAR_CELLS))
    drawn = "█" * full + "░" * (_BAR_CELLS - full) + " " if bar else ""
    return f"{drawn}{load * 100:3.0f} %"


class CellTable(DataTable[Text]):
    """DataTable that redraws only changed cells."""

    def __init__(self, key_prefix: str, **rest: Any) -> None:
        super().__init__(cell_padding=0, **rest)
        self._key_prefix = key_prefix
        self._rows: list[list[Text]] = []

    def set_columns(self, widths: Mapping[str, int], rows: Sequence[list[Text]]) -> None:
        """Replace the columns and rows; keep the selected row."""
        selected = self.cursor_row
        self.clear(columns=True)
        for name, cells in widths.items():
            self.add_column(_cell(output.text(f"live.{self._key_prefix}.{name}"), name), key=name, width=cells)
        self._rows = []
        self.update_rows(rows)
        if rows:
            self.move_cursor(row=selected)

    def update_rows(self, rows: Sequence[list[Text]]) -> None:
        """Show these rows; their number only grows, because a drive or bus that goes offline keeps its row."""
        for index, row in enumerate(rows):
            if index == len(self._rows):
                self._rows.append(row)
                self.add_row(*row)
            for column, cell in enumerate(row):
                if cell != self._rows[index][column] or cell.style != self._rows[index][column].style:
                    self.update_cell_at(Coordinate(index, column), cell)
            self._rows[index] = row


def _cell(text: str, name: str, style: str = "") -> Text:
    side: Literal["left", "right"] = "right" if name in _RIGHT_ALIGNED else "left"
    return Text(text, style=style, justify=side, no_wrap=True, overflow="ellipsis")
