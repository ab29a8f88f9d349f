"""Live view without a terminal: text, or JSON documents one per line."""

from __future__ import annotations

import sys

from drivebus.cli import output
from drivebus.cli.output import pad
from drivebus.cli.signals import ShutdownSignal
from drivebus.cli.tui.row_source import RowSource
from drivebus.cli.tui.rows import COLUMN_SIGNALS, BusRow, DriveRow

MESSAGE_CHECK_PERIOD_S = 0.2  # between two checks for new messages


async def print_rows(source: RowSource, shutdown: ShutdownSignal, period_s: float) -> None:
    """Print messages at once and all rows every ``period_s``, until the source is finished or a shutdown."""
    await source.start()
    try:
        printed, next_at = 0, 0.0
        output.print_wrapped(source.title)
        while True:
            printed = _print_new_messages(source, printed)
            if source.now() >= next_at:
                _print_all_rows(source)
                next_at = source.now() + period_s
            if source.finished or await shutdown.wait(MESSAGE_CHECK_PERIOD_S):
                break
        _print_new_messages(source, printed)
        _print_all_rows(source)
    finally:
        await source.close()


def _print_new_messages(source: RowSource, printed: int) -> int:
    """Print the messages after the first ``printed``; return their new number."""
    messages = list(source.messages())
    for text in messages[printed:]:
        output.print_json({"event": text}, stream=True)
        output.print_wrapped(text)
    return len(messages)


def _print_all_rows(source: RowSource) -> None:
    now = source.now()
    drives, buses = source.drives(), source.buses()
    if output.as_json():
        document = {"drives": [row.to_json(now) for row in drives], "buses": [row.to_json() for row in buses]}
        output.print_json(document, stream=True)
        return
    for row in drives:
        output.echo(drive_text(row, now))
    for bus in buses:
        output.echo(bus_text(bus))


def drive_text(row: DriveRow, now: float) -> str:
    """Format one drive."""
    head = f"{pad(row.name_text(), 13)} {pad(row.state_text(), 13)} {pad(row.direction_text(), 4)}"
    values = [f"{output.text(f'live.drive.{name}')} {row.cell(name):>6}" for name in COLUMN_SIGNALS]
    return _row_text(head, *values, f"{output.text('live.drive.age')} {row.age_text(now)}", row.fault_cell())


def bus_text(row: BusRow) -> str:
    """Format one bus."""
    up = output.text("live.link.up" if row.up else "live.link.lost")
    load = "–" if row.load is None else f"{row.load * 100:.0f} %"
    rate = "–" if row.transactions_per_s is None else f"{row.transactions_per_s:.1f}"
    labels = {name: output.text(f"live.bus.{name}").strip() for name in ("load", "rate", "errors")}
    errors = output.text("live.counted", name=labels["errors"], counts=row.errors_text())
    head = f"{pad(row.name, 13)} {pad(row.settings, 11)} {pad(up, 5)}"
    return _row_text(head, f"{labels['load']} {load}", f"{labels['rate']} {rate}", errors)


def _row_text(*values: str) -> str:
    """Format the values of a row: in lines that fit the terminal, or in one line of a file or a pipe."""
    first, *further = output.fill_lines(values, output.terminal_width(sys.stdout) - 4)
    return "\n".join([f"  {first.rstrip()}", *(f"    {line}" for line in further)])
