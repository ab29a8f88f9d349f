"""``init``: a commented plant.toml, from a scan (reads only), from answers, or from a few questions."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import click

from drivebus.cli import options
from drivebus.cli import output as voice
from drivebus.cli.click_ext import Argument, CliCommand, Option
from drivebus.cli.commands.scan import listen_option, search_options
from drivebus.cli.errors import ExitCode

if TYPE_CHECKING:
    from drivebus.commissioning.scan import DetectedDrive
    from drivebus.service.config.wizard import BusAnswer, PlantAnswers


def _init(
    links: tuple[str, ...],
    scan: bool,
    answers: str | None,
    models: tuple[str, ...],
    addresses: tuple[int, ...] | None,
    listen: float,
    output: str,
    force: bool,
) -> ExitCode:
    """1 where nobody answered a scan; 2 where the file exists or the answers make no plant."""
    from drivebus.service.config.load import loads
    from drivebus.service.config.wizard import plant_toml, read_answers

    _require_new_file(output, force)
    if scan:
        found = asyncio.run(_scan_ports(links, models, addresses, listen))
        if isinstance(found, ExitCode):
            return found
    else:
        found = read_answers(answers) if answers is not None else _ask_answers(links)
    text = plant_toml(found, voice.language())
    setting = loads(text, output, Path(output).resolve().parent)
    _write(output, text, force)
    voice.print_json({"file": output, "plant": setting.id, "drives": [drive.id for drive in setting.drives]})
    if output != "-":
        voice.print_message("plant_init.written", file=output, drives=len(setting.drives), buses=len(setting.buses))
    return ExitCode.DONE


def _require_new_file(output: str, force: bool) -> None:
    """Raises ConfigurationError where there is a file already: before anybody answers questions."""
    from drivebus.errors import ConfigurationError

    if output != "-" and not force and Path(output).exists():
        raise ConfigurationError("plant_init.exists", file=output)


def _write(output: str, text: str, force: bool) -> None:
    """Raises ConfigurationError: there is a file by now, or it can't be written."""
    from drivebus.errors import ConfigurationError

    if output == "-":
        voice.print_text(text.rstrip("\n"))
        return
    try:
        with Path(output).open("w" if force else "x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        raise ConfigurationError("plant_init.exists", file=output) from None
    except OSError as error:
        raise ConfigurationError("plant_init.unwritten", file=output, reason=error.strerror or str(error)) from error


# --- a scan -------------------------------------------------------------------------------------------------------


async def _scan_ports(
    links: tuple[str, ...], models: tuple[str, ...], addresses: tuple[int, ...] | None, listen_s: float
) -> PlantAnswers | ExitCode:
    """Raises ConfigurationError where no LINK was given."""
    from drivebus.cli.signals import shutdown_signals
    from drivebus.errors import ConfigurationError
    from drivebus.service.config.wizard import PlantAnswers

    if not links:
        raise ConfigurationError("plant_init.no_link")
    lines: list[BusAnswer] = []
    with shutdown_signals() as ending:
        for link in links:
            found = await ending.interruptible(_line(link, models, addresses, listen_s))
            if ending.received:
                return ExitCode.INTERRUPTED
            if found is None or not found.drives:
                voice.print_note("plant_init.nobody", link=link)
                return ExitCode.FAILED
            lines.append(found)
    return PlantAnswers(voice.text("plant_init.default_title"), tuple(lines))


async def _line(
    link: str, models: tuple[str, ...], addresses: tuple[int, ...] | None, listen_s: float
) -> BusAnswer | None:
    """What answers on a LINK; None where another master speaks there."""
    from drivebus import ports
    from drivebus.cli.commands.scan import make_plan
    from drivebus.cli.scanning import ScanProgressBar
    from drivebus.commissioning import scan
    from drivebus.ports.base import Port
    from drivebus.serial_settings import SerialSettings

    passes = make_plan(link, models, addresses, None, None, None)

    def open_port(settings: SerialSettings) -> Port:
        return ports.open_port(link, baud=settings.baud, format=settings.format)

    if listen_s > 0 and passes:
        voice.print_note("scan.listening", seconds=f"{listen_s:g}")
        overheard = await scan.sniff(open_port(passes[0].settings), listen_s)
        if overheard.count:
            voice.print_note("scan.foreign", count=overheard.count, seconds=f"{overheard.seconds:g}")
            return None
    progress = scan.ScanProgress(sum(one.duration_s for one in passes))
    with ScanProgressBar() as meter:
        await scan.scan(passes, open_port, progress, meter.on_progress)
    return _answer(link, [one for one in progress.found if not one.doubtful])


def _answer(link: str, found: list[DetectedDrive]) -> BusAnswer:
    """Drives of one line setting, family and encoding; whoever else answered is named and left out (T18).

    A C320 answers in two encodings: the first that it was found with counts.
    """
    from drivebus.service.config.wizard import BusAnswer, DriveAnswer

    if not found:
        return BusAnswer(link, ())
    first = found[0]
    alike = {one.address: one for one in found if _kind(one) == _kind(first)}
    for one in found:
        if one.address not in alike:
            voice.print_note("plant_init.left_out", link=link, address=one.address, models="/".join(one.models))
    drives = [
        DriveAnswer(one.address, one.models[0], encoding=one.encoding, others=one.models[1:])
        for _, one in sorted(alike.items())
    ]
    return BusAnswer(link, tuple(drives), first.settings.baud, first.settings.format)


def _kind(one: DetectedDrive) -> tuple[object, ...]:
    return (one.settings, one.family, one.encoding)


# --- questions ------------------------------------------------------------------------------------------------------


def _ask_answers(links: tuple[str, ...]) -> PlantAnswers:
    """A few questions on the terminal. Raises ConfigurationError where there is none."""
    from drivebus.errors import ConfigurationError
    from drivebus.ports import open_port
    from drivebus.service.config.wizard import PlantAnswers

    if not _on_terminal():
        raise ConfigurationError("plant_init.no_terminal")
    title = _ask("title", voice.text("plant_init.default_title"))
    lines = [_ask_bus(link) for link in links or (_ask("link", check=open_port),)]
    while not links and click.confirm(voice.text("plant_init.ask_more"), default=False, err=True):
        lines.append(_ask_bus(_ask("link", check=open_port)))
    return PlantAnswers(title, tuple(lines))


def _on_terminal() -> bool:
    return sys.stdin.isatty()


def _ask_bus(link: str) -> BusAnswer:
    from drivebus import profiles
    from drivebus.service.config.wizard import BusAnswer, DriveAnswer

    voice.print_note("plant_init.about", link=link)
    model = _ask("model", "c320", check=profiles.load)
    addresses = options.parse_addresses(_ask("addresses", "1", check=lambda text: _check_addresses(model, text)))
    names = [_ask("name", f"{model} {address}", address=address) for address in addresses]
    drives = (DriveAnswer(address, model, name) for address, name in zip(addresses, names, strict=True))
    return BusAnswer(link, tuple(drives))


def _check_addresses(model: str, text: str) -> None:
    """Raises ValueError: no addresses; ConfigurationError: one that the model can't have."""
    from drivebus import profiles
    from drivebus.drives.dialects.create import create_dialect

    profile = profiles.load(model)
    for address in options.parse_addresses(text):
        create_dialect(profile, address)


def _ask(name: str, default: str | None = None, check: Callable[[str], object] | None = None, **params: object) -> str:
    """The answer, asked for again until ``check`` raises neither ValueError nor an error of ours."""
    from drivebus.cli.errors import error_text
    from drivebus.errors import DrivebusError

    while True:
        answer: str = click.prompt(voice.text(f"plant_init.ask_{name}", **params), default=default, err=True).strip()
        try:
            if check is not None:
                check(answer)
            return answer
        except DrivebusError as error:
            click.echo(error_text(error), err=True)
        except ValueError:
            voice.print_note("cli.found_expected", found=answer, expected=voice.text(f"cli.expect.{name}"))


command = CliCommand(
    "init",
    callback=_init,
    params=[
        Argument(["links"], metavar="[LINK]...", nargs=-1, key="help.argument.init_links"),
        Option(["--scan"], is_flag=True, key="help.option.init_scan"),
        Option(["--answers"], metavar="FILE", key="help.option.answers", example="--answers answers.toml"),
        *search_options(),
        listen_option(),
        Option(
            ["-o", "--output"],
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
        "drivebus init sim://c320@1-2 --scan --models c320 --addresses 1-3 --listen 0 -o -",
    ),
)
