"""Exit codes of the commands, and reports of errors."""

from __future__ import annotations

import re
import signal
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from enum import IntEnum
from typing import Any

import click

from drivebus import i18n
from drivebus.cli import output
from drivebus.control_characters import without_control_characters
from drivebus.errors import (
    AddressError,
    AlphabetError,
    ChecksumError,
    CodeError,
    ConfigurationError,
    DrivebusError,
    EchoError,
    HeaderError,
    LengthError,
    OutcomeUnknown,
    ProtocolError,
    StopUnconfirmed,
    SystemReason,
    TerminatorError,
    TrailingError,
)
from drivebus.user_input import half_width

_TEXT_CHARACTER = re.compile(r"[\s一-鿿]")
"""Blank or Chinese character: a reason or a file name may have one, an option, a number or a port URL has none."""
_PORT_ARGUMENTS = {"port", "source", "target"}
"""Names of the arguments that a port may be given as."""
_EXTRA_ARGUMENTS = re.compile(r"Got unexpected extra arguments? \((.*)\)", re.DOTALL)
"""Message of click for arguments beyond those of a command; it has no class or attribute of its own."""
FLAG_WITH_VALUE = "does not take a value."
"""End of the message of click for a flag with a value; its class is that of an option without one."""
_UNIT_WORDS = {"hz", "赫兹", "赫", "s", "秒", "bps"}
"""Units that stand as a word of their own behind a number."""
_ON_THE_PAGE = {"history", "trend", "trends", "export"}
"""Words for what only the page of a service has."""
_MISSING_COMMAND = "Missing command."
"""Message of click for a group without a command; it has no class of its own either."""


_HINTS_OF_VALUES = {
    ("drives.cannot", "coast"): "hint.drives.cannot_coast",
    ("drives.cannot", "quick_stop"): "hint.drives.cannot_quick_stop",
    ("drives.start_failed", "fault"): "hint.drives.state_forbids_fault",
    ("drives.start_failed", "not_ready"): "hint.drives.not_ready",
    ("drives.started_and_tripped", "fault"): "hint.drives.state_forbids_fault",
    ("drives.started_and_tripped", "not_ready"): "hint.drives.not_ready",
    ("drives.state_forbids", "fault"): "hint.drives.state_forbids_fault",
    ("drives.state_forbids", "not_ready"): "hint.drives.not_ready",
    ("drives.state_forbids", "paused"): "hint.drives.state_forbids_paused",
    ("drives.state_forbids", "stopped"): "hint.drives.state_forbids_stopped",
    ("ports.lost", "end of the capture"): "hint.ports.capture_end",
    ("ports.url", "drivebus ports"): "hint.ports.url_name",
    ("ports.scheme", "http"): "hint.ports.scheme_http",
    ("ports.scheme", "https"): "hint.ports.scheme_http",
}
"""Hints of an error with this value of a parameter."""
_SHARED_HINTS = {
    "bus.line_errors": "damaged_reply",
    "bus.not_open": "drives.stop_not_sent_port",
    "drives.command_port_lost": "drives.stop_not_sent_port",
    "drives.duplicate": "bus.second_reply",
    "drives.confirm_inputs": "drives.confirm_address",
    "drives.confirm_reply_delay": "drives.confirm_address",
    "drives.confirm_serial": "drives.confirm_address",
    "drives.confirm_source": "drives.confirm_address",
    "drives.eeprom_clock": "drives.eeprom_budget",
    "drives.stop_port_lost": "drives.stop_not_sent_port",
    "drives.stop_port_lost_after": "drives.stop_not_sent_port",
    "drives.stop_rejected_running": "drives.stop_rejected",
    "drives.write_port_lost": "drives.stop_not_sent_port",
    "plant.waiver_needed_tested": "plant.waiver_needed",
    "plant.waiver_of_another": "plant.waiver_needed",
    "ports.lost": "drives.stop_not_sent_port",
    "ports.not_open": "drives.stop_not_sent_port",
}
"""Errors with the same remedy as another one."""
_DAMAGED_REPLIES = (
    AddressError,
    AlphabetError,
    ChecksumError,
    CodeError,
    HeaderError,
    LengthError,
    TerminatorError,
    TrailingError,
)
"""Errors of bytes that are no valid reply; the remedy does not depend on which byte it is."""


class ExitCode(IntEnum):
    """Exit code of a command."""

    DONE = 0  # confirmed, or acknowledged and reported as such
    FAILED = 1  # rejected by the drive, or failed on the bus
    USAGE = 2  # wrong usage or configuration
    INVALID_FRAME = 3
    UNKNOWN = 4  # outcome unknown, or stop unconfirmed
    INTERRUPTED = 128 + signal.SIGINT  # also: the user declined what the command asked to confirm


