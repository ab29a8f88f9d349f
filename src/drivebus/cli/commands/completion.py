"""``completion``: print the completion script of a shell."""

from __future__ import annotations

from drivebus.cli import output
from drivebus.cli.click_ext import COMPLETION_VARIABLE, Argument, Choice, CliCommand

COMPLETION_NAMES = {
    "complete_func": "_drivebus_completion",
    "complete_var": COMPLETION_VARIABLE,
    "prog_name": "drivebus",
}
"""Names in the script of click."""


def _complete(shell: str) -> None:
    from click.shell_completion import get_completion_class

    from drivebus.cli.main import cli

    kind = get_completion_class(shell)
    if kind is not None:
        script = kind(cli, {}, "drivebus", COMPLETION_VARIABLE).source_template % COMPLETION_NAMES
        output.print_json({"shell": shell, "script": script})
        output.print_text(script)


command = CliCommand(
    "completion",
    callback=_complete,
    params=[Argument(["shell"], type=Choice(["bash", "zsh", "fish"]), metavar="SHELL")],
    examples=("drivebus completion bash >> ~/.bashrc", "drivebus completion fish"),
)
