"""Commands on one drive: parameters, target, execution and outcome.

Each works on a PORT, or with ``--service`` and ``--drive`` on a drive of a running service.
"""

from __future__ import annotations

import asyncio
import copy
from collections.abc import Awaitable, Callable, Sequence
from contextlib import nullcontext
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import click

from drivebus.cli import connect, options, output
from drivebus.cli.background_output import background_output
from drivebus.cli.click_ext import CliCommand
from drivebus.cli.connect import Target
from drivebus.cli.errors import ExitCode
from drivebus.cli.stop_errors import stop_errors, stop_to_the_end
from drivebus.errors import ConfigurationError, InvalidParameters, NotFound

if TYPE_CHECKING:
    from drivebus.bus import Bus
    from drivebus.cli.remote.drive import RemoteBus, RemoteDrive
    from drivebus.cli.run_watch import Remark
    from drivebus.drives import Drive, DriveLimits
    from drivebus.drives.outcome import Outcome

BUS_OPTIONS = ("model", "address", "baud", "format", "encoding", "option", "record")  # options of a drive on a port
_PORT_OPTIONS = ("port", *BUS_OPTIONS)
_LOCAL_OPTIONS = ("dry_run", "wait", "eeprom_writes_per_day")  # options of some commands that a service does not take
_REPLACED_ARGUMENTS = ("port", "source", "target")  # arguments that ``--service`` replaces
_SERVICE_GIVEN = "drivebus.service"
MAX_START_DELAY_S = 60.0  # from the command to the start: opening and reading take seconds, a standby longer


