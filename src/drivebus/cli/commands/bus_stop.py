"""``bus-stop``: every drive on a line, or on every line of a service; broadcast first, then one by one until each
reports stopped.
"""

from __future__ import annotations

import asyncio
import sys
from typing import TYPE_CHECKING, Any

from drivebus.cli import options, output
from drivebus.cli.click_ext import Option
from drivebus.cli.connect import Target
from drivebus.cli.errors import ExitCode
from drivebus.cli.remote import options as remote_options
from drivebus.cli.remote.options import RemoteCommand

if TYPE_CHECKING:
    from drivebus.bus import Bus
    from drivebus.drives import Drive, StopReport


_OWN = ("link", "model", "baud", "format", "encoding", "set", "record")


def _bus_stop(service: str | None, addresses: tuple[int, ...] | None, dry_run: bool, **line: Any) -> ExitCode:
    if service is not None:
        remote_options.reject_local_options({**line, "address": addresses, "dry_run": dry_run}, (*_OWN, "address"))
        from drivebus.cli.remote.stop import stop_all_remote

        return stop_all_remote(service)
    target = Target(address=0, **line)
    wanted = addresses or all_addresses(target)
    if dry_run:
        return _plan(target, wanted)
    return asyncio.run(_stop(target, wanted, named=addresses is not None))


def all_addresses(target: Target) -> tuple[int, ...]:
    """Every address that the model can have, but the broadcast."""
    profile = target.profile()
    low, high = profile.addresses
    return tuple(address for address in range(low, high + 1) if address != profile.broadcast)


async def _stop(target: Target, addresses: tuple[int, ...], named: bool) -> ExitCode:
    from drivebus.bus import Bus
    from drivebus.cli.connect import open_port, record_port
    from drivebus.drives import Drive, stop_bus

    profile = target.profile()
    settings = target.drive_options()
    with record_port(open_port(target.link, profile, target.baud, target.format), target.record) as port:
        async with Bus(port) as bus:
            drives = [Drive(bus, profile, each, encoding=target.encoding, settings=settings) for each in addresses]
            present = drives if named else await _sweep(bus, drives)
            report = await stop_bus(bus, present)
            absent = tuple(drive.address for drive in drives if drive not in present)
            for drive in drives:
                drive.close()
            return _print_report(report, absent, bus.now())


async def _sweep(bus: Bus, drives: list[Drive]) -> list[Drive]:
    """Everybody at once where the family can, then one stop to each address; returns the drives that made a sound."""
    from drivebus.bus.messages import BusRequest, RequestPriority, RetryPolicy
    from drivebus.cli.progress import ProgressBar
    from drivebus.drives.dialects.base import StopMode

    bus.inhibit_start(None)
    first = drives[0]
    for request in first.dialect.broadcast_stop() if "broadcast_stop" in first.profile.capabilities else ():
        await bus.transact(BusRequest(first.address, request, RequestPriority.STOP, RetryPolicy.BROADCAST))
    present, begun = [], bus.now()
    with ProgressBar() as bar:
        for number, drive in enumerate(drives):
            request = drive.dialect.stop(StopMode.STOP)[0]
            answer = await bus.transact(
                BusRequest(drive.address, request, RequestPriority.STOP, RetryPolicy.IDEMPOTENT)
            )
            if answer.received:
                present.append(drive)
            spent = bus.now() - begun
            bar.update(f"{drive.profile.model} {drive.address:3d}", spent, spent / (number + 1) * len(drives))
    return present


def _print_report(report: StopReport, absent: tuple[int, ...], now: float) -> ExitCode:
    from drivebus.cli.formatting import exchange_json, outcome_json

    words = addresses_by_status(report)
    unconfirmed = words["unknown"]
    output.print_json(
        {
            "confirmed": words["confirmed"],
            "acknowledged": words["acknowledged"],
            "unconfirmed": unconfirmed,
            "absent": list(absent),
            "text": report_text(report, absent),
            "seconds": round(report.ended_at - report.started_at, 3),
            "broadcasts": [exchange_json(one) for one in report.broadcasts],
            "drives": {str(address): outcome_json(one, now) for address, one in report.outcomes},
        }
    )
    output.print_text(output.wrap_for(report_text(report, absent), sys.stdout))
    nobody = not report.outcomes
    return ExitCode.UNKNOWN if unconfirmed or nobody else ExitCode.DONE


def addresses_by_status(report: StopReport) -> dict[str, list[int]]:
    """Addresses by how their stop ended; everything that is neither confirmed nor acknowledged is unknown."""
    words: dict[str, list[int]] = {"confirmed": [], "acknowledged": [], "unknown": []}
    for address, outcome in report.outcomes:
        words[str(outcome.status) if outcome.succeeded else "unknown"].append(address)
    return words


def report_text(report: StopReport, absent: tuple[int, ...] = ()) -> str:
    """Who stopped, who said yes but can't show it, and where somebody must go and look."""
    said = []
    for word, found in addresses_by_status(report).items():
        shown = [str(address) for address in found]
        said += [output.text(f"bus_stop.{word}", addresses=", ".join(shown))] if shown else []
    if absent:
        said.append(output.text("bus_stop.absent", count=len(absent)))
    return output.join_sentences(said)


def _plan(target: Target, addresses: tuple[int, ...]) -> ExitCode:
    from dataclasses import replace

    from drivebus.cli.dry_run import DryRun, print_plan
    from drivebus.drives.dialects.base import StopMode

    planned: list[Any] = []
    for number, address in enumerate(addresses):
        dry = DryRun(replace(target, address=address))
        if number == 0:
            dry.add("broadcast_stop", dry.dialect.broadcast_stop())
        dry.add("stop", dry.dialect.stop(StopMode.STOP))
        planned += dry.frames
    return print_plan(planned, target.serial_settings(), ["dry.note.confirm"])


command = RemoteCommand(
    "bus-stop",
    callback=_bus_stop,
    params=[
        options.port_argument(),
        options.model_option(),
        Option(
            ["--address", "addresses"],
            type=options.ADDRESSES,
            metavar="N,...",
            key="help.option.stop_addresses",
            example="--address 1-8",
        ),
        *options.serial_options(),
        options.encoding_option(),
        options.profile_option(),
        options.record_option(),
        *remote_options.service_option(),
        options.dry_run_option(),
    ],
    examples=(
        "drivebus bus-stop /dev/ttyUSB0 --model c320 --address 1-8",
        "drivebus bus-stop /dev/ttyUSB0 --model dzb100 --dry-run",
        "drivebus bus-stop --service http://127.0.0.1:8080",
    ),
)
