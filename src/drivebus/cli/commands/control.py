"""``control``: ask the user who controls a drive of a running service for its control, and answer such a request."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any

import click

from drivebus.cli import options, output
from drivebus.cli.click_ext import CliCommand, LazyGroup, Option
from drivebus.cli.errors import ExitCode

if TYPE_CHECKING:
    from drivebus.cli.remote.client import RemoteClient
    from drivebus.service.api.operations import Operation
    from drivebus.types import Json

ANSWER_POLL_PERIOD_S = 0.5


def _request(service: str, drive: str, reason: str | None, *, hold: bool) -> ExitCode:
    """Ask, wait for the answer, and with ``hold`` keep control until Ctrl-C."""

    async def ask() -> ExitCode:
        from drivebus.cli.remote.client import open_client

        async with open_client(service) as client:
            answer = await _ask(client, drive, reason)
            output.print_json({"control": answer["state"], "drive": drive, "by": answer["answered_by"]}, stream=True)
            key = f"control.{answer['state']}"
            if answer["state"] == "granted" and (hold or client.is_local):
                key = "control.granted_until_ctrl_c" if hold else "control.granted_and_free"
            output.print_message(key, drive=drive, by=answer["answered_by"] or "")
            if answer["state"] != "granted":
                return ExitCode.FAILED
            if client.is_local or hold:
                await _use_control(client, drive, hold=hold)
            return ExitCode.DONE

    async def interruptible() -> ExitCode:
        from drivebus.cli.signals import shutdown_signals

        with shutdown_signals() as shutdown, output.continue_without_output():  # once made, the request may be granted
            code = await shutdown.interruptible(ask())
        return ExitCode.INTERRUPTED if code is None else code

    return asyncio.run(interruptible())


async def _ask(client: RemoteClient, drive: str, reason: str | None) -> Json:
    """Return the request once it has ended. It is withdrawn where the command is interrupted."""
    from drivebus.service.api.operations.control import CONTROL_REQUEST_MAKE, CONTROL_REQUEST_WITHDRAW
    from drivebus.service.api.operations.drives import DRIVES_GET

    making = asyncio.ensure_future(client.call(CONTROL_REQUEST_MAKE.name, {"drive": drive, "reason": reason}))
    try:
        reply = await asyncio.shield(making)
        made: Json = reply["control_request"]
        output.print_note("control.asked", drive=drive, owner=reply["lease"]["owner"])
        while True:
            request: Json | None = (await client.call(DRIVES_GET.name, {"drive": drive}))["control_request"]
            if request is None or request["id"] != made["id"]:
                return made | {"state": "expired"}
            if request["state"] != "open":
                return request
            await asyncio.sleep(ANSWER_POLL_PERIOD_S)
    except asyncio.CancelledError:
        await making  # the service may have made the request before its reply arrives
        await client.call(CONTROL_REQUEST_WITHDRAW.name, {"drive": drive})
        raise


async def _use_control(client: RemoteClient, drive: str, *, hold: bool) -> None:
    """Renew control until the command is interrupted, then release it; without ``hold`` release it at once.

    On the socket of the service each command has a session of its own, and takes control that is free. Each request of
    another user is printed once.
    """
    from drivebus.cli.connect import note_control_request
    from drivebus.cli.remote.drive import LEASE_RENEW_PERIOD_S
    from drivebus.service.api.operations.control import LEASE_RELEASE, LEASE_RENEW

    printed: str | None = None
    try:
        while hold:
            request = (await client.call(LEASE_RENEW.name, {"drive": drive})).get("control_request")
            if request is not None and request["id"] != printed:
                printed = request["id"]
                note_control_request(drive, request)
            await asyncio.sleep(LEASE_RENEW_PERIOD_S)
    finally:
        await client.call(LEASE_RELEASE.name, {"drive": drive})


def _grant(service: str, drive: str) -> None:
    from drivebus.service.api.operations.control import CONTROL_REQUEST_GRANT

    _answer(service, drive, CONTROL_REQUEST_GRANT, "control.did_grant")


def _decline(service: str, drive: str) -> None:
    from drivebus.service.api.operations.control import CONTROL_REQUEST_DECLINE

    _answer(service, drive, CONTROL_REQUEST_DECLINE, "control.did_decline")


def _answer(service: str, drive: str, operation: Operation, key: str) -> None:
    """Answer the open request for control of a drive. Raises NotFound without one."""
    from drivebus.cli.remote.client import open_client
    from drivebus.errors import NotFound
    from drivebus.service.api.operations.drives import DRIVES_GET

    async def answer() -> Json:
        async with open_client(service) as client:
            request: Json | None = (await client.call(DRIVES_GET.name, {"drive": drive}))["control_request"]
            if request is None or request["state"] != "open":
                raise NotFound("plant.no_control_request", drive=drive)
            await client.call(operation.name, {"drive": drive, "request": request["id"]})
            return request

    user = asyncio.run(answer())["user"]
    with output.continue_without_output():  # it is answered
        output.print_json({"drive": drive, "user": user})
        output.print_message(key, drive=drive, user=user)


def _control_command(name: str, callback: Any, *more: click.Parameter, example: str = "") -> CliCommand:
    drive = options.required(options.service_drive_option())
    return CliCommand(
        name,
        help_key=f"control.{name}",
        callback=callback,
        params=[options.required(options.service_option()), drive, *more],
        examples=(f"drivebus control {name} --service http://127.0.0.1:8080 --drive fan-1{example}",),
    )


request = _control_command(
    "request",
    _request,
    Option(["--reason"], metavar="TEXT", key="help.option.control_reason"),
    Option(["--hold"], is_flag=True, key="help.option.control_hold"),
    example=' --reason "belt is slipping"',
)
grant = _control_command("grant", _grant)
decline = _control_command("decline", _decline)

command = LazyGroup(
    "control",
    help_key="control",
    sections={
        "cli.section.commands": {
            name: f"drivebus.cli.commands.control:{name}" for name in ("request", "grant", "decline")
        }
    },
    no_args_is_help=True,
    examples=("drivebus control request --service http://127.0.0.1:8080 --drive fan-1",),
)
