"""``demo``: a virtual plant of all four families, in the browser or in the terminal."""

from __future__ import annotations

import click

from drivebus.cli.command import Option, Verb
from drivebus.cli.exits import Exit
from drivebus.cli.options import PERIOD_S, Checked
from drivebus.cli.server import need_server


def _demo(terminal: bool, plain: bool, memory: bool, period: float, port: int) -> Exit:
    if terminal or plain or memory:
        return _in_terminal(plain, memory, period)
    need_server()
    from drivebus.cli.demo.dashboard import show

    return show(port)


def _in_terminal(plain: bool, memory: bool, period: float) -> Exit:
    from drivebus.cli.demo.plant import MemoryPlant, make_plant
    from drivebus.cli.demo.stage import Stage
    from drivebus.cli.live.start import show

    stage = Stage(MemoryPlant() if memory else make_plant())
    return show(stage, stage, plain, period)


command = Verb(
    "demo",
    callback=_demo,
    params=[
        Option(["--terminal"], is_flag=True),
        Option(
            ["--port"],
            type=Checked(click.IntRange(1, 65535), "cli.expect.port"),
            default=8080,
            metavar="N",
            example="--port 8090",
            key="help.option.demo_port",
        ),
        Option(["--plain"], is_flag=True),
        Option(["--memory"], is_flag=True),
        Option(["--period"], type=PERIOD_S, default=5.0, metavar="S", example="--period 2"),
    ],
    examples=(
        "drivebus demo",
        "drivebus demo --lang zh --port 8090",
        "drivebus demo --terminal",
        "drivebus demo --plain --period 2",
        "drivebus demo --plain --json",
    ),
)
