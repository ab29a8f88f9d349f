"""Entry point and tree of the commands.

It imports only what the help needs: ``drivebus --help`` must cost little more than click.
"""

from __future__ import annotations

import click

from drivebus.cli import output
from drivebus.cli.click_ext import LazyGroup, Option


def _commands(*names: str) -> dict[str, str]:
    return {name: f"drivebus.cli.commands.{name.replace('-', '_')}:command" for name in names}


SECTIONS = {
    "cli.section.first": _commands("demo", "simulate"),
    "cli.section.look": _commands("status", "monitor", "read", "scan", "loopback"),
    "cli.section.move": _commands(
        "run", "jog", "set-frequency", "pause", "hold-ramp", "stop", "coast", "reset", "control", "release"
    ),
    "cli.section.change": _commands("write", "calibrate", "comm-loss-test", "waive"),
    "cli.section.plant": _commands("init", "check", "serve", "user", "audit"),
    "cli.section.tools": _commands("decode", "models", "ports", "profile", "capture", "acceptance", "completion"),
}


def _version(ctx: click.Context, option: click.Parameter, value: bool) -> None:
    if value and not ctx.resilient_parsing:
        from importlib.metadata import version

        number = version("drivebus")
        output.print_text(f"drivebus {number}")
        output.print_json({"version": number})
        ctx.exit()


cli = LazyGroup(
    "drivebus",
    help_key="drivebus",
    sections=SECTIONS,
    no_args_is_help=True,
    params=[Option(["-V", "--version"], is_flag=True, is_eager=True, expose_value=False, callback=_version)],
    examples=(
        "drivebus demo",
        "drivebus scan /dev/ttyUSB0 --models c320,vc660",
        "drivebus status sim://c320@1 --model c320 --address 1",
        "drivebus run /dev/ttyUSB0 --model vc660 --address 3 --frequency 25 --dry-run",
    ),
)


def main() -> None:
    """Run the ``drivebus`` command."""
    cli(prog_name="drivebus")
