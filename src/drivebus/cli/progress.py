"""A progress bar on a terminal, silence elsewhere."""

from __future__ import annotations

import sys
from typing import Any

from drivebus.cli import output


class ProgressBar:
    """One bar on standard error with a description and the time that is left."""

    def __init__(self) -> None:
        self._bar: Any = None
        self._task: Any = None

    def __enter__(self) -> ProgressBar:
        if sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, Progress, TextColumn

            columns = (TextColumn("{task.description}"), BarColumn(bar_width=None), TextColumn("{task.fields[left]}"))
            self._bar = Progress(*columns, console=Console(stderr=True), transient=True)
            self._task = self._bar.add_task("", total=1.0, left="")
            self._bar.start()
        return self

    def __exit__(self, *exc: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    def update(self, what: str, done: float, total: float) -> None:
        """``done`` of ``total`` seconds."""
        if self._bar is not None:
            left = output.text("scan.left", time=format_minutes(max(0.0, total - done)))
            self._bar.update(self._task, description=what, total=total, completed=done, left=left)

    def update_count(self, what: str, done: int, total: int, unit: str) -> None:
        """``done`` of ``total`` trials."""
        if self._bar is not None:
            self._bar.update(self._task, description=what, total=total, completed=done, left=f"{done}/{total} {unit}")

    def print_above(self, text: str) -> None:
        """A line above the bar; nothing where there is no bar."""
        if self._bar is not None:
            self._bar.console.print(text, markup=False, highlight=False)


def format_minutes(seconds: float) -> str:
    """Minutes and seconds."""
    whole = int(seconds + 0.5)
    return f"{whole // 60}:{whole % 60:02d}"


def format_duration(seconds: float) -> str:
    """``31 min 50 s``, ``2 s``; never 0."""
    minutes, rest = divmod(max(1, int(seconds + 0.5)), 60)
    return output.text("scan.long" if minutes else "scan.short", minutes=minutes, seconds=rest)
