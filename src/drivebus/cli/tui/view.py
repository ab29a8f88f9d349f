"""Show a row source: full screen on a terminal, text elsewhere."""

from __future__ import annotations

import asyncio
import os
import sys

from drivebus.cli import output
from drivebus.cli.errors import ExitCode
from drivebus.cli.extras import require_extra
from drivebus.cli.tui.row_source import KeyCommands, RowSource


def run_view(
    source: RowSource, commands: KeyCommands | None, *, plain: bool, period_s: float, duration_s: float | None = None
) -> ExitCode:
    """Show the rows until the user, the source, a signal or ``duration_s`` ends the view."""
    if plain or output.as_json() or not _has_screen():
        return asyncio.run(_run_plain(source, period_s, duration_s))
    require_extra("tui")
    from drivebus.cli.tui.app import MonitorApp
    from drivebus.cli.tui.threaded import ThreadedRowSource

    threaded = ThreadedRowSource(source, commands)
    screen = MonitorApp(threaded, threaded if commands is not None else None, duration_s)
    screen.run()
    if screen.failure is not None:
        raise screen.failure
    return ExitCode.DONE


def _has_screen() -> bool:
    """Return whether standard input and output are a terminal that has a cursor."""
    is_dumb = os.name == "posix" and os.environ.get("TERM", "") in ("", "dumb")
    return sys.stdout.isatty() and sys.stdin.isatty() and not is_dumb


async def _run_plain(source: RowSource, period_s: float, duration_s: float | None) -> ExitCode:
    from drivebus.cli.signals import shutdown_signals
    from drivebus.cli.tui.plain import print_rows

    with shutdown_signals() as shutdown:
        timer = duration_s and asyncio.get_running_loop().call_later(duration_s, shutdown.request, "duration")
        await print_rows(source, shutdown, period_s)
        if timer:
            timer.cancel()
    return ExitCode.INTERRUPTED if shutdown.cause == "SIGINT" else ExitCode.DONE
