"""The live view without a terminal: lines of text, or a JSON document a line."""

from __future__ import annotations

import click

from drivebus.cli import output
from drivebus.cli.output import pad
from drivebus.cli.signals import ShutdownSignal
from drivebus.cli.tui.row_source import RowSource
from drivebus.cli.tui.rows import COLUMN_SIGNALS, BusRow, DriveRow

MESSAGE_CHECK_PERIOD_S = 0.2
"""How often news are looked for."""


async def print_rows(feed: RowSource, ending: ShutdownSignal, period_s: float) -> None:
    """Print news at once and all rows every ``period_s``, until the feed is over or the end comes."""
    await feed.start()
    try:
        told, next_at = 0, 0.0
        output.print_text(feed.title)
        while True:
            told = _print_new_messages(feed, told)
            if feed.now() >= next_at:
                _print_all_rows(feed)
                next_at = feed.now() + period_s
            if feed.over or await ending.wait(MESSAGE_CHECK_PERIOD_S):
                break
        _print_new_messages(feed, told)
        _print_all_rows(feed)
    finally:
        await feed.close()


def _print_new_messages(feed: RowSource, told: int) -> int:
    news = list(feed.news())
    for text in news[told:]:
        output.print_json({"event": text}, stream=True)
        output.print_text(text)
    return len(news)


def _print_all_rows(feed: RowSource) -> None:
    now = feed.now()
    drives, lines = feed.drives(), feed.lines()
    if output.as_json():
        document = {"drives": [row.to_json(now) for row in drives], "lines": [row.to_json() for row in lines]}
        output.print_json(document, stream=True)
        return
    for row in drives:
        click.echo(drive_text(row, now))
    for line in lines:
        click.echo(bus_text(line))


def drive_text(row: DriveRow, now: float) -> str:
    """One drive as a line of text."""
    values = "  ".join(f"{output.text(f'live.drive.{name}')} {row.cell(name):>6}" for name in COLUMN_SIGNALS)
    head = f"  {pad(row.name, 13)} {pad(row.state_text(), 13)} {pad(row.direction_text(), 5)}"
    fault = f"  {row.fault_label} {row.fault_text}" if row.fault_label else ""
    return f"{head} {values}  {output.text('live.drive.age')} {row.age_text(now)}{fault}"


def bus_text(row: BusRow) -> str:
    """One line (of the plant) as a line of text."""
    up = output.text("live.link.up" if row.up else "live.link.lost")
    load = "–" if row.load is None else f"{row.load * 100:.0f} %"
    rate = "–" if row.transactions_per_s is None else f"{row.transactions_per_s:.1f}"
    labels = {name: output.text(f"live.line.{name}").strip() for name in ("load", "rate", "errors")}
    return (
        f"  {pad(row.name, 13)} {pad(row.settings, 11)} {pad(up, 6)} {labels['load']} {load}  "
        f"{labels['rate']} {rate}  {labels['errors']}: {row.errors_text()}"
    )
