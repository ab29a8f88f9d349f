"""click commands, options and arguments with texts from the catalogues and a layout for Chinese characters."""

from __future__ import annotations

import os
import re
import shutil
import sys
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from contextvars import ContextVar, copy_context
from importlib import import_module
from itertools import zip_longest
from pathlib import Path
from typing import Any

import click
from click.shell_completion import CompletionItem

from drivebus.cli import errors, output
from drivebus.cli.early_interrupt import end_interrupt_on_sigterm
from drivebus.cli.stop_errors import note_no_stop
from drivebus.terminal import PLAIN_ENCODING, discard_output

COMPLETION_VARIABLE = "_DRIVEBUS_COMPLETE"
"""Environment variable with which a shell asks for completions."""
_MAX_HELP_CELLS = 100
_MIN_HELP_CELLS = 50
_FILE_METAVAR = re.compile(r"FILE|PLANT|DIR|FOLDER|PATH|PORT|OUT|MODEL|SOCKET")
"""Placeholders of files: a port may be a link to a pty, a model the file of a profile."""
LIST_METAVAR = ",..."
"""End of the placeholder of an option whose one value is a list: ``--address N,...``."""


class _FileCompletion(click.Parameter):
    """Parameter whose value the shell completes as a file where nothing else fits and its placeholder names one."""

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        found = super().shell_complete(ctx, incomplete)
        if found or _FILE_METAVAR.search(self.metavar or "") is None:
            return found
        return [CompletionItem(incomplete, type="file")]


_UNUSED_VALUES = "drivebus.unused_values"
"""Key of the options in ``click.Context.meta`` whose value is invalid and is left out where the command stops."""


class Option(_FileCompletion, click.Option):
    """An option with the help text ``help.<key>``; ``example`` is a value that works.

    ``unused``: key of the note after a stop, which an invalid value of this option does not prevent.
    """

    def __init__(self, *names: Any, key: str = "", example: str = "", unused: str = "", **rest: Any) -> None:
        super().__init__(*names, **rest)
        self.key = key or f"help.option.{self.name}"
        self.example = example
        self.unused = unused

    def get_help_record(self, ctx: click.Context) -> tuple[str, str] | None:
        names = ", ".join(sorted([*self.opts, *self.secondary_opts], key=len))
        takes = "" if self.is_flag else f" {self.make_metavar(ctx)}"
        return names + takes, self.help_text()

    def add_to_parser(self, parser: Any, ctx: click.Context) -> None:
        """Keep every value of an option that takes one: click would keep the last and drop the others silently."""
        if self.is_flag or self.multiple or self.count:
            super().add_to_parser(parser, ctx)
        else:
            parser.add_option(obj=self, opts=self.opts, dest=self.name, action="append", nargs=self.nargs)

    def consume_value(self, ctx: click.Context, opts: Mapping[str, Any]) -> tuple[Any, Any]:
        """Return the value of an option. Raises BadParameter for two that differ."""
        occurrences = opts.get(self.name or "")
        if isinstance(occurrences, list):
            self._require_values(ctx, occurrences)
        if self.is_flag or self.multiple or not isinstance(occurrences, list):
            return super().consume_value(ctx, opts)
        if len(set(occurrences)) > 1:
            key = "cli.given_twice_list" if (self.metavar or "").endswith(LIST_METAVAR) else "cli.given_twice"
            problem = output.text(
                key,
                values=output.join(occurrences, "items"),
                example=f"{max(self.opts, key=len)} {','.join(occurrences)}",
            )
            error = click.BadParameter(problem, ctx, self)
            if not self._leaves_out(ctx, error):
                raise error
            occurrences = [None]
        return super().consume_value(ctx, {**opts, str(self.name): occurrences[0]})

    def type_cast_value(self, ctx: click.Context, value: Any) -> Any:
        """Return the converted value, None for an invalid one that prevents no stop. Raises BadParameter."""
        try:
            return super().type_cast_value(ctx, value)
        except click.BadParameter as error:
            if not self._leaves_out(ctx, error):
                raise
            return None

    def _leaves_out(self, ctx: click.Context, error: click.UsageError) -> bool:
        """Return whether an invalid value is left out, with a note after the stop, because it prevents none."""
        if not (self.unused and getattr(ctx.command, "stops", False)):
            return False
        ctx.meta.setdefault(_UNUSED_VALUES, {})[self.unused] = error
        return True

    def without_faulty_value(self, ctx: click.Context, words: Sequence[str]) -> list[str]:
        """Return the words of a command without this option where its value is missing, or without a flag's value.

        Only where that prevents no stop; click would refuse the command before it converts any value.
        """
        end = words.index("--") if "--" in words else len(words)
        remove_value = self._without_flag_value if self.is_flag else self._without_missing_value
        return [*remove_value(ctx, words[:end]), *words[end:]]

    def _without_flag_value(self, ctx: click.Context, words: Sequence[str]) -> list[str]:
        words_left = []
        for word in words:
            name, separator, _ = word.partition("=")
            has_value = name in self.opts and bool(separator)
            is_left_out = has_value and self._leaves_out(ctx, click.BadOptionUsage(name, errors.FLAG_WITH_VALUE))
            words_left.append(name if is_left_out else word)
        return words_left

    def _without_missing_value(self, ctx: click.Context, words: Sequence[str]) -> list[str]:
        options = {name for param in ctx.command.params if isinstance(param, click.Option) for name in param.opts}
        words_left = []
        for word, following in zip_longest(words, words[1:]):
            is_missing = word in self.opts and (following is None or following.partition("=")[0] in options)
            if not (is_missing and self._leaves_out(ctx, click.BadOptionUsage(word, ""))):
                words_left.append(word)
        return words_left

    def help_text(self) -> str:
        """Return the explanation, the default and the example."""
        text = output.text(self.key)
        if not self.example:
            return text
        default = self._default_text()
        key = "cli.default_and_example" if default else "cli.for_example"
        return text + output.text(key, default=default, example=self.example)

    def _default_text(self) -> str:
        """Return the default as it is typed; nothing for a flag, and without a default."""
        values = self.default if isinstance(self.default, list) else [self.default]
        if self.is_flag or not all(isinstance(value, str | int | float | Path) for value in values):
            return ""
        return output.join([f"{value:g}" if isinstance(value, float) else str(value) for value in values], "items")

    def _require_values(self, ctx: click.Context, values: list[Any]) -> None:
        """Raise BadOptionUsage where the value is the next option of the command: the value of this one is missing."""
        option_names = {
            name for param in ctx.command.get_params(ctx) for name in param.opts if isinstance(param, click.Option)
        }
        if option_names & {value.partition("=")[0] for value in values if isinstance(value, str)}:
            raise click.BadOptionUsage(max(self.opts, key=len), "", ctx)


