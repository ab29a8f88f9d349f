"""``stop``: stop one drive, a group of a service, or with ``--all`` every drive of a bus or service; and confirm it."""

from __future__ import annotations

import asyncio
import json
import shlex
from collections.abc import Awaitable, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from drivebus.cli import options, output
from drivebus.cli.click_ext import Argument, Option
from drivebus.cli.connect import Target, record_port
from drivebus.cli.drive_command import (
    BUS_OPTIONS,
    RemoteCommand,
    check_port_form,
    pop_remote_target,
    reject_local_options,
    run_command,
)
from drivebus.cli.errors import ExitCode
from drivebus.cli.stop_errors import stop_errors, stop_to_the_end
from drivebus.cli.stop_result import (
    drives_by_status,
    exit_code,
    print_outcomes,
    print_reasons,
    print_service_result,
    result_text,
)
from drivebus.errors import ConfigurationError, StopUnconfirmed
from drivebus.types import Json
from drivebus.user_input import format_addresses, parse_addresses

if TYPE_CHECKING:
    from drivebus.bus import Bus
    from drivebus.drives import Drive, StopReport
    from drivebus.drives.outcome import Outcome

STOP_ACCEPT_TIMEOUT_S = 3.0  # a service accepts a stop at once; its result takes as long as the motor
_FLAGS_OF_ONE_DRIVE = ("--quick", "--assume-model", "--")  # left out of the command that stops several
_NOT_OF_ADDRESSES = ("everything", "service", "drive", "group", "directory")


def _stop(
    *,
    everything: bool,
    group: str | None,
    quick: bool,
    assume_model: bool,
    directory: str | None,
    target: str | None = None,
    **arguments: Any,
) -> ExitCode:
    if sum((everything, group is not None, arguments["drive"] is not None)) > 1:
        raise ConfigurationError("stop_all.one_selection")
    with stop_to_the_end(dry_run=arguments["dry_run"]):
        if group is not None:
            _check_of_many("--group", quick=quick, assume_model=assume_model)
            return _stop_group(arguments.pop("service"), group, arguments | {"directory": directory})
        if everything:
            return _stop_all(target, directory, quick=quick, assume_model=assume_model, arguments=arguments)
        if directory is not None:
            raise ConfigurationError("stop_all.needs_all")
        return _stop_one(target, arguments, quick=quick, assume_model=assume_model)


def _stop_all(
    target: str | None, directory: str | None, *, quick: bool, assume_model: bool, arguments: dict[str, Any]
) -> ExitCode:
    _check_of_many("--all", quick=quick, assume_model=assume_model)
    service = arguments.pop("service")
    if service is not None:
        _reject_bus_options(arguments | {"directory": directory}, "directory")
        return _stop_service(service)
    if directory is not None or target is None or target.endswith(".toml"):
        folder = _state_folder(target, directory)
        _reject_bus_options(arguments)
        return _stop_local_service(folder)
    return _stop_bus(target, arguments)


def _check_of_many(option: str, *, quick: bool, assume_model: bool) -> None:
    """Raise ConfigurationError for an option that is for a stop of one drive."""
    if quick:
        raise ConfigurationError("stop_all.not_quick", option=option)
    if assume_model:
        raise ConfigurationError("stop_all.not_assumed", option=option)


def _reject_bus_options(arguments: dict[str, Any], *more: str) -> None:
    """Raise ConfigurationError for an option of a bus, or of ``more``, that a stop through a service does not take."""
    reject_local_options(arguments | {"address": arguments["addresses"]}, (*BUS_OPTIONS, *more))


# --- one drive ----------------------------------------------------------------------------------------------------


def _stop_one(port: str | None, arguments: dict[str, Any], *, quick: bool, assume_model: bool) -> ExitCode:
    addresses, dry_run = arguments.pop("addresses"), arguments.pop("dry_run")
    with stop_errors(arguments["drive"]):
        remote = pop_remote_target(arguments | {"address": addresses, "dry_run": dry_run, "port": None})
    if remote is None:
        _require("target", port)
        if str(port).endswith(".toml"):
            raise ConfigurationError("stop_all.plant_needs_all", file=port)
        _require_model(str(port), arguments["model"])
        _require("addresses", addresses)
    target = remote or Target(port=str(port), address=addresses[0], must_record=False, **_port_options(arguments))
    if dry_run:
        return _print_plan(target, (target.address,), broadcast=False, quick=quick, assume_model=assume_model)

    def stop(drive: Drive) -> Awaitable[Outcome]:
        if assume_model:
            drive.assume_model()
        return drive.quick_stop() if quick else drive.stop(wait=True)

    with stop_errors(arguments["drive"]):
        return asyncio.run(run_command(target, stop))


