"""``bus-stop``: every drive on a line, or on every line of a service; broadcast first, then one by one until each
reports stopped.
"""

from __future__ import annotations

import asyncio
import sys
from typing import TYPE_CHECKING, Any

from drivebus.cli import options, voice
from drivebus.cli.command import Option
from drivebus.cli.connect import Target
from drivebus.cli.exits import Exit
from drivebus.cli.service import option
from drivebus.cli.service.option import ServedVerb

if TYPE_CHECKING:
    from drivebus.bus import Bus
    from drivebus.drives import Drive, StopReport


_OWN = ("link", "model", "baud", "format", "encoding", "set", "record")


def _bus_stop(service: str | None, addresses: tuple[int, ...] | None, dry_run: bool, **line: Any) -> Exit:
    if service is not None:
        option.alone({**line, "address": addresses, "dry_run": dry_run}, (*_OWN, "address"))
        from drivebus.cli.service.stop import stop_everything

        return stop_everything(service)
    target = Target(address=0, **line)
    wanted = addresses or everybody(target)
    if dry_run:
        return _dry(target, wanted)
    return asyncio.run(_stop(target, wanted, named=addresses is not None))


def everybody(target: Target) -> tuple[int, ...]:
    """Every address that the model can have, but the broadcast."""
    profile = target.profile()
    low, high = profile.addresses
    return tuple(address for address in range(low, high + 1) if address != profile.broadcast)


async def _stop(target: Target, addresses: tuple[int, ...], named: bool) -> Exit:
    from drivebus.bus import Bus
    from drivebus.cli.connect import open_port, recorded
    from drivebus.drives import Drive, bus_stop

    profile = target.profile()
    settings = target.settings()
    with recorded(open_port(target.link, profile, target.baud, target.format), target.record) as port:
        async with Bus(port) as bus:
            drives = [Drive(bus, profile, each, encoding=target.encoding, settings=settings) for each in addresses]
            present = drives if named else await _sweep(bus, drives)
            report = await bus_stop(bus, present)
            absent = tuple(drive.address for drive in drives if drive not in present)
            for drive in drives:
                drive.close()
            return _tell(report, absent, bus.now())


async def _sweep(bus: Bus, drives: list[Drive]) -> list[Drive]:
    """Everybody at once where the family can, then one stop to each address; returns the drives that made a sound."""
    from drivebus.cli.progress import Bar
    from drivebus.drives.dialect import Stop
    from drivebus.message import Ask, Lane, WriteClass

    bus.latch(None)
    first = drives[0]
    for request in first.dialect.stop_everyone() if "broadcast_stop" in first.profile.capabilities else ():
        await bus.transact(Ask(first.address, request, Lane.STOP, WriteClass.BROADCAST))
    present, begun = [], bus.now()
    with Bar() as bar:
        for number, drive in enumerate(drives):
            request = drive.dialect.stop(Stop.STOP)[0]
            answer = await bus.transact(Ask(drive.address, request, Lane.STOP, WriteClass.ABSOLUTE))
            if answer.received:
                present.append(drive)
            spent = bus.now() - begun
            bar.move(f"{drive.profile.model} {drive.address:3d}", spent, spent / (number + 1) * len(drives))
    return present


def _tell(report: StopReport, absent: tuple[int, ...], now: float) -> Exit:
    from drivebus.cli.outcome import exchange_document, outcome_document

    words = by_word(report)
    unconfirmed = words["unknown"]
    voice.document(
        {
            "confirmed": words["confirmed"],
            "acknowledged": words["acknowledged"],
            "unconfirmed": unconfirmed,
            "absent": list(absent),
            "text": report_text(report, absent),
            "seconds": round(report.ended_at - report.begun_at, 3),
            "broadcasts": [exchange_document(one) for one in report.broadcasts],
            "drives": {str(address): outcome_document(one, now) for address, one in report.outcomes},
        }
    )
    voice.show(voice.wrapped(report_text(report, absent), sys.stdout))
    nobody = not report.outcomes
    return Exit.UNKNOWN if unconfirmed or nobody else Exit.DONE


def by_word(report: StopReport) -> dict[str, list[int]]:
    """Addresses by how their stop ended; everything that is neither confirmed nor acknowledged is unknown."""
    words: dict[str, list[int]] = {"confirmed": [], "acknowledged": [], "unknown": []}
    for address, outcome in report.outcomes:
        words[str(outcome.word) if outcome.done else "unknown"].append(address)
    return words


def report_text(report: StopReport, absent: tuple[int, ...] = ()) -> str:
    """Who stopped, who said yes but can't show it, and where somebody must go and look."""
    said = []
    for word, found in by_word(report).items():
        shown = [str(address) for address in found]
        said += [voice.say(f"bus_stop.{word}", addresses=", ".join(shown))] if shown else []
    if absent:
        said.append(voice.say("bus_stop.absent", count=len(absent)))
    return voice.sentences(said)


def _dry(target: Target, addresses: tuple[int, ...]) -> Exit:
    from dataclasses import replace

    from drivebus.cli.dry import DryRun, show
    from drivebus.drives.dialect import Stop

    planned: list[Any] = []
    for number, address in enumerate(addresses):
        dry = DryRun(replace(target, address=address))
        if number == 0:
            dry.add("broadcast_stop", dry.dialect.stop_everyone())
        dry.add("stop", dry.dialect.stop(Stop.STOP))
        planned += dry.planned
    return show(planned, target.line(), ["dry.note.confirm"])


command = ServedVerb(
    "bus-stop",
    callback=_bus_stop,
    params=[
        options.link(),
        options.model(),
        Option(
            ["--address", "addresses"],
            type=options.ADDRESSES,
            metavar="N,...",
            key="help.option.stop_addresses",
            example="--address 1-8",
        ),
        *options.line(),
        options.encoding(),
        options.setting(),
        options.record(),
        *option.service(),
        options.dry_run(),
    ],
    examples=(
        "drivebus bus-stop /dev/ttyUSB0 --model c320 --address 1-8",
        "drivebus bus-stop /dev/ttyUSB0 --model dzb100 --dry-run",
        "drivebus bus-stop --service http://127.0.0.1:8080",
    ),
)