class RemoteCommand(CliCommand):
    """A command that needs no PORT if ``--service`` is given."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        own = args[: args.index("--")] if "--" in args else args
        ctx.meta[_SERVICE_GIVEN] = any(word == "--service" or word.startswith("--service=") for word in own)
        if not ctx.resilient_parsing:
            self._check_port(ctx, args)
        try:
            return super().parse_args(ctx, args)
        except click.MissingParameter:
            if not ctx.meta[_SERVICE_GIVEN]:  # a drive or group of a service needs no port, model or address
                for name in ("group", "drive"):
                    if ctx.params.get(name) is not None:
                        raise ConfigurationError(f"service.{name}_alone") from None
                check_port_form(ctx.params.get("port"))
            raise

    def _check_port(self, ctx: click.Context, args: list[str]) -> None:
        """Raise UsageError where a port does not stand first, or is given beside ``--service``, which replaces it.

        So is a flag without its dashes: ``stop all PORT``.
        """
        arguments = [param for param in self.params if isinstance(param, click.Argument)]
        replaced = next(param for param in arguments if param.name in _REPLACED_ARGUMENTS)
        try:
            values, words, _ = self.make_parser(ctx).parse_args(list(args))
        except click.UsageError:
            return  # the parser of click reports it
        for param in reversed(arguments):
            value = values.get(str(param.name))
            words = [*(value if isinstance(value, tuple) else [value] if isinstance(value, str) else []), *words]
        if not words:
            return
        flags = {name for param in self.params if getattr(param, "is_flag", False) for name in param.opts}
        if bare := next((word for word in words if f"--{word}" in flags), None):
            raise click.UsageError(output.text("cli.without_dashes", found=bare, option=f"--{bare}"), ctx)
        has_port_first = _is_port(words[0])
        if ctx.meta[_SERVICE_GIVEN] and (arguments == [replaced] or has_port_first):
            is_name = not has_port_first and not words[0].endswith(".toml") and not values.get("drive")
            key = "cli.service_drive" if is_name and _has_option(self, "drive") else "cli.service_replaces"
            name = replaced.make_metavar(ctx).strip("[]")
            raise click.UsageError(output.text(key, name=name, found=words[0]), ctx)
        port = None if has_port_first else next(filter(_is_port, words[1:]), None)
        if port is not None:
            raise click.UsageError(output.text("cli.port_first", port=port, found=words[0]), ctx)

    def get_params(self, ctx: click.Context) -> list[click.Parameter]:
        params = super().get_params(ctx)
        if not ctx.meta.get(_SERVICE_GIVEN):
            return params
        return [_optional(param) for param in params if param.name not in _REPLACED_ARGUMENTS]


def _has_option(command: click.Command, name: str) -> bool:
    return any(param.name == name for param in command.params)


def _is_port(word: str) -> bool:
    from drivebus.errors import PortUrlError
    from drivebus.ports.url import parse_port_url

    try:
        parse_port_url(word)
    except PortUrlError:
        return False
    return True


def check_port_form(port: str | None) -> None:
    """Raise PortUrlError where a port is none by its form, such as the name of a service's drive or its page's address.

    The hint of that error is ``--service``, which needs no ``--model``.
    """
    from drivebus.ports import open_port

    if port is not None:
        open_port(port)


def _optional(param: click.Parameter) -> click.Parameter:
    """Return a copy that is not required where the service has the value: model and address of a drive."""
    if not (param.required and param.name in _PORT_OPTIONS):
        return param
    optional = copy.copy(param)
    optional.required = False
    return optional


def drive_command(
    name: str,
    execute: Callable[..., Awaitable[ExitCode]],
    plan: Callable[..., ExitCode],
    *,
    on_group: Callable[..., Awaitable[ExitCode]] | None = None,
    extra: tuple[click.Parameter, ...] = (),
    stops: bool = False,
    stays_attached: bool = False,
    examples: tuple[str, ...],
) -> CliCommand:
    """Return a command: ``execute(target, **extra)`` runs it, ``plan(dry, **extra)`` prints its frames.

    With ``on_group(service, group, **extra)`` it has ``--group``, for all drives of a group of a service.
    ``stops``: an error that keeps the frame from being sent is reported as one of a stop; ``stays_attached``: the motor
    runs while the command prints, so that it never waits for the reader of its output.
    """

    def run_stop(**arguments: Any) -> ExitCode:
        with stop_to_the_end(dry_run=arguments["dry_run"]), stop_errors(arguments["drive"]):
            return run(**arguments)

    def run(**arguments: Any) -> ExitCode:
        if on_group is not None and (group := arguments.pop("group")) is not None:
            return asyncio.run(on_group(_pop_service_of_group(arguments), group, **arguments))  # type: ignore[arg-type]
        remote = pop_remote_target(arguments)
        dry_run = arguments.pop("dry_run")
        target = remote or replace(pop_target(arguments), must_record=not stops)
        if dry_run:
            from drivebus.cli.dry_run import DryRun

            return plan(DryRun(target), **arguments)
        with background_output() if stays_attached else nullcontext():
            return asyncio.run(execute(target, **arguments))  # type: ignore[arg-type]

    port, *rest = options.drive_options()
    params = [port, *[param for param in extra if param.param_type_name == "argument"], *rest]
    params += [param for param in extra if param.param_type_name != "argument"]
    params += [options.service_option(), options.service_drive_option()]
    params += [options.group_option()] if on_group is not None else []
    params.append(options.dry_run_option())
    return RemoteCommand(name, callback=run_stop if stops else run, params=params, examples=examples, stops=stops)


def pop_target(arguments: dict[str, Any]) -> Target:
    """Take the options of ``options.drive_options()`` out of ``arguments``."""
    return Target(**{name: arguments.pop(name) for name in _PORT_OPTIONS})


def pop_remote_target(arguments: dict[str, Any]) -> Target | None:
    """Return the drive of ``--service`` and ``--drive`` with its model and address; None without ``--service``.

    Takes these and the options of a port out of ``arguments``. Raises ConfigurationError for an option that a service
    does not take, and for one of the two without the other.
    """
    service, drive = arguments.pop("service", None), arguments.pop("drive", None)
    if service is None:
        if drive is not None:
            raise ConfigurationError("service.drive_alone")
        return None
    reject_local_options(arguments, _PORT_OPTIONS)
    if drive is None:
        raise ConfigurationError("service.no_drive")
    for name in _PORT_OPTIONS:
        arguments.pop(name, None)
    from drivebus.cli.remote.client import call_once
    from drivebus.service.api.operations.drives import DRIVES_GET, DRIVES_LIST

    try:
        view = call_once(service, DRIVES_GET.name, {"drive": drive})
    except InvalidParameters:  # no name of a drive by its form, such as a title
        names = sorted(each["id"] for each in call_once(service, DRIVES_LIST.name, {})["drives"])
        raise NotFound("plant.no_drive", id=drive, known=names) from None
    return Target(port=service, model=view["model"], address=view["address"], service=service, drive=drive)


def _pop_service_of_group(arguments: dict[str, Any]) -> str:
    """Return ``--service``, and take it and the options of one drive or a port out of ``arguments``.

    Raises ConfigurationError without it, and for an option that a service does not take.
    """
    service: str | None = arguments.pop("service")
    if arguments.pop("drive") is not None:
        raise ConfigurationError("service.drive_or_group")
    if service is None:
        raise ConfigurationError("service.group_alone")
    reject_local_options(arguments, _PORT_OPTIONS)
    for name in (*_PORT_OPTIONS, "dry_run"):
        arguments.pop(name, None)
    return service


def reject_local_options(arguments: dict[str, Any], names: Sequence[str]) -> None:
    """Raise ConfigurationError for an option that a service does not take."""
    wrong = next((name for name in (*names, *_LOCAL_OPTIONS) if arguments.get(name) not in (None, False, ())), None)
    if wrong is not None:
        raise ConfigurationError("service.not_with", option=f"--{wrong.replace('_', '-')}")


async def run_command(
    target: Target, operation: Callable[[Drive], Awaitable[Outcome]], limits: DriveLimits | None = None
) -> ExitCode:
    """Run one operation on one drive and print its outcome; the exit code is that of the outcome in any case."""
    with output.continue_without_output():
        async with connect.open_drive(target, limits) as (bus, drive):
            return print_outcome(await operation(drive), bus.now())


def print_outcome(outcome: Outcome, now: float, *, stream: bool = False, **more: Any) -> ExitCode:
    """Print an outcome, ``more`` in its JSON; return its exit code."""
    from drivebus.cli.formatting import outcome_exit_code, outcome_json, outcome_text

    output.print_json(more | outcome_json(outcome, now), stream=stream)
    output.print_text(outcome_text(outcome))
    return outcome_exit_code(outcome)


def print_remark(remark: Remark) -> None:
    """Print a remark on a line of its own."""
    text = output.text(remark.key, **remark.params)
    output.print_json({"event": "remark", "key": remark.key, "text": text}, stream=True)
    output.end_live_line()
    output.print_wrapped(text)


async def print_comm_loss(drive: Drive) -> None:
    """Print the drive's own reaction to a communication loss, before a motion that it alone may have to end."""
    report = await drive.comm_loss_behaviour()
    text = report.text(output.language())
    output.print_json(
        {"event": "comm_loss", "stops_on_comm_loss": report.stops_on_comm_loss, "text": text}, stream=True
    )
    output.print_wrapped(text)


