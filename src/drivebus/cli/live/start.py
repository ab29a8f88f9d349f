"""Show a feed: full screen on a terminal, plain lines elsewhere."""

from __future__ import annotations

import asyncio
import sys

from drivebus.cli import voice
from drivebus.cli.exits import Exit
from drivebus.cli.live.feed import Control, Feed


def show(feed: Feed, control: Control | None, plain: bool, period_s: float, duration_s: float | None = None) -> Exit:
    """Until the user, the feed, a signal or ``duration_s`` ends it."""
    if plain or voice.as_json() or not (sys.stdout.isatty() and sys.stdin.isatty()):
        return asyncio.run(_plain(feed, period_s, duration_s))
    from drivebus.cli.live.screen import Screen
    from drivebus.cli.live.thread import Threaded

    threaded = Threaded(feed, control)
    screen = Screen(threaded, threaded if control is not None else None, duration_s)
    screen.run()
    if screen.failure is not None:
        raise screen.failure
    return Exit.DONE


async def _plain(feed: Feed, period_s: float, duration_s: float | None) -> Exit:
    from drivebus.cli.ending import listening
    from drivebus.cli.live.plain import follow

    with listening() as ending:
        timer = duration_s and asyncio.get_running_loop().call_later(duration_s, ending.end, "duration")
        await follow(feed, ending, period_s)
        if timer:
            timer.cancel()
    return Exit.INTERRUPTED if ending.cause == "SIGINT" else Exit.DONE
