"""``serve``: run the service of a plant until it is ended."""

from __future__ import annotations

import asyncio
import signal
import sys
from typing import TYPE_CHECKING

from drivebus.cli import output
from drivebus.cli.click_ext import Argument, Choice, CliCommand, Option
from drivebus.cli.early_interrupt import end_interrupt_on_sigterm, interrupt_on_sigterm, is_early_interrupt
from drivebus.cli.errors import ExitCode
from drivebus.cli.extras import require_extra
from drivebus.errors import ConfigurationError

if TYPE_CHECKING:
    from drivebus.service.config.model import PlantConfig
    from drivebus.service.process.gateway_arguments import AddressOutput
    from drivebus.service.process.logging_setup import LogFormat


def _serve(plant: str, without: tuple[str, ...], log: LogFormat) -> ExitCode:
    """Run the service. A signal before it has its handlers ends it with a sentence: no port was opened until then."""
    signal.signal(signal.SIGHUP, signal.SIG_IGN)  # a reload during the start; systemd counts an end by it as clean
    interrupt_on_sigterm()
    try:
        return _start(plant, without, log)
    except (KeyboardInterrupt, RuntimeError) as error:
        if not is_early_interrupt(error):
            raise
        end_interrupt_on_sigterm()
        output.print_note("cli.interrupted_early")
        return ExitCode.INTERRUPTED


def _start(plant: str, without: tuple[str, ...], log: LogFormat) -> ExitCode:
    from drivebus.service.config.gateways import installed_gateways
    from drivebus.service.config.load import load
    from drivebus.service.process.logging_setup import configure_logging

    config = load(plant)
    for name in without:
        if name not in installed_gateways():
            raise ConfigurationError("gateways.unknown", found=name, expected=tuple(installed_gateways()))
    for gateway in config.gateways:
        if gateway.extra is not None and gateway.enabled and gateway.id not in without:
            require_extra(gateway.extra)
    output.export_language()
    # A checkpoint helps where the log is kept; at a terminal it only stood before the address of the page.
    configure_logging(log, without_events=("checkpoint",) if sys.stderr.isatty() else ())
    return asyncio.run(_run(config, without, log))


async def _run(config: PlantConfig, without: tuple[str, ...], log: LogFormat) -> ExitCode:
    from drivebus.service.control.stops import DECELERATING
    from drivebus.service.process.logging_setup import LOG
    from drivebus.service.process.main import run_service

    def ready() -> None:
        with output.continue_without_output():
            output.print_json({"plant": config.id, "directory": str(config.directory)}, stream=True)
            output.print_message("serve.ready", plant=config.id, directory=config.directory)

    address_output: AddressOutput = "json" if output.as_json() else "plain"
    outcomes = await run_service(
        config, without=without, address_output=address_output, log_format=log, on_ready=lambda _: ready()
    )
    unconfirmed = [drive for drive, outcome in outcomes.items() if outcome is None or "status" not in outcome]
    for drive in unconfirmed:
        key = "serve.decelerating" if outcomes[drive] == DECELERATING else "serve.unconfirmed"
        LOG.error(output.text(key), extra={"event": {"kind": "stop", "drive": drive}})
    return ExitCode.UNKNOWN if unconfirmed else ExitCode.DONE


command = CliCommand(
    "serve",
    callback=_serve,
    params=[
        Argument(["plant"], metavar="PLANT.toml", key="help.argument.plant"),
        Option(["--without"], multiple=True, metavar="GATEWAY", example="--without web"),
        Option(["--log"], type=Choice(["text", "json"]), default="text", example="--log json"),
    ],
    examples=("drivebus serve plant.toml", "drivebus serve plant.toml --without web --log json"),
)
