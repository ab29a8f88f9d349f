"""``monitor``: the live view of a real line, or of a capture. Reads only."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from drivebus.cli import options, voice
from drivebus.cli.command import Option, Verb
from drivebus.cli.exits import Exit
from drivebus.cli.verbs.scan import DEFAULT_MODELS
from drivebus.errors import ConfigurationError

if TYPE_CHECKING:
    from drivebus.line import LineSettings
    from drivebus.profiles import DriveProfile

Known = list[tuple["DriveProfile", str | None, int]]


def _monitor(
    source: str,
    model: str | None,
    addresses: tuple[int, ...] | None,
    baud: int | None,
    format: str | None,
    encoding: str | None,
    plain: bool,
    period: float,
    duration: float | None,
    speed: float,
    record: str | None,
    dry_run: bool,
) -> Exit:
    if record and source.endswith(".dbcap"):
        raise ConfigurationError("record.of_capture", file=source)
    if dry_run:
        return _dry(source, model, addresses, baud, format, encoding)
    if source.endswith(".dbcap"):
        return _capture(source, model, encoding, plain, period, duration, speed)
    return _line(source, model, addresses, baud, format, encoding, plain, period, duration, record)


def _capture(
    file: str, model: str | None, encoding: str | None, plain: bool, period: float, duration: float | None, speed: float
) -> Exit:
    from drivebus import profiles
    from drivebus.capture import read_capture
    from drivebus.cli.live.playback import CaptureFeed
    from drivebus.cli.live.start import show

    capture = read_capture(file)
    chosen = [profiles.load(name) for name in ([model] if model else DEFAULT_MODELS)]
    candidates = [(one, each) for one in chosen for each in one.encodings if encoding in (None, each)]
    title = voice.say("monitor.title_file", file=file, line=capture.header.settings, speed=f"{speed:g}")
    return show(CaptureFeed(capture, candidates, title, speed), None, plain, period, duration)


def _line(
    link: str,
    model: str | None,
    addresses: tuple[int, ...] | None,
    baud: int | None,
    format: str | None,
    encoding: str | None,
    plain: bool,
    period: float,
    duration: float | None,
    record: str | None,
) -> Exit:
    from drivebus import profiles
    from drivebus.cli.connect import open_port, recorded
    from drivebus.cli.live.line import LineFeed
    from drivebus.cli.live.start import show

    known: Known
    if model is not None and addresses is not None:
        profile = profiles.load(model)
        known = [(profile, encoding, address) for address in addresses]
    else:
        known, baud, format = asyncio.run(_scanned(link, model, addresses, baud, format, encoding))
        if not known:
            voice.tell("scan.nobody")
            return Exit.REFUSED
    port = open_port(link, known[0][0], baud, format)
    title = voice.say("monitor.title", link=link, line=port.settings, count=len(known))
    with recorded(port, record) as heard:
        return show(LineFeed(heard, known, title), None, plain, period, duration)


def _dry(
    link: str,
    model: str | None,
    addresses: tuple[int, ...] | None,
    baud: int | None,
    format: str | None,
    encoding: str | None,
) -> Exit:
    """One round of polls; without --model and --address the scan that would come first. A capture sends nothing."""
    from drivebus.cli import dry
    from drivebus.cli.connect import Target
    from drivebus.cli.live.model import SIGNALS
    from drivebus.cli.scan_page import show_plan as show_scan
    from drivebus.cli.verbs.scan import make_plan

    if link.endswith(".dbcap"):
        return dry.show([], _line_of(link))
    if model is None or addresses is None:
        models = (model,) if model else DEFAULT_MODELS
        bauds, formats = (baud,) if baud else None, (format,) if format else None
        return show_scan(make_plan(link, models, addresses, bauds, formats, encoding))
    planned: list[dry.Planned] = []
    for address in addresses:
        one = dry.DryRun(Target(link, model, address, baud, format, encoding))
        names = tuple(name for name in SIGNALS if name in one.dialect.profile.signals)
        one.add("signals", [request for request, _ in one.dialect.polls(names)])
        planned += one.planned
    return dry.show(planned, Target(link, model, addresses[0], baud, format).line(), ["dry.note.rounds"])


def _line_of(file: str) -> LineSettings:
    from drivebus.capture import read_capture

    return read_capture(file).header.settings


async def _scanned(
    link: str,
    model: str | None,
    addresses: tuple[int, ...] | None,
    baud: int | None,
    format: str | None,
    encoding: str | None,
) -> tuple[Known, int | None, str | None]:
    """Find out who is there; reads only, after listening. Another master ends it: nothing is found."""
    from drivebus import ports, profiles
    from drivebus.cli.scan_page import Meter
    from drivebus.cli.verbs.scan import make_plan
    from drivebus.commissioning import scan

    models = (model,) if model else DEFAULT_MODELS
    passes = make_plan(link, models, addresses, (baud,) if baud else None, (format,) if format else None, encoding)
    voice.note("scan.listening", seconds=2)
    overheard = await scan.listen(
        ports.open_port(link, baud=passes[0].settings.baud, format=passes[0].settings.format), 2.0
    )
    if overheard.count:
        voice.note("scan.foreign", count=overheard.count, seconds=2)
        return [], None, None
    progress = scan.Progress(sum(one.seconds for one in passes))
    with Meter() as meter:
        await scan.scan(
            passes,
            lambda settings: ports.open_port(link, baud=settings.baud, format=settings.format),
            progress,
            meter.tell,
        )
    found = [one for one in progress.found if not one.doubtful]
    known: Known = [(profiles.load(one.models[0]), one.encoding, one.address) for one in found]
    if not found:
        return [], None, None
    return known, found[0].settings.baud, found[0].settings.format


command = Verb(
    "monitor",
    callback=_monitor,
    params=[
        options.source(),
        options.model(required=False),
        Option(
            ["--address", "addresses"],
            type=options.ADDRESSES,
            metavar="N,...",
            key="help.option.addresses",
            example="--address 1-3,7",
        ),
        *options.line(),
        options.encoding(),
        Option(["--plain"], is_flag=True),
        Option(["--period"], type=float, default=5.0, metavar="S", example="--period 2"),
        Option(["--duration"], type=float, metavar="S", example="--duration 60"),
        options.record(),
        options.dry_run(),
        Option(["--speed"], type=float, default=1.0, metavar="X", key="help.option.fast", example="--speed 10"),
    ],
    examples=(
        "drivebus monitor /dev/ttyUSB0 --model c320 --address 1-3",
        "drivebus monitor /dev/ttyUSB0",
        "drivebus monitor /dev/ttyUSB0 --model c320 --address 1-3 --record trip-of-pump-3.dbcap",
        "drivebus monitor trip-of-pump-3.dbcap --speed 10",
        "drivebus monitor sim://vc660@1-4 --model vc660 --address 1-4 --json --duration 10",
    ),
)
