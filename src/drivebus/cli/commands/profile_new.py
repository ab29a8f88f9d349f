"""``profile new``: write a profile from the facts of a manual, check it and try it on a simulated drive."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from drivebus.cli import output
from drivebus.cli.click_ext import Argument, CliCommand, Option
from drivebus.cli.errors import ExitCode, print_error
from drivebus.cli.prompts import prompt_text
from drivebus.cli.written_file import check_writable, file_errors, write_or_print
from drivebus.user_input import half_width

if TYPE_CHECKING:
    from drivebus.commissioning.new_profile.questions import Question
    from drivebus.commissioning.profile_trial import TrialStep

MAX_PRINTED_FRAMES = 12
"""Frames printed for a step: a motor that accelerates gives many different replies."""


def _new(*, file: str, table: str | None, answers_file: str | None, force: bool) -> ExitCode:
    """Return 2 if the file is not valid yet, 1 if the trial fails. Raises ConfigurationError, ProfileError."""
    from drivebus import profiles
    from drivebus.commissioning.new_profile import file_text, register_table
    from drivebus.errors import ProfileError
    from drivebus.testing import virtual_time

    with file_errors(file):
        check_writable(file, replace=force)
    answers = _read_answers(answers_file) if answers_file is not None else {}
    try:
        _ask_all(answers)
    except click.Abort:
        return _save_unfinished(answers, file)
    rows = register_table.read_table(table, answers["numbering"]) if table is not None else []
    with file_errors(file):
        write_or_print(file, file_text.profile_toml(answers, rows, output.file_language()), replace=force)
    try:
        profile = profiles.load(Path(file).resolve())
    except ProfileError as error:
        output.print_note("profile_new.rejected", file=file)
        print_error(error)
        output.print_note("profile_new.next_step", file=file)
        return ExitCode.USAGE
    from drivebus.commissioning.profile_trial import try_profile

    output.print_message("profile_new.written", file=file)
    steps = virtual_time.run(try_profile(profile))
    _print_trial(steps)
    keypad = answers["keypad"] if answers["keypad"] != "?" else output.text("profile_new.keypad_unknown")
    calibration = _calibration(answers, file)
    output.print_message("profile_new.checklist", file=file, keypad=keypad, calibration=calibration)
    failed = [step.name for step in steps if step.error is not None]
    output.print_json({"file": file, "model": profile.model, "tried": [step.name for step in steps], "failed": failed})
    return ExitCode.FAILED if failed else ExitCode.DONE


def _calibration(answers: dict[str, str], file: str) -> str:
    """Return the line of the checklist for the calibration that ends the cap of 5 Hz; empty where there is no cap."""
    if answers["setpoint_kind"] == "share":
        return output.text("profile_new.calibrate_maximum")
    return "" if answers["setpoint_step"] != "?" else output.text("profile_new.calibrate_step", file=file)


def _read_answers(path: str) -> dict[str, str]:
    """Return the answers of an unfinished dialogue. Raises ConfigurationError."""
    from drivebus.cli.errors import from_os_error
    from drivebus.commissioning.new_profile.questions import QUESTIONS, check_answer
    from drivebus.errors import ConfigurationError
    from drivebus.profiles.diagnostics import error_params, to_diagnostic
    from drivebus.profiles.toml_file import TomlFault, decode_toml

    try:
        _, data = decode_toml(Path(path).read_bytes())
    except TomlFault as fault:
        diagnostic = to_diagnostic(fault.issue, path, fault.line)
        raise ConfigurationError("profile_new.answers_toml", **error_params([diagnostic])) from None
    except OSError as error:
        raise from_os_error(error) from error
    known = {question.name: question for question in QUESTIONS}
    if unknown := [key for key in data if key not in known]:
        raise ConfigurationError("profile_new.answers_key", file=path, key=unknown[0])
    answers: dict[str, str] = {}
    for name, question in known.items():
        if name in data:
            text = _without_full_width(question, str(data[name]).strip())
            try:
                check_answer(question, text, answers)
            except (ValueError, KeyError):
                expected = _expected(question, answers)
                raise ConfigurationError(
                    "profile_new.answers_value", file=path, key=name, found=text, expected=expected
                ) from None
            answers[name] = text
    return answers


def _ask_all(answers: dict[str, str]) -> None:
    """Ask for every fact that is not in ``answers``, and add it there. Raises click.Abort at Ctrl-C and at the end."""
    from drivebus.commissioning.new_profile.questions import check_answer, open_questions

    output.print_note("profile_new.about")
    for question in open_questions(answers):
        question_text = output.text(f"profile_new.ask_{question.name}")
        while question.name not in answers:
            text = _without_full_width(question, prompt_text(question_text, question.default))
            try:
                check_answer(question, text, answers)
                answers[question.name] = text
            except ValueError:
                output.print_note("profile_new.wrong", found=text, expected=_expected(question, answers))


def _without_full_width(question: Question, text: str) -> str:
    """Return an answer in half-width characters; a text of the user as it is, but for the mark of an unknown fact."""
    from drivebus.commissioning.new_profile.questions import UNKNOWN

    plain = half_width(text).strip()
    return text if question.kind == "text" and plain != UNKNOWN else plain


def _expected(question: Question, answers: dict[str, str]) -> str:
    """Return what a question expects."""
    from drivebus.commissioning.new_profile.questions import most_registers, readable_registers
    from drivebus.protocols.modbus.messages import MAX_READ

    params: dict[str, object] = {}
    match question.kind:
        case "choice":
            params["choices"] = output.join(question.choices, "items")
        case "number":
            params["low"], params["high"] = (f"{bound:g}" for bound in question.span)
        case "rejected_read":
            params["most"], params["high"] = most_registers(answers), MAX_READ
        case "neighbour":
            known = output.join((f"{register:04X}H" for register in sorted(readable_registers(answers))), "items")
            params["registers"] = known or output.text("profile_new.any_register")
    return output.text(f"profile_new.expect_{question.kind}", **params)


def _save_unfinished(answers: dict[str, str], file: str) -> ExitCode:
    """Write the answers of an unfinished dialogue beside the file that it would have written."""
    from drivebus.profiles.toml_file import toml_string

    answers_file = f"{file}.answers.toml"
    click.echo(err=True)
    if not answers:
        return ExitCode.INTERRUPTED
    with file_errors(answers_file):
        lines = (f"{name} = {toml_string(text)}\n" for name, text in answers.items())
        write_or_print(answers_file, "".join(lines), replace=True)
    output.print_note("profile_new.left", count=len(answers), kept=answers_file, file=file)
    return ExitCode.INTERRUPTED


def _print_trial(steps: list[TrialStep]) -> None:
    """Print each step with its result and the frames that were sent and received."""
    output.print_message("profile_new.trial")
    for step in steps:
        name = output.text(f"profile_new.trial_{step.name}", hz=f"{step.hz:g}")
        detail = "" if step.error is None else step.error.text(output.language())
        result = "profile_new.trial_ok" if step.error is None else "profile_new.trial_failed"
        output.print_wrapped(output.text(result, name=name, detail=detail), indent=2)
        for frame in step.frames[:MAX_PRINTED_FRAMES]:
            arrow = "→" if frame.direction == "sent" else "←"
            output.print_text(f"    {arrow} {frame.data.hex(' ').upper()}")


command = CliCommand(
    "new",
    help_key="profile.new",
    callback=_new,
    params=[
        Argument(["file"], metavar="FILE", type=click.Path(), key="help.argument.new_profile"),
        Option(["--from", "table"], metavar="FILE.csv", key="help.option.register_table", example="--from table.csv"),
        Option(["--answers", "answers_file"], metavar="FILE", key="help.option.profile_answers"),
        Option(["--force"], is_flag=True, key="help.option.init_force"),
    ],
    examples=(
        "drivebus profile new my-drive.toml",
        "drivebus profile new my-drive.toml --from registers.csv",
        "drivebus profile new my-drive.toml --answers my-drive.toml.answers.toml",
    ),
)
