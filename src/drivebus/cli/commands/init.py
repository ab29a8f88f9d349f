"""``init``: write a commented plant.toml from a scan (reads only), a file of answers, or a few questions."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from drivebus import i18n
from drivebus.cli import options, output
from drivebus.cli.click_ext import Argument, CliCommand, Option
from drivebus.cli.errors import ExitCode, print_error
from drivebus.cli.prompts import confirm, prompt, prompt_text
from drivebus.cli.scanning import ScanRequest, fitting_drives, listen_option, search, search_options, select_alike
from drivebus.cli.written_file import check_writable, file_errors, write_or_print
from drivebus.types import Json
from drivebus.user_input import parse_addresses

if TYPE_CHECKING:
    from drivebus.commissioning.scan import DetectedDrive
    from drivebus.service.config.wizard import BusAnswer, DriveAnswer, PlantAnswers


def _init(
    *,
    ports: tuple[str, ...],
    scan: bool,
    answers: str | None,
    models: tuple[str, ...] | None,
    addresses: tuple[int, ...] | None,
    bauds: tuple[int, ...] | None,
    formats: tuple[str, ...] | None,
    listen_seconds: float,
    file: str,
    force: bool,
) -> ExitCode:
    """Return 1 where a port has no drive. Raises ConfigurationError if the file exists or the answers are invalid.

    Ctrl-C during a scan or its questions prints the file with what was found so far instead of writing it.
    """
    from drivebus.service.config.wizard import read_answers

    if file != "-":
        with file_errors(file):
            check_writable(file, replace=force)
    if scan:
        requests = [
            ScanRequest(port=port, models=models, addresses=addresses, bauds=bauds, formats=formats) for port in ports
        ]
        scanned, code = asyncio.run(_scan_ports(requests, listen_seconds))
        if not scanned:
            if code is ExitCode.INTERRUPTED:
                output.print_note("cli.interrupted")
            output.print_json({"file": None, "plant": None, "drives": [], "undecided": []})
            return code
        found, code = _answers_of_scan(scanned, models or (), code)
    else:
        code = ExitCode.DONE
        found = read_answers(answers) if answers is not None else _ask_answers(ports)
    _write_plant(found, file, force=force, is_interrupted=code is ExitCode.INTERRUPTED)
    return code


def _write_plant(found: PlantAnswers, file: str, *, force: bool, is_interrupted: bool) -> None:
    """Write the plant file and report its drives; print it for the file ``-`` or after an interruption.

    A plant without a title, as a scan finds it, gets the default one.
    """
    from drivebus.service.config.load import loads
    from drivebus.service.config.wizard import plant_toml

    is_written = file != "-" and not is_interrupted
    language = output.file_language() if is_written else output.language()
    titled = replace(found, title=found.title or i18n.text("plant_init.default_title", language))
    text = plant_toml(titled, language)
    config = loads(text, file, Path(file).resolve().parent)
    if is_written:
        with file_errors(file):
            write_or_print(file, text, replace=force)
    else:
        if file != "-":
            output.print_note("plant_init.interrupted", file=file)
        output.print_text(text.rstrip("\n"))
    output.print_json(
        {
            "file": file if is_written or file == "-" else None,
            "plant": config.id,
            "drives": [drive.id for drive in config.drives],
            "undecided": _undecided_json(found),
            **({} if is_written else {"toml": text}),
        }
    )
    if is_written:
        output.print_message("plant_init.written", file=file, drives=len(config.drives), buses=len(config.buses))


def _undecided_json(answers: PlantAnswers) -> list[Json]:
    """Return the drives whose model is still to be chosen, each with the models that it may be."""
    return [
        {"port": bus.port, "address": drive.address, "models": list(drive.candidates)}
        for bus in answers.buses
        for drive in bus.drives
        if drive.candidates
    ]


# --- a scan -------------------------------------------------------------------------------------------------------


async def _scan_ports(
    requests: list[ScanRequest], listen_s: float
) -> tuple[list[tuple[str, list[DetectedDrive]]], ExitCode]:
    """Scan each port; return those that have drives, and the exit code.

    A port that has none, fails or is interrupted does not discard what was found before. Raises ConfigurationError
    without a port, and the error of a single port on which nothing was found.
    """
    from drivebus.cli.signals import shutdown_signals
    from drivebus.commissioning.scan import ScanProgress
    from drivebus.errors import ConfigurationError, DrivebusError

    if not requests:
        raise ConfigurationError("plant_init.no_port")
    for request in requests:
        request.plan()  # a wrong port URL or model is reported before the first scan
    scanned: list[tuple[str, list[DetectedDrive]]] = []
    code = ExitCode.DONE
    with shutdown_signals() as shutdown:
        for request in requests:
            progress, found = ScanProgress(total_s=0.0), None
            try:
                found = await shutdown.interruptible(search(request, listen_s, progress))
            except DrivebusError as error:
                if len(requests) == 1 and not fitting_drives(progress):
                    raise
                print_error(error)
            if so_far := fitting_drives(progress):
                scanned.append((request.port, so_far))
            if shutdown.received:
                return scanned, ExitCode.INTERRUPTED
            if not found:
                code = ExitCode.FAILED
            if found == []:  # None: it could not be scanned, as the error says
                output.print_note("plant_init.no_drive", port=request.port)
    return scanned, code


def _answers_of_scan(
    scanned: list[tuple[str, list[DetectedDrive]]], named: tuple[str, ...], code: ExitCode
) -> tuple[PlantAnswers, ExitCode]:
    """Return the plant of a scan that ended with ``code``, and the exit code after the questions for its models."""
    from drivebus.service.config.wizard import PlantAnswers

    questions = ModelQuestions(is_interrupted=code is ExitCode.INTERRUPTED)
    buses = tuple(_bus_answer(port, drives, named, questions) for port, drives in scanned)
    found = PlantAnswers("", buses)
    return found, ExitCode.INTERRUPTED if questions.is_interrupted else code


@dataclass
class ModelQuestions:
    """Questions for the models that the bus can't tell apart; all are left open from the one that is interrupted."""

    is_interrupted: bool

    def ask(self, drive: DetectedDrive) -> str | None:
        """Return the model of the name plate; None where the user leaves it open, or without a terminal."""
        if self.is_interrupted or not _on_terminal():
            return None
        try:
            return _ask_model(drive)
        except click.Abort:
            self.is_interrupted = True
            click.echo(err=True)  # ends the line of the question
            return None