def _port_options(arguments: Mapping[str, Any]) -> dict[str, Any]:
    return {name: arguments[name] for name in BUS_OPTIONS if name != "address"}


def _require(name: str, value: Any) -> None:
    """Raise the usage error of a missing parameter; which ones are required depends on ``--all``."""
    if value is None:
        context = click.get_current_context()
        raise click.MissingParameter(ctx=context, param=next(p for p in context.command.params if p.name == name))


def _require_model(port: str, model: str | None) -> None:
    """Raise the usage error of a missing model, PortUrlError where the port is none: that error names the remedy."""
    if model is None:
        check_port_form(port)
    _require("model", model)


# --- all drives of a bus ------------------------------------------------------------------------------------------


def _stop_bus(port: str, arguments: dict[str, Any]) -> ExitCode:
    """Stop the drives at ``--address``, or every drive that replies at an address of the model."""
    _require_model(port, arguments["model"])
    target = Target(port=port, address=0, must_record=False, **_port_options(arguments))
    addresses = arguments["addresses"] or _all_addresses(target)
    _check_addresses(target, addresses)
    if arguments["dry_run"]:
        return _print_plan(target, addresses, broadcast=True)
    with stop_errors(None):
        return asyncio.run(_stop_addresses(target, addresses, find=arguments["addresses"] is None))


def _all_addresses(target: Target) -> tuple[int, ...]:
    low, high = target.profile.addresses
    return tuple(address for address in range(low, high + 1) if address != target.profile.broadcast)


def _check_addresses(target: Target, addresses: tuple[int, ...]) -> None:
    """Raise ConfigurationError that names every address which the model does not have."""
    known = _all_addresses(target)
    outside = [address for address in addresses if address not in known]
    if outside:
        inside = format_addresses(sorted(set(addresses) - set(outside)) or known)
        expected = format_addresses(known)
        params = {"model": target.profile.model, "found": format_addresses(outside), "expected": expected}
        raise ConfigurationError("stop_all.addresses", **params, example=f"--address {inside}")


async def _stop_addresses(target: Target, addresses: tuple[int, ...], *, find: bool) -> ExitCode:
    from drivebus.bus import Bus
    from drivebus.drives import Drive, stop_bus

    profile, options = target.profile, target.drive_options()
    with record_port(target.open_port(), target.record, required=target.must_record) as port:
        async with Bus(port) as bus:
            drives = [Drive(bus, profile, each, encoding=target.encoding, options=options) for each in addresses]
            report = await (_stop_unknown_addresses(bus, drives) if find else stop_bus(bus, drives))
            for drive in drives:
                drive.close()
            return _print_report(report, bus.now())


async def _stop_unknown_addresses(bus: Bus, drives: list[Drive]) -> StopReport:
    """Stop the drives that there are among ``drives``, with a progress bar of each round."""
    from drivebus.drives import stop_all_addresses

    with output.ProgressBar() as bar:
        round_started_at, last_share = bus.now(), 0.0

        def show(drive: Drive, share: float) -> None:
            nonlocal round_started_at, last_share
            if share < last_share:  # the next round has begun
                round_started_at = bus.now()
            last_share, spent_s = share, bus.now() - round_started_at
            bar.update(f"{drive.profile.model} {drive.address:3d}", spent_s, spent_s / share)

        return await stop_all_addresses(bus, drives, show)


