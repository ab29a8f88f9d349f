"""Reference of the command line: usage, arguments, options and examples of each command, from its declaration."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import click

from drivebus.cli import output
from drivebus.cli.click_ext import Argument, LazyGroup, Option
from drivebus.cli.main import cli
from generator.terms import table, term

COMMON = {"lang", "json", "help"}


def page(language: str) -> str:
    """Return all commands in the order of ``drivebus --help``."""
    output.parse_global_options(["--lang", language])
    return "\n".join(_sections(cli, (), language))


def _sections(group: LazyGroup, path: tuple[str, ...], language: str) -> Iterator[str]:
    context = click.Context(group, info_name="drivebus")
    for heading, names in group.sections.items():
        if not path:
            yield f"## {output.text(heading).rstrip(':：')}\n"
        for name in names:
            command = group.get_command(context, name)
            assert command is not None
            yield from _command_section(command, (*path, name), language)


def _command_section(command: click.Command, path: tuple[str, ...], language: str) -> Iterator[str]:
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
    """Yield arguments and the command's own options; the page lists the common ones once."""
    rows = [(f"`{p.make_metavar(context)}`", output.text(p.key)) for p in command.params if isinstance(p, Argument)]
    own = [p for p in command.params if isinstance(p, Option) and p.name not in COMMON]
    rows += [
        (f"`{names}`", sentence) for p in own if (record := p.get_help_record(context)) for names, sentence in [record]
    ]
    if rows:
        yield table([term("name", language), term("meaning", language)], rows)
