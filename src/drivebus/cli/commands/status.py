"""``status``: state, fault and readings of a drive. Sends only reads."""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivebus.cli import connect, output
from drivebus.cli.connect import Target
from drivebus.cli.drive_command import drive_command
from drivebus.cli.errors import ExitCode

if TYPE_CHECKING:
    from drivebus.cli.dry_run import DryRun


async def _status(target: Target) -> ExitCode:
    from drivebus.cli.formatting import status_json, status_text

    async with connect.open_drive(target) as (bus, drive):
        status = await drive.status()
        now = bus.now()
    where = {"port": target.port, "model": target.model, "address": target.address}
    output.print_json(where | status_json(status, now))
    output.print_text(status_text(status, now, drive.profile))
    return ExitCode.DONE


def _plan(dry: DryRun) -> ExitCode:
    reads = dry.dialect.state_reads()
    dry.add("state", reads)
    names = tuple(dry.dialect.profile.signals)
    dry.add("signals", [request for request, _ in dry.dialect.polls(names) if request not in reads])
    return dry.print("dry.note.sync")


command = drive_command(
    "status",
    _status,
    _plan,
    examples=(
        "drivebus status sim://c320@1 --model c320 --address 1",
        "drivebus status /dev/ttyUSB0 --model vc660 --address 3 --baud 19200 --json",
        "drivebus status rfc2217://192.168.1.50:4001 --model df800 --address 2 --dry-run",
        "drivebus status --service http://127.0.0.1:8080 --drive fan-1",
    ),
)