def _print_report(report: StopReport, now: float) -> ExitCode:
    from drivebus.cli.formatting import exchange_json, outcome_json

    drives = drives_by_status({str(address): {"status": outcome.status} for address, outcome in report.outcomes})
    uncovered = {"bus_stop.absent": report.absent, "bus_stop.lost": report.lost}
    text = result_text(drives, [output.text(key, count=len(found)) for key, found in uncovered.items() if found])
    output.print_json(
        {
            "confirmed": [address for address, _ in report.outcomes if str(address) in drives["confirmed"]],
            "acknowledged": list(report.acknowledged),
            "unconfirmed": list(report.unconfirmed),
            "absent": list(report.absent),
            "lost": list(report.lost),
            "text": text,
            "seconds": round(report.ended_at - report.started_at, 3),
            "broadcasts": [exchange_json(exchange) for exchange in report.broadcasts],
            "drives": {str(address): outcome_json(outcome, now) for address, outcome in report.outcomes},
        }
    )
    output.print_wrapped(text)
    language = output.language()
    print_reasons({str(address): each.text(language) for address, each in report.outcomes if not each.succeeded})
    return ExitCode.UNKNOWN if report.lost else exit_code(drives)


def _print_plan(
    target: Target,
    addresses: tuple[int, ...],
    *,
    broadcast: bool,
    quick: bool = False,
    assume_model: bool = False,
) -> ExitCode:
    from drivebus.cli.dry_run import DryRun, PlannedFrame, print_plan
    from drivebus.drives.dialects.base import StopMode

    frames: list[PlannedFrame] = []
    needs_unlock = False
    for number, address in enumerate(addresses):
        dry = DryRun(replace(target, address=address))
        is_checked = not assume_model and dry.add_model_check()
        if broadcast and number == 0 and not is_checked:
            dry.add("broadcast_stop", dry.dialect.broadcast_stop())
        mode = StopMode.QUICK_STOP if quick else StopMode.STOP
        dry.add(mode.value, dry.dialect.stop(mode))
        frames += dry.frames
        needs_unlock = needs_unlock or dry.dialect.unlock() is not None
    notes = ["dry.note.unlock"] * needs_unlock + ["dry.note.confirm"]
    return print_plan(frames, target.open_port().settings, [(note, {}) for note in notes])


# --- drives of a service ------------------------------------------------------------------------------------------


def _stop_service(service: str) -> ExitCode:
    """Stop every drive of the service at an address or socket."""
    from drivebus.cli.remote.client import call_once
    from drivebus.service.api.operations.plant import PLANT_STOP

    with stop_errors(service):
        result = call_once(service, PLANT_STOP.name, {})
    return print_service_result(result, service)


def _stop_group(service: str | None, group: str, arguments: dict[str, Any]) -> ExitCode:
    """Stop every drive of a group at once; starts are not inhibited by it."""
    from drivebus.cli.remote.client import call_once
    from drivebus.service.api.operations.groups import GROUP_STOP

    if service is None:
        raise ConfigurationError("service.group_alone")
    _reject_bus_options(arguments, "directory")
    with stop_errors(group):
        result = call_once(service, GROUP_STOP.name, {"group": group})
    return print_outcomes(result["outcomes"])


def _stop_local_service(folder: Path) -> ExitCode:
    """Stop every drive of a service on this machine, through the socket that accepts nothing else."""
    from drivebus.service.ipc.protocol import SERVICE_SOCKET, socket_path

    result = asyncio.run(_request_stop(folder))
    return print_service_result(result, str(socket_path(folder, SERVICE_SOCKET)))


def _state_folder(plant: str | None, directory: str | None) -> Path:
    """Return the state directory as given, or of the plant file, even one with errors. Raises ConfigurationError."""
    if directory is not None:
        return Path(directory)
    if plant is None:
        raise ConfigurationError("stop_all.which")
    from drivebus.service.config.load import state_directory_of

    try:
        return state_directory_of(plant)
    except ConfigurationError as error:
        error.add_note(output.text("stop_all.without_plant"))
        raise


