"""``demo``: a virtual plant of twelve drives, in the browser or in the terminal."""

from __future__ import annotations

from drivebus.cli.click_ext import CliCommand, Option
from drivebus.cli.errors import ExitCode
from drivebus.cli.extras import require_extra
from drivebus.cli.options import PERIOD, CheckedType, NumberType


def _demo(*, terminal: bool, plain: bool, memory: bool, period: float, port: int) -> ExitCode:
    if terminal or plain or memory:
        from drivebus.cli.demo.terminal import DemoClient
        from drivebus.cli.tui.view import run_view

        client = DemoClient(memory=memory)
        return run_view(client, client, plain=plain, period_s=period)
    require_extra("server")
    from drivebus.cli.demo.host import run_demo

    return run_demo(port)


command = CliCommand(
    "demo",
    callback=_demo,
    params=[
        Option(["--terminal"], is_flag=True),
        Option(
            ["--port"],
            type=CheckedType(NumberType(1, 65535), "cli.expect.port"),
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
