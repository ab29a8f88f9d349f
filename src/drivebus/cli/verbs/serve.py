"""``serve``: run a plant: its buses, drives, alarms, history and page, until it is told to end."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from drivebus.cli import voice
from drivebus.cli.command import Argument, OneOf, Option, Verb
from drivebus.cli.exits import Exit
from drivebus.cli.server import need_server

if TYPE_CHECKING:
    from drivebus.plant.model import PlantSetting


def _serve(plant: str, web: bool, log: str) -> Exit:
    from drivebus.plant.config.load import load
    from drivebus.plant.logs import begin

    setting = load(plant)
    if web and setting.web.enabled:
        need_server()
    begin(log)
    return asyncio.run(_run(setting, web))


async def _run(setting: PlantSetting, web: bool) -> Exit:
    from drivebus.plant.logs import LOG
    from drivebus.plant.process import run

    def ready() -> None:
        voice.document({"plant": setting.id, "directory": str(setting.directory)}, stream=True)
        voice.tell("serve.ready", plant=setting.id, directory=setting.directory)

    found = await run(setting, web=web, announce="json" if voice.as_json() else "plain", ready=ready)
    left = [drive for drive, told in found.items() if told is None or "word" not in told]
    for drive in left:
        LOG.error(voice.say("serve.unconfirmed", drive=drive), extra={"event": {"kind": "stop", "drive": drive}})
    return Exit.UNKNOWN if left else Exit.DONE


command = Verb(
    "serve",
    callback=_serve,
    params=[
        Argument(["plant"], metavar="PLANT.toml", key="help.argument.plant"),
        Option(["--web/--no-web"], default=True, key="help.option.web"),
        Option(["--log"], type=OneOf(["text", "json"]), default="text", example="--log json"),
    ],
    examples=("drivebus serve plant.toml", "drivebus serve plant.toml --no-web --log json"),
)
