"""``completion``: the script that teaches a shell our verbs."""

from __future__ import annotations

from drivebus.cli import voice
from drivebus.cli.command import Argument, OneOf, Verb


def _complete(shell: str) -> None:
    from click.shell_completion import get_completion_class

    from drivebus.cli.root import cli

    kind = get_completion_class(shell)
    if kind is not None:
        script = kind(cli, {}, "drivebus", "_DRIVEBUS_COMPLETE").source_template % _names()
        voice.document({"shell": shell, "script": script})
        voice.show(script)


def _names() -> dict[str, str]:
    return {
        "complete_func": "_drivebus_completion",
        "complete_var": "_DRIVEBUS_COMPLETE",
        "prog_name": "drivebus",
    }


command = Verb(
    "completion",
    callback=_complete,
    params=[Argument(["shell"], type=OneOf(["bash", "zsh", "fish"]), metavar="SHELL")],
    examples=("drivebus completion bash >> ~/.bashrc", "drivebus completion fish"),
)