def exit_code_of(error: BaseException) -> ExitCode:
    """Return the exit code of a library error."""
    if isinstance(error, OutcomeUnknown | StopUnconfirmed):
        return ExitCode.UNKNOWN
    if isinstance(error, ConfigurationError):
        return ExitCode.USAGE
    return ExitCode.INVALID_FRAME if isinstance(error, ProtocolError) else ExitCode.FAILED


def report_error(error: DrivebusError) -> ExitCode:
    """Print an error on standard error, and as a document with ``--json``; return its exit code."""
    code = exit_code_of(error)
    _print_uninterrupted(lambda: print_error(error))
    _print_uninterrupted(lambda: output.print_json(error_json(error) | {"exit": int(code)}, stream=True))
    return code


def _print_uninterrupted(print_part: Callable[[], None]) -> None:
    """Print a part of a report; once more where Ctrl-C ends it: a stop that was not sent must not go unnamed.

    A second Ctrl-C gives it up: its reader may have stopped reading.
    """
    with output.continue_without_output():
        try:
            print_part()
        except KeyboardInterrupt:
            with suppress(KeyboardInterrupt):
                print_part()


def from_os_error(error: OSError) -> ConfigurationError:
    """Convert an error of the operating system about a file or folder of the command line."""
    kinds = {FileNotFoundError: "cli.system_missing", IsADirectoryError: "cli.system_folder"}
    key = kinds.get(type(error), "cli.system" if error.filename else "cli.system_output")
    return ConfigurationError(key, file=error.filename or "-", reason=SystemReason(error))


def print_error(error: DrivebusError) -> None:
    """Print the error, the notes of its outcome, its remedy and its own notes on standard error."""
    sentence = error_text(error)
    _print_error_line(sentence)
    outcome = getattr(error, "outcome", None)
    for note in outcome.note_texts(output.language()) if outcome is not None else ():
        if note != sentence:
            output.echo(output.wrap_for(note, sys.stderr, indent=2), err=True)
    if hint := error_hint(error):
        output.echo(output.wrap_for(hint, sys.stderr), err=True)
    _print_notes(error)


def error_json(error: DrivebusError) -> dict[str, Any]:
    """Return an error as JSON: type, key and parameters for programs, the sentence for people."""
    return {
        "error": {
            "type": type(error).__name__,
            "key": error.key,
            "text": error_text(error),
            "hint": error_hint(error),
            "scope": str(error.scope),
            "retryable": error.retryable,
            "params": {name: value for name, value in error.params.items() if value is not None},
        }
    }


def error_hint(error: DrivebusError) -> str | None:
    """Return the remedy at the command line: ``hint.<key>`` of the error, its cause or its reason; None without one."""
    cause = error.__cause__
    reasons: list[Any] = [reason for reason in (error, cause, error.params.get("why")) if hasattr(reason, "key")]
    for reason in reasons:
        own = next(
            filter(None, (_HINTS_OF_VALUES.get((reason.key, str(value))) for value in reason.params.values())), None
        )
        if i18n.known(key := own or f"hint.{_SHARED_HINTS.get(reason.key, reason.key)}"):
            return output.text(key, **reason.params)
    if any(isinstance(reason, EchoError) for reason in (error, cause)):
        return output.text("hint.reply_to_another_request")
    is_damaged = any(isinstance(reason, _DAMAGED_REPLIES) for reason in (error, cause))
    return output.text("hint.damaged_reply") if is_damaged else None


def error_text(error: DrivebusError) -> str:
    """Return the error's text; an unknown model name gets the list of models."""
    diagnostics = error.params.get("diagnostics") or ()
    if [diagnostic.kind for diagnostic in diagnostics] == ["no_model"]:
        from drivebus import profiles
        from drivebus.profiles.listing import models_of_maker

        name = error.params["file"]
        near = output.join(profiles.similar_models(name) or models_of_maker(name), "items")
        return output.text("cli.no_such_model" if near else "cli.no_similar_model", name=name, near=near)
    return error.text(output.language())


def report_usage(error: click.ClickException) -> ExitCode:
    """Print a wrong usage of the command line, and the command that prints the help."""
    context = getattr(error, "ctx", None)
    path = context.command_path if context else "drivebus"
    sentence = usage_text(error)
    hint = _usage_hint(error)
    described = {
        "type": "UsageError",
        "key": "cli.usage",
        "text": sentence,
        "hint": hint and output.text(hint),
        "scope": "configuration",
    }

    def print_usage() -> None:
        _print_error_line(sentence)
        if hint is not None:
            output.print_note(hint)
        output.print_note("cli.try_help", command=path)
        _print_notes(error)

    _print_uninterrupted(print_usage)
    _print_uninterrupted(lambda: output.print_json({"error": described, "exit": int(ExitCode.USAGE)}, stream=True))
    return ExitCode.USAGE