def monotonic_now() -> float:
    """Return monotonic seconds that go on while the computer is suspended, where the system has them."""
    from drivebus.bus import timer

    return timer.loop_now(asyncio.get_running_loop())


def check_start_delay(requested_at: float) -> None:
    """Raise Expired where the start was requested so long ago, by ``monotonic_now``, that its user has left."""
    from drivebus.errors import Expired

    age_s = monotonic_now() - requested_at
    if age_s > MAX_START_DELAY_S:
        raise Expired("drives.checks_timeout", age_s=round(age_s, 1), limit_s=MAX_START_DELAY_S)


async def stop_and_print(bus: Bus | RemoteBus, drive: Drive | RemoteDrive, code: ExitCode) -> ExitCode:
    """Stop at the end of an attached command; an unconfirmed stop decides the exit code.

    Nothing is printed before the stop is sent.
    """
    stopping = asyncio.ensure_future(drive.stop(wait=True))
    await asyncio.sleep(0)
    with output.continue_without_output():
        output.end_live_line()
        output.print_message("run.stopping")
        stopped = print_outcome(await stopping, bus.now(), event="stopped", stream=True)
    return code if stopped is ExitCode.DONE else stopped


def must_stop_after(error: BaseException) -> bool:
    """Return whether a stop must follow a failed command: always, unless its drive or its service rules that out."""
    return getattr(error, "may_be_running", None) is not False
