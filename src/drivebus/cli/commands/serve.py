"""``serve``: run the service of a plant until it is ended."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from drivebus.cli import output
from drivebus.cli.click_ext import Argument, Choice, CliCommand, Option
from drivebus.cli.errors import ExitCode
from drivebus.cli.extras import require_extra

if TYPE_CHECKING:
    from drivebus.service.config.model import PlantConfig


def _serve(plant: str, web: bool, log: str) -> ExitCode:
    from drivebus.service.config.load import load
    from drivebus.service.process.logging_setup import configure_logging

    config = load(plant)
    if web and config.web.enabled:
        require_extra("server")
    configure_logging(log)
    return asyncio.run(_run(config, web))


async def _run(config: PlantConfig, web: bool) -> ExitCode:
    from drivebus.service.process.logging_setup import LOG
    from drivebus.service.process.main import run_service

    def ready() -> None:
        output.print_json({"plant": config.id, "directory": str(config.directory)}, stream=True)
        output.print_message("serve.ready", plant=config.id, directory=config.directory)

    outcomes = await run_service(config, web=web, announce="json" if output.as_json() else "plain", on_ready=ready)
    unconfirmed = [drive for drive, outcome in outcomes.items() if outcome is None or "status" not in outcome]
    for drive in unconfirmed:
        LOG.error(output.text("serve.unconfirmed", drive=drive), extra={"event": {"kind": "stop", "drive": drive}})
    return ExitCode.UNKNOWN if unconfirmed else ExitCode.DONE


command = CliCommand(
    "serve",
    callback=_serve,
    params=[
        Argument(["plant"], metavar="PLANT.toml", key="help.argument.plant"),
        Option(["--web/--no-web"], default=True, key="help.option.web"),
        Option(["--log"], type=Choice(["text", "json"]), default="text", example="--log json"),
    ],
    examples=("drivebus serve plant.toml", "drivebus serve plant.toml --no-web --log json"),
)
