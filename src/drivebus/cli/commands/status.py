"""``status``: state, fault and readings of a drive. Sends only reads."""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivebus.cli import connect, output
from drivebus.cli.connect import Target
from drivebus.cli.drive_command import drive_command
from drivebus.cli.errors import ExitCode

if TYPE_CHECKING:
    from drivebus.cli.dry_run import DryRun
    from drivebus.drives import Drive
    from drivebus.drives.dialects.base import Identity
    from drivebus.drives.state import DriveStatus


async def _status(target: Target) -> ExitCode:
    from drivebus.cli.formatting import status_json, status_text

    async with connect.open_drive(target) as (bus, drive):
        status = await (drive.status() if target.service is not None else _read_status(drive))
        now = bus.now()
        identity = None if target.service is not None else await _identity(drive)
    where = {"port": target.port, "model": target.model, "address": target.address}
    output.print_json(where | status_json(status, now) | {"identity": identity and identity.as_json()})
    output.print_text(status_text(status, now, drive.profile, identity))
    return ExitCode.DONE


async def _read_status(drive: Drive) -> DriveStatus:
    """Read the status, and again later where no reply came. Raises the error of the second attempt."""
    from drivebus.errors import NoReply

    try:
        return await drive.status()
    except NoReply as error:
        if error.key == "bus.late_reply":
            raise
        return await connect.read_again_later(drive.status)


async def _identity(drive: Drive) -> Identity | None:
    """Return what the drive reports about itself, None where its model has no such report or it does not answer."""
    from drivebus.errors import DrivebusError

    if not drive.dialect.identity_reads():
        return None
    try:
        identity = await drive.identify()
    except DrivebusError:
        return None
    return identity if identity.reported else None


def _plan(dry: DryRun) -> ExitCode:
    reads = dry.dialect.state_reads()
    dry.add("state", reads)
    names = tuple(dry.dialect.profile.signals)
    dry.add("signals", [request for request, _ in dry.dialect.polls(names) if request not in reads])
    dry.add("identity", dry.dialect.identity_reads())
    return dry.print("dry.note.sync")


command = drive_command(
    "status",
    _status,
    _plan,
    examples=(
        "drivebus status sim://c320@1 --model c320 --address 1",
        "drivebus status /dev/ttyUSB0 --model vc660 --address 3 --baud 19200 --json",
        "drivebus status rfc2217://10.0.0.7:4001 --model df800 --address 2 --dry-run",
        "drivebus status --service http://127.0.0.1:8080 --drive fan-1",
    ),
)