class Choice(click.Choice[str]):
    """Choice among a few words; a wrong value is reported in the user's language."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        try:
            return super().convert(value, param, ctx)
        except click.BadParameter:
            expected = output.text("cli.expect.one_of", choices=output.join(self.choices, "items"))
            self.fail(output.text("cli.found_expected", found=value, expected=expected), param, ctx)


class Argument(_FileCompletion, click.Argument):
    """An argument with the help text ``help.<key>``."""

    def __init__(self, *names: Any, key: str = "", **rest: Any) -> None:
        super().__init__(*names, **rest)
        self.key = key or f"help.argument.{self.name}"


class _LocalizedHelp:
    """Help page of commands and groups in the user's language."""

    examples: Sequence[str] = ()
    help_key: str = ""

    def _help_page(self, command: click.Command, ctx: click.Context, body: Sequence[tuple[str, str]]) -> str:
        usage = " ".join([ctx.command_path, *command.collect_usage_pieces(ctx)])
        explanation = output.paragraphs(output.text(f"help.{self.help_key}.long"), _help_cells())
        parts = [output.text("cli.usage", usage=usage), explanation]
        parts += [f"{title}\n{text}" for title, text in body if text]
        if self.examples:
            parts.append(output.text("cli.examples") + "\n" + "\n".join(f"  {line}" for line in self.examples))
        return "\n\n".join(parts) + "\n"

    def _options_help(self, command: click.Command, ctx: click.Context) -> str:
        options = [param for param in command.get_params(ctx) if isinstance(param, click.Option)]
        rows = [row for option in options if (row := option.get_help_record(ctx))]
        return output.two_columns(rows, _help_cells())


_has_begun: ContextVar[bool] = ContextVar("drivebus_command_has_begun", default=False)
"""Whether the command was called; before that it sends nothing."""