def _bus_answer(port: str, found: list[DetectedDrive], named: tuple[str, ...], questions: ModelQuestions) -> BusAnswer:
    """Return the bus of a port. ``named``: models that the user gave with ``--models``."""
    from drivebus.service.config.wizard import BusAnswer

    def left_out(drive: DetectedDrive) -> None:
        models = "/".join(drive.models)
        output.print_note("plant_init.left_out", port=port, address=drive.address, models=models)

    drives = tuple(_drive_answer(port, drive, named, questions) for drive in select_alike(found, left_out))
    return BusAnswer(port, drives, found[0].settings.baud, found[0].settings.format)


def _drive_answer(port: str, drive: DetectedDrive, named: tuple[str, ...], questions: ModelQuestions) -> DriveAnswer:
    """Return a drive with the model that the bus, ``--models`` or the user tells, or with all that it may be."""
    from drivebus.service.config.wizard import DriveAnswer

    stated = [model for model in drive.models if model in named]
    if not drive.doubtful or len(stated) == 1:
        model = stated[0] if stated else drive.models[0]
        others = tuple(other for other in drive.models if other != model)
        return DriveAnswer(drive.address, model, encoding=drive.encoding, others=others, is_doubtful=drive.fits_partly)
    has_choice = len(drive.models) > 1
    chosen = questions.ask(drive) if has_choice else None
    if chosen is not None:
        return DriveAnswer(drive.address, chosen, encoding=drive.encoding)
    note = "plant_init.undecided" if has_choice else "plant_init.unlike"
    output.print_note(note, port=port, address=drive.address, models=output.join(drive.models, "items"))
    return DriveAnswer(drive.address, "", encoding=drive.encoding, candidates=drive.models)


