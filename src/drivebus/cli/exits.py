"""Exit codes, and what the user reads when a verb ends badly."""

from __future__ import annotations

import signal
import sys
from enum import IntEnum
from typing import Any

import click

from drivebus import i18n
from drivebus.cli import voice
from drivebus.errors import (
    ConfigurationError,
    DrivebusError,
    OutcomeUnknown,
    ProtocolError,
    StopUnconfirmed,
)


class Exit(IntEnum):
    """What a verb's exit code says to a script."""

    DONE = 0
    """Confirmed, or acknowledged and said so."""
    REFUSED = 1
    """The drive or the bus said no."""
    USAGE = 2
    """Usage or configuration."""
    INVALID_FRAME = 3
    UNKNOWN = 4
    """Outcome unknown, or stop unconfirmed."""
    INTERRUPTED = 128 + signal.SIGINT


def code_of(error: BaseException) -> Exit:
    """The exit code of an error of the library."""
    if isinstance(error, OutcomeUnknown | StopUnconfirmed):
        return Exit.UNKNOWN
    if isinstance(error, ConfigurationError):
        return Exit.USAGE
    return Exit.INVALID_FRAME if isinstance(error, ProtocolError) else Exit.REFUSED


def report(error: DrivebusError) -> Exit:
    """Say what went wrong, on standard error, and as a document where JSON was asked for."""
    code = code_of(error)
    complain(error)
    voice.document(describe(error) | {"exit": int(code)}, stream=True)
    return code


def of_the_system(error: OSError) -> ConfigurationError:
    """A file or folder that a verb was given and the operating system refuses."""
    return ConfigurationError("cli.system", file=error.filename or "-", reason=error.strerror or str(error))


def complain(error: DrivebusError) -> None:
    """What went wrong and what to do about it, on standard error."""
    _complain(sentence(error))
    if said := hint(error):
        click.echo(voice.wrapped(said, sys.stderr), err=True)


def describe(error: DrivebusError) -> dict[str, Any]:
    """An error as JSON: type, key and numbers for programs, the sentence for people."""
    return {
        "error": {
            "type": type(error).__name__,
            "key": error.key,
            "text": sentence(error),
            "hint": hint(error),
            "scope": str(error.scope),
            "retryable": error.retryable,
            "params": {name: value for name, value in error.params.items() if value is not None},
        }
    }


def hint(error: DrivebusError) -> str | None:
    """What to do at the command line about it, where there is such a thing: the sentence ``hint.<key>``."""
    key = f"hint.{error.key}"
    return voice.say(key) if i18n.known(key) else None


def sentence(error: DrivebusError) -> str:
    """The error's own text; a model's name that nobody knows is no refused file."""
    complaints = error.params.get("complaints") or ()
    if [one.kind for one in complaints] == ["no_model"]:
        from drivebus import profiles

        return voice.say("cli.no_such_model", name=error.params["file"], known=", ".join(profiles.models()))
    return error.text(voice.language())


def report_usage(error: click.ClickException) -> Exit:
    """A wrong command line: what is wrong, in the user's language, and where the help is."""
    context = getattr(error, "ctx", None)
    path = context.command_path if context else "drivebus"
    sentence = usage_sentence(error)
    _complain(sentence)
    click.echo(voice.say("cli.try_help", command=path), err=True)
    described = {"type": "UsageError", "key": "cli.usage", "text": sentence, "scope": "configuration"}
    voice.document({"error": described, "exit": int(Exit.USAGE)}, stream=True)
    return Exit.USAGE


def usage_sentence(error: click.ClickException) -> str:
    """click's own complaints, in the user's language."""
    if isinstance(error, click.NoSuchOption):
        return _with_guess("cli.no_such_option", error.option_name, error.possibilities)
    if isinstance(error, click.exceptions.UsageError) and type(error).__name__ == "NoSuchCommand":
        return _with_guess(
            "cli.no_such_verb", getattr(error, "command_name", ""), getattr(error, "possibilities", None)
        )
    if isinstance(error, click.MissingParameter):
        return voice.say("cli.missing", name=_name_of(error))
    if isinstance(error, click.BadParameter):
        return voice.say("cli.bad_value", name=_name_of(error), problem=error.message)
    if isinstance(error, click.BadOptionUsage):
        return voice.say("cli.needs_value", name=error.option_name)
    return error.format_message()


def _with_guess(key: str, name: str, possibilities: list[str] | None) -> str:
    sentence = voice.say(key, name=name)
    guess = [voice.say("cli.did_you_mean", names=", ".join(possibilities))] if possibilities else []
    return voice.sentences([sentence, *guess])


def _name_of(error: click.BadParameter) -> str:
    if isinstance(error.param, click.Option):
        return max(error.param.opts, key=len)
    return (error.param.make_metavar(error.ctx) if error.param and error.ctx else "") or str(error.param_hint or "?")


def _complain(sentence: str) -> None:
    text = voice.wrapped(f"drivebus: {sentence}", sys.stderr)
    click.echo(click.style(text, fg="red") if coloured(sys.stderr) else text, err=True)


def coloured(stream: Any) -> bool:
    """Colours only on a terminal, and never where NO_COLOR is set."""
    import os

    return not os.environ.get("NO_COLOR") and hasattr(stream, "isatty") and bool(stream.isatty())
