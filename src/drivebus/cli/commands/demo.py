"""``demo``: a virtual plant of all four families, in the browser or in the terminal."""

from __future__ import annotations

import click

from drivebus.cli.click_ext import CliCommand, Option
from drivebus.cli.errors import ExitCode
from drivebus.cli.extras import require_extra
from drivebus.cli.options import PERIOD, CheckedType


def _demo(terminal: bool, plain: bool, memory: bool, period: float, port: int) -> ExitCode:
    if terminal or plain or memory:
        return _in_terminal(plain, memory, period)
    require_extra("server")
    from drivebus.cli.demo.dashboard import show

    return show(port)


def _in_terminal(plain: bool, memory: bool, period: float) -> ExitCode:
    from drivebus.cli.demo.plant import MemoryDemoPlant, create_demo_plant
    from drivebus.cli.demo.stage import Stage
    from drivebus.cli.tui.view import run_view

    stage = Stage(MemoryDemoPlant() if memory else create_demo_plant())
    return run_view(stage, stage, plain, period)


command = CliCommand(
    "demo",
    callback=_demo,
    params=[
        Option(["--terminal"], is_flag=True),
        Option(
            ["--port"],
            type=CheckedType(click.IntRange(1, 65535), "cli.expect.port"),
            default=8080,
            metavar="N",
            example="--port 8090",
            key="help.option.demo_port",
        ),
        Option(["--plain"], is_flag=True),
        Option(["--memory"], is_flag=True),
        Option(["--period"], type=PERIOD, default=5.0, metavar="S", example="--period 2"),
    ],
    examples=(
        "drivebus demo",
        "drivebus demo --lang zh --port 8090",
        "drivebus demo --terminal",
        "drivebus demo --plain --period 2",
        "drivebus demo --plain --json",
    ),
)