class CliCommand(_LocalizedHelp, click.Command):
    """Command of the command line. ``examples`` are command lines that work as they stand; a test parses each.

    ``stops``: it stops drives, and an error before its first frame says that no stop was sent.
    """

    def __init__(
        self, name: str, *, examples: Sequence[str] = (), help_key: str = "", stops: bool = False, **rest: Any
    ) -> None:
        super().__init__(name, **rest)
        self.examples = examples
        self.help_key = help_key or name
        self.stops = stops
        self.params += common_options()

    def make_context(self, *args: Any, **named: Any) -> click.Context:
        with note_no_stop() if self.stops else nullcontext():
            return super().make_context(*args, **named)

    def invoke(self, ctx: click.Context) -> Any:
        end_interrupt_on_sigterm()
        _has_begun.set(True)
        try:
            with note_no_stop() if self.stops else nullcontext():
                return super().invoke(ctx)
        finally:
            with output.continue_without_output():
                for key, error in ctx.meta.get(_UNUSED_VALUES, {}).items():
                    output.print_note(key, why=errors.usage_text(error))

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse as click does, without invalid values that prevent no stop; an error names what was typed and meant."""
        words = list(args)
        if not self.stops and not ctx.resilient_parsing:
            for error in ctx.meta.get(_UNUSED_VALUES, {}).values():  # an option before the name of the command
                raise error
        for param in self.params:
            if isinstance(param, Option) and param.unused:
                args = param.without_faulty_value(ctx, args)
        try:
            return super().parse_args(ctx, args)
        except click.NoSuchOption as error:
            raise self._unknown_option_error(error, words, ctx) from None
        except click.BadOptionUsage as error:
            error.ctx = error.ctx or ctx  # the parser of click leaves it out
            raise

    def _unknown_option_error(
        self, error: click.NoSuchOption, words: Sequence[str], ctx: click.Context
    ) -> click.UsageError:
        """Return the error of an unknown option with the whole word that was typed, and the options that were meant."""
        known = [name for param in self.params for name in param.opts]
        word = next((word.partition("=")[0] for word in words if word[:2] == error.option_name), "--")
        if not word.startswith("--"):
            takes_frequency = any(param.metavar == "HZ" for param in self.params if isinstance(param, Argument))
            if takes_frequency and word[1:2].isdecimal():
                return click.UsageError(output.text("cli.no_negative_frequency"), ctx)
            return click.NoSuchOption(word, possibilities=[name for name in known if name == f"-{word}"], ctx=ctx)
        meant = [name for name in _OPTION_SYNONYMS.get(error.option_name, ()) if name in known]
        if meant:
            error.possibilities = meant  # type: ignore[misc]  # its constructor keeps only similar words
        return error

    def get_short_help_str(self, limit: int = 45) -> str:
        return output.text(f"help.{self.help_key}.short")

    def get_help_option(self, ctx: click.Context) -> click.Option | None:
        return help_option()

    def format_help(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        arguments = [(p.make_metavar(ctx), output.text(p.key)) for p in self.params if isinstance(p, Argument)]
        body = [
            (output.text("cli.arguments"), output.two_columns(arguments, _help_cells())),
            (output.text("cli.options"), self._options_help(self, ctx)),
        ]
        formatter.write(self._help_page(self, ctx, body))


_SYNONYMS = {
    "describe": ("decode", "models"),
    "doctor": ("ports", "check", "acceptance"),
    "emergency-stop": ("stop",),
    "estop": ("stop",),
    "explain": ("decode",),
    "find": ("scan",),
    "frequency": ("set-frequency",),
    "get": ("read",),
    "halt": ("stop",),
    "identify": ("scan",),
    "info": ("status", "models"),
    "list": ("models", "ports"),
    "listen": ("monitor",),
    "search": ("scan", "models"),
    "show": ("status",),
    "sniff": ("monitor",),
    "speed": ("set-frequency",),
    "start": ("run",),
    "trace": ("monitor", "capture"),
    "version": ("--version",),
}
"""Words for a command that other programs use, with what is meant here."""

_OPTION_SYNONYMS = {
    "--baudrate": ("--baud", "--bauds"),
    "--direction": ("--reverse",),
    "--hz": ("--frequency",),
    "--parity": ("--format", "--formats"),
    "--slave": ("--address", "--addresses"),
    "--speed": ("--frequency",),
    "--station": ("--address", "--addresses"),
    "--unit": ("--address", "--addresses"),
}
"""Options that other programs have, with those of the same meaning here."""


class LazyGroup(_LocalizedHelp, click.Group):
    """A group that imports a command when it is called: ``sections`` maps a heading to {command: "module:name"}."""

    stops = True  # one of its commands may

    def __init__(self, name: str, *, sections: Mapping[str, Mapping[str, str]], help_key: str, **rest: Any) -> None:
        self.examples = rest.pop("examples", ())
        super().__init__(name, **rest)
        self.sections = sections
        self.help_key = help_key
        self.params += common_options()

    def list_commands(self, ctx: click.Context) -> list[str]:
        return [name for section in self.sections.values() for name in section]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        place = next((section[cmd_name] for section in self.sections.values() if cmd_name in section), None)
        if place is None:
            return None
        module, _, name = place.partition(":")
        command: click.Command = getattr(import_module(module), name)
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Resolve as click does, and add similar command names to the error of an unknown one."""
        try:
            return super().resolve_command(ctx, args)
        except click.UsageError as error:
            if not hasattr(error, "command_name"):
                raise
            from difflib import get_close_matches

            names, typed = self.list_commands(ctx), error.command_name
            begun = [name for name in names if typed and name.startswith(typed)]
            known = {*names, *(option for param in self.params for option in param.opts)}
            meant = [name for name in _SYNONYMS.get(typed, ()) if name in known]
            likely = meant or begun or get_close_matches(typed, names)
            error.possibilities = likely  # type: ignore[attr-defined]
            if {"stop", "coast"} & set(likely):
                error.add_note(output.text("bus_stop.none_sent"))
            raise

    def get_help_option(self, ctx: click.Context) -> click.Option | None:
        return help_option()

    def format_help(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        prefix = "" if self.help_key == "drivebus" else f"{self.help_key}."
        body = []
        for heading, section in self.sections.items():
            rows = [(name, output.text(f"help.{prefix}{name}.short")) for name in section]
            body.append((output.text(heading), output.two_columns(rows, _help_cells())))
        body.append((output.text("cli.options"), self._options_help(self, ctx)))
        formatter.write(self._help_page(self, ctx, body))

    def main(self, args: Sequence[str] | None = None, *rest: Any, **named: Any) -> Any:
        """Run, and end the process with the exit code of the outcome."""
        arguments = list(sys.argv[1:] if args is None else args)
        if arguments[:1] == ["help"]:
            arguments = [*arguments[1:], "--help"]
        # In a context of its own, so that ``--lang`` and ``--json`` end with the invocation.
        sys.exit(copy_context().run(self._run_to_exit_code, arguments, *rest, **named))

    def _run_to_exit_code(self, arguments: list[str], *rest: Any, **named: Any) -> int:
        settings = output.parse_global_options(arguments)
        _escape_unencodable()
        if settings.encoding_without_chinese and COMPLETION_VARIABLE not in os.environ:
            output.print_note("cli.encoding_without_chinese", encoding=settings.encoding_without_chinese)
        try:
            code = self._run_with_errors(arguments, *rest, **named)
            if code not in (errors.ExitCode.DONE, errors.ExitCode.INTERRUPTED):
                errors.note_full_width(arguments)
        except KeyboardInterrupt:  # one more, as the command was already ending
            return errors.ExitCode.INTERRUPTED
        return code

    def _run_with_errors(self, arguments: list[str], *rest: Any, **named: Any) -> int:
        """Run and report an error; return the exit code."""
        from drivebus.errors import DrivebusError

        named["standalone_mode"] = False
        try:
            return int(super().main(arguments, *rest, **named) or errors.ExitCode.DONE)
        except click.ClickException as error:
            if isinstance(error, click.exceptions.NoArgsIsHelpError):
                error.show()
                return errors.ExitCode.USAGE
            return errors.report_usage(error)
        except click.Abort:
            if not _has_begun.get():
                output.print_note("cli.interrupted_early")
            return errors.ExitCode.INTERRUPTED
        except DrivebusError as error:
            return errors.report_error(error)
        except OSError as error:
            code = errors.report_error(errors.from_os_error(error))
            if error.filename is None:  # standard output: Python would write it again at the end, and exit with 120
                discard_output(sys.stdout)
            return code


def common_options() -> list[click.Parameter]:
    """Return the options of every command; ``output.parse_global_options`` has already applied them."""
    return [
        Option(
            ["--lang"],
            type=Choice(["en", "zh"]),
            expose_value=False,
            example="--lang zh",
            unused="cli.unclear_language",
        ),
        Option(["--json"], is_flag=True, expose_value=False, unused="cli.unused_value"),
    ]


def help_option() -> click.Option:
    """Return ``--help`` in the user's language."""

    def show(ctx: click.Context, option: click.Parameter, value: bool) -> None:
        if value and not ctx.resilient_parsing:
            click.echo(ctx.get_help(), color=ctx.color)
            ctx.exit()

    return Option(
        ["-h", "--help"], is_flag=True, is_eager=True, expose_value=False, callback=show, key="help.option.help"
    )


def _help_cells() -> int:
    return min(max(_MIN_HELP_CELLS, shutil.get_terminal_size().columns - 2), _MAX_HELP_CELLS)


def _escape_unencodable() -> None:
    """Print what stands for a character that the terminal cannot encode, instead of failing; JSON has its escape."""
    for stream in (sys.stdout, sys.stderr):
        reconfigure = getattr(stream, "reconfigure", None)
        if reconfigure is not None:
            reconfigure(errors="backslashreplace" if output.as_json() else PLAIN_ENCODING)