def _ask_model(drive: DetectedDrive) -> str | None:
    """Ask which of the models that the bus can't tell apart the drive is; None where the user leaves it open."""
    from drivebus.profiles.load import model_name

    models = output.join(drive.models, "items")
    question = output.text("plant_init.ask_alike", address=drive.address, models=models)
    while answer := prompt(question, "", show_default=False):
        if (model := model_name(answer)) in drive.models:
            return model
        output.print_note("cli.found_expected", found=answer, expected=models)
    return None


# --- questions ----------------------------------------------------------------------------------------------------


def _ask_answers(ports: tuple[str, ...]) -> PlantAnswers:
    """Ask on the terminal. Raises ConfigurationError without one."""
    from drivebus.errors import ConfigurationError
    from drivebus.ports import open_port
    from drivebus.service.config.wizard import PlantAnswers

    if not _on_terminal():
        raise ConfigurationError("plant_init.no_terminal")
    title = _ask("title", output.text("plant_init.default_title"))
    buses = [_ask_bus(port) for port in ports or (_ask("port", check=open_port),)]
    while not ports and confirm(output.text("plant_init.ask_more")):
        buses.append(_ask_bus(_ask("port", check=open_port)))
    return PlantAnswers(title, tuple(buses))


def _on_terminal() -> bool:
    return sys.stdin.isatty()


def _ask_bus(port: str) -> BusAnswer:
    from drivebus import profiles
    from drivebus.profiles.load import model_name
    from drivebus.service.config.wizard import BusAnswer, DriveAnswer

    output.print_note("plant_init.about", port=port)
    model = model_name(_ask("model", "c320", check=profiles.load))
    addresses = parse_addresses(_ask("addresses", "1", check=lambda text: _check_addresses(model, text)))
    names = [_ask("name", f"{model} {address}", address=address) for address in addresses]
    drives = (DriveAnswer(address, model, name) for address, name in zip(addresses, names, strict=True))
    return BusAnswer(port, tuple(drives))


def _check_addresses(model: str, text: str) -> None:
    """Raise ValueError for an invalid list, ConfigurationError for an address that the model does not have."""
    from drivebus import profiles
    from drivebus.drives.dialects.create import create_dialect

    profile = profiles.load(model)
    for address in parse_addresses(text):
        create_dialect(profile, address)


def _ask(name: str, default: str | None = None, check: Callable[[str], object] | None = None, **params: object) -> str:
    """Return the answer; repeat the question until ``check`` raises no error."""
    from drivebus.cli.errors import error_text
    from drivebus.errors import DrivebusError

    ask = prompt_text if name in _FREE_TEXTS else prompt
    while True:
        answer = ask(output.text(f"plant_init.ask_{name}", **params), default)
        try:
            if check is not None:
                check(answer)
            return answer
        except DrivebusError as error:
            output.echo(error_text(error), err=True)
        except ValueError:
            output.print_note("cli.found_expected", found=answer, expected=output.text(f"cli.expect.{name}"))


_FREE_TEXTS = frozenset({"title", "name"})
"""Questions whose answers are texts of the user, in any characters."""


command = CliCommand(
    "init",
    callback=_init,
    params=[
        Argument(
            ["ports"],
            metavar="[PORT]...",
            nargs=-1,
            key="help.argument.init_ports",
            shell_complete=options.complete_ports,
        ),
        Option(["--scan"], is_flag=True, key="help.option.init_scan"),
        Option(["--answers"], metavar="FILE", key="help.option.answers", example="--answers answers.toml"),
        *search_options(),
        listen_option(),
        Option(
            ["-o", "--output", "file"],
            default="plant.toml",
            metavar="FILE",
            key="help.option.init_output",
            example="-o plant.toml",
        ),
        Option(["--force"], is_flag=True, key="help.option.init_force"),
    ],
    examples=(
        "drivebus init",
        "drivebus init /dev/ttyUSB0 --scan",
        "drivebus init /dev/ttyUSB0 /dev/ttyUSB1 --scan --addresses 1-8 -o plant.toml",
        "drivebus init --answers answers.toml --force",
        "drivebus init sim://c320@1-2 --scan --models c320 --addresses 1-3 -o -",
    ),
)
