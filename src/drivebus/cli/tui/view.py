"""Show a feed: full screen on a terminal, plain lines elsewhere."""

from __future__ import annotations

import asyncio
import sys

from drivebus.cli import output
from drivebus.cli.errors import ExitCode
from drivebus.cli.extras import require_extra
from drivebus.cli.tui.row_source import KeyCommands, RowSource


def run_view(
    feed: RowSource, control: KeyCommands | None, plain: bool, period_s: float, duration_s: float | None = None
) -> ExitCode:
    """Until the user, the feed, a signal or ``duration_s`` ends it."""
    if plain or output.as_json() or not (sys.stdout.isatty() and sys.stdin.isatty()):
        return asyncio.run(_run_plain(feed, period_s, duration_s))
    require_extra("tui")
    from drivebus.cli.tui.app import MonitorApp
    from drivebus.cli.tui.threaded import ThreadedRowSource

    threaded = ThreadedRowSource(feed, control)
    screen = MonitorApp(threaded, threaded if control is not None else None, duration_s)
    screen.run()
    if screen.failure is not None:
        raise screen.failure
    return ExitCode.DONE


async def _run_plain(feed: RowSource, period_s: float, duration_s: float | None) -> ExitCode:
    from drivebus.cli.signals import shutdown_signals
    from drivebus.cli.tui.plain import print_rows

    with shutdown_signals() as ending:
        timer = duration_s and asyncio.get_running_loop().call_later(duration_s, ending.request, "duration")
        await print_rows(feed, ending, period_s)
        if timer:
            timer.cancel()
    return ExitCode.INTERRUPTED if ending.cause == "SIGINT" else ExitCode.DONE