def note_full_width(arguments: Sequence[str]) -> None:
    """Name the words of a failed command line with full-width characters, and what to type; not words of a text."""
    wrong = [word for word in arguments if half_width(word) != word and _TEXT_CHARACTER.search(word) is None]
    if wrong:
        words = output.join([f"{word} → {_option_or_word(half_width(word))}" for word in wrong], "items")
        with output.continue_without_output():
            output.print_note("cli.full_width", words=words)


def _option_or_word(word: str) -> str:
    """Return a word with the second dash of a long option, which an input method makes one of."""
    return f"-{word}" if re.match(r"-[A-Za-z]{2}", word) else word


def usage_text(error: click.ClickException) -> str:
    """Translate an error of click."""
    if isinstance(error, click.NoSuchOption):
        return _with_suggestions("cli.no_such_option", error.option_name, error.possibilities)
    if isinstance(error, click.exceptions.UsageError) and type(error).__name__ == "NoSuchCommand":
        name = getattr(error, "command_name", "")
        if name in _ON_THE_PAGE:
            sentences = [output.text("cli.no_such_command", name=name), output.text("cli.on_the_page")]
            return output.join(sentences, "sentences")
        return _with_suggestions("cli.no_such_command", name, getattr(error, "possibilities", None))
    if isinstance(error, click.MissingParameter):
        return output.text("cli.missing", name=_parameter_name(error))
    if isinstance(error, click.BadParameter):
        return output.text("cli.bad_value", name=_parameter_name(error), problem=error.message)
    if isinstance(error, click.BadOptionUsage):
        is_flag = error.message.endswith(FLAG_WITH_VALUE)
        return output.text("cli.takes_no_value" if is_flag else "cli.needs_value", name=error.option_name)
    if error.message == _MISSING_COMMAND:
        return output.text("cli.missing", name="COMMAND")
    if extra := _EXTRA_ARGUMENTS.fullmatch(error.message):
        sentence = output.text("cli.extra_arguments", arguments=extra[1])
        if isinstance(error, click.UsageError) and error.ctx is not None and error.ctx.command.name == "models":
            return output.join([sentence, output.text("cli.models_search", word=extra[1].split()[-1])], "clauses")
        is_unit = extra[1].lower() in _UNIT_WORDS
        return output.join([sentence, output.text("cli.number_alone")], "clauses") if is_unit else sentence
    return error.format_message()


def _usage_hint(error: click.ClickException) -> str | None:
    """Return the key of the next step after a missing value, an unknown option or a bare frequency; else None."""
    if isinstance(error, click.NoSuchOption):
        key = f"cli.no_such_option.{error.option_name.lstrip('-')}"
        return key if i18n.known(key) else None
    extra, context = _EXTRA_ARGUMENTS.fullmatch(error.message), getattr(error, "ctx", None)
    if (
        extra
        and extra[1].isdecimal()
        and context
        and any("--frequency" in param.opts for param in context.command.params)
    ):
        return "cli.missing.frequency"
    return _missing_hint(error) if isinstance(error, click.MissingParameter) else None


def _missing_hint(error: click.MissingParameter) -> str | None:
    """Return the key of the sentence that says where a missing value is found; None without one."""
    name = error.param.name if error.param is not None else ""
    names = {param.name for param in error.ctx.command.params} if error.ctx is not None else set()
    if name == "model" and not names & _PORT_ARGUMENTS:
        return "cli.missing.simulated_model"
    key = f"cli.missing.{'port' if name in _PORT_ARGUMENTS else 'address' if name == 'addresses' else name}"
    if i18n.known(key) and (name != "address" or names & _PORT_ARGUMENTS):
        return key
    return getattr(error.param, "key", None) if isinstance(error.param, click.Option) else None


def _with_suggestions(key: str, name: str, possibilities: list[str] | None) -> str:
    sentence = output.text(key, name=name)
    guess = [output.text("cli.did_you_mean", names=output.join(possibilities, "items"))] if possibilities else []
    return output.join([sentence, *guess], "sentences")


def _parameter_name(error: click.BadParameter) -> str:
    if isinstance(error.param, click.Option):
        return max(error.param.opts, key=len)
    return (error.param.make_metavar(error.ctx) if error.param and error.ctx else "") or str(error.param_hint or "?")


def _print_error_line(sentence: str) -> None:
    text = without_control_characters(output.wrap_for(f"drivebus: {sentence}", sys.stderr), keep="\n\t")
    output.echo(click.style(text, fg="red") if supports_colour(sys.stderr) else text, err=True, controls=True)


def _print_notes(error: BaseException) -> None:
    for note in getattr(error, "__notes__", ()):
        output.echo(output.wrap_for(note, sys.stderr), err=True)


def supports_colour(stream: Any) -> bool:
    """Return whether ``stream`` is a terminal and NO_COLOR is not set."""
    import os

    return not os.environ.get("NO_COLOR") and hasattr(stream, "isatty") and bool(stream.isatty())
