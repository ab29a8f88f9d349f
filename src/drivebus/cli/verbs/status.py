"""``status``: what a drive reports. Reads only."""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivebus.cli import connect, voice
from drivebus.cli.connect import Target
from drivebus.cli.drive_verb import drive_verb
from drivebus.cli.exits import Exit

if TYPE_CHECKING:
    from drivebus.cli.dry import DryRun


async def _status(target: Target) -> Exit:
    from drivebus.cli.live.model import status_document
    from drivebus.cli.outcome import status_lines

    async with connect.drive(target) as (bus, drive):
        status = await drive.status()
        now = bus.now()
    where = {"link": target.link, "model": target.model, "address": target.address}
    voice.document(where | status_document(status, now))
    voice.show(status_lines(status, now, drive.profile))
    return Exit.DONE


def _plan(dry: DryRun) -> Exit:
    reads = dry.dialect.state_reads()
    dry.add("state", reads)
    names = tuple(dry.dialect.profile.signals)
    dry.add("signals", [request for request, _ in dry.dialect.polls(names) if request not in reads])
    return dry.show("dry.note.fence")


command = drive_verb(
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
