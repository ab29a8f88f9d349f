"""``release``: permit starts again after a bus stop of a running service. Nothing is sent to a drive."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

import click

from drivebus.cli import options, output
from drivebus.cli.click_ext import CliCommand, Option
from drivebus.cli.errors import ExitCode
from drivebus.types import Json

if TYPE_CHECKING:
    from drivebus.cli.remote.client import RemoteClient


def _release(service: str, drive: str | None, everything: bool) -> ExitCode:
    """Raises ConfigurationError unless exactly one of ``--drive`` and ``--all`` is given."""
    from drivebus.errors import ConfigurationError

    if (drive is None) is not everything:
        raise ConfigurationError("release.which")
    return asyncio.run(_release_drives(service, drive))


async def _release_drives(service: str, drive: str | None) -> ExitCode:
    from drivebus.cli.remote.client import open_client
    from drivebus.service.api.operations.drives import DRIVES_GET, DRIVES_LIST

    async with open_client(service) as client:
        if drive is None:
            views = (await client.call(DRIVES_LIST.name, {}))["drives"]
        else:
            views = [await client.call(DRIVES_GET.name, {"drive": drive})]
        inhibited = [view for view in views if view["start_inhibited"]]
        for view in inhibited:
            await _release_drive(client, view)
            output.print_json({"released": view["id"]}, stream=True)
            output.print_message("release.done", drive=view["id"])
    if not inhibited:
        output.print_json({"released": None}, stream=True)
        output.print_message("release.nothing")
    return ExitCode.DONE


async def _release_drive(client: RemoteClient, view: Json) -> None:
    """Release one drive under its control lease. Raises ControlNotHeld where another user controls it."""
    from drivebus import profiles
    from drivebus.cli.remote.drive import RemoteDrive

    drive = RemoteDrive(client, view["id"], view["address"], profiles.load(view["model"]))
    try:
        await drive.release_start_inhibit()
    finally:
        await drive.close()


def _required_service() -> click.Option:
    option = options.service_option()
    option.required = True
    return option


command = CliCommand(
    "release",
    callback=_release,
    params=[
        _required_service(),
        options.service_drive_option(),
        Option(["--all", "everything"], is_flag=True, key="help.option.release_all"),
    ],
    examples=(
        "drivebus release --service http://127.0.0.1:8080 --drive fan-1",
        "drivebus release --service http://127.0.0.1:8080 --all",
    ),
)
