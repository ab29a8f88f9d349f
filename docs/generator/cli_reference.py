"""The command line as pages: every verb with its usage, arguments, options and examples, from the verbs themselves."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import click

from drivebus.cli import output
from drivebus.cli.click_ext import Argument, LazyGroup, Option
from drivebus.cli.main import cli
from generator.words import say, table

COMMON = {"lang", "json", "help"}


def page(language: str) -> str:
    """All verbs in the order of ``drivebus --help``."""
    output.parse_global_options(["--lang", language])
    return "\n".join(_sections(cli, (), language))


def _sections(group: LazyGroup, path: tuple[str, ...], language: str) -> Iterator[str]:
    context = click.Context(group, info_name="drivebus")
    for heading, verbs in group.sections.items():
        if not path:
            yield f"## {output.text(heading).rstrip(':：')}\n"
        for name in verbs:
            command = group.get_command(context, name)
            assert command is not None
            yield from _verb(command, (*path, name), language)


def _verb(command: click.Command, path: tuple[str, ...], language: str) -> Iterator[str]:
    context = click.Context(command, info_name=" ".join(("drivebus", *path)))
    pieces = " ".join([context.command_path, *command.collect_usage_pieces(context)])
    yield f"### `drivebus {' '.join(path)}`\n"
    yield f"```\n{pieces}\n```\n"
    yield output.text(f"help.{command.help_key}.long") + "\n"  # type: ignore[attr-defined]
    yield from _parameters(command, context, language)
    examples: Sequence[str] = command.examples  # type: ignore[attr-defined]
    if examples:
        yield "```\n" + "\n".join(examples) + "\n```\n"
    if isinstance(command, LazyGroup):
        yield from _sections(command, path, language)


def _parameters(command: click.Command, context: click.Context, language: str) -> Iterator[str]:
    """Arguments and the verb's own options; those that all have stand once, above."""
    rows = [(f"`{p.make_metavar(context)}`", output.text(p.key)) for p in command.params if isinstance(p, Argument)]
    own = [p for p in command.params if isinstance(p, Option) and p.name not in COMMON]
    rows += [
        (f"`{names}`", sentence) for p in own if (record := p.get_help_record(context)) for names, sentence in [record]
    ]
    if rows:
        yield table([say("name", language), say("meaning", language)], rows)