async def _request_stop(folder: Path) -> Json:
    """Send the stop and return its result.

    Raises StopUnconfirmed if no service answers, this user may not call it, it hangs or ends before it reports the
    result, or reports another one.
    """
    from drivebus.service.ipc.protocol import (
        MAX_MESSAGE_BYTES,
        STOP_RECEIVED,
        STOP_REQUEST,
        STOP_SOCKET,
        short_socket_path,
        socket_path,
    )

    path = socket_path(folder, STOP_SOCKET)
    socket = str(path)
    try:
        with short_socket_path(path) as short:
            reader, writer = await asyncio.open_unix_connection(short, limit=MAX_MESSAGE_BYTES)
        writer.write(STOP_REQUEST)
    except PermissionError as error:
        raise StopUnconfirmed("stop_all.no_permission", socket=socket) from error
    except OSError as error:
        raise StopUnconfirmed("stop_all.no_service", socket=socket) from error
    try:
        accepted = await asyncio.wait_for(reader.readline(), STOP_ACCEPT_TIMEOUT_S)
        line = await reader.readline() if accepted else b""
        writer.close()
    except TimeoutError:
        raise StopUnconfirmed("stop_all.hangs", socket=socket, seconds=STOP_ACCEPT_TIMEOUT_S) from None
    except OSError:
        line = b""
    if not line:
        raise StopUnconfirmed("stop_all.gone", socket=socket)
    result: Json | None = None
    with suppress(ValueError):
        result = json.loads(line)
    if accepted != STOP_RECEIVED or not isinstance(result, dict) or not {"outcomes", "buses"} <= result.keys():
        raise StopUnconfirmed("stop_all.not_a_result", socket=socket)
    return result


class StopCommand(RemoteCommand):
    """Command that refuses several addresses without ``--all`` with the whole command that stops them."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        if not ctx.resilient_parsing:
            self._check_one_address(ctx, args)
        return super().parse_args(ctx, args)

    def _check_one_address(self, ctx: click.Context, args: list[str]) -> None:
        """Raise BadParameter for several addresses of a port without ``--all``."""
        try:
            values, _, _ = self.make_parser(ctx).parse_args(list(args))
            addresses = ",".join(dict.fromkeys(values.get("addresses", ())))
            is_one = len(parse_addresses(addresses)) == 1
        except (click.UsageError, ValueError):
            return  # the parsing that follows reports it
        is_plant = str(values.get("target") or "").endswith(".toml")
        if is_one or is_plant or any(values.get(name) for name in _NOT_OF_ADDRESSES):
            return  # with --all they are right, elsewhere the command reports what is wrong
        words, others = iter(args), []
        for word in words:
            if word == "--address":
                next(words, None)
            elif not word.startswith("--address=") and word not in _FLAGS_OF_ONE_DRIVE:
                others.append(word)
        whole = shlex.join(["drivebus", "stop", "--all", *others, "--address", addresses])
        param = next(each for each in self.params if each.name == "addresses")
        expected = output.text("cli.expect.one_address", command=whole)
        raise click.BadParameter(options.found_expected(addresses, expected), ctx, param)


command = StopCommand(
    "stop",
    callback=_stop,
    stops=True,
    params=[
        Argument(
            ["target"],
            metavar="PORT|PLANT.toml",
            required=False,
            key="help.argument.stop_target",
            shell_complete=options.complete_ports,
        ),
        options.model_option(required=False),
        Option(
            ["--address", "addresses"],
            type=options.ADDRESSES,
            metavar="N,...",
            key="help.option.stop_addresses",
            example="--address 1-8",
        ),
        Option(["--all", "everything"], is_flag=True, key="help.option.stop_all"),
        Option(["--quick"], is_flag=True, key="help.option.stop_quick"),
        Option(["--assume-model"], is_flag=True, key="help.option.assume_model"),
        Option(["--directory"], metavar="DIR", example="--directory /var/lib/drivebus/plants/hall"),
        *options.serial_options(),
        options.encoding_option(),
        options.profile_option(),
        options.record_option(),
        options.service_option(),
        options.service_drive_option(),
        options.group_option(),
        options.dry_run_option(),
    ],
    examples=(
        "drivebus stop /dev/ttyUSB0 --model c320 --address 1",
        "drivebus stop sim://vc660@3 --model vc660 --address 3 --json",
        "drivebus stop /dev/ttyUSB0 --model vc660 --address 3 --quick",
        "drivebus stop /dev/ttyUSB0 --model ms300 --address 3 --assume-model",
        "drivebus stop --service http://127.0.0.1:8080 --drive fan-1",
        "drivebus stop --service http://127.0.0.1:8080 --group fans",
        "drivebus stop --all /dev/ttyUSB0 --model c320 --address 1-8",
        "drivebus stop --all /dev/ttyUSB0 --model dzb100 --dry-run",
        "drivebus stop --all plant.toml",
        "drivebus stop --all --directory /var/lib/drivebus/plants/hall --json",
        "drivebus stop --all --service http://127.0.0.1:8080",
    ),
)
