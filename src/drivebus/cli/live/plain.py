"""The live view without a terminal: lines of text, or a JSON document a line."""

from __future__ import annotations

import click

from drivebus.cli import voice
from drivebus.cli.ending import Ending
from drivebus.cli.layout import pad
from drivebus.cli.live.feed import Feed
from drivebus.cli.live.model import SIGNALS, DriveRow, LineRow

LOOK_S = 0.2
"""How often news are looked for."""


async def follow(feed: Feed, ending: Ending, period_s: float) -> None:
    """Print news at once and all rows every ``period_s``, until the feed is over or the end comes."""
    await feed.start()
    try:
        told, next_at = 0, 0.0
        voice.show(feed.title)
        while True:
            told = _tell(feed, told)
            if feed.now() >= next_at:
                _show(feed)
                next_at = feed.now() + period_s
            if feed.over or await ending.wait(LOOK_S):
                break
        _tell(feed, told)
        _show(feed)
    finally:
        await feed.close()


def _tell(feed: Feed, told: int) -> int:
    news = list(feed.news())
    for text in news[told:]:
        voice.document({"event": text}, stream=True)
        voice.show(text)
    return len(news)


def _show(feed: Feed) -> None:
    now = feed.now()
    drives, lines = feed.drives(), feed.lines()
    if voice.as_json():
        document = {"drives": [row.as_document(now) for row in drives], "lines": [row.as_document() for row in lines]}
        voice.document(document, stream=True)
        return
    for row in drives:
        click.echo(drive_line(row, now))
    for line in lines:
        click.echo(line_line(line))


def drive_line(row: DriveRow, now: float) -> str:
    """One drive as a line of text."""
    values = "  ".join(f"{voice.say(f'live.drive.{name}')} {row.cell(name):>6}" for name in SIGNALS)
    head = f"  {pad(row.name, 13)} {pad(row.state_text(), 13)} {pad(row.direction_text(), 5)}"
    fault = f"  {row.fault_label} {row.fault_text}" if row.fault_label else ""
    return f"{head} {values}  {voice.say('live.drive.age')} {row.age_text(now)}{fault}"


def line_line(row: LineRow) -> str:
    """One line (of the plant) as a line of text."""
    up = voice.say("live.link.up" if row.up else "live.link.lost")
    load = "–" if row.load is None else f"{row.load * 100:.0f} %"
    rate = "–" if row.transactions_per_s is None else f"{row.transactions_per_s:.1f}"
    return (
        f"  {pad(row.name, 13)} {pad(row.settings, 11)} {pad(up, 6)} {voice.say('live.line.load')} {load}  "
        f"{voice.say('live.line.rate').strip()} {rate}  {voice.say('live.line.errors').strip()}: {row.errors_text()}"
    )
